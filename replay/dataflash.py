"""ArduPilot DataFlash logs (.BIN), old layouts (TimeMS) and new (TimeUS, instances).

Time of validity is the record's stamp since boot. Where the GPS tells week and time of week, one
constant takes it to Unix time, session by session; otherwise times count from the boot. Nothing is
known about arrival except the order of logging, which numbers the samples.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
from drivers.ublox.interference import INDICATOR_FULL
from replay.clipping import with_counter
from replay.clocks import Clock, boot_sessions, interpolation, unwrapped_interpolation
from replay.dataflash_codec import Columns, DataFlash, index_dataflash
from replay.streams import finish_vehicle, unknown, wrap

_DEG = np.pi / 180.0
_GPS_EPOCH_S = 315_964_800
_LEAP_S = 18
"""GPS − UTC since 2017; before, it is one or two less, which only shifts the whole log."""
_WEEK_MS = 604_800_000
_GAP_NS = NS
_MAX_BOOT_US = 100_000_000_000_000
"""No autopilot runs for three years: a later stamp is corrupt."""

_STAMPED = ("IMU", "ATT", "GPS", "BARO", "MAG")


def _boot_us(columns: Columns) -> I64 | None:
    """(N,) stamps since boot [µs], or None for a message that has none.

    The old GPS message has the time of week in ``TimeMS`` and the boot time in ``T``.
    """
    raw = columns.integers
    if "TimeUS" in raw:
        return np.clip(raw["TimeUS"], 0, _MAX_BOOT_US)
    label = "T" if columns.name in ("GPS", "GPS2") else "TimeMS"
    return raw[label] * 1000 if label in raw else None


def _clock(log: DataFlash) -> Clock:
    """Sessions and offsets from the stamps of the main messages and the GPS's own time."""
    rows, boots = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for name in _STAMPED:
        columns = log.columns(name)
        stamp = _boot_us(columns)
        if stamp is not None:
            rows.append(columns.order)
            boots.append(stamp)
    order = np.argsort(np.concatenate(rows), kind="stable")
    row, boot = np.concatenate(rows)[order], np.concatenate(boots)[order]
    if not row.shape[0]:
        zero = np.zeros(1, np.int64)
        return Clock(np.zeros(len(log), np.int64), np.zeros(len(log), np.int64), zero, zero)
    session_row = row[boot_sessions(boot)].copy()
    session_row[0] = 0
    offset, notes = _offsets(log, row, boot, session_row)
    session = np.searchsorted(session_row, row, side="right") - 1
    latest = np.maximum(np.searchsorted(row, np.arange(len(log)), side="right") - 1, 0)
    rx = np.maximum.accumulate((boot * 1000 + offset[session])[latest])
    return Clock(rx, boot[latest], session_row, offset, notes)


def _offsets(log: DataFlash, row: I64, boot: I64, session_row: I64) -> tuple[I64, tuple[str, ...]]:
    """(S,) Unix − boot [ns] of each session, and notes."""
    fix_row, delay_us = _gps_delays(log)
    edges = np.append(session_row, len(log))
    offset = np.zeros(session_row.shape[0], np.int64)
    last = 0
    dated = False
    for k in range(session_row.shape[0]):
        mine = delay_us[(fix_row >= edges[k]) & (fix_row < edges[k + 1])]
        part = boot[(row >= edges[k]) & (row < edges[k + 1])]
        if mine.size:
            offset[k] = int(np.median(mine)) * 1000
            dated = True
        elif k:
            offset[k] = offset[k - 1]
        first = int(part.min()) * 1000 + int(offset[k])
        if k and first <= last:
            offset[k] += last + NS - first
        last = int(part.max()) * 1000 + int(offset[k])
    notes = [] if dated else ["no GPS time in the log; times count from the autopilot's boot"]
    if session_row.shape[0] > 1:
        notes.append(f"autopilot's clock restarted {session_row.shape[0] - 1} time(s)")
    return offset, tuple(notes)


def _gps_delays(log: DataFlash) -> tuple[I64, I64]:
    """Record numbers of GPS messages with a date, and Unix − boot [µs] of each."""
    columns = log.columns("GPS")
    boot = _boot_us(columns)
    week_label = "GWk" if "GWk" in columns.integers else "Week"
    ms_label = "GMS" if "GMS" in columns.integers else "TimeMS"
    if boot is None or week_label not in columns.integers or ms_label not in columns.integers:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    week, ms = columns.integers[week_label], columns.integers[ms_label]
    # Week 1042 began in 2000: less is a receiver that does not know the date.
    dated = (week > 1042) & (week < 5000) & (ms >= 0) & (ms < _WEEK_MS)
    unix_us = (week * _WEEK_MS + ms) * 1000 + (_GPS_EPOCH_S - _LEAP_S) * 1_000_000
    return columns.order[dated], (unix_us - boot)[dated]


