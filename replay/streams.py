"""What all readers share: stream statistics, choosing the IMU, numbering arrivals, finishing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from companion.types import (
    F64,
    I64,
    NS,
    AttitudeSamples,
    BaroSamples,
    BroadcastSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    RawGnssSamples,
    ReferenceSamples,
    Samples,
    StreamInfo,
    VehicleRecording,
)

S = TypeVar("S", bound=Samples)
GnssClock = Literal["utc", "gps"]
"""Time of a recording's stamps beside raw GNSS: POSIX nanoseconds in UTC, or in GPS time."""
Kind = Literal["imu", "gnss", "baro", "mag", "attitude", "raw", "truth", "autopilot"]

SLOW_HZ = 20.0
"""Below it an IMU loses against any that is faster."""
G = 9.80665


def unknown(count: int, width: int = 3) -> F64:
    """(N, width) of NaN."""
    return np.full((count, width), np.nan)


def wrap(angle: F64) -> F64:
    """Angle [rad] in (−π, π]."""
    out: F64 = np.pi - np.mod(np.pi - angle, 2 * np.pi)
    return out


def rate_hz(t_ns: I64) -> float:
    """Median rate of increasing stamps; 0 with fewer than two."""
    if t_ns.shape[0] < 2:
        return 0.0
    step = float(np.median(np.diff(t_ns)))
    return NS / step if step > 0 else 0.0


def stream_info(samples: Samples, kind: Kind, note: str = "") -> StreamInfo:
    """Count, median rate and gaps of one stream."""
    steps = np.diff(samples.t_ns)
    if steps.size:
        limit = max(5.0 * float(np.median(steps)), 0.5 * NS)
        longest, gaps = float(steps.max()) / NS, int((steps > limit).sum())
    else:
        longest, gaps = 0.0, 0
    return StreamInfo(
        samples.source, kind, len(samples), rate_hz(samples.t_ns), longest, gaps, note
    )


def increasing(samples: S) -> tuple[S, int]:
    """Only the rows that move time forward, and how many were dropped."""
    t = samples.t_ns
    if t.shape[0] < 2:
        return samples, 0
    # One corrupt stamp far ahead must not cost everything after it: a row is a spike if the
    # next two are earlier, while the next still goes on from the one before.
    spike = np.zeros(t.shape[0], np.bool_)
    spike[1:-2] = (t[1:-2] > t[2:-1]) & (t[1:-2] > t[3:]) & (t[2:-1] > t[:-3])
    before = np.maximum.accumulate(np.where(spike, t.min(), t))[:-1]
    keep = np.concatenate([[True], t[1:] > before]) & ~spike
    dropped = int((~keep).sum())
    return (samples.take(keep), dropped) if dropped else (samples, 0)


def finite(samples: S, *names: str) -> tuple[S, int]:
    """Only the rows whose columns ``names`` are all finite, and how many were dropped."""
    keep = np.ones(len(samples), np.bool_)
    for name in names:
        values: NDArray[Any] = getattr(samples, name)
        keep &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return (samples, 0) if keep.all() else (samples.take(keep), int((~keep).sum()))


def numbered(groups: Sequence[Sequence[Samples]]) -> list[list[Any]]:
    """The same streams with ``seq`` numbering all samples by arrival, ties in the order given.

    For logs that keep each stream apart and know arrivals only by their times.
    """
    flat = [samples for group in groups for samples in group]
    if not flat:
        return [[] for _ in groups]
    order = np.argsort(np.concatenate([s.t_rx_ns for s in flat]), kind="stable")
    seq = np.empty(order.shape[0], np.int64)
    seq[order] = np.arange(order.shape[0])
    ends = np.cumsum([len(s) for s in flat])
    parts = iter(np.split(seq, ends[:-1]))
    return [[replace(samples, seq=next(parts)) for samples in group] for group in groups]


def rank_imus(imus: Sequence[ImuSamples]) -> tuple[ImuSamples, ...]:
    """Best first: at least 20 Hz before slower; the order given decides among equals.

    Callers give their sources by resolution, finest first.
    """
    return tuple(sorted(imus, key=lambda imu: rate_hz(imu.t_ns) < SLOW_HZ))


