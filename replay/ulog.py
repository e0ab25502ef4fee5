"""PX4 ULog (.ulg), through pyulog: topics as columns, boot clock taken to Unix time by the GPS.

A topic's ``timestamp`` is when it was published (arrival), ``timestamp_sample``, where it has one,
when it was measured. ``*_groundtruth`` topics are the simulator's.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pyulog import ULog

from companion.types import (
    F64,
    I64,
    NS,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    LogFormatError,
    MagSamples,
    Recording,
    ReferenceSamples,
)
from drivers.ublox.interference import INDICATOR_FULL, STATE_SHARE
from replay.clocks import interpolation, unwrapped_interpolation
from replay.streams import finish_vehicle, numbered, unknown, wrap

_DEG = np.pi / 180.0
_GAP_NS = NS
_MAX_US = 10**14
"""A stamp of more than three years since boot is a corrupt record."""
_MAP_RADIUS_M = 6_371_000.0
"""Radius of the sphere on which PX4 projects local positions."""
_TOPICS = [
    "sensor_combined",
    "vehicle_gps_position",
    "sensor_gps",
    "vehicle_air_data",
    "sensor_baro",
    "vehicle_magnetometer",
    "sensor_mag",
    "vehicle_attitude",
    "vehicle_global_position",
    "vehicle_local_position",
    "vehicle_attitude_groundtruth",
    "vehicle_global_position_groundtruth",
    "vehicle_local_position_groundtruth",
]

Topic = dict[str, NDArray[Any]]
Logged = dict[tuple[str, int], Topic]


class _Bounded(io.BytesIO):
    """A file in memory that ends the reading of a log which makes the parser go round in circles.

    pyulog seeks back over corrupt messages; at the end of a cut file that never ends. A sound log
    is read about once, in two calls a message.
    """

    def __init__(self, path: Path) -> None:
        data = path.read_bytes()
        super().__init__(data)
        self._path = path
        self._left = 40 * len(data) + 1_000_000

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        self._left -= len(data) + 16
        if self._left < 0:
            raise LogFormatError(f"{self._path}: ULog file too corrupt to find its messages")
        return data


def _load(path: Path) -> tuple[Logged, list[str]]:
    """Topics by (name, instance) with plausible, increasing publication times, and notes."""
    chatter = io.StringIO()  # pyulog reports corruption by printing
    try:
        with contextlib.redirect_stdout(chatter), np.errstate(all="ignore"):
            log = ULog(_Bounded(path), message_name_filter_list=_TOPICS)
    except (OSError, LogFormatError):
        raise
    except Exception as error:  # pyulog raises whatever its parsing stumbles over
        reason = str(error).splitlines()[0][:80] if str(error) else type(error).__name__
        raise LogFormatError(f"{path}: not a readable ULog file: {reason}") from None
    notes = ["corrupt data in the log, skipped"] if log.file_corruption else []
    if log.dropouts:
        lost = sum(d.duration for d in log.dropouts) * 1e-3
        notes.append(f"{len(log.dropouts)} logging dropout(s), {lost:.2f} s in all")
    topics: Logged = {}
    for data in log.data_list:
        stamp = np.asarray(data.data.get("timestamp", np.zeros(0, np.uint64)))
        good = (stamp > 0) & (stamp < _MAX_US)
        if good.any():
            topics[(data.name, data.multi_id)] = {k: v[good] for k, v in data.data.items()}
    return topics, notes


def _instances(topics: Logged, *names: str) -> list[tuple[str, Topic]]:
    """Instances of the first of ``names`` that was logged, with their stream names."""
    for name in names:
        found = [(i, topic) for (n, i), topic in sorted(topics.items()) if n == name]
        if found:
            return [(name if len(found) == 1 else f"{name}[{i}]", topic) for i, topic in found]
    return []


def _times(topic: Topic, offset_ns: int) -> tuple[I64, I64, I64]:
    """(t_ns, t_rx_ns, seq); ``seq`` is numbered over all streams later."""
    published = topic["timestamp"].astype(np.int64)
    sampled = published
    if "timestamp_sample" in topic:
        stamp = np.minimum(topic["timestamp_sample"], _MAX_US).astype(np.int64)
        # A sample cannot be newer than its message, nor seconds older.
        sampled = np.where((stamp <= published) & (stamp > published - 2_000_000), stamp, published)
    rx = np.maximum.accumulate(published) * 1000 + offset_ns
    return sampled * 1000 + offset_ns, rx, np.arange(published.shape[0], dtype=np.int64)


def _field(topic: Topic, *names: str, scale: float = 1.0) -> F64 | None:
    """The first of ``names`` that the topic has, as float64 times ``scale``."""
    for name in names:
        if name in topic:
            with np.errstate(invalid="ignore"):  # corrupt floats may be signalling NaN
                out: F64 = topic[name].astype(np.float64) * scale
            return out
    return None


def _vector(topic: Topic, *names: str, scale: float = 1.0) -> F64 | None:
    """(N, 3) from three fields, or None if one is missing."""
    found = [_field(topic, name, scale=scale) for name in names]
    parts = [part for part in found if part is not None]
    return np.stack(parts, axis=1) if len(parts) == len(names) else None


def _indexed(name: str) -> tuple[str, str, str]:
    return f"{name}[0]", f"{name}[1]", f"{name}[2]"


def _imus(topics: Logged, offset_ns: int) -> list[ImuSamples]:
    """``sensor_combined``: means over the integration interval that ends at the stamp."""
    out = []
    for source, topic in _instances(topics, "sensor_combined"):
        gyro = _vector(topic, *_indexed("gyro_rad"))
        accel = _vector(topic, *_indexed("accelerometer_m_s2"))
        if gyro is None or accel is None:
            continue
        interval = np.full(gyro.shape[0], np.nan)
        dt = topic.get("accelerometer_integral_dt")
        if dt is not None:
            # Seconds as float in 2016-17, microseconds as integer since.
            seconds = dt.astype(np.float64) * (1.0 if dt.dtype.kind == "f" else 1e-6)
            interval = np.where((seconds > 0) & (seconds < 1), seconds, np.nan)
        times, clipped = _times(topic, offset_ns), _clipped(topic, gyro.shape[0])
        out.append(ImuSamples(source, *times, gyro, accel, interval, clipped))
    return out


def _clipped(topic: Topic, count: int) -> F64:
    """(N,) what the driver says of the end of the range: a bit an axis, within the interval."""
    found = np.zeros(count)
    for name, code in (("accelerometer_clipping", 1.0), ("gyro_clipping", 2.0)):
        if name in topic:
            found += np.where(topic[name] != 0, code, 0.0)
    return found


def _baros(topics: Logged, offset_ns: int) -> list[BaroSamples]:
    for source, topic in _instances(topics, "vehicle_air_data", "sensor_baro")[:1]:
        pressure = _field(topic, "baro_pressure_pa")
        if pressure is None:
            pressure = _field(topic, "pressure")
            # sensor_baro was in hPa until 2022.
            if pressure is not None and np.median(pressure) < 2000:
                pressure = pressure * 100.0
        if pressure is not None:
            return [BaroSamples(source, *_times(topic, offset_ns), pressure)]
    return []


def _mags(topics: Logged, offset_ns: int) -> list[MagSamples]:
    out = []
    for source, topic in _instances(topics, "vehicle_magnetometer", "sensor_mag"):
        field = _vector(topic, *_indexed("magnetometer_ga"), scale=1e-4)
        if field is None:
            field = _vector(topic, "x", "y", "z", scale=1e-4)
        if field is not None:
            out.append(MagSamples(source, *_times(topic, offset_ns), field))
    return out


def _fixes(topics: Logged, offset_ns: int) -> list[tuple[GnssSamples, F64]]:
    """Receivers with AMSL heights, each with its undulation [m], NaN where unknown."""
    out = []
    for source, topic in _instances(topics, "sensor_gps", "vehicle_gps_position"):
        lat = _field(topic, "lat", scale=1e-7 * _DEG)
        lat = lat if lat is not None else _field(topic, "latitude_deg", scale=_DEG)
        lon = _field(topic, "lon", scale=1e-7 * _DEG)
        lon = lon if lon is not None else _field(topic, "longitude_deg", scale=_DEG)
        height = _field(topic, "alt", scale=1e-3)
        height = height if height is not None else _field(topic, "altitude_msl_m")
        if lat is None or lon is None or height is None:
            continue
        count = lat.shape[0]
        ellipsoid = _field(topic, "alt_ellipsoid", scale=1e-3)
        ellipsoid = ellipsoid if ellipsoid is not None else _field(topic, "altitude_ellipsoid_m")
        undulation = np.full(count, np.nan)
        if ellipsoid is not None:
            undulation = np.where(ellipsoid == 0, np.nan, ellipsoid - height)
        vel = _vector(topic, "vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
        vel = unknown(count) if vel is None else vel
        if "vel_ned_valid" in topic:
            vel = np.where(topic["vel_ned_valid"][:, None] != 0, vel, np.nan)
        sd_pos = _vector(topic, "eph", "eph", "epv")
        sd_vel = _vector(topic, *["s_variance_m_s"] * 3)
        sats = topic.get("satellites_used", np.full(count, -1))
        kind = topic.get("fix_type", np.full(count, 3))
        samples = GnssSamples(
            source,
            *_times(topic, offset_ns),
            lat,
            lon,
            height,
            vel,
            _positive(sd_pos, count),
            _positive(sd_vel, count),
            sats.astype(np.int64),
            np.where(kind > 6, 3, kind).astype(np.int64),
            _interference(topic, count),
        )
        out.append((samples, undulation))
    return out


def _interference(topic: Topic, count: int) -> F64:
    """(N,) jamming and spoofing as the receiver says them, 0 to 1: states and indicator as u-blox
    has them, whose driver PX4's fields are made for."""
    share = np.full(count, np.nan)
    for name in ("jamming_state", "spoofing_state"):
        if name in topic:
            state = np.minimum(topic[name].astype(np.int64), len(STATE_SHARE) - 1)
            share = np.fmax(share, np.array(STATE_SHARE)[state])
    if "jamming_indicator" in topic:
        indicator = topic["jamming_indicator"].astype(np.float64) / INDICATOR_FULL
        share = np.fmax(share, np.clip(indicator, 0.0, 1.0))
    return share


