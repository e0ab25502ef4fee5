"""New readings of a sensor that is read more slowly than the message that carries it is sent.

An autopilot reads compass and barometer at some 10 Hz and puts the last reading into messages that
may go out at 200 Hz. A repeated row is no measurement: its stamp is up to 100 ms younger than the
field it carries, which in a turn of 60 °/s is 6° of heading.
"""

from __future__ import annotations

import numpy as np

from companion.types import F64, I64, NS
from drivers.mavlink.samples import Rows

HELD_NS = NS // 4
"""A value that stays for longer is taken as read again, once in this time: at rest a sensor with
coarse counts tells the same twice, and then the stamp does not matter."""


class Readings:
    """Which rows of one stream are new readings, however the stream is cut into calls."""

    def __init__(self) -> None:
        self._value: list[float] | None = None
        self._since_ns = self._last_ns = 0

    def new(self, values: F64, t_ns: I64) -> Rows:
        """(N,) which rows of ``values`` (N, k), N ≥ 1, stamped ``t_ns`` (N,), are new readings."""
        if len(t_ns) == 1 and self._value is not None:
            return np.array([self._one(values[0].tolist(), int(t_ns[0]))])
        held = 0 if self._value is None else 2
        if self._value is not None:
            values = np.concatenate([[self._value, self._value], values])
            t_ns = np.concatenate([[self._since_ns, self._last_ns], t_ns])
        changed = np.concatenate([[True], (values[1:] != values[:-1]).any(axis=1)])
        since = np.maximum.accumulate(np.where(changed, np.arange(len(changed)), 0))
        cell = (t_ns - t_ns[since]) // HELD_NS
        again = np.concatenate([[False], np.diff(cell) != 0])
        self._value = values[-1].tolist()
        self._since_ns, self._last_ns = int(t_ns[since[-1]]), int(t_ns[-1])
        rows: Rows = (changed | again)[held:]
        return rows

    def _one(self, value: list[float], t_ns: int) -> bool:
        """The same for one row: live, at the rate of the inertial messages."""
        changed = value != self._value
        since = self._since_ns
        again = (t_ns - since) // HELD_NS != (self._last_ns - since) // HELD_NS
        self._value, self._last_ns = value, t_ns
        if changed:
            self._since_ns = t_ns
        return changed or again
