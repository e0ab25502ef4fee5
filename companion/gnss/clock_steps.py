"""Steps of a receiver's clock: many keep it within a millisecond of GPS time by jumping.

A step is a whole number of milliseconds in every pseudorange at once. It is taken off, so that a
filter sees a clock that only drifts; a first offset is taken off too.
"""

from __future__ import annotations

from companion.gnss.systems import C

STEP_M = 1e-3 * C
SLACK = 0.05
"""How far from a whole number of milliseconds a step may be: 15 km of drift and motion."""
FORGOTTEN_S = 60.0
"""After such a silence the drift of the clock says nothing about where it is."""


class ClockSteps:
    """What to take off the pseudoranges of one receiver."""

    def __init__(self) -> None:
        self.offset: float | None = None
        """[m]; None before the first solution."""
        self.steps = 0
        self._last: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def take(self, t: float, clock: float, rate: float) -> float:
        """Offset [m] to take off at time ``t`` [s], where the clock reads ``clock`` [m].

        ``rate`` [m/s], NaN where unknown: then the last known one.
        """
        rate = rate if rate == rate else self._last[2]
        if self.offset is None:
            self.offset = clock
        else:
            then, was, drift = self._last
            foreseen = was + 0.5 * (drift + rate) * (t - then)
            whole = round((clock - foreseen) / STEP_M)
            near = abs(clock - foreseen - whole * STEP_M) < SLACK * STEP_M
            if whole and near and t - then < FORGOTTEN_S:
                self.offset += whole * STEP_M
                self.steps += 1
        self._last = (t, clock, rate)
        return self.offset
