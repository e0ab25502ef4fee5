"""Whether a receiver's stamps can be true, looked at now and then: it says so, and changes nothing.

Receivers keep their time to a microsecond; what stamps a file, or converts one, may be off by a
tenth of a second, which is a place 60 m off and no contradiction.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from companion.gnss.time_error import time_error
from companion.types import F64, Event, Flags

EVERY_S = 10.0
LOOKS = 6
"""Looks that count: what is doubted lasts for a minute."""
SURE, LEAST_S = 3.5, 0.01
"""Deviations, and seconds, that the median of the looks must exceed. Errors of the ranges last from
look to look: their mean is no better than one."""
PLACE_MPS = 600.0
"""Error of the place for each second of time, about: half on the walk, and as much at rest."""


class TimeDoubt:
    """The latest looks at one stream. Times ``now`` are GPS time [s]."""

    def __init__(self) -> None:
        self._slot = -math.inf
        self._looks: deque[tuple[float, float]] = deque(maxlen=LOOKS)
        self._said = False

    def due(self, now: F64) -> Flags:
        """(N,) the first epoch of each ten seconds, of epochs in order; they count as looked at."""
        slots = np.floor(now / EVERY_S)
        first = np.empty(len(slots), np.bool_)
        if len(slots):
            first[0], first[1:] = slots[0] != self._slot, slots[1:] != slots[:-1]
            self._slot = float(slots[-1])
        return first

    def look(self, t_ns: int, rows: F64, x: F64) -> list[Event]:
        """Look at an epoch's corrected satellites (m, 12), seen from ``x`` (3,), ECEF."""
        found = np.empty(2)
        if not time_error(np.ascontiguousarray(rows), np.ascontiguousarray(x), found):
            return []
        self._looks.append((float(found[0]), float(found[1])))
        if len(self._looks) < LOOKS:
            return []
        error, sd = np.median(np.array(self._looks), axis=0).tolist()
        # Half the limit once it was said: what is near it would come and go.
        limit = max(SURE * sd, LEAST_S) * (0.5 if self._said else 1.0)
        doubted = abs(error) > limit
        if doubted == self._said:
            return []
        self._said = doubted
        if not doubted:
            return [Event(t_ns, "receiver-time", "the receiver's time fits the satellites again")]
        text = (
            f"the receiver's time is {1e3 * abs(error):.0f} ± {1e3 * sd:.0f} ms "
            f"{'behind' if error > 0 else 'ahead of'} where the satellites are: its place is some "
            f"{PLACE_MPS * abs(error):.0f} m off"
        )
        return [Event(t_ns, "receiver-time", text, "warning")]
