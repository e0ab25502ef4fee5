"""Messages of one moment put together: an epoch is as many of them as there are systems. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.types import F64, I64
from drivers.rtcm.msm import Msm

_OTHER_STATION_S = 10.0
"""A station is let go for another that was heard for as long without it."""
_BACK_S = 2.0
"""What is further back is a receiver that started anew."""
_HALF_WEEK_S = 302_400.0


@dataclass(slots=True)
class Assembly:
    """Collects messages until one says that it is the last, or the next moment begins."""

    foreign: int = 0
    """Messages of another station on the same line: two receivers are no epoch."""
    late: int = 0
    """Messages that came after the end of their epoch, or go back in time."""
    _station: int | None = None
    _tow: float | None = None
    _parts: list[Msm] = field(default_factory=list)
    _done: float | None = None
    """Second of week of the last epoch that was given out."""
    _ends_told: bool = True
    """Whether the mark of the last message is right: some encoders set it on every one."""
    _foreign_since: float | None = None

    def take(self, message: Msm) -> list[tuple[float, I64, I64, F64]]:
        """Epochs that it completes, oldest first: second of week, satellites, signals, columns."""
        if not self._ours(message):
            return []
        out = []
        if message.tow is not None:
            if self._tow is not None and message.tow != self._tow:
                out += self._finish()
            if self._done is not None and -_BACK_S < _since(message.tow, self._done) <= 0.0:
                self._ends_told = self._ends_told and message.tow != self._done
                self.late += 1
                return out
            self._tow = message.tow
            self._parts.append(message)
        if message.last and self._ends_told:
            out += self._finish()
        return out

    def _ours(self, message: Msm) -> bool:
        if self._station is None or message.station == self._station:
            self._station, self._foreign_since = message.station, None
            return True
        self.foreign += 1
        if message.tow is not None:
            if self._foreign_since is None:
                self._foreign_since = message.tow
            if _since(message.tow, self._foreign_since) > _OTHER_STATION_S:
                self._station = self._foreign_since = self._done = self._tow = None
                self._parts = []
        return False

    def _finish(self) -> list[tuple[float, I64, I64, F64]]:
        if self._tow is None:
            return []
        parts, tow = self._parts, self._tow
        self._parts, self._tow, self._done = [], None, tow
        sat = np.concatenate([p.sat for p in parts])
        # A system with more than 64 cells says some of it in a second message.
        _, first = np.unique(sat, return_index=True)
        keep = np.sort(first)
        signal = np.concatenate([p.signal for p in parts])[keep]
        columns = np.concatenate([p.columns for p in parts], axis=1)[:, keep]
        return [(tow, sat[keep], signal, columns)] if len(keep) else []


def _since(tow: float, before: float) -> float:
    """Seconds between two seconds of week, of neighbouring weeks where that is nearer."""
    return (tow - before + _HALF_WEEK_S) % (2.0 * _HALF_WEEK_S) - _HALF_WEEK_S