def _instances(log: DataFlash, name: str) -> list[tuple[str, Columns]]:
    """The units of one sensor: new logs number them in ``I``, old ones by name (IMU, IMU2)."""
    units: list[tuple[str, Columns]] = []
    for source in (name, f"{name}2", f"{name}3"):
        columns = log.columns(source)
        if not len(columns):
            continue
        if "I" in columns.integers:
            number = columns.integers["I"]
            units += [(f"{source}[{i}]", columns.take(number == i)) for i in np.unique(number)]
        else:
            units.append((source, columns))
    return units


def _times(columns: Columns, clock: Clock) -> tuple[I64, I64, I64] | None:
    """(t_ns, t_rx_ns, seq), or None for a message without a stamp since boot."""
    boot = _boot_us(columns)
    if boot is None:
        return None
    return clock.at(columns.order, boot), clock.rx_ns[columns.order], columns.order


def _stack(columns: Columns, *labels: str) -> F64:
    return np.stack([columns.values[label] for label in labels], axis=1)


def _imus(log: DataFlash, clock: Clock) -> list[ImuSamples]:
    gyro, accel = ("GyrX", "GyrY", "GyrZ"), ("AccX", "AccY", "AccZ")
    out: list[ImuSamples] = []
    for source, unit in _instances(log, "IMU"):
        times = _times(unit, clock)
        if times is not None and unit.has(*gyro, *accel):
            instant = np.full(len(unit), np.nan)
            imu = ImuSamples(source, *times, _stack(unit, *gyro), _stack(unit, *accel), instant)
            out.append(_clipped(log, clock, imu, len(out)))
    return out


def _clipped(log: DataFlash, clock: Clock, imu: ImuSamples, number: int) -> ImuSamples:
    """``imu`` with what VIBE counts of accelerometer ``number``: a message for each in new logs,
    one with three counters in old ones."""
    vibe = log.columns("VIBE")
    if "IMU" in vibe.integers and "Clip" in vibe.integers:
        vibe, label = vibe.take(vibe.integers["IMU"] == number), "Clip"
    else:
        label = f"Clip{number}"
    if label not in vibe.integers:
        return imu
    return with_counter(imu, vibe.order, clock.rx_ns[vibe.order], vibe.integers[label])


def _baros(log: DataFlash, clock: Clock) -> list[BaroSamples]:
    """Only the first barometer: the others sit in the same air and add nothing."""
    for source, unit in _instances(log, "BARO")[:1]:
        times = _times(unit, clock)
        if times is not None and unit.has("Press"):
            return [BaroSamples(source, *times, unit.values["Press"])]
    return []


def _mags(log: DataFlash, clock: Clock) -> list[MagSamples]:
    labels = ("MagX", "MagY", "MagZ")
    out = []
    for source, unit in _instances(log, "MAG"):
        times = _times(unit, clock)
        if times is not None and unit.has(*labels) and _stack(unit, *labels).any():
            out.append(MagSamples(source, *times, _stack(unit, *labels) * 1e-7))
    return out


def _accuracies(log: DataFlash, source: str, boot_us: I64) -> tuple[F64, F64]:
    """(N, 3) position [m] and velocity [m/s] standard deviations from GPA at the same stamps."""
    count = boot_us.shape[0]
    name = source.replace("GPS", "GPA")
    units = dict(_instances(log, "GPA"))
    unit = units.get(name)
    stamp = _boot_us(unit) if unit is not None else None
    if unit is None or stamp is None or not unit.has("HAcc", "VAcc", "SAcc"):
        return unknown(count), unknown(count)
    order = np.argsort(stamp, kind="stable")
    at = np.minimum(np.searchsorted(stamp[order], boot_us), stamp.shape[0] - 1)
    same = np.abs(stamp[order][at] - boot_us) < 50_000
    h, v, s = (
        np.where(same & (unit.values[n][order][at] > 0), unit.values[n][order][at], np.nan)
        for n in ("HAcc", "VAcc", "SAcc")
    )
    return np.stack([h, h, v], axis=1), np.stack([s, s, s], axis=1)


def _interference(log: DataFlash, source: str, order: I64) -> F64:
    """(N,) u-blox's indicator of jamming, of UBX1 the last one before each record of ``order``."""
    share = np.full(order.shape[0], np.nan)
    indicators = log.columns("UBX1")
    number = {"GPS2": 1, "GPS[1]": 1}.get(source, 0)
    if "jamInd" not in indicators.integers:
        return share
    if "Instance" in indicators.integers:
        indicators = indicators.take(indicators.integers["Instance"] == number)
    at = np.searchsorted(indicators.order, order) - 1
    known = at >= 0
    share[known] = np.clip(indicators.integers["jamInd"][at[known]] / INDICATOR_FULL, 0.0, 1.0)
    return share


