"""Several recordings of one run as one: inertial units of a CAN bus beside an autopilot's log.

Their clocks meet at arrival. Both recorders ran on one computer (or were kept to one clock), so
the times of arrival of both are on the same clock; times of validity are not, where they come from
the autopilot's boot clock, which drifts by milliseconds a minute against it. So validity is moved
to the arrival clock along the lower envelope of (arrival − validity), as it changes over the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from companion.types import F64, I64, NS, LogFormatError, Recording, Samples, VehicleRecording
from replay.streams import numbered, rank_imus, stream_info

_END_POINTS = 5
"""Points of the envelope that give the drift beyond its first and last one."""

S = TypeVar("S", bound=Samples)

_WINDOW_NS = 4 * NS
"""An envelope point for each: short against drift, long against the scatter of arrivals."""


def join_inertial(base: Recording, inertial: Sequence[Recording]) -> Recording:
    """The vehicle of ``base`` with the units of ``inertial`` recordings as its first IMUs.

    Raises :class:`LogFormatError` where ``base`` has several vehicles, or times do not overlap.
    """
    if len(base.vehicles) != 1:
        names = ", ".join(vehicle.name for vehicle in base.vehicles)
        raise LogFormatError(
            f"{base.path}: which of {names} carries the CAN IMU? Say it with --vehicle NAME"
        )
    vehicle, drift_s = on_arrival_clock(base.vehicles[0])
    notes = list(base.notes)
    if drift_s > 0.0:
        notes.append(
            f"{Path(base.path).name}: validity moved to the clock of arrival, "
            f"{drift_s * 1e3:.0f} ms of drift between the two"
        )
    for recording in inertial:
        _need_overlap(vehicle, base.path, recording)
        notes += [f"{Path(recording.path).name}: {note}" for note in recording.notes]
    units = [imu for recording in inertial for v in recording.vehicles for imu in v.imu]
    _need_names([*units, *vehicle.imu])
    joined = _numbered(replace(vehicle, imu=rank_imus([*units, *vehicle.imu])))
    infos = tuple(stream_info(imu, "imu") for imu in joined.imu)
    others = tuple(info for info in vehicle.streams if info.kind != "imu")
    return Recording(
        " + ".join([base.path, *(r.path for r in inertial)]),
        f"{base.format}+can",
        (replace(joined, streams=infos + others),),
        tuple(notes),
        base.config_toml,
        base.metadata,
    )


def on_arrival_clock(vehicle: VehicleRecording) -> tuple[VehicleRecording, float]:
    """The same recording, validity on the clock of arrival; and how far the two drifted [s]."""
    at_ns, delay = _envelope(_streams(vehicle))
    if at_ns.size == 0:
        return vehicle, 0.0
    origin = int(at_ns[0])

    def moved(samples: S) -> S:
        since = (samples.t_ns - origin).astype(np.float64)
        shift = np.interp(since, (at_ns - origin).astype(np.float64), delay)
        return replace(samples, t_ns=samples.t_ns + np.rint(shift).astype(np.int64))

    return _mapped(vehicle, moved), float(np.ptp(delay)) / NS


def _envelope(streams: Sequence[Samples]) -> tuple[I64, F64]:
    """Times of validity [ns], increasing, and the least (arrival − validity) about each [ns]."""
    valid = np.concatenate([np.zeros(0, np.int64), *(s.t_ns for s in streams)])
    if valid.size == 0:
        return valid, np.zeros(0)
    delay = np.concatenate([s.t_rx_ns for s in streams]) - valid
    window = (valid - valid.min()) // _WINDOW_NS
    # The least delay of each window, at its own time: within a window the clocks drift, too.
    order = np.lexsort((delay, window))
    first = np.concatenate([[True], np.diff(window[order]) > 0])
    least = order[first]
    return _to_the_ends(valid, valid[least], delay[least].astype(np.float64))


def _to_the_ends(valid: I64, at_ns: I64, delay: F64) -> tuple[I64, F64]:
    """The envelope carried on, at the drift of its first and last points, to all of ``valid``."""
    if at_ns.size < 2:
        return at_ns, delay
    k = min(_END_POINTS, at_ns.size - 1)
    before = delay[0] - (delay[k] - delay[0]) * _ratio(at_ns[0] - valid.min(), at_ns[k] - at_ns[0])
    after = delay[-1] + (delay[-1] - delay[-1 - k]) * _ratio(
        valid.max() - at_ns[-1], at_ns[-1] - at_ns[-1 - k]
    )
    # A nanosecond outside, so that times still increase where an end is a point already.
    times = np.concatenate([[valid.min() - 1], at_ns, [valid.max() + 1]])
    return times, np.concatenate([[before], delay, [after]])


def _ratio(part: np.int64, whole: np.int64) -> float:
    return float(part) / float(whole)


def _streams(vehicle: VehicleRecording) -> list[Samples]:
    references = [r for r in (vehicle.truth, vehicle.autopilot) if r is not None]
    return [*vehicle.imu, *vehicle.gnss, *vehicle.baro, *vehicle.mag, *references]


def _mapped(vehicle: VehicleRecording, change: Callable[[Any], Any]) -> VehicleRecording:
    """The vehicle with every stream changed."""
    return replace(
        vehicle,
        imu=tuple(map(change, vehicle.imu)),
        gnss=tuple(map(change, vehicle.gnss)),
        baro=tuple(map(change, vehicle.baro)),
        mag=tuple(map(change, vehicle.mag)),
        truth=None if vehicle.truth is None else change(vehicle.truth),
        autopilot=None if vehicle.autopilot is None else change(vehicle.autopilot),
    )


def _numbered(vehicle: VehicleRecording) -> VehicleRecording:
    """The vehicle with ``seq`` by arrival over all streams; ties go to the inertial ones."""
    parts = iter(numbered([_streams(vehicle)])[0])
    return _mapped(vehicle, lambda _: next(parts))


def _need_overlap(vehicle: VehicleRecording, path: str, other: Recording) -> None:
    ours = [s.t_rx_ns for s in _streams(vehicle) if len(s)]
    theirs = [imu.t_rx_ns for v in other.vehicles for imu in v.imu if len(imu)]
    if not ours or not theirs:
        return
    begin = max(min(int(t[0]) for t in ours), min(int(t[0]) for t in theirs))
    end = min(max(int(t[-1]) for t in ours), max(int(t[-1]) for t in theirs))
    if begin >= end:
        raise LogFormatError(
            f"{path} and {other.path} have no time in common: {(begin - end) / NS:.0f} s lie "
            "between them; are they of one run, and stamped by one clock?"
        )


def _need_names(streams: Sequence[Samples]) -> None:
    names = [stream.source for stream in streams]
    for name in names:
        if names.count(name) > 1:
            raise LogFormatError(f"two inertial streams of the run are named '{name}'")
