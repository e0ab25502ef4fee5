"""A u-blox receiver on a live link: its bytes as samples on the clock of the run. Pure.

The receiver's time is GPS time; the clocks are matched at the epochs that arrive soonest after they
are stamped (:mod:`drivers.can_imu.clock`), which ``raw_gnss.latency_ms`` tells the time of.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from companion.types import BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.can_imu.clock import SensorClock
from drivers.ublox.decoder import UbxDecoder, UbxSamples

SOURCE = "UBLOX"
"""Name of its streams in the log and for ``gnss.source`` and ``raw_gnss.source``."""


BACK_NS = 2_000_000_000


class UbloxSession:
    """One receiver's stream, from its bytes to samples stamped with arrival."""

    def __init__(self, source: str = SOURCE) -> None:
        self._decoder = UbxDecoder(source)
        self._clock = SensorClock()
        self._last: tuple[int, int] | None = None

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> Sequence[UbxSamples]:
        """Take bytes as they arrived; the samples that they complete, messages before epochs.

        All of them have the number ``seq``: what is decoded first must not depend on the order of
        kinds, or a replay of the samples, stream by stream, would see another one.
        """
        found = self._decoder.feed(data)
        order = {BroadcastSamples: 0, RawGnssSamples: 1, GnssSamples: 2}
        out: list[UbxSamples] = []
        for kind in order:
            mine = [s for s in found if isinstance(s, kind)]
            out += [self._stamped(s, seq, t_rx_ns) for s in mine]
        return out

    def _stamped(self, samples: UbxSamples, seq: int, t_rx_ns: int) -> UbxSamples:
        gps_ns = int(samples.t_ns[0])
        return replace(
            samples,
            t_ns=np.array([self._validity(gps_ns, t_rx_ns)], np.int64),
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