def _positive(sd: F64 | None, count: int) -> F64:
    """Standard deviations with everything that is not positive unknown."""
    if sd is None:
        return unknown(count)
    return np.where(np.isfinite(sd) & (sd > 0), sd, np.nan)


def _rpy(topics: Logged, name: str, offset_ns: int, t_ns: I64) -> F64:
    """(N, 3) roll, pitch, yaw [rad] at ``t_ns`` from an attitude topic's quaternion."""
    found = _instances(topics, name)
    columns = [_field(found[0][1], f"q[{i}]") for i in range(4)] if found else [None]
    parts = [c for c in columns if c is not None]
    if len(parts) < 4:
        return unknown(t_ns.shape[0])
    w, x, y, z = parts
    at = _times(found[0][1], offset_ns)[0]
    keep = np.isfinite(w + x + y + z) & _forward(at)
    angles = (
        np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        np.arcsin(np.clip(2 * (w * y - z * x), -1, 1)),
        np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
    rpy = np.stack(
        [unwrapped_interpolation(t_ns, at[keep], a[keep], _GAP_NS) for a in angles], axis=1
    )
    rpy[:, 2] = wrap(rpy[:, 2])
    return rpy


def _forward(t_ns: I64) -> NDArray[np.bool_]:
    """Which stamps are later than all before them."""
    return np.concatenate([[True], np.diff(np.maximum.accumulate(t_ns)) > 0])


def _velocity(topics: Logged, name: str, offset_ns: int, t_ns: I64) -> F64:
    """(N, 3) NED velocity [m/s] at ``t_ns`` from a local position topic."""
    found = _instances(topics, name)
    vel = _vector(found[0][1], "vx", "vy", "vz") if found else None
    if vel is None:
        return unknown(t_ns.shape[0])
    at = _times(found[0][1], offset_ns)[0]
    keep = _forward(at)
    return np.stack(
        [interpolation(t_ns, at[keep], vel[keep, i], _GAP_NS) for i in range(3)], axis=1
    )


def _position(topics: Logged, suffix: str) -> tuple[str, Topic, F64, F64, F64] | None:
    """(source, topic, lat [rad], lon [rad], AMSL height [m]) of the best position topic."""
    for source, topic in _instances(topics, f"vehicle_global_position{suffix}"):
        lat, lon = _field(topic, "lat", scale=_DEG), _field(topic, "lon", scale=_DEG)
        height = _field(topic, "alt")
        if lat is not None and lon is not None and height is not None:
            return source, topic, lat, lon, height
    for source, topic in _instances(topics, f"vehicle_local_position{suffix}"):
        local = _vector(topic, "x", "y", "z")
        origin = _vector(topic, "ref_lat", "ref_lon", "ref_alt")
        if local is None or origin is None or not origin[:, 0].any():
            continue
        # Older logs have the origin in degrees · 1e7.
        to_rad = _DEG * (1e-7 if np.abs(origin[:, :2]).max() > 360 else 1.0)
        lat0, lon0 = origin[:, 0] * to_rad, origin[:, 1] * to_rad
        lat = lat0 + local[:, 0] / _MAP_RADIUS_M
        lon = lon0 + local[:, 1] / (_MAP_RADIUS_M * np.cos(lat0))
        return source, topic, lat, lon, origin[:, 2] - local[:, 2]
    return None


def _reference(topics: Logged, offset_ns: int, suffix: str) -> ReferenceSamples | None:
    """The autopilot's solution (``suffix`` empty) or simulator truth (``_groundtruth``)."""
    position = _position(topics, suffix)
    if position is None:
        return None
    source, topic, lat, lon, height = position
    times = _times(topic, offset_ns)
    vel = _vector(topic, "vel_n", "vel_e", "vel_d")
    if vel is None:
        vel = _velocity(topics, f"vehicle_local_position{suffix}", offset_ns, times[0])
    rpy = _rpy(topics, f"vehicle_attitude{suffix}", offset_ns, times[0])
    known = np.isfinite(lat + lon + height) & ((lat != 0) | (lon != 0))
    reference = ReferenceSamples(source, *times, lat, lon, height, vel, rpy)
    return reference.take(known) if known.any() else None


def _unix_offset(topics: Logged) -> int | None:
    """Unix − boot [ns] by the receiver's UTC; None if it never knew."""
    for _, topic in _instances(topics, "sensor_gps", "vehicle_gps_position"):
        utc = topic.get("time_utc_usec")
        if utc is None:
            continue
        utc = np.minimum(utc, np.uint64(2**62)).astype(np.int64)
        known = (utc > 946_684_800_000_000) & (utc < 4_102_444_800_000_000)
        if known.any():
            return int(np.median((utc - topic["timestamp"].astype(np.int64))[known])) * 1000
    return None


def _datum(
    fixes: Sequence[tuple[GnssSamples, F64]], *references: ReferenceSamples | None
) -> tuple[Literal["hae", "msl"], list[GnssSamples], list[ReferenceSamples | None], list[str]]:
    """Everything on the ellipsoid where every fix tells its undulation, else AMSL."""
    samples = [s for s, _ in fixes]
    parts = [u[s.fix_type >= 3] for s, u in fixes]
    undulation = np.concatenate([np.zeros(0), *parts])
    if not undulation.size or not np.isfinite(undulation).all():
        return "msl", samples, list(references), []
    geoid = float(np.median(undulation))
    raised = [None if r is None else replace(r, height=r.height + geoid) for r in references]
    notes = [f"heights above the ellipsoid: AMSL {geoid:+.2f} m, from the GNSS messages"]
    return "hae", [replace(s, height=s.height + geoid) for s in samples], raised, notes


def read_ulog(path: Path) -> Recording:
    """Read a PX4 ULog file.

    Raises :class:`LogFormatError` if pyulog cannot parse it, or neither IMU nor GNSS is in it.
    """
    topics, notes = _load(path)
    offset = _unix_offset(topics)
    if offset is None:
        notes.append("no UTC in the log; times count from the autopilot's boot")
        offset = 0
    imus, fixes = _imus(topics, offset), _fixes(topics, offset)
    if not imus and not fixes:
        raise LogFormatError(f"{path}: a ULog file with neither IMU nor GNSS data")
    truth, autopilot = _reference(topics, offset, "_groundtruth"), _reference(topics, offset, "")
    datum, gnss, (truth, autopilot), more = _datum(fixes, truth, autopilot)
    notes += more
    imus, gnss, baro, mag, references = numbered(
        [
            imus,
            gnss,
            _baros(topics, offset),
            _mags(topics, offset),
            [r for r in (truth, autopilot) if r is not None],
        ]
    )
    if truth is not None:
        truth = references[0]
    if autopilot is not None:
        autopilot = references[-1]
    vehicle, odd = finish_vehicle("vehicle", imus, gnss, baro, mag, truth, autopilot, datum=datum)
    return Recording(str(path), "ulog", (vehicle,), tuple(notes + odd))
