"""Counting what arrives during a check. Pure: bytes, frames and samples in, columns out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.runtime.check.heard import ImuHeard, StreamHeard, SystemHeard, Vec3
from companion.types import (
    F64,
    I64,
    NS,
    AnySamples,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
)
from drivers.can_imu.decoder import CanCounters
from drivers.mavlink.columns import decode
from drivers.mavlink.dialect import message_id, message_name
from drivers.mavlink.framer import StreamFramer

_HEARTBEAT = message_id("HEARTBEAT")
_ENOUGH = 20
"""Samples from which on noise is worth a number."""


def rate_hz(t_rx_ns: I64) -> float:
    """Samples a second between the first and the last arrival; 0 for fewer than two."""
    if len(t_rx_ns) < 2 or t_rx_ns[-1] == t_rx_ns[0]:
        return 0.0
    return float((len(t_rx_ns) - 1) * NS / (t_rx_ns[-1] - t_rx_ns[0]))


def _noise(values: F64, rate: float) -> float:
    """White noise density of the noisiest axis: σ(differences) / √2, over √rate."""
    if len(values) < _ENOUGH or rate <= 0:
        return float("nan")
    return float(np.diff(values, axis=0).std(axis=0).max() / np.sqrt(2.0 * rate))


def _mean(values: F64) -> Vec3:
    x, y, z = values.mean(axis=0).tolist()
    return x, y, z


class SampleTally:
    """Collects decoded samples by stream."""

    def __init__(self) -> None:
        self._imu: dict[str, tuple[str, list[ImuSamples]]] = {}
        self._aids: dict[tuple[str, str], list[AnySamples]] = {}

    def add(self, link: str, samples: AnySamples) -> None:
        """Samples that came over ``link``."""
        if isinstance(samples, ImuSamples):
            self._imu.setdefault(samples.source, (link, []))[1].append(samples)
        else:
            self._aids.setdefault((type(samples).__name__, samples.source), []).append(samples)

    def imus(self, axes: F64, counters: dict[str, CanCounters]) -> tuple[ImuHeard, ...]:
        """Inertial streams; ``axes`` (3, 3) turns them to body, ``counters`` are the drivers'."""
        return tuple(
            _imu(source, link, parts, axes, counters.get(source))
            for source, (link, parts) in self._imu.items()
        )

    def streams(self) -> tuple[StreamHeard, ...]:
        """Aiding streams."""
        out = []
        for (_, source), parts in self._aids.items():
            t = np.concatenate([p.t_rx_ns for p in parts])
            last = parts[-1].take(slice(-1, None))
            if isinstance(last, GnssSamples):
                out.append(StreamHeard("gnss", source, len(t), rate_hz(t), last))
            elif isinstance(last, BaroSamples):
                out.append(StreamHeard("baro", source, len(t), rate_hz(t), last))
            elif isinstance(last, MagSamples):
                out.append(StreamHeard("mag", source, len(t), rate_hz(t), last))
        return tuple(out)


def _imu(
    source: str, link: str, parts: Sequence[ImuSamples], axes: F64, counters: CanCounters | None
) -> ImuHeard:
    gyro = np.degrees(np.concatenate([p.gyro_b for p in parts])) @ axes.T
    accel = np.concatenate([p.accel_b for p in parts]) @ axes.T
    rate = rate_hz(np.concatenate([p.t_rx_ns for p in parts]))
    counts = counters if counters is not None else CanCounters()
    return ImuHeard(
        source=source,
        link=link,
        samples=len(gyro),
        rate_hz=rate,
        gyro_mean_dps=_mean(gyro),
        accel_mean_mps2=_mean(accel),
        gyro_noise_dps_rthz=_noise(gyro, rate),
        accel_noise_mps2_rthz=_noise(accel, rate),
        lost=counts.lost,
        repeated=counts.repeated,
        malformed=counts.malformed + counts.incomplete,
        saturated=counts.saturated,
    )


class MavlinkTally:
    """Who says what on a MAVLink link, whether it is our vehicle or not."""

    def __init__(self) -> None:
        self._framer = StreamFramer()
        self._messages: Counter[tuple[int, int, str]] = Counter()
        self._before: Counter[tuple[int, int, str]] = Counter()
        self._autopilots: dict[tuple[int, int], int] = {}
        self.bytes = 0

    @property
    def bad_bytes(self) -> int:
        """Bytes that belong to no frame."""
        return self._framer.bad_bytes

    def feed(self, data: bytes) -> None:
        """Bytes as they arrived."""
        self.bytes += len(data)
        buf, index = self._framer.feed(data)
        for row in np.flatnonzero(index.checked).tolist():
            sender = int(index.system[row]), int(index.component[row])
            msgid = int(index.msgid[row])
            self._messages[(*sender, message_name(msgid))] += 1
            if msgid == _HEARTBEAT:
                beat = decode(buf, index, msgid, np.array([row], np.int64))
                self._autopilots[sender] = int(beat["autopilot"][0])

    def mark(self) -> None:
        """From here on counts :meth:`since_mark`."""
        self._before = self._messages.copy()

    def since_mark(self, sender: tuple[int, int] | None) -> Counter[str]:
        """Messages of one sender since the mark, by name."""
        later = self._messages - self._before
        return Counter({name: n for (s, c, name), n in later.items() if (s, c) == sender})

    def systems(self, seconds: float) -> tuple[SystemHeard, ...]:
        """Every sender, with its messages a second."""
        senders = sorted({key[:2] for key in self._messages})
        return tuple(self._system(sender, seconds) for sender in senders)

    def _system(self, sender: tuple[int, int], seconds: float) -> SystemHeard:
        counts = {name: n for (s, c, name), n in self._messages.items() if (s, c) == sender}
        kind = self._autopilots.get(sender, mavlink.MAV_AUTOPILOT_INVALID)
        rates = {name: n / seconds for name, n in sorted(counts.items())}
        return SystemHeard(*sender, _autopilot_name(kind), sum(counts.values()), rates)


def _autopilot_name(kind: int) -> str:
    """``ArduPilot``, ``PX4``, another name of MAV_AUTOPILOT; empty for what is none."""
    known = {
        mavlink.MAV_AUTOPILOT_INVALID: "",
        mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot",
        mavlink.MAV_AUTOPILOT_PX4: "PX4",
    }
    entry = mavlink.enums["MAV_AUTOPILOT"].get(kind)
    other = entry.name.removeprefix("MAV_AUTOPILOT_").lower() if entry is not None else str(kind)
    return known.get(kind, other)
