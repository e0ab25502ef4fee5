"""Steps and jumps of a receiver's clock: many keep it within a millisecond of GPS time by stepping.

A step is a whole number of milliseconds in every pseudorange at once. It is taken off, so that a
filter sees a clock that only drifts; a first offset is taken off too. What is no whole number is a
jump (a receiver that started again, or was silent for long): it is taken off as well, as far as one
epoch tells, and said, so that the filter lets its clock go.
"""

from __future__ import annotations

from companion.gnss.systems import C

STEP_M = 1e-3 * C


def unforeseen(seconds: float) -> float:
    """How far off [m] a clock may be that was extrapolated by its drift over ``seconds``.

    A bad fix, a drift known to 5 m/s, and a quartz that warms up by 1 m/s².
    """
    return 100.0 + 5.0 * seconds + 0.5 * seconds * seconds


class ClockSteps:
    """What to take off the pseudoranges of one receiver."""

    def __init__(self) -> None:
        self.offset: float | None = None
        """[m]; None before the first solution."""
        self.steps = 0
        self.jumps = 0
        self._last: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def take(self, t: float, clock: float, rate: float, doubt: float = 0.0) -> float:
        """Offset [m] to take off at time ``t`` [s], where the clock reads ``clock`` [m].

        ``rate`` [m/s], NaN where unknown: then the last known one. ``doubt`` [m]: how far ``clock``
        may be off itself.
        """
        rate = rate if rate == rate else self._last[2]
        if self.offset is None:
            self.offset = clock
        else:
            then, was, drift = self._last
            off = clock - was - 0.5 * (drift + rate) * (t - then)
            slack = unforeseen(abs(t - then)) + doubt
            whole = round(off / STEP_M)
            if whole and slack < 0.25 * STEP_M and abs(off - whole * STEP_M) < slack:
                self.offset += whole * STEP_M
                self.steps += 1
            elif abs(off) > slack:
                self.offset += off
                self.jumps += 1
        self._last = (t, clock, rate)
        return self.offset
