"""MAVLink telemetry logs (.tlog): frames in order of arrival, each behind a wall-clock stamp.

Time of validity comes from the messages' own boot stamps, mapped by :mod:`replay.clocks`; arrival
from the recorder's stamps. Arrival numbers are the frames' positions in the file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

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
    VehicleRecording,
)
from drivers.mavlink.columns import decode
from drivers.mavlink.dialect import message_id
from drivers.mavlink.framer import U8, FrameIndex, index_frames
from replay.clocks import (
    MAX_BOOT_US,
    Clock,
    plausible_wall,
    unwrapped_interpolation,
    vehicle_clock,
)
from replay.streams import G, Table, column, finish_vehicle, triple, unknown, wrap

_BOOT_STAMPED = {
    "SYSTEM_TIME": "time_boot_ms",
    "SCALED_IMU": "time_boot_ms",
    "RAW_IMU": "time_usec",
    "SCALED_PRESSURE": "time_boot_ms",
    "ATTITUDE": "time_boot_ms",
    "ATTITUDE_QUATERNION": "time_boot_ms",
    "LOCAL_POSITION_NED": "time_boot_ms",
    "GLOBAL_POSITION_INT": "time_boot_ms",
    "HIGHRES_IMU": "time_usec",
    "SCALED_IMU2": "time_boot_ms",
    "SCALED_IMU3": "time_boot_ms",
}
"""Messages stamped by the autopilot's boot clock as it sends them."""

_E7 = np.pi / 180.0 * 1e-7
_MILLI_G = G * 1e-3
_MAX_ATTITUDE_GAP_NS = NS
_PER_FRAME = 4
"""Arrival numbers per frame: one HIGHRES_IMU is an IMU, a pressure and a field sample."""


@dataclass(frozen=True, slots=True)
class _Stream:
    """All frames of one (system, component), with its clock."""

    buf: U8
    index: FrameIndex
    rows: I64
    clock: Clock

    def message(self, name: str) -> tuple[Table, I64]:
        """Structured array of one message and the frame numbers it came with."""
        msgid = message_id(name)
        rows = self.rows[self.index.msgid[self.rows] == msgid]
        return decode(self.buf, self.index, msgid, rows), rows

    def boot_us(self, table: Table, rows: I64) -> I64:
        """Boot stamps [µs]: as sent, or the latest one seen where there is none (or Unix time)."""
        if "time_usec" in (table.dtype.names or ()):
            stamp = np.minimum(table["time_usec"], np.uint64(2**62)).astype(np.int64)
        else:
            stamp = table["time_boot_ms"].astype(np.int64) * 1000
        usable = (stamp > 0) & (stamp < MAX_BOOT_US)
        return np.where(usable, stamp, self.clock.boot_us[rows])


def _boot_references(buf: U8, index: FrameIndex, rows: I64) -> tuple[I64, I64]:
    """Frame numbers that carry a boot stamp and the stamps [µs], in stream order."""
    found_rows, found_boot = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    ids = index.msgid[rows]
    for name, field in _BOOT_STAMPED.items():
        msgid = message_id(name)
        these = rows[ids == msgid]
        stamp = decode(buf, index, msgid, these)[field]
        boot = np.minimum(stamp, stamp.dtype.type(min(2**62, np.iinfo(stamp.dtype).max)))
        boot_us = boot.astype(np.int64) * (1000 if field == "time_boot_ms" else 1)
        usable = (boot_us > 0) & (boot_us < MAX_BOOT_US)
        found_rows.append(these[usable])
        found_boot.append(boot_us[usable])
    all_rows = np.concatenate(found_rows)
    order = np.argsort(all_rows, kind="stable")
    return all_rows[order], np.concatenate(found_boot)[order]


def _imu(stream: _Stream, name: str) -> ImuSamples | None:
    """One inertial message as samples; None if it is absent or not in its documented units."""
    table, rows = stream.message(name)
    if name == "HIGHRES_IMU":
        # Bits 0-5 of fields_updated: the three accelerometer and three gyro axes are new.
        fresh = (table["fields_updated"] & 0x3F) == 0x3F
        table, rows = table[fresh], rows[fresh]
        accel_scale, gyro_scale = 1.0, 1.0
    else:
        accel_scale, gyro_scale = _MILLI_G, 1e-3
    accel = triple(table, ("xacc", "yacc", "zacc"), accel_scale)
    gyro = triple(table, ("xgyro", "ygyro", "zgyro"), gyro_scale)
    if not table.shape[0] or not accel.any():
        return None
    t_ns = stream.clock.at(rows, stream.boot_us(table, rows))
    rx = stream.clock.rx_ns[rows]
    return ImuSamples(
        name, t_ns, rx, rows * _PER_FRAME, gyro, accel, np.full(rows.shape[0], np.nan)
    )


