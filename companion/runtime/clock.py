"""The clock of a run: like UTC, and never steps.

run time = wall clock at the start + monotonic time since then. The wall clock may be set while the
process runs (no real-time clock, then NTP or GNSS); intervals of a run must not notice.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

Clock = Callable[[], int]

MAX_STAMP_AGE_NS = 1_000_000_000
"""A kernel stamp further back than this is not believed."""


class Reading(NamedTuple):
    """The clocks at one moment [ns]."""

    run: int
    monotonic: int
    wall: int


class RunClock:
    """Wall clock once, monotonic clock ever after."""

    def __init__(self, wall: Clock = time.time_ns, monotonic: Clock = time.monotonic_ns) -> None:
        self._wall = wall
        self._monotonic = monotonic
        self._offset = wall() - monotonic()

    def read(self) -> Reading:
        """All clocks now."""
        monotonic = self._monotonic()
        return Reading(monotonic + self._offset, monotonic, self._wall())


def arrival_ns(stamp_ns: int | None, now: Reading) -> int:
    """Run time of an arrival that the kernel stamped with the wall clock, or now.

    The two clocks are compared at this very moment: a wall clock that was set since the start does
    no harm, one that was set since the stamp makes it unbelievable, and then it is not used.
    """
    if stamp_ns is None:
        return now.run
    age = now.wall - stamp_ns
    return now.run - age if 0 <= age < MAX_STAMP_AGE_NS else now.run
