"""A satellite receiver on a live link: its bytes as samples on the clock of the run. Pure.

The receiver's time is GPS time; the clocks are matched at the epochs that arrive soonest after they
are stamped (:mod:`drivers.can_imu.clock`), which ``raw_gnss.latency_ms`` tells the time of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, WEEK_S, gps_ns, leap_seconds, week_and_tow
from companion.types import NS, BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.can_imu.clock import SensorClock
from drivers.rtcm.decoder import UNKNOWN, RtcmDecoder
from drivers.ublox.decoder import UbxDecoder

ReceiverSamples = RawGnssSamples | BroadcastSamples | GnssSamples

UBLOX, RTCM = "UBLOX", "RTCM"
"""Names of their streams in the log and for ``gnss.source`` and ``raw_gnss.source``."""
BACK_NS = 2 * NS
SILENCE_NS = 3_600 * NS
"""After a pause as long as this, the week is where the arrival clock has gone on to."""
RTCM_SINCE_S = 2048 * WEEK_S
"""April 2019: a clock of before was never set, or belongs to a recording without dates."""


class ReceiverSession:
    """One receiver's stream, from its bytes to samples stamped with arrival."""

    _times_messages = True
    """Whether its navigation messages come at the time that they are stamped with."""

    def __init__(self, decoder: UbxDecoder | RtcmDecoder) -> None:
        self._decoder = decoder
        self._clock = SensorClock()
        self._last: tuple[int, int] | None = None

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> Sequence[ReceiverSamples]:
        """Take bytes as they arrived; the samples that they complete, messages before epochs.

        All of them have the number ``seq``: what is decoded first must not depend on the order of
        kinds, or a replay of the samples, stream by stream, would see another one.
        """
        found = self._decoder.feed(data)
        order = {BroadcastSamples: 0, RawGnssSamples: 1, GnssSamples: 2}
        out: list[ReceiverSamples] = []
        for kind in order:
            mine = [s for s in found if isinstance(s, kind)]
            out += [self._stamped(s, seq, t_rx_ns) for s in mine]
        return out

    def _stamped(self, samples: ReceiverSamples, seq: int, t_rx_ns: int) -> ReceiverSamples:
        timed = self._times_messages or not isinstance(samples, BroadcastSamples)
        t_ns = self._validity(int(samples.t_ns[0]), t_rx_ns) if timed else t_rx_ns
        return replace(
            samples,
            t_ns=np.array([t_ns], np.int64),
            t_rx_ns=np.array([t_rx_ns], np.int64),
            seq=np.array([seq], np.int64),
        )

    def _validity(self, gps_ns: int, t_rx_ns: int) -> int:
        """Its time on the run's clock; the first message of an epoch moves the match of both."""
        # What is far back is a receiver that started anew; the match begins again, too.
        if self._last is None or gps_ns > self._last[0] or self._last[0] - gps_ns > BACK_NS:
            self._last = gps_ns, self._clock.at(gps_ns, t_rx_ns)
        return self._last[1] + gps_ns - self._last[0]

    @property
    def counters(self) -> Mapping[str, int]:
        """What came, by name."""
        framer, decoded = self._decoder.framer, asdict(self._decoder.counters)
        decoded["malformed"] += framer.bad
        return {"frames": framer.frames, "skipped_bytes": framer.skipped, **decoded}


class RtcmSession(ReceiverSession):
    """RTCM 3, which does not tell the week: the computer's clock does until an ephemeris comes."""

    _times_messages = False

    def __init__(self, source: str = RTCM) -> None:
        self._rtcm = RtcmDecoder(source)
        self._heard_ns: int | None = None
        super().__init__(self._rtcm)

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> Sequence[ReceiverSamples]:
        """As in :class:`ReceiverSession`."""
        if self._rtcm.near == UNKNOWN:
            gps_s = t_rx_ns // NS - GPS_EPOCH_POSIX_S
            # A clock that never was set tells less than nothing.
            if gps_s > RTCM_SINCE_S:
                self._rtcm.near = week_and_tow((gps_s + leap_seconds(gps_s)) * NS)
        elif self._heard_ns is not None and t_rx_ns - self._heard_ns > SILENCE_NS:
            # Half a week later, the nearest to the epoch before would be another one.
            self._rtcm.near = week_and_tow(gps_ns(*self._rtcm.near) + t_rx_ns - self._heard_ns)
        self._heard_ns = t_rx_ns
        return super().feed(seq, t_rx_ns, data)

    @property
    def counters(self) -> Mapping[str, int]:
        """What came, by name; of other stations, and too late for its epoch, beside."""
        assembly = self._rtcm.assembly
        return {**super().counters, "other_station": assembly.foreign, "late": assembly.late}


def receiver_session(protocol: str) -> ReceiverSession:
    """The session for ``raw_gnss.protocol``."""
    return RtcmSession() if protocol == "rtcm3" else ReceiverSession(UbxDecoder(UBLOX))
