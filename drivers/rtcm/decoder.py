"""A stream's bytes as samples: raw epochs and broadcast ephemerides. Pure.

Observations carry the second of the week and not the week. It is the one nearest to what is known:
the epoch before, else the first ephemeris, else :attr:`RtcmDecoder.near`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from companion.gnss import orbit as ob
from companion.gnss.messages.bits import nearest_week
from companion.gnss.messages.rtcm import GALILEO_FNAV, GALILEO_INAV, LENGTHS, ephemeris
from companion.types import BroadcastSamples, RawGnssSamples
from drivers.one_sample import broadcast_sample, raw_sample, stamps
from drivers.rtcm.epochs import Assembly
from drivers.rtcm.framer import Framer
from drivers.rtcm.msm import is_msm, msm

UNKNOWN = 2560, 0.0
"""Weeks of ten bits nearest to this are those from April 2019 to November 2038."""

RtcmSamples = RawGnssSamples | BroadcastSamples


@dataclass(slots=True)
class Counters:
    """What came in."""

    epochs: int = 0
    ephemerides: int = 0
    malformed: int = 0
    """Messages whose CRC fits, but not their length or values."""
    other: int = 0
    """Messages that are not used: station, legacy observations, corrections, GLONASS."""


@dataclass(slots=True)
class RtcmDecoder:
    """Decodes one stream; half frames and half epochs wait."""

    source: str = "rtcm"
    near: tuple[int, float] = UNKNOWN
    """GPS week and second of it, about now, as far as anybody knows."""
    framer: Framer = field(default_factory=Framer)
    counters: Counters = field(default_factory=Counters)
    assembly: Assembly = field(default_factory=Assembly)
    dated: int = 0
    """How often an ephemeris put the time elsewhere than it was: epochs before it are elsewhere."""
    _sure: bool = False
    _seq: int = 0
    _inav: set[int] = field(default_factory=set)

    def feed(self, data: bytes) -> list[RtcmSamples]:
        """Samples that ``data`` completes, in order; ``t_ns`` = ``t_rx_ns``, GPS time."""
        out: list[RtcmSamples] = []
        for payload in self.framer.feed(data):
            number = payload[0] << 4 | payload[1] >> 4 if len(payload) > 1 else 0
            if is_msm(number):
                out += self._observations(payload)
            elif number in LENGTHS:
                out += self._ephemeris(number, payload)
            else:
                self.counters.other += 1
        return out

    def _observations(self, payload: bytes) -> list[RtcmSamples]:
        message = msm(payload)
        if message is None:
            self.counters.malformed += 1
            return []
        self.counters.other += message.tow is None
        out: list[RtcmSamples] = []
        for tow, sat, signal, columns in self.assembly.take(message):
            week = nearest_week(tow, *self.near)
            self.near = week, tow
            self.counters.epochs += 1
            self._seq += 1
            at = stamps(week, tow, self._seq)
            out.append(raw_sample(self.source, at, week, tow, sat, signal, columns))
        return out

    def _ephemeris(self, number: int, payload: bytes) -> list[RtcmSamples]:
        found = ephemeris(payload, self.near)
        if found is None:
            self.counters.malformed += 1
            return []
        row, fits = found
        sat = int(row[ob.E_SAT])
        if number == GALILEO_INAV:
            self._inav.add(sat)
        elif number == GALILEO_FNAV and sat in self._inav:
            # One clock a satellite, that of I/NAV, which everything else here uses.
            self.counters.other += 1
            return []
        if not fits and not self._sure:
            self.near = int(row[ob.E_WEEK]), float(row[ob.E_TOE])
            self.dated += 1
        self._sure = True
        self.counters.ephemerides += 1
        self._seq += 1
        return [broadcast_sample(self.source, stamps(*self.near, self._seq), sat, row)]
