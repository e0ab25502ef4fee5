"""Writes a recording as a MAVLink 2 telemetry log, as a ground station beside ArduPilot would.

Each frame follows its time of arrival (big-endian microseconds since 1970), frames in the order of
arrival. Times inside the messages are on the autopilot's boot clock. Heights above mean sea level
use one constant undulation; ``alt_ellipsoid`` carries the recording's own. Packing is pymavlink's.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import (
    F64,
    I64,
    NS,
    BaroSamples,
    CompanionError,
    GnssSamples,
    ImuSamples,
    MagSamples,
    ReferenceSamples,
    VehicleRecording,
)

BOOT_S = 20.0
"""The autopilot booted this long before the first IMU sample."""
UNDULATION_M = 47.5
"""Ellipsoid to mean sea level: the geoid near the scenarios' usual start."""
_GAUSS_PER_T = 1e4
_IMU_FIELDS, _MAG_FIELDS = 0x3F, 0x1C0
_MAV_TYPES = {
    "multirotor": mavlink.MAV_TYPE_QUADROTOR,
    "fixed-wing": mavlink.MAV_TYPE_FIXED_WING,
    "ground": mavlink.MAV_TYPE_GROUND_ROVER,
}

_ROWS = 50_000
"""Samples turned into Python numbers together: bounds memory for long recordings."""

Messages = Iterator[Any]
"""pymavlink messages, one per sample of a stream, in its order, made when asked for."""


def _rows(*columns: F64 | I64) -> Iterator[tuple[Any, ...]]:
    for lo in range(0, len(columns[0]), _ROWS):
        yield from zip(*(c[lo : lo + _ROWS].tolist() for c in columns), strict=True)


def _mag_at(imu: ImuSamples, mag: MagSamples | None) -> tuple[F64, I64]:
    """Newest field (N, 3) [gauss] at each IMU sample and the update flags (N,) that go with it."""
    if mag is None or len(mag) == 0:
        return np.zeros((len(imu), 3)), np.full(len(imu), _IMU_FIELDS)
    newest = np.searchsorted(mag.seq, imu.seq) - 1
    fresh = np.diff(newest, prepend=-1) > 0
    field = mag.field_b[np.maximum(newest, 0)] * _GAUSS_PER_T
    return field, np.where(fresh, _IMU_FIELDS | _MAG_FIELDS, _IMU_FIELDS)


def _imu_messages(mav: Any, imu: ImuSamples, mag: MagSamples | None, boot_ns: int) -> Messages:
    field, updated = _mag_at(imu, mag)
    usec = (imu.t_ns - boot_ns) // 1000
    for t, a, g, m, flags in _rows(usec, imu.accel_b, imu.gyro_b, field, updated):
        yield mav.highres_imu_encode(t, *a, *g, *m, 0.0, 0.0, 0.0, 0.0, flags)


def _truth_messages(mav: Any, truth: ReferenceSamples) -> Messages:
    sr, sp, sy = np.sin(truth.rpy / 2).T
    cr, cp, cy = np.cos(truth.rpy / 2).T
    q_nb = [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]
    imu = [0.0] * 6
    degrees = [np.degrees(truth.lat), np.degrees(truth.lon)]
    rows = _rows(
        np.stack(q_nb, axis=-1),
        truth.rpy,
        *degrees,
        truth.height - UNDULATION_M,
        truth.vel_n,
        *(np.rint(angle * 1e7).astype(np.int64) for angle in degrees),
    )
    for q, rpy, lat, lon, alt, vel, lat_e7, lon_e7 in rows:
        yield mav.sim_state_encode(*q, *rpy, *imu, lat, lon, alt, 0.0, 0.0, *vel, lat_e7, lon_e7)


