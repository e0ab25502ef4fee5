"""Messages of an autopilot as samples: one meaning for what arrives live and what a log holds.

Tables are structured arrays of one message, as :func:`drivers.mavlink.columns.decode` gives them; a
single live message is a table of one row. Units, axes and the marks of missing values are those of
mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion.types import F64, I64, BaroSamples, GnssSamples, ImuSamples, MagSamples

Table = np.ndarray[Any, np.dtype[Any]]
Rows = NDArray[np.bool_]

IMU = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
"""Messages that carry an inertial sample, the preferred ones first: by resolution, then unit."""
GNSS = ("GPS_RAW_INT", "GPS2_RAW")
BARO = ("SCALED_PRESSURE", "HIGHRES_IMU")
"""Messages that carry the first barometer's pressure, the preferred one first."""
BARO_OTHERS = ("SCALED_PRESSURE2",)
MAG = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")
"""Messages that carry the first compass's field, the preferred one first."""
MAG_OTHERS = ("SCALED_IMU2", "SCALED_IMU3")
VIBRATION = "VIBRATION"
"""Message with the counters of clipped accelerations, one an accelerometer."""
ACCELEROMETER = {"SCALED_IMU2": 1, "SCALED_IMU3": 2}
"""Whose counter speaks for an inertial message; of the others the first one's."""

BOOT_STAMPED = (
    "SYSTEM_TIME",
    "SCALED_IMU",
    "RAW_IMU",
    "SCALED_PRESSURE",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "HIGHRES_IMU",
    "SCALED_IMU2",
    "SCALED_IMU3",
)
"""Messages stamped by the autopilot's boot clock as it sends them. A fix is stamped earlier."""

MAX_BOOT_US = 100_000_000_000_000
"""A stamp of more than three years since boot is Unix time."""

_E7 = np.pi / 180.0 * 1e-7
_MILLI_G = 9.80665e-3
_ACCEL_GYRO_UPDATED, _MAG_UPDATED, _PRESSURE_UPDATED = 0x3F, 0x1C0, 0x200
"""Bits of HIGHRES_IMU.fields_updated: all six inertial axes, all three magnetic, pressure."""


@dataclass(frozen=True, slots=True)
class Stamps:
    """Times and arrival numbers of the rows of a table."""

    t_ns: I64
    """(N,) time of validity."""
    rx_ns: I64
    """(N,) time of arrival."""
    seq: I64
    """(N,) arrival number."""

    def take(self, rows: Rows) -> Stamps:
        """The same, restricted to ``rows``."""
        return Stamps(self.t_ns[rows], self.rx_ns[rows], self.seq[rows])


def column(table: Table, name: str) -> F64:
    """(N,) a field of a structured array as float64."""
    out: F64 = table[name].astype(np.float64)
    return out


def triple(table: Table, names: Sequence[str], scale: float = 1.0) -> F64:
    """(N, 3) float64 from three fields, times ``scale``."""
    out = np.empty((table.shape[0], 3))
    for i, name in enumerate(names):
        out[:, i] = table[name]
    if scale != 1.0:
        out *= scale
    return out


def boot_us(table: Table) -> I64:
    """(N,) stamps [µs since boot] by the autopilot's clock; 0 where there is no usable one.

    Some autopilots put Unix time into ``time_usec``; that is no boot stamp.
    """
    names = table.dtype.names or ()
    if "time_usec" in names:
        stamp = np.minimum(table["time_usec"], np.uint64(2**62)).astype(np.int64)
    elif "time_boot_ms" in names:
        stamp = table["time_boot_ms"].astype(np.int64) * 1000
    else:
        return np.zeros(table.shape[0], np.int64)
    return np.where((stamp > 0) & (stamp < MAX_BOOT_US), stamp, 0)


def fix_boot_us(table: Table, stamp_us: I64) -> I64:
    """(N,) stamps by :func:`boot_us`, of fixes: without a fix the stamp of the last good one is
    often repeated, so it says nothing."""
    return np.where(table["fix_type"] < 2, 0, stamp_us)


def _there(vector: F64) -> Rows:
    """(N,) which vectors (N, 3) are not exactly zero: that is how a missing sensor is sent."""
    there: Rows = (vector[:, 0] != 0) | (vector[:, 1] != 0) | (vector[:, 2] != 0)
    return there


def imu(name: str, table: Table, at: Stamps) -> ImuSamples | None:
    """Inertial samples of a message of :data:`IMU`; None if it has none in documented units.

    A specific force of exactly zero on all axes is a sensor that is not there.
    """
    accel_scale, gyro_scale = (1.0, 1.0) if name == "HIGHRES_IMU" else (_MILLI_G, 1e-3)
    accel = triple(table, ("xacc", "yacc", "zacc"), accel_scale)
    fresh = _there(accel)
    if name == "HIGHRES_IMU":
        fresh &= (table["fields_updated"] & _ACCEL_GYRO_UPDATED) == _ACCEL_GYRO_UPDATED
    if not fresh.any():
        return None
    gyro = triple(table, ("xgyro", "ygyro", "zgyro"), gyro_scale)
    if not fresh.all():
        at, accel, gyro = at.take(fresh), accel[fresh], gyro[fresh]
    interval = np.full(accel.shape[0], np.nan)
    return ImuSamples(name, at.t_ns, at.rx_ns, at.seq, gyro, accel, interval)


