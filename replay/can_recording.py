"""Inertial samples out of recorded CAN traffic: the live decoders, fed from a file.

Which units there are is what the configuration says (``[[can.imu]]``), else what the identifiers on
the bus give away. Units that only a DBC describes need the configuration.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from companion.config import CanBus, CanImu
from companion.types import I64, ImuSamples, LogFormatError, Recording
from drivers.can_imu import CanImuDecoder, make_decoder
from replay.candump import CanFrames, read_frames
from replay.streams import G, finish_vehicle

_KNOWN = ("dronecan", "xsens-mti", "sbg-ellipse", "openimu-j1939")
_STREAM = {"dronecan": "RawIMU", "openimu-j1939": "OpenIMU"}
_FEWEST = 10
"""Fewer samples than this are another device's frames under the same identifiers."""


def read_can(path: Path, buses: Sequence[CanBus] = ()) -> Recording:
    """The inertial units of recorded CAN traffic, as one vehicle named ``can``.

    ``buses``: the configuration's; where it names no unit, the known protocols are looked for.
    Raises :class:`LogFormatError` where there is no unit, ``ConfigError`` for a DBC that is wrong.
    """
    frames = read_frames(path)
    notes = []
    if frames.bad_lines:
        notes.append(f"{frames.bad_lines} line(s) that are no CAN frame, skipped")
    units: list[ImuSamples] = []
    configured = [(bus, imu) for bus in buses for imu in bus.imu]
    for decoder, rows in _configured(frames, configured) if configured else _found(frames):
        samples = _decoded(frames, decoder, rows)
        notes += _oddities(decoder)
        if samples is not None and (configured or _plausible(samples)):
            units.append(samples)
    vehicle, more = finish_vehicle("can", units, ())
    if not vehicle.imu:
        raise LogFormatError(
            f"{path}: {len(frames)} CAN frames, but none of an inertial unit that is known; "
            "name it in [[can.imu]] of --config"
        )
    return Recording(str(path), "candump", (vehicle,), tuple(notes + more))


def _configured(
    frames: CanFrames, units: Sequence[tuple[CanBus, CanImu]]
) -> list[tuple[CanImuDecoder, I64]]:
    """Decoders of the configured units, and the frames of each."""
    out = []
    for bus, imu in units:
        decoder = make_decoder(
            imu.name,
            imu.protocol,
            node_id=imu.node_id,
            axes=imu.axes,
            rate_hz=imu.rate_hz,
            gyro_range_dps=imu.gyro_range_dps,
            accel_range_mps2=imu.accel_range_mps2,
            dbc=imu.dbc,
        )
        # A recording may have been made under another name of the bus.
        channel = frames.channels.index(bus.channel) if bus.channel in frames.channels else None
        out.append((decoder, _rows(frames, decoder, channel)))
    return out


def _found(frames: CanFrames) -> list[tuple[CanImuDecoder, I64]]:
    """Decoders of the units whose identifiers are on a channel, and the frames of each."""
    out = []
    for channel, channel_name in enumerate(frames.channels):
        suffix = f"@{channel_name}" if len(frames.channels) > 1 else ""
        for protocol in _KNOWN:
            rows = _rows(frames, make_decoder("", protocol), channel)
            nodes = _nodes(frames, protocol, rows)
            for node in nodes:
                name = _STREAM.get(protocol, protocol)
                name += f".{node}" if len(nodes) > 1 else ""
                decoder = make_decoder(name + suffix, protocol, node_id=node)
                out.append((decoder, _rows(frames, decoder, channel)))
    return out


def _nodes(frames: CanFrames, protocol: str, rows: I64) -> list[int]:
    """Nodes or addresses that send a protocol's frames; a single 0 where it has none."""
    if not rows.size:
        return []
    if protocol not in _STREAM:
        return [0]
    mask = 0x7F if protocol == "dronecan" else 0xFF
    found: list[int] = np.unique(frames.can_id[rows] & mask).tolist()
    return found


def _rows(frames: CanFrames, decoder: CanImuDecoder, channel: int | None) -> I64:
    """The frames that a decoder can want, of one channel or of all."""
    key = frames.can_id * 2 + frames.extended
    wanted = [k for k in np.unique(key).tolist() if decoder.wants(k >> 1, bool(k & 1))]
    chosen = np.isin(key, wanted)
    if channel is not None:
        chosen &= frames.channel == channel
    return np.flatnonzero(chosen)


def _decoded(frames: CanFrames, decoder: CanImuDecoder, rows: I64) -> ImuSamples | None:
    """The samples of a decoder that is fed the frames ``rows``; ``seq`` is the frame's number."""
    # Channels are stamped apart and merged: a frame may stand behind a later one.
    arrival = np.maximum.accumulate(frames.t_ns)
    columns = (
        rows,
        arrival[rows],
        frames.can_id[rows],
        frames.extended[rows],
        frames.start[rows],
        frames.start[rows] + frames.length[rows],
    )
    data, feed = frames.data, decoder.feed
    for seq, t_rx, can_id, extended, a, b in zip(*(c.tolist() for c in columns), strict=True):
        feed(seq, t_rx, can_id, extended, data[a:b])
    return decoder.take()


def _plausible(samples: ImuSamples) -> bool:
    """Whether frames that were only taken for an inertial unit's by their identifiers are one's."""
    force = float(np.median(np.linalg.norm(samples.accel_b, axis=1)))
    return len(samples) >= _FEWEST and 0.5 * G < force < 2.0 * G


def _oddities(decoder: CanImuDecoder) -> list[str]:
    """A line for each counter that a person should know of."""
    c = decoder.counters
    name = decoder.source
    if not c.frames:
        return [f"{name}: no frame of it in the recording"]
    counts = (
        (c.lost, f"samples lost, by the unit's counter, beside {c.samples}"),
        (c.incomplete, f"samples given up for a missing frame, beside {c.samples}"),
        (c.saturated, f"of {c.samples} samples saturated"),
        (c.malformed, "malformed frames, dropped"),
        (c.restarts, "restart(s) of the unit's clock"),
    )
    return [f"{name}: {count} {what}" for count, what in counts if count]
