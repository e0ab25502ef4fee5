"""Steps and jumps of a receiver's clock: many keep it within a millisecond of GPS time by stepping.

A step is a whole number of milliseconds in every pseudorange at once. It is taken off, so that a
filter sees a clock that only drifts; a first offset is taken off too. What is no whole number is a
jump (a receiver that started again, or was silent for long): it is taken off as well, as far as one
epoch tells, and said, so that the filter lets its clock go.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.gnss.systems import C
from companion.types import F64

STEP_M = 1e-3 * C

# --- entries of what is known of a clock
C_OFFSET, C_TIME, C_CLOCK, C_RATE = range(4)
"""What is taken off the pseudoranges [m], NaN before the first solution; when the clock was last
read [s], what it read [m], and its rate [m/s]."""
C_STEPS, C_JUMPS = 4, 5
"""How many there were."""
CLOCK_SIZE = 6


def new_clock() -> F64:
    """(:data:`CLOCK_SIZE`,) of a receiver of which nothing is known."""
    clock = np.zeros(CLOCK_SIZE)
    clock[C_OFFSET] = np.nan
    return clock


@njit("f8(f8)", cache=True, counted=False)
def unforeseen(seconds: float) -> float:
    """How far off [m] a clock may be that was extrapolated by its drift over ``seconds``.

    A bad fix, a drift known to 5 m/s, and a quartz that warms up by 1 m/s².
    """
    return 100.0 + 5.0 * seconds + 0.5 * seconds * seconds


@njit("f8(f8[::1], f8, f8, f8, f8)", cache=True, counted=False)
def offset_at(known: F64, t: float, clock: float, rate: float, doubt: float) -> float:
    """Offset [m] to take off at time ``t`` [s], where the clock reads ``clock`` [m].

    ``known`` (:data:`CLOCK_SIZE`,) goes on. ``rate`` [m/s], NaN where unknown: then the last known
    one. ``doubt`` [m]: how far ``clock`` may be off itself.
    """
    if np.isnan(rate):
        rate = known[C_RATE]
    if np.isnan(known[C_OFFSET]):
        known[C_OFFSET] = clock
    else:
        passed = t - known[C_TIME]
        off = clock - known[C_CLOCK] - 0.5 * (known[C_RATE] + rate) * passed
        slack = unforeseen(abs(passed)) + doubt
        whole = np.rint(off / STEP_M)
        if whole != 0.0 and slack < 0.25 * STEP_M and abs(off - whole * STEP_M) < slack:
            known[C_OFFSET] += whole * STEP_M
            known[C_STEPS] += 1.0
        elif abs(off) > slack:
            known[C_OFFSET] += off
            known[C_JUMPS] += 1.0
    known[C_TIME], known[C_CLOCK], known[C_RATE] = t, clock, rate
    return float(known[C_OFFSET])


class ClockSteps:
    """What was taken off the pseudoranges of one receiver."""

    def __init__(self) -> None:
        self.known = new_clock()

    @property
    def offset(self) -> float | None:
        """[m]; None before the first solution."""
        offset = float(self.known[C_OFFSET])
        return None if offset != offset else offset

    @property
    def steps(self) -> int:
        """Whole milliseconds, so far."""
        return int(self.known[C_STEPS])

    @property
    def jumps(self) -> int:
        """Everything else that was no drift."""
        return int(self.known[C_JUMPS])