def clip_counts(table: Table) -> I64:
    """(N, 3) counters of clipped accelerations of :data:`VIBRATION`."""
    return np.stack([table[f"clipping_{i}"].astype(np.int64) for i in range(3)], axis=1)


def mag(name: str, table: Table, at: Stamps) -> MagSamples | None:
    """Magnetic field [T] of an inertial message; None if it has none. All zero: not there."""
    field = triple(table, ("xmag", "ymag", "zmag"), 1e-4 if name == "HIGHRES_IMU" else 1e-7)
    fresh = _there(field)
    if name == "HIGHRES_IMU":
        fresh &= (table["fields_updated"] & _MAG_UPDATED) == _MAG_UPDATED
    if not fresh.any():
        return None
    if not fresh.all():
        at, field = at.take(fresh), field[fresh]
    return MagSamples(name, at.t_ns, at.rx_ns, at.seq, field)


def baro(name: str, table: Table, at: Stamps) -> BaroSamples | None:
    """Static pressure of a message of :data:`BARO` or :data:`BARO_OTHERS`, sent in hPa."""
    highres = name == "HIGHRES_IMU"
    pressure = column(table, "abs_pressure" if highres else "press_abs") * 100.0
    fresh = pressure > 0
    if highres:
        fresh &= (table["fields_updated"] & _PRESSURE_UPDATED) != 0
    if not fresh.any():
        return None
    at = at.take(fresh)
    return BaroSamples(name, at.t_ns, at.rx_ns, at.seq, pressure[fresh])


def new_fixes(table: Table) -> Rows:
    """(N,) which rows are new epochs of the receiver; the first row always is.

    The autopilot sends its latest fix at the stream's rate, which may be faster than the
    receiver's. A row repeats the one before if its own stamp is the same, or, where it has no
    stamp of its own, if its content is; a change of fix type always counts as new.
    """
    if not table.shape[0]:
        return np.zeros(0, np.bool_)
    stamp = table["time_usec"]
    same_content = np.ones(table.shape[0] - 1, np.bool_)
    for name in ("lat", "lon", "alt", "vel", "cog", "satellites_visible"):
        same_content &= table[name][1:] == table[name][:-1]
    unstamped = stamp[1:] == 0
    repeat = (stamp[1:] == stamp[:-1]) & (~unstamped | same_content)
    repeat &= table["fix_type"][1:] == table["fix_type"][:-1]
    return np.concatenate([[True], ~repeat])


def _millimetres(table: Table, name: str) -> F64:
    """A MAVLink accuracy [mm] in metres; 0 and all ones mean unknown: NaN."""
    raw = table[name]
    absent = (raw == 0) | (raw == np.iinfo(raw.dtype).max)
    return np.where(absent, np.nan, raw * 1e-3)


def gnss(name: str, table: Table, at: Stamps) -> tuple[GnssSamples, F64]:
    """Fixes of a message of :data:`GNSS`, heights above mean sea level, and the undulation.

    The undulation (N,) [m] (ellipsoid height − height above mean sea level) is NaN where the
    receiver gives no ellipsoid height. The caller decides on the datum, once for all fixes.
    """
    count = table.shape[0]
    speed = np.where(table["vel"] == 65535, np.nan, table["vel"] * 1e-2)
    # Course is undefined at a standstill, where its unknown value does no harm.
    course = np.where(table["cog"] == 65535, np.where(speed == 0, 0.0, np.nan), table["cog"])
    course = course * (np.pi / 18000.0)
    vel = np.stack([speed * np.cos(course), speed * np.sin(course), np.full(count, np.nan)], axis=1)
    h_acc, v_acc = _millimetres(table, "h_acc"), _millimetres(table, "v_acc")
    s_acc = _millimetres(table, "vel_acc")
    amsl = column(table, "alt") * 1e-3
    ellipsoid = column(table, "alt_ellipsoid") * 1e-3
    undulation = np.where(table["alt_ellipsoid"] == 0, np.nan, ellipsoid - amsl)
    sats = table["satellites_visible"].astype(np.int64)
    samples = GnssSamples(
        name,
        at.t_ns,
        at.rx_ns,
        at.seq,
        column(table, "lat") * _E7,
        column(table, "lon") * _E7,
        amsl,
        vel,
        np.stack([h_acc, h_acc, v_acc], axis=1),
        np.stack([s_acc, s_acc, s_acc], axis=1),
        np.where(sats == 255, -1, sats),
        np.where(table["fix_type"] > 6, 3, table["fix_type"]).astype(np.int64),
    )
    return samples, undulation


def known_position(table: Table) -> Rows:
    """(N,) which rows of GLOBAL_POSITION_INT have a position: none yet is sent as 0, 0."""
    known: Rows = (table["lat"] != 0) | (table["lon"] != 0)
    return known


def position(table: Table) -> tuple[F64, F64, F64, F64]:
    """Latitude, longitude [rad], height above mean sea level [m], velocity NED (N, 3) [m/s] of
    GLOBAL_POSITION_INT: the autopilot's own solution, for comparison only."""
    return (
        column(table, "lat") * _E7,
        column(table, "lon") * _E7,
        column(table, "alt") * 1e-3,
        triple(table, ("vx", "vy", "vz"), 1e-2),
    )
