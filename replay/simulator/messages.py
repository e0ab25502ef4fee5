"""A recording's samples as pymavlink messages: what an autopilot would send for them.

Heights above mean sea level use one constant undulation; ``alt_ellipsoid`` carries the recording's
own. Times inside the messages count from ``boot_ns``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import (
    F64,
    I64,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    ReferenceSamples,
)

UNDULATION_M = 47.5
"""Ellipsoid to mean sea level: the geoid near the scenarios' usual start."""
_GAUSS_PER_T = 1e4
_IMU_FIELDS, _MAG_FIELDS = 0x3F, 0x1C0
MAV_TYPES = {
    "multirotor": mavlink.MAV_TYPE_QUADROTOR,
    "fixed-wing": mavlink.MAV_TYPE_FIXED_WING,
    "ground": mavlink.MAV_TYPE_GROUND_ROVER,
}

_ROWS = 50_000
"""Samples turned into Python numbers together: bounds memory for long recordings."""

Messages = Iterator[Any]
"""pymavlink messages, one per sample of a stream, in its order, made when asked for."""


def rows_of(*columns: F64 | I64) -> Iterator[tuple[Any, ...]]:
    """Rows of equally long columns as Python numbers, a batch at a time."""
    for lo in range(0, len(columns[0]), _ROWS):
        yield from zip(*(c[lo : lo + _ROWS].tolist() for c in columns), strict=True)


def mag_at(imu: ImuSamples, mag: MagSamples | None) -> tuple[F64, I64]:
    """Newest field (N, 3) [gauss] at each IMU sample and the update flags (N,) that go with it."""
    if mag is None or len(mag) == 0:
        return np.zeros((len(imu), 3)), np.full(len(imu), _IMU_FIELDS)
    newest = np.searchsorted(mag.seq, imu.seq) - 1
    fresh = np.diff(newest, prepend=-1) > 0
    field = mag.field_b[np.maximum(newest, 0)] * _GAUSS_PER_T
    return field, np.where(fresh, _IMU_FIELDS | _MAG_FIELDS, _IMU_FIELDS)


def imu_messages(mav: Any, imu: ImuSamples, mag: MagSamples | None, boot_ns: int) -> Messages:
    """HIGHRES_IMU, each with the newest magnetometer sample."""
    field, updated = mag_at(imu, mag)
    usec = (imu.t_ns - boot_ns) // 1000
    for t, a, g, m, flags in rows_of(usec, imu.accel_b, imu.gyro_b, field, updated):
        yield mav.highres_imu_encode(t, *a, *g, *m, 0.0, 0.0, 0.0, 0.0, flags)


def truth_messages(mav: Any, truth: ReferenceSamples) -> Messages:
    """SIM_STATE, which carries no time."""
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
    rows = rows_of(
        np.stack(q_nb, axis=-1),
        truth.rpy,
        *degrees,
        truth.height - UNDULATION_M,
        truth.vel_n,
        *(np.rint(angle * 1e7).astype(np.int64) for angle in degrees),
    )
    for q, rpy, lat, lon, alt, vel, lat_e7, lon_e7 in rows:
        yield mav.sim_state_encode(*q, *rpy, *imu, lat, lon, alt, 0.0, 0.0, *vel, lat_e7, lon_e7)


def gnss_messages(mav: Any, gnss: GnssSamples, boot_ns: int) -> Messages:
    """GPS_RAW_INT: ground speed and course, no vertical velocity, as on every real link."""
    fixed = np.isfinite(gnss.lat) & np.isfinite(gnss.height)

    def scaled(values: F64, factor: float, missing: int) -> I64:
        known = fixed & np.isfinite(values)
        return np.where(known, np.rint(np.nan_to_num(values) * factor), missing).astype(np.int64)

    speed = np.hypot(gnss.vel_n[:, 0], gnss.vel_n[:, 1])
    course = np.remainder(np.degrees(np.arctan2(gnss.vel_n[:, 1], gnss.vel_n[:, 0])), 360.0)
    columns = rows_of(
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


def baro_messages(mav: Any, baro: BaroSamples, boot_ns: int) -> Messages:
    """SCALED_PRESSURE."""
    for t, hpa in rows_of((baro.t_ns - boot_ns) // 1_000_000, baro.pressure / 100.0):
        yield mav.scaled_pressure_encode(t, hpa, 0.0, 2500)


def slow_messages(mav: Any, wall_ns: I64, boot_ns: int, mav_type: int) -> Messages:
    """A HEARTBEAT and a SYSTEM_TIME for each of the times ``wall_ns`` (N,), interleaved."""
    autopilot, active = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_STATE_ACTIVE
    for wall in wall_ns.tolist():
        yield mav.heartbeat_encode(mav_type, autopilot, 0, 0, active)
        yield mav.system_time_encode(wall // 1000, (wall - boot_ns) // 1_000_000)
