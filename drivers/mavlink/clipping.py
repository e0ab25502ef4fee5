"""The counters of VIBRATION: an accelerometer was at the end of its range since the last one."""

from __future__ import annotations

import numpy as np

from companion.types import I64, NS
from drivers.mavlink.samples import ACCELEROMETER

COUNTED = 0.5
"""In :attr:`companion.types.ImuSamples.clipped`."""
HOLDS_NS = 2 * NS
"""A rise speaks for the samples behind it until the next message, but for no longer."""


class ClipCounters:
    """Which accelerometers' counters rose from the last message but one to the last one."""

    def __init__(self) -> None:
        self._last: I64 | None = None
        self._rose = np.zeros(3, np.bool_)
        self._rx_ns = 0

    def take(self, counts: I64, rx_ns: int) -> None:
        """The counters (N, 3) of messages as they arrived; one that falls has begun anew."""
        for now in counts:
            if self._last is not None:
                self._rose = now > self._last
            self._last, self._rx_ns = now, rx_ns

    def rising(self, name: str, rx_ns: int) -> bool:
        """Whether that holds for an inertial message ``name`` arriving at ``rx_ns``."""
        return bool(self._rose[ACCELEROMETER.get(name, 0)]) and rx_ns - self._rx_ns <= HOLDS_NS