def _gnss_messages(mav: Any, gnss: GnssSamples, boot_ns: int) -> Messages:
    """GPS_RAW_INT: ground speed and course, no vertical velocity, as on every real link."""
    fixed = np.isfinite(gnss.lat) & np.isfinite(gnss.height)

    def scaled(values: F64, factor: float, missing: int) -> I64:
        known = fixed & np.isfinite(values)
        return np.where(known, np.rint(np.nan_to_num(values) * factor), missing).astype(np.int64)

    speed = np.hypot(gnss.vel_n[:, 0], gnss.vel_n[:, 1])
    course = np.remainder(np.degrees(np.arctan2(gnss.vel_n[:, 1], gnss.vel_n[:, 0])), 360.0)
    columns = _rows(
        (gnss.t_ns - boot_ns) // 1000,
        gnss.fix_type,
        scaled(np.degrees(gnss.lat), 1e7, 0),
        scaled(np.degrees(gnss.lon), 1e7, 0),
        scaled(gnss.height - UNDULATION_M, 1e3, 0),
        scaled(speed, 100.0, 0xFFFF),
        np.where(fixed & np.isfinite(course), scaled(course, 100.0, 0) % 36000, 0xFFFF),
        np.where(gnss.num_sats < 0, 255, gnss.num_sats),
        scaled(gnss.height, 1e3, 0),
        scaled(np.maximum(gnss.sd_pos[:, 0], gnss.sd_pos[:, 1]), 1e3, 0),
        scaled(gnss.sd_pos[:, 2], 1e3, 0),
        scaled(np.maximum(gnss.sd_vel[:, 0], gnss.sd_vel[:, 1]), 1e3, 0),
    )
    for *fix, speed_cms, course_cdeg, sats, hae_mm, h_acc, v_acc, vel_acc in columns:
        yield mav.gps_raw_int_encode(
            *fix, 0xFFFF, 0xFFFF, speed_cms, course_cdeg, sats, hae_mm, h_acc, v_acc, vel_acc
        )


def _baro_messages(mav: Any, baro: BaroSamples, boot_ns: int) -> Messages:
    for t, hpa in _rows((baro.t_ns - boot_ns) // 1_000_000, baro.pressure / 100.0):
        yield mav.scaled_pressure_encode(t, hpa, 0.0, 2500)


def _slow_messages(mav: Any, wall_ns: I64, boot_ns: int, mav_type: int) -> Messages:
    """A HEARTBEAT and a SYSTEM_TIME for each of the times ``wall_ns`` (N,), interleaved."""
    autopilot, active = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_STATE_ACTIVE
    for wall in wall_ns.tolist():
        yield mav.heartbeat_encode(mav_type, autopilot, 0, 0, active)
        yield mav.system_time_encode(wall // 1000, (wall - boot_ns) // 1_000_000)


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
        (imu.t_rx_ns, imu.seq, _imu_messages(mav, imu, next(iter(recording.mag), None), boot_ns))
    ]
    if recording.truth is not None:
        # SIM_STATE carries no time: it may only follow an IMU sample of its own time.
        truth = recording.truth.take(np.isin(recording.truth.t_ns, imu.t_ns))
        streams.append((truth.t_rx_ns, truth.seq, _truth_messages(mav, truth)))
    streams += [(g.t_rx_ns, g.seq, _gnss_messages(mav, g, boot_ns)) for g in recording.gnss[:1]]
    streams += [(b.t_rx_ns, b.seq, _baro_messages(mav, b, boot_ns)) for b in recording.baro[:1]]
    wall_ns = np.arange(int(imu.t_rx_ns[0]), int(imu.t_rx_ns[-1]) + 1, NS)
    slow = _slow_messages(mav, wall_ns, boot_ns, _MAV_TYPES.get(vehicle_kind, 0))
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
    for arrived_ns, source in _rows(rx[order], stream[order]):
        yield struct.pack(">Q", arrived_ns // 1000)
        yield next(streams[source][2]).pack(mav)
        mav.seq = (mav.seq + 1) % 256