def _fixes(log: DataFlash, clock: Clock) -> list[GnssSamples]:
    """Every receiver; heights AMSL. A record that repeats the stamp before is not a new fix."""
    out = []
    for source, unit in _instances(log, "GPS"):
        if not unit.has("Status", "Lat", "Lng", "Alt", "Spd", "GCrs"):
            continue
        boot = _boot_us(unit)
        if boot is None:
            continue
        fresh = np.concatenate([[True], np.diff(boot) != 0])
        unit, boot = unit.take(fresh), boot[fresh]
        v = unit.values
        course = v["GCrs"] * _DEG
        down = v["VZ"] if "VZ" in v else np.full(len(unit), np.nan)
        vel = np.stack([v["Spd"] * np.cos(course), v["Spd"] * np.sin(course), down], axis=1)
        sd_pos, sd_vel = _accuracies(log, source, boot)
        sats = unit.integers.get("NSats", np.full(len(unit), -1, np.int64))
        out.append(
            GnssSamples(
                source,
                clock.at(unit.order, boot),
                clock.rx_ns[unit.order],
                unit.order,
                v["Lat"] * _DEG,
                v["Lng"] * _DEG,
                v["Alt"],
                vel,
                sd_pos,
                sd_vel,
                sats,
                np.clip(unit.integers.get("Status", v["Status"].astype(np.int64)), 0, 6),
                _interference(log, source, unit.order),
            )
        )
    return out


def _angles(columns: Columns, clock: Clock, t_ns: I64) -> F64:
    """(N, 3) roll, pitch, yaw [rad] of ATT or SIM at ``t_ns``."""
    times = _times(columns, clock)
    if times is None or not columns.has("Roll", "Pitch", "Yaw"):
        return unknown(t_ns.shape[0])
    at, keep = times[0], np.concatenate([[True], np.diff(np.maximum.accumulate(times[0])) > 0])
    return np.stack(
        [
            unwrapped_interpolation(t_ns, at[keep], columns.values[n][keep] * _DEG, _GAP_NS)
            for n in ("Roll", "Pitch", "Yaw")
        ],
        axis=1,
    )


def _velocity(log: DataFlash, clock: Clock, t_ns: I64, names: tuple[str, ...]) -> F64:
    """(N, 3) NED velocity [m/s] at ``t_ns`` from the first of ``names`` that has one."""
    for name in names:
        columns = log.columns(name)
        if "C" in columns.integers:  # the EKF core that flies first
            columns = columns.take(columns.integers["C"] == columns.integers["C"].min(initial=255))
        times = _times(columns, clock)
        if times is None or not columns.has("VN", "VE", "VD"):
            continue
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(times[0])) > 0])
        at = times[0][keep]
        return np.stack(
            [interpolation(t_ns, at, columns.values[n][keep], _GAP_NS) for n in ("VN", "VE", "VD")],
            axis=1,
        )
    return unknown(t_ns.shape[0])


def _reference(
    log: DataFlash, clock: Clock, position: str, attitude: str, velocity: tuple[str, ...]
) -> ReferenceSamples | None:
    """A solution put together from a position message, attitudes and velocities; heights AMSL."""
    columns = log.columns(position)
    times = _times(columns, clock)
    if times is None or not columns.has("Lat", "Lng", "Alt"):
        return None
    t_ns = times[0]
    rpy = _angles(log.columns(attitude), clock, t_ns)
    rpy[:, 2] = wrap(rpy[:, 2])
    known = (columns.values["Lat"] != 0) | (columns.values["Lng"] != 0)
    reference = ReferenceSamples(
        position,
        *times,
        columns.values["Lat"] * _DEG,
        columns.values["Lng"] * _DEG,
        columns.values["Alt"],
        _velocity(log, clock, t_ns, velocity),
        rpy,
    )
    return reference.take(known) if known.any() else None


def read_dataflash(path: Path) -> Recording:
    """Read an ArduPilot DataFlash log.

    Raises :class:`LogFormatError` if it holds no records, or none of a sensor.
    """
    log = index_dataflash(np.fromfile(path, np.uint8))
    if not log.formats:
        raise LogFormatError(f"{path}: no DataFlash format records; not a .BIN log, or cut off")
    clock = _clock(log)
    notes = list(clock.notes)
    if log.bad_bytes:
        notes.append(f"{log.bad_bytes} bytes that are no record, dropped")
    imus, fixes = _imus(log, clock), _fixes(log, clock)
    if not imus and not fixes:
        raise LogFormatError(
            f"{path}: {len(log)} DataFlash records, but neither IMU nor GPS among them"
        )
    if not imus:
        notes.append("no IMU records in the log")
    if not fixes:
        notes.append("no GPS records in the log")
    ekf = ("XKF1", "NKF1", "EKF1")
    autopilot = None
    for position in ("POS", "AHR2"):
        autopilot = autopilot or _reference(log, clock, position, "ATT", ekf)
    vehicle, odd = finish_vehicle(
        "vehicle",
        imus,
        fixes,
        _baros(log, clock),
        _mags(log, clock),
        _reference(log, clock, "SIM", "SIM", ("SIM2",)),
        autopilot,
        datum="msl",
    )
    return Recording(str(path), "dataflash", (vehicle,), tuple(notes + odd))
