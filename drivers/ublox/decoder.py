"""A receiver's bytes as samples: raw epochs, broadcast messages, its own fixes. Pure.

Times of validity are GPS time; whoever owns the clock of the run matches them to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from companion.gnss.messages.d1 import D1
from companion.gnss.messages.inav import Inav
from companion.gnss.messages.lnav import Lnav
from companion.types import F64, BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.one_sample import Stamps, broadcast_sample, raw_sample, stamps
from drivers.ublox.framer import Frame, Framer
from drivers.ublox.interference import KINDS, Interference
from drivers.ublox.messages import NAV_PVT, RXM_RAWX, RXM_SFRBX, Pvt, pvt, raw_epoch, subframe

_DECODERS: dict[tuple[int, int], Callable[[int], Lnav | Inav | D1]] = {
    (1, 10): Lnav,
    (2, 8): Inav,
    (3, 10): D1,
}
"""By hundreds of the satellite's number and words of a piece."""
_CARRIERS = {1: (0,), 2: (0, 1, 5, 6), 3: (0, 2, 4)}
"""Signals whose messages are those: L1 C/A; E1-B and E5b-I (0: firmware that does not say);
B1I, B2I and B3I with D1."""

UbxSamples = RawGnssSamples | BroadcastSamples | GnssSamples


@dataclass(slots=True)
class Counters:
    """What came in."""

    epochs: int = 0
    ephemerides: int = 0
    fixes: int = 0
    malformed: int = 0
    """Frames whose check bytes fit, but not their length or values."""
    other: int = 0


@dataclass(slots=True)
class UbxDecoder:
    """Decodes one receiver's stream; half frames wait."""

    source: str = "ublox"
    framer: Framer = field(default_factory=Framer)
    counters: Counters = field(default_factory=Counters)
    leap_s: int | None = None
    _interference: Interference = field(default_factory=Interference)
    _time: tuple[int, float] | None = None
    _messages: dict[int, Lnav | Inav | D1] = field(default_factory=dict)
    _seq: int = 0

    def feed(self, data: bytes) -> list[UbxSamples]:
        """Samples that ``data`` completes, in order; ``t_ns`` = ``t_rx_ns``, GPS time."""
        out = []
        for frame in self.framer.feed(data):
            sample = self._frame(frame)
            if sample is not None:
                out.append(sample)
        return out

    def _frame(self, frame: Frame) -> UbxSamples | None:
        if frame.kind == RXM_RAWX:
            return self._raw(frame.payload)
        if frame.kind == RXM_SFRBX:
            return self._subframe(frame.payload)
        if frame.kind == NAV_PVT:
            return self._fix(frame.payload)
        if frame.kind in KINDS:
            self.counters.malformed += not self._interference.take(frame.kind, frame.payload)
            return None
        self.counters.other += 1
        return None

    def _stamps(self, week: int, tow: float) -> Stamps:
        self._seq += 1
        return stamps(week, tow, self._seq)

    def _raw(self, payload: bytes) -> RawGnssSamples | None:
        epoch = raw_epoch(payload)
        if epoch is None:
            self.counters.malformed += 1
            return None
        self._time = (epoch.week, epoch.tow)
        self.leap_s = epoch.leap_s if epoch.leap_s is not None else self.leap_s
        self.counters.epochs += 1
        at = self._stamps(epoch.week, epoch.tow)
        return raw_sample(
            self.source, at, epoch.week, epoch.tow, epoch.sat, epoch.signal, epoch.columns
        )

    def _subframe(self, payload: bytes) -> BroadcastSamples | None:
        piece = subframe(payload)
        if piece is None:
            self.counters.other += 1
            return None
        kind = _DECODERS.get((piece.sat // 100, len(piece.words)))
        if kind is None or piece.signal not in _CARRIERS[piece.sat // 100] or self._time is None:
            self.counters.other += 1
            return None
        decoder = self._messages.setdefault(piece.sat, kind(piece.sat))
        found = decoder.take(list(piece.words), *self._time)
        return None if found is None else self._broadcast(*found)

    def _broadcast(self, sat: int, values: F64) -> BroadcastSamples:
        assert self._time is not None
        self.counters.ephemerides += sat > 0
        return broadcast_sample(self.source, self._stamps(*self._time), sat, values)

    def _fix(self, payload: bytes) -> GnssSamples | None:
        fix = pvt(payload)
        if fix is None:
            self.counters.malformed += 1
            return None
        week = fix.week
        if week is None:
            if self._time is None:
                return None
            # The fix of the epoch before a turn of the week comes after it, or the reverse.
            week = self._time[0] + round((self._time[1] - fix.tow) / 604_800.0)
        self.counters.fixes += 1
        return _gnss(self.source, fix, self._stamps(week, fix.tow), self._interference.share)


def _gnss(source: str, fix: Pvt, at: Stamps, interference: float) -> GnssSamples:
    one = np.array
    return GnssSamples(
        source, *at, one([fix.lat]), one([fix.lon]), one([fix.height]), one([fix.vel_n]),
        # A horizontal accuracy is that of both components together.
        one([[fix.sd_h / np.sqrt(2), fix.sd_h / np.sqrt(2), fix.sd_v]]),
        one([[fix.sd_vel / np.sqrt(3)] * 3]), one([fix.num_sats], np.int64),
        one([fix.fix_type], np.int64), one([interference]),
    )  # fmt: skip
