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

from companion.types import (
    F64,
    I64,
    NS,
    AttitudeSamples,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    LogFormatError,
    MagSamples,
    Recording,
    ReferenceSamples,
    VehicleRecording,
)
from drivers.mavlink import samples as messages
from drivers.mavlink.columns import decode
from drivers.mavlink.dialect import message_id
from drivers.mavlink.framer import U8, FrameIndex, index_frames
from drivers.mavlink.readings import Readings
from drivers.mavlink.samples import Stamps, Table, column, triple
from replay.clipping import with_counter
from replay.clocks import (
    Clock,
    plausible_wall,
    unwrapped_interpolation,
    vehicle_clock,
)
from replay.streams import finish_vehicle, unknown, wrap

_E7 = np.pi / 180.0 * 1e-7
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

    def stamps(self, rows: I64, boot_us: I64) -> Stamps:
        """Times and numbers of frames ``rows`` stamped ``boot_us`` [µs], 0 where there is none.

        Those without take the latest stamp seen on the stream.
        """
        boot = np.where(boot_us > 0, boot_us, self.clock.boot_us[rows])
        return Stamps(self.clock.at(rows, boot), self.clock.rx_ns[rows], rows * _PER_FRAME)


def _boot_references(buf: U8, index: FrameIndex, rows: I64) -> tuple[I64, I64]:
    """Frame numbers that carry a boot stamp and the stamps [µs], in stream order."""
    found_rows, found_boot = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    ids = index.msgid[rows]
    for name in messages.BOOT_STAMPED:
        msgid = message_id(name)
        these = rows[ids == msgid]
        stamp = messages.boot_us(decode(buf, index, msgid, these))
        found_rows.append(these[stamp > 0])
        found_boot.append(stamp[stamp > 0])
    all_rows = np.concatenate(found_rows)
    order = np.argsort(all_rows, kind="stable")
    return all_rows[order], np.concatenate(found_boot)[order]


def _imu(stream: _Stream, name: str) -> ImuSamples | None:
    """One inertial message as samples; None if it is absent or not in its documented units."""
    table, rows = stream.message(name)
    samples = messages.imu(name, table, stream.stamps(rows, messages.boot_us(table)))
    counters, at = stream.message(messages.VIBRATION)
    if samples is None or not at.shape[0]:
        return samples
    count = messages.clip_counts(counters)[:, messages.ACCELEROMETER.get(name, 0)]
    return with_counter(samples, at * _PER_FRAME, stream.clock.rx_ns[at], count)


def _mag(stream: _Stream, name: str) -> MagSamples | None:
    """Magnetic field of an inertial message; None if absent or all zero."""
    table, rows = stream.message(name)
    samples = messages.mag(name, table, stream.stamps(rows, messages.boot_us(table)))
    if samples is None:
        return None
    samples = samples.take(Readings().new(samples.field_b, samples.t_ns))
    return replace(samples, seq=samples.seq + 2)


def _mags(stream: _Stream) -> list[MagSamples]:
    """One stream a compass: the first one by its best message, then the others."""
    first = [mag for mag in (_mag(stream, name) for name in messages.MAG) if mag is not None]
    others = [_mag(stream, name) for name in messages.MAG_OTHERS]
    return first[:1] + [mag for mag in others if mag is not None]


def _baro(stream: _Stream) -> list[BaroSamples]:
    """One stream a barometer: the first one by its best message, then the others."""
    found: list[BaroSamples] = []
    for name in (*messages.BARO, *messages.BARO_OTHERS):
        table, rows = stream.message(name)
        samples = messages.baro(name, table, stream.stamps(rows, messages.boot_us(table)))
        if samples is not None and not (found and name in messages.BARO):
            samples = samples.take(Readings().new(samples.pressure[:, None], samples.t_ns))
            found.append(replace(samples, seq=samples.seq + 1))
    return found


def _gnss(stream: _Stream, name: str) -> tuple[GnssSamples | None, F64, int]:
    """(fixes with AMSL heights, undulation [m] of each or NaN, repeats dropped)."""
    table, rows = stream.message(name)
    keep = messages.new_fixes(table)
    repeats = int((~keep).sum())
    table, rows = table[keep], rows[keep]
    if not table.shape[0]:
        return None, np.zeros(0), repeats
    at = stream.stamps(rows, messages.fix_boot_us(table, messages.boot_us(table)))
    samples, undulation = messages.gnss(name, table, at)
    return samples, undulation, repeats


def _attitude(stream: _Stream, t_ns: I64) -> F64:
    """(N, 3) roll, pitch, yaw [rad] of ATTITUDE at ``t_ns``; NaN where it has gaps."""
    table, rows = stream.message("ATTITUDE")
    at = stream.stamps(rows, messages.boot_us(table)).t_ns
    keep = np.isfinite(triple(table, ("roll", "pitch", "yaw")).sum(axis=1))
    keep[1:] &= at[1:] > np.maximum.accumulate(at)[:-1]
    columns = [
        unwrapped_interpolation(t_ns, at[keep], column(table, n)[keep], _MAX_ATTITUDE_GAP_NS)
        for n in ("roll", "pitch", "yaw")
    ]
    return np.stack(columns, axis=1)


def _attitudes(stream: _Stream) -> list[AttitudeSamples]:
    """The autopilot's attitude at its own rate."""
    table, rows = stream.message("ATTITUDE")
    if not table.shape[0]:
        return []
    at = stream.stamps(rows, messages.boot_us(table))
    rpy = triple(table, ("roll", "pitch", "yaw"))
    return [AttitudeSamples("ATTITUDE", at.t_ns, at.rx_ns, at.seq, rpy)]


def _autopilot(stream: _Stream) -> ReferenceSamples | None:
    """The autopilot's own solution: GLOBAL_POSITION_INT (AMSL) with ATTITUDE at its times."""
    table, rows = stream.message("GLOBAL_POSITION_INT")
    known = messages.known_position(table)
    table, rows = table[known], rows[known]
    if not table.shape[0]:
        return None
    at = stream.stamps(rows, messages.boot_us(table))
    lat, lon, amsl, vel_n = messages.position(table)
    rpy = _attitude(stream, at.t_ns)
    return ReferenceSamples(
        "GLOBAL_POSITION_INT", at.t_ns, at.rx_ns, at.seq, lat, lon, amsl, vel_n, rpy
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
        stamp = messages.boot_us(imu_table)
        imu_boot.append(np.where(stamp > 0, stamp, stream.clock.boot_us[at]))
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
    imus = [imu for imu in (_imu(stream, n) for n in messages.IMU) if imu is not None]
    fixes: list[GnssSamples] = []
    undulations: list[F64] = []
    for source in messages.GNSS:
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
        name,
        imus,
        fixes,
        _baro(stream),
        _mags(stream),
        truth,
        autopilot,
        datum=datum,
        attitude=_attitudes(stream),
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