def _mag(stream: _Stream, name: str) -> MagSamples | None:
    """Magnetic field of an inertial message [T]; None if absent or all zero."""
    table, rows = stream.message(name)
    if name == "HIGHRES_IMU":
        fresh = (table["fields_updated"] & 0x1C0) == 0x1C0
        table, rows = table[fresh], rows[fresh]
    field = triple(table, ("xmag", "ymag", "zmag"), 1e-4 if name == "HIGHRES_IMU" else 1e-7)
    if not field.any():
        return None
    t_ns = stream.clock.at(rows, stream.boot_us(table, rows))
    return MagSamples(name, t_ns, stream.clock.rx_ns[rows], rows * _PER_FRAME + 2, field)


def _mags(stream: _Stream) -> list[MagSamples]:
    """One stream a compass: the first one by its best message, then the others."""
    first = [
        mag
        for mag in (_mag(stream, name) for name in ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU"))
        if mag is not None
    ]
    others = [_mag(stream, name) for name in ("SCALED_IMU2", "SCALED_IMU3")]
    return first[:1] + [mag for mag in others if mag is not None]


def _baro(stream: _Stream) -> list[BaroSamples]:
    """The first barometer, by SCALED_PRESSURE or else HIGHRES_IMU; both in hPa."""
    for name, field in (("SCALED_PRESSURE", "press_abs"), ("HIGHRES_IMU", "abs_pressure")):
        table, rows = stream.message(name)
        if name == "HIGHRES_IMU":
            fresh = (table["fields_updated"] & 0x200) != 0
            table, rows = table[fresh], rows[fresh]
        pressure = column(table, field) * 100.0
        good = pressure > 0
        if good.any():
            rows, table = rows[good], table[good]
            t_ns = stream.clock.at(rows, stream.boot_us(table, rows))
            rx = stream.clock.rx_ns[rows]
            return [BaroSamples(name, t_ns, rx, rows * _PER_FRAME + 1, pressure[good])]
    return []


def _new_fixes(table: Table) -> NDArray[np.bool_]:
    """Which rows are new epochs of the receiver.

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


def _gnss(stream: _Stream, name: str) -> tuple[GnssSamples | None, F64, int]:
    """(fixes with AMSL heights, undulation [m] of each or NaN, repeats dropped)."""
    table, rows = stream.message(name)
    boot = stream.boot_us(table, rows)
    keep = _new_fixes(table)
    repeats = int((~keep).sum())
    table, rows, boot = table[keep], rows[keep], boot[keep]
    if not table.shape[0]:
        return None, np.zeros(0), repeats
    # Without a fix the stamp of the last good one is often repeated: arrival says more.
    boot = np.where(table["fix_type"] < 2, stream.clock.boot_us[rows], boot)
    speed = np.where(table["vel"] == 65535, np.nan, table["vel"] * 1e-2)
    # Course is undefined at a standstill, where its unknown value does no harm.
    course = np.where(table["cog"] == 65535, np.where(speed == 0, 0.0, np.nan), table["cog"])
    course = course * (np.pi / 18000.0)
    vel = np.stack(
        [speed * np.cos(course), speed * np.sin(course), np.full(rows.shape[0], np.nan)], axis=1
    )
    h_acc, v_acc = _millimetres(table, "h_acc"), _millimetres(table, "v_acc")
    s_acc = _millimetres(table, "vel_acc")
    ellipsoid = column(table, "alt_ellipsoid") * 1e-3
    amsl = column(table, "alt") * 1e-3
    undulation = np.where(table["alt_ellipsoid"] == 0, np.nan, ellipsoid - amsl)
    sats = table["satellites_visible"].astype(np.int64)
    samples = GnssSamples(
        name,
        stream.clock.at(rows, boot),
        stream.clock.rx_ns[rows],
        rows * _PER_FRAME,
        column(table, "lat") * _E7,
        column(table, "lon") * _E7,
        amsl,
        vel,
        np.stack([h_acc, h_acc, v_acc], axis=1),
        np.stack([s_acc, s_acc, s_acc], axis=1),
        np.where(sats == 255, -1, sats),
        np.where(table["fix_type"] > 6, 3, table["fix_type"]).astype(np.int64),
    )
    return samples, undulation, repeats


def _attitude(stream: _Stream, t_ns: I64) -> F64:
    """(N, 3) roll, pitch, yaw [rad] of ATTITUDE at ``t_ns``; NaN where it has gaps."""
    table, rows = stream.message("ATTITUDE")
    at = stream.clock.at(rows, stream.boot_us(table, rows))
    keep = np.isfinite(triple(table, ("roll", "pitch", "yaw")).sum(axis=1))
    keep[1:] &= at[1:] > np.maximum.accumulate(at)[:-1]
    columns = [
        unwrapped_interpolation(t_ns, at[keep], column(table, n)[keep], _MAX_ATTITUDE_GAP_NS)
        for n in ("roll", "pitch", "yaw")
    ]
    return np.stack(columns, axis=1)


def _autopilot(stream: _Stream) -> ReferenceSamples | None:
    """The autopilot's own solution: GLOBAL_POSITION_INT (AMSL) with ATTITUDE at its times."""
    table, rows = stream.message("GLOBAL_POSITION_INT")
    known = (table["lat"] != 0) | (table["lon"] != 0)
    table, rows = table[known], rows[known]
    if not table.shape[0]:
        return None
    t_ns = stream.clock.at(rows, stream.boot_us(table, rows))
    return ReferenceSamples(
        "GLOBAL_POSITION_INT",
        t_ns,
        stream.clock.rx_ns[rows],
        rows * _PER_FRAME,
        column(table, "lat") * _E7,
        column(table, "lon") * _E7,
        column(table, "alt") * 1e-3,
        triple(table, ("vx", "vy", "vz"), 1e-2),
        _attitude(stream, t_ns),
    )


def _truth(stream: _Stream) -> ReferenceSamples | None:
    """Simulator truth: SIM_STATE, or the poorer SIMSTATE (no height, no velocity).

    Neither has a stamp. They are valid when the simulated IMU was last sampled, so they take
    the stamp of the HIGHRES_IMU or RAW_IMU before them in the stream.
    """
    name = "SIM_STATE"
    table, rows = stream.message(name)
    if not table.shape[0]:
        name = "SIMSTATE"
        table, rows = stream.message(name)
    if not table.shape[0]:
        return None
    imu_rows, imu_boot = [], []
    for imu in ("HIGHRES_IMU", "RAW_IMU"):
        imu_table, at = stream.message(imu)
        imu_rows.append(at)
        imu_boot.append(stream.boot_us(imu_table, at))
    order = np.argsort(np.concatenate(imu_rows), kind="stable")
    at, boot = np.concatenate(imu_rows)[order], np.concatenate(imu_boot)[order]
    before = np.searchsorted(at, rows) - 1
    table, rows, before = table[before >= 0], rows[before >= 0], before[before >= 0]
    if not rows.shape[0]:
        return None
    # A 4 Hz IMU message does not tell the time of a truth message half a period later; the
    # latest stamp of any message does.
    slow = np.median(np.diff(boot)) > 50_000 if boot.shape[0] > 1 else True
    t_ns = stream.clock.at(rows, stream.clock.boot_us[rows] if slow else boot[before])
    count = rows.shape[0]
    if name == "SIMSTATE":
        lat, lon = column(table, "lat"), column(table, "lng")
        height, vel = np.full(count, np.nan), unknown(count)
        rpy = triple(table, ("roll", "pitch", "yaw"))
    else:
        lat, lon = column(table, "lat_int"), column(table, "lon_int")
        if not lat.any():  # before these fields existed: float degrees
            lat, lon = column(table, "lat") * 1e7, column(table, "lon") * 1e7
        height, vel = column(table, "alt"), triple(table, ("vn", "ve", "vd"))
        rpy = _euler(table)
    return ReferenceSamples(
        name,
        t_ns,
        stream.clock.rx_ns[rows],
        rows * _PER_FRAME,
        lat * _E7,
        lon * _E7,
        height,
        vel,
        np.stack([rpy[:, 0], rpy[:, 1], wrap(rpy[:, 2])], axis=1),
    )


def _euler(table: Table) -> F64:
    """(N, 3) roll, pitch, yaw [rad] from fields q1..q4, body to NED, scalar first."""
    w, x, y, z = (column(table, f"q{i}") for i in range(1, 5))
    roll = np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = np.arcsin(np.clip(2 * (w * y - z * x), -1, 1))
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([roll, pitch, yaw], axis=1)


def _raised(reference: ReferenceSamples | None, by_m: float) -> ReferenceSamples | None:
    """The same reference with its heights moved to another datum."""
    return None if reference is None else replace(reference, height=reference.height + by_m)


def _vehicle(stream: _Stream, name: str) -> tuple[VehicleRecording, list[str]]:
    """Everything that one autopilot sent, as samples, and what was odd about it."""
    notes: list[str] = list(stream.clock.notes)
    names = ("HIGHRES_IMU", "SCALED_IMU", "RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
    imus = [imu for imu in (_imu(stream, n) for n in names) if imu is not None]
    fixes: list[GnssSamples] = []
    undulations: list[F64] = []
    for source in ("GPS_RAW_INT", "GPS2_RAW"):
        samples, undulation, repeats = _gnss(stream, source)
        if samples is not None:
            fixes.append(samples)
            undulations.append(undulation[samples.fix_type >= 3])
            if repeats:
                notes.append(f"{source}: {repeats} repeats of a fix, dropped")
    truth, autopilot = _truth(stream), _autopilot(stream)
    datum: Literal["hae", "msl"] = "msl"
    undulation = np.concatenate([np.zeros(0), *undulations])
    if undulation.size and np.isfinite(undulation).all():
        # One constant, so that a coarse undulation in the messages adds no steps.
        geoid = float(np.median(undulation))
        datum = "hae"
        fixes = [replace(fix, height=fix.height + geoid) for fix in fixes]
        truth, autopilot = _raised(truth, geoid), _raised(autopilot, geoid)
        if geoid:
            notes.append(f"heights above the ellipsoid: AMSL {geoid:+.2f} m, from the GNSS")
    vehicle, more = finish_vehicle(
        name, imus, fixes, _baro(stream), _mags(stream), truth, autopilot, datum=datum
    )
    return vehicle, notes + more


def _autopilots(buf: U8, index: FrameIndex) -> list[tuple[int, int]]:
    """(system, component) of each autopilot: its HEARTBEAT names one, or it sends IMU data."""
    key = index.system.astype(np.int64) * 256 + index.component
    beats = np.flatnonzero(index.msgid == message_id("HEARTBEAT"))
    invalid = 8  # MAV_AUTOPILOT_INVALID: ground stations, cameras, companions
    table = decode(buf, index, message_id("HEARTBEAT"), beats)
    found = key[beats[table["autopilot"] != invalid]]
    if not found.size:
        sensors = np.isin(index.msgid, [message_id(n) for n in ("RAW_IMU", "HIGHRES_IMU")])
        found = key[sensors & (index.component == 1)]
    return [(int(k) // 256, int(k) % 256) for k in np.unique(found)]


def _named(keys: Sequence[tuple[int, int]]) -> list[str]:
    """``sys1``, or ``sys1.2`` where a system has several autopilots."""
    systems = [system for system, _ in keys]
    return [f"sys{s}" if systems.count(s) == 1 else f"sys{s}.{c}" for s, c in keys]


def read_tlog(path: Path) -> Recording:
    """Read a MAVLink telemetry log, one vehicle for each autopilot in it.

    Raises :class:`LogFormatError` if there are no MAVLink frames or no autopilot among them.
    """
    buf = np.fromfile(path, np.uint8)
    index = index_frames(buf, stamped=True)
    if not len(index):
        raise LogFormatError(f"{path}: no MAVLink frame in {buf.shape[0]} bytes; not a tlog")
    notes = []
    if index.bad_bytes:
        notes.append(
            f"{index.bad_bytes} bytes that are no frame ({index.bad_crc} bad CRC), dropped"
        )
    wall, spikes = plausible_wall(index.stamp_us)
    if spikes:
        notes.append(f"{spikes} corrupt wall-clock stamp(s), replaced by their neighbours'")
    keys = _autopilots(buf, index)
    if not keys:
        raise LogFormatError(f"{path}: {len(index)} MAVLink frames, but none from an autopilot")
    key = index.system.astype(np.int64) * 256 + index.component
    vehicles = []
    metadata: dict[str, str] = {}
    for (system, component), name in zip(keys, _named(keys), strict=True):
        rows = np.flatnonzero(key == system * 256 + component)
        clock = vehicle_clock(wall, *_boot_references(buf, index, rows))
        vehicle, odd = _vehicle(_Stream(buf, index, rows, clock), name)
        vehicles.append(vehicle)
        # Of the first boot: what a ground station noted in time since boot can then be found.
        metadata[f"{name}.boot_offset_ns"] = str(int(clock.offset_ns[0]))
        notes += [f"{name}: {line}" if len(keys) > 1 else line for line in odd]
    return Recording(str(path), "tlog", tuple(vehicles), tuple(notes), metadata=metadata)
