"""Writes a recording as a MAVLink 2 telemetry log, as a ground station beside ArduPilot would.

Each frame follows its time of arrival (big-endian microseconds since 1970), frames in the order of
arrival. Times inside the messages are on the autopilot's boot clock. Packing is pymavlink's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import I64, NS, CompanionError, VehicleRecording
from replay.simulator.messages import (
    MAV_TYPES,
    Messages,
    baro_messages,
    gnss_messages,
    imu_messages,
    rows_of,
    slow_messages,
    truth_messages,
)

BOOT_S = 20.0
"""The autopilot booted this long before the first IMU sample."""


def write_tlog(recording: VehicleRecording, path: Path, vehicle_kind: str = "unknown") -> None:
    """Write the first IMU, receiver, barometer and magnetometer of ``recording``, and its truth.

    HIGHRES_IMU (with the newest magnetometer sample), GPS_RAW_INT, SCALED_PRESSURE, SIM_STATE right
    after the IMU sample it belongs to, HEARTBEAT and SYSTEM_TIME every second; system 1,
    component 1. ``vehicle_kind`` as in the configuration. Raises :class:`CompanionError` without
    an IMU, with heights not above the ellipsoid, or if the file cannot be written.
    """
    if not recording.imu or len(recording.imu[0]) == 0:
        raise CompanionError("a tlog needs an IMU: this recording has none")
    if recording.height_datum != "hae":
        raise CompanionError("a tlog is written from heights above the ellipsoid")
    imu = recording.imu[0]
    boot_ns = int(imu.t_ns[0]) - round(BOOT_S * NS)
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    streams = [
        (
            imu.t_rx_ns,
            imu.seq,
            imu_messages(mav, imu, next(iter(recording.mag), None), boot_ns),
        )
    ]
    if recording.truth is not None:
        # SIM_STATE carries no time: it may only follow an IMU sample of its own time.
        truth = recording.truth.take(np.isin(recording.truth.t_ns, imu.t_ns))
        streams.append((truth.t_rx_ns, truth.seq, truth_messages(mav, truth)))
    streams += [(g.t_rx_ns, g.seq, gnss_messages(mav, g, boot_ns)) for g in recording.gnss[:1]]
    streams += [(b.t_rx_ns, b.seq, baro_messages(mav, b, boot_ns)) for b in recording.baro[:1]]
    wall_ns = np.arange(int(imu.t_rx_ns[0]), int(imu.t_rx_ns[-1]) + 1, NS)
    slow = slow_messages(mav, wall_ns, boot_ns, MAV_TYPES.get(vehicle_kind, 0))
    streams.append((np.repeat(wall_ns, 2), np.full(2 * len(wall_ns), -1), slow))
    try:
        with path.open("wb") as file:
            file.writelines(_framed(mav, streams))
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from None


def _framed(mav: Any, streams: list[tuple[I64, I64, Messages]]) -> Iterator[bytes]:
    """All messages in order of arrival, then of arrival number, stamped and packed."""
    rx = np.concatenate([s[0] for s in streams])
    seq = np.concatenate([s[1] for s in streams])
    stream = np.repeat(np.arange(len(streams)), [len(s[0]) for s in streams])
    order = np.lexsort((seq, rx))
    # Within a stream both keys increase, so each of its messages is made when its turn comes.
    for arrived_ns, source in rows_of(rx[order], stream[order]):
        yield struct.pack(">Q", arrived_ns // 1000)
        yield next(streams[source][2]).pack(mav)
        mav.seq = (mav.seq + 1) % 256