def imu_oddities(imu: ImuSamples) -> list[str]:
    """Lines about units or axes that cannot be body FRD specific force and rad/s."""
    if len(imu) < 10:
        return []
    notes = []
    norm = float(np.median(np.linalg.norm(imu.accel_b, axis=1)))
    down = float(np.median(imu.accel_b[:, 2]))
    if not 0.5 * G < norm < 2.0 * G:
        notes.append(f"{imu.source}: median specific force {norm:.3g} m/s², expected about 9.8")
    elif down > 0.7 * G:
        notes.append(
            f"{imu.source}: specific force is {down:+.1f} m/s² on z; forward-right-down axes "
            "give about −9.8 when level (sensor upside down, or z up)"
        )
    rate = float(np.percentile(np.linalg.norm(imu.gyro_b, axis=1), 99))
    if rate > 35.0:
        notes.append(f"{imu.source}: angular rates to {rate:.3g} rad/s; in degrees, perhaps?")
    return notes


def _cleaned(
    samples: Sequence[S], columns: tuple[str, ...], notes: list[str], *, ordered: bool
) -> tuple[S, ...]:
    """Streams without non-finite rows and, if ``ordered``, without rows that go back in time."""
    out = []
    for stream in samples:
        kept, bad = finite(stream, *columns)
        if bad:
            notes.append(f"{stream.source}: {bad} sample(s) that are not numbers, dropped")
        if ordered:
            kept, late = increasing(kept)
            if late:
                notes.append(f"{stream.source}: {late} repeated or backward time(s), dropped")
        if len(kept):
            out.append(kept)
    return tuple(out)


def finish_vehicle(
    name: str,
    imu: Sequence[ImuSamples],
    gnss: Sequence[GnssSamples],
    baro: Sequence[BaroSamples] = (),
    mag: Sequence[MagSamples] = (),
    truth: ReferenceSamples | None = None,
    autopilot: ReferenceSamples | None = None,
    *,
    datum: Literal["hae", "msl"] = "hae",
    attitude: Sequence[AttitudeSamples] = (),
    raw: Sequence[RawGnssSamples] = (),
    broadcast: Sequence[BroadcastSamples] = (),
) -> tuple[VehicleRecording, list[str]]:
    """A vehicle's recording with cleaned, ranked and described streams, and what was odd.

    IMU, barometer and magnetometer come out strictly increasing in time and finite; GNSS keeps
    its order of arrival, because fixes may be late or out of order and the engine handles that.
    """
    notes: list[str] = []
    imus = rank_imus(_cleaned(imu, ("gyro_b", "accel_b"), notes, ordered=True))
    fixes = _cleaned(gnss, ("lat", "lon"), notes, ordered=False)
    pressures = _cleaned(baro, ("pressure",), notes, ordered=True)
    fields = _cleaned(mag, ("field_b",), notes, ordered=True)
    attitudes = _cleaned(attitude, ("rpy",), notes, ordered=True)
    references = []
    for reference in (truth, autopilot):
        kept = increasing(reference)[0] if reference is not None else None
        references.append(kept if kept is not None and len(kept) else None)
    for unit in imus:
        notes += imu_oddities(unit)
    kinds: list[tuple[Kind, Sequence[Samples]]] = [
        ("imu", imus),
        ("gnss", fixes),
        ("baro", pressures),
        ("mag", fields),
        ("attitude", attitudes),
        ("raw", raw),
        ("truth", [r for r in references[:1] if r is not None]),
        ("autopilot", [r for r in references[1:] if r is not None]),
    ]
    infos = tuple(stream_info(s, kind) for kind, group in kinds for s in group)
    vehicle = VehicleRecording(
        name,
        imus,
        fixes,
        pressures,
        fields,
        references[0],
        references[1],
        datum,
        infos,
        attitude=attitudes,
        raw=tuple(raw),
        broadcast=tuple(broadcast),
    )
    return vehicle, notes
