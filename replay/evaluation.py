"""Errors of a solution against a reference that no estimator has seen.

A reference is interpolated to the solution's epochs and never extended: positions linearly in a
local metric frame, attitude along the great arc of the quaternion. Where its samples are further
apart than :data:`MAX_GAP_S`, there is nothing to hold the solution against.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from companion.navigation.earth import ned_difference
from companion.navigation.rotation import rpy_from_quat
from companion.types import (
    COV_POS,
    F64,
    I64,
    NS,
    AidingReports,
    Channel,
    CompanionError,
    GnssSamples,
    Mode,
    ReferenceSamples,
    Solution,
    Verdict,
)

MAX_GAP_S = 1.1
"""Longest step of the reference that is interpolated: one second and the jitter of a 1 Hz log."""

Mask = NDArray[np.bool_]


class EvaluationError(CompanionError):
    """Nothing to compare: no aligned epoch, or none that the reference covers."""


@dataclass(frozen=True, slots=True)
class Outage:
    """A time without GNSS, from the last fix to the first one after it."""

    start_ns: int
    end_ns: int


@dataclass(frozen=True, slots=True)
class OutageError:
    """What happened to the position while GNSS was away; None where the reference is missing."""

    start_s: float
    """Since the origin of times."""
    seconds: float
    max_horizontal_error_m: float | None
    end_horizontal_error_m: float | None


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Errors of a solution; NaN where the reference does not have the quantity."""

    solution: Literal["forward", "smoothed"]
    reference: Literal["truth", "autopilot"]
    duration_s: float
    samples: int
    """Epochs compared."""
    position_rmse_m: dict[str, float]
    velocity_rmse_mps: dict[str, float]
    attitude_rmse_deg: dict[str, float]
    position_nees_mean: float
    """Mean of eᵀ P⁻¹ e over all compared epochs; 3 for an honest covariance."""
    outages: tuple[OutageError, ...]
    digest: str | None
    digest_published: str | None
    nis_mean: dict[str, float] = field(default_factory=dict)
    """Mean of NIS over its degrees of freedom, of accepted updates; 1 where P and R are honest."""

    def to_json(self) -> dict[str, Any]:
        """The object of ``evaluate --json``; what is not known is null."""
        return {
            "solution": self.solution,
            "reference": self.reference,
            "duration_s": self.duration_s,
            "samples": self.samples,
            "position_rmse_m": _nulls(self.position_rmse_m),
            "velocity_rmse_mps": _nulls(self.velocity_rmse_mps),
            "attitude_rmse_deg": _nulls(self.attitude_rmse_deg),
            "position_nees_mean": _null(self.position_nees_mean),
            "outages": [
                {
                    "start_s": o.start_s,
                    "seconds": o.seconds,
                    "max_horizontal_error_m": o.max_horizontal_error_m,
                    "end_horizontal_error_m": o.end_horizontal_error_m,
                }
                for o in self.outages
            ],
            "digest": self.digest,
            "digest_published": self.digest_published,
        }

    def json_text(self) -> str:
        """:meth:`to_json` on one line."""
        return json.dumps(self.to_json(), allow_nan=False)


@dataclass(frozen=True, slots=True)
class Errors:
    """Solution − reference at the solution's epochs; NaN rows where there is no reference."""

    t_ns: I64
    position_n: F64
    """(N, 3) NED [m]."""
    velocity_n: F64
    """(N, 3) NED [m/s]."""
    attitude: F64
    """(N, 3) roll, pitch, yaw [rad], wrapped to ±π."""


def evaluate(
    solution: Solution,
    reference: ReferenceSamples,
    *,
    reference_kind: Literal["truth", "autopilot"],
    outages: Sequence[Outage] = (),
    window_s: tuple[float, float] | None = None,
    origin_ns: int | None = None,
    lever_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
    reports: AidingReports | None = None,
    solution_kind: Literal["forward", "smoothed"] = "forward",
    digest: str | None = None,
    digest_published: str | None = None,
) -> Evaluation:
    """Errors of ``solution`` after its alignment has finished.

    ``window_s`` (start, end) and the outages' starts count from ``origin_ns``, by default the
    first epoch. ``lever_arm_b`` [m]: the point of the body that the reference is of (an antenna).
    Heights must have one datum; a constant difference is the caller's to remove.
    Raises :class:`EvaluationError` when no epoch can be compared.
    """
    if not len(solution):
        raise EvaluationError("the solution has no epochs: alignment never began")
    origin = int(solution.t_ns[0]) if origin_ns is None else origin_ns
    errors = errors_against(solution, reference, lever_arm_b)
    aligned = _after_alignment(solution)
    used = aligned.copy()
    if window_s is not None:
        since = (solution.t_ns - origin) / NS
        used &= (since >= window_s[0]) & (since <= window_s[1])
    used &= np.isfinite(errors.position_n).all(axis=1)
    if not used.any():
        raise EvaluationError(_why_nothing(solution, reference, aligned))
    n, e, d = np.sqrt(np.mean(errors.position_n[used] ** 2, axis=0))
    vn, ve, vd = _rms_columns(errors.velocity_n[used])
    roll, pitch, yaw = np.degrees(_rms_columns(errors.attitude[used]))
    times = solution.t_ns[used]
    return Evaluation(
        solution=solution_kind,
        reference=reference_kind,
        duration_s=float(times[-1] - times[0]) / NS,
        samples=int(used.sum()),
        position_rmse_m={
            "n": float(n),
            "e": float(e),
            "d": float(d),
            "horizontal": float(np.hypot(n, e)),
            "3d": float(np.sqrt(n * n + e * e + d * d)),
        },
        velocity_rmse_mps={
            "n": float(vn),
            "e": float(ve),
            "d": float(vd),
            "3d": float(np.sqrt(vn * vn + ve * ve + vd * vd)),
        },
        attitude_rmse_deg={"roll": float(roll), "pitch": float(pitch), "yaw": float(yaw)},
        position_nees_mean=_mean(position_nees(errors.position_n[used], solution.cov[used])),
        outages=tuple(_outage_error(o, errors, aligned, origin) for o in outages),
        digest=digest,
        digest_published=digest_published,
        nis_mean=_nis_means(reports) if reports is not None else {},
    )


def errors_against(
    solution: Solution,
    reference: ReferenceSamples,
    lever_arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Errors:
    """Solution − reference at every epoch, in north, east, down of the reference."""
    t = solution.t_ns
    lon = np.where(np.isfinite(reference.lon), reference.lon, 0.0)
    place = np.stack([reference.lat, np.unwrap(lon), reference.height], axis=1)
    place[~np.isfinite(reference.lon)] = np.nan
    lat0, lon0, height0 = _interpolate(reference.t_ns, place, t).T
    position = ned_difference(solution.lat, solution.lon, solution.height, lat0, lon0, height0)
    if any(lever_arm_b):
        position = position + _rotate(solution.q_nb, np.array(lever_arm_b))
    velocity = solution.vel_n - _interpolate(reference.t_ns, reference.vel_n, t, each=True)
    attitude = rpy_from_quat(solution.q_nb) - _interpolate_rpy(reference.t_ns, reference.rpy, t)
    return Errors(t, position, velocity, _wrap(attitude))


def as_solution(reference: ReferenceSamples) -> Solution:
    """Somebody else's solution in our columns, standard deviations and biases unknown (NaN)."""
    n = len(reference)
    return Solution(
        t_ns=reference.t_ns,
        lat=reference.lat,
        lon=reference.lon,
        height=reference.height,
        vel_n=reference.vel_n,
        q_nb=_quaternions(reference.rpy),
        accel_bias_b=np.full((n, 3), np.nan),
        gyro_bias_b=np.full((n, 3), np.nan),
        cov=np.full((n, 5, 6), np.nan),
        mode=np.full(n, int(Mode.NAVIGATING), np.int64),
        resets=np.zeros(n, np.int64),
    )


def position_nees(error_n: F64, cov: F64) -> F64:
    """Normalised error squared eᵀ P⁻¹ e (N,); NaN where P is not positive definite.

    ``error_n`` (N, 3) [m], ``cov`` (N, 5, 6) as :attr:`Solution.cov`.
    """
    a, b, c, d, e, f = cov[:, COV_POS].T
    x, y, z = error_n.T
    # Cholesky by hand: it also tells positive definite from not.
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        l11 = np.sqrt(a)
        l21, l31 = b / l11, c / l11
        l22 = np.sqrt(d - l21 * l21)
        l32 = (e - l31 * l21) / l22
        l33 = np.sqrt(f - l31 * l31 - l32 * l32)
        u = x / l11
        v = (y - l21 * u) / l22
        w = (z - l31 * u - l32 * v) / l33
        nees: F64 = u * u + v * v + w * w
    nees[~((l11 > 0) & (l22 > 0) & (l33 > 0))] = np.nan
    return nees


def find_outages(
    gnss: GnssSamples, minimum_s: float = 3.0, *, min_fix_type: int = 3
) -> tuple[Outage, ...]:
    """Times of at least ``minimum_s`` without a fix: silence, or ``fix_type`` too low.

    A receiver that is slow by nature has no outage: a gap must also exceed two and a half of its
    median intervals. Before the first and after the last fix nothing is reported.
    """
    return silences(gnss.t_ns[gnss.fix_type >= min_fix_type], minimum_s)


def silences(t_ns: I64, minimum_s: float = 3.0) -> tuple[Outage, ...]:
    """Gaps of :func:`find_outages` between times (N,) at which there was something."""
    good = np.unique(t_ns)
    if len(good) < 2:
        return ()
    gaps = np.diff(good)
    limit = max(minimum_s * NS, 2.5 * float(np.median(gaps)))
    return tuple(Outage(int(good[i]), int(good[i + 1])) for i in np.flatnonzero(gaps >= limit))


def describe(evaluation: Evaluation) -> list[str]:
    """The evaluation in words, a line each."""
    p, v, a = (evaluation.position_rmse_m, evaluation.velocity_rmse_mps,
               evaluation.attitude_rmse_deg)  # fmt: skip
    lines = [
        f"{evaluation.solution} solution against {evaluation.reference}: {evaluation.samples} "
        f"epochs over {evaluation.duration_s:.0f} s",
        f"position RMSE {p['horizontal']:.2f} m horizontal, {p['d']:.2f} m vertical, "
        f"{p['3d']:.2f} m in space",
        _line("velocity RMSE", v, " m/s", 3),
        _line("attitude RMSE", a, "°", 2),
    ]
    if np.isfinite(evaluation.position_nees_mean):
        lines.append(f"position NEES {evaluation.position_nees_mean:.2f} (honest: 3)")
    if evaluation.nis_mean:
        values = ", ".join(f"{name} {x:.2f}" for name, x in evaluation.nis_mean.items())
        lines.append(f"NIS per degree of freedom (honest: 1): {values}")
    for o in evaluation.outages:
        if o.max_horizontal_error_m is None or o.end_horizontal_error_m is None:
            lines.append(f"outage at {o.start_s:.1f} s for {o.seconds:.1f} s: not covered")
        else:
            lines.append(
                f"outage at {o.start_s:.1f} s for {o.seconds:.1f} s: "
                f"{o.end_horizontal_error_m:.2f} m off at its end, "
                f"{o.max_horizontal_error_m:.2f} m at most"
            )
    return lines


def _line(name: str, values: dict[str, float], unit: str, digits: int) -> str:
    known = [f"{key} {x:.{digits}f}{unit}" for key, x in values.items() if np.isfinite(x)]
    return f"{name} {', '.join(known) if known else 'not in the reference'}"


def _after_alignment(solution: Solution) -> Mask:
    """Epochs with a solution, from the first one that navigates."""
    mask: Mask = (solution.mode != Mode.ALIGNING) & np.isfinite(solution.lat)
    navigating = np.flatnonzero(solution.mode >= Mode.NAVIGATING)
    mask[: navigating[0] if len(navigating) else len(mask)] = False
    return mask


def _why_nothing(solution: Solution, reference: ReferenceSamples, aligned: Mask) -> str:
    if not aligned.any():
        return "alignment never finished: there is no epoch to evaluate"
    t = solution.t_ns[aligned]
    if not len(reference):
        return "the reference is empty"
    if reference.t_ns.max() < t[0] or reference.t_ns.min() > t[-1]:
        return "the reference and the solution have no time in common"
    return "the reference covers no epoch: only gaps, or outside the window"


def _interpolate(t_ref: I64, values: F64, t: I64, each: bool = False) -> F64:
    """Columns (M, k) at times ``t`` (N,), NaN outside and in gaps.

    Rows with a NaN are passed over; ``each``: column by column, for columns that are known apart.
    """
    if each:
        columns = [_interpolate(t_ref, values[:, i : i + 1], t) for i in range(values.shape[1])]
        return np.concatenate(columns, axis=1)
    kept = _usable(t_ref, values)
    out = np.full((len(t), values.shape[1]), np.nan)
    i, w, ok = _bracket(t_ref[kept], t)
    low, high = values[kept][i[ok]], values[kept][i[ok] + 1]
    out[ok] = low + w[ok, None] * (high - low)
    return out


def _interpolate_rpy(t_ref: I64, rpy: F64, t: I64) -> F64:
    """Roll, pitch, yaw (N, 3) at ``t``: slerp where all are known, else each angle unwrapped."""
    out = np.full((len(t), 3), np.nan)
    if np.isfinite(rpy).all(axis=1).any():
        kept = _usable(t_ref, rpy)
        q = _quaternions(rpy[kept])
        i, w, ok = _bracket(t_ref[kept], t)
        out[ok] = rpy_from_quat(_slerp(q[i[ok]], q[i[ok] + 1], w[ok]))
        return out
    for axis in range(3):
        known = np.isfinite(rpy[:, axis])
        unwrapped = np.unwrap(rpy[known, axis])[:, None]
        out[:, axis] = _interpolate(t_ref[known], unwrapped, t)[:, 0]
    return out


def _usable(t_ref: I64, values: F64) -> I64:
    """Rows without NaN whose times increase."""
    finite = np.flatnonzero(np.isfinite(values).all(axis=1))
    if not len(finite):
        return finite
    before = np.maximum.accumulate(t_ref[finite])
    rising = np.concatenate(([True], t_ref[finite][1:] > before[:-1]))
    kept: I64 = finite[rising]
    return kept


def _bracket(t_ref: I64, t: I64) -> tuple[I64, F64, Mask]:
    """For each of ``t``: the row before it, the weight of the next row, and whether both serve."""
    if len(t_ref) < 2:
        return np.zeros(len(t), np.int64), np.zeros(len(t)), np.zeros(len(t), bool)
    i = np.clip(np.searchsorted(t_ref, t, side="right") - 1, 0, len(t_ref) - 2)
    step = t_ref[i + 1] - t_ref[i]
    since = t - t_ref[i]
    # An epoch exactly on a sample needs no neighbour, so a gap beside it does not matter.
    on_sample = (since == 0) | (since == step)
    ok = (since >= 0) & (since <= step) & ((step <= MAX_GAP_S * NS) | on_sample)
    return i, since / step, ok


def _quaternions(rpy: F64) -> F64:
    """q_nb (N, 4) of roll, pitch, yaw (N, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy.T / 2), np.sin(rpy.T / 2)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def _slerp(q0: F64, q1: F64, w: F64) -> F64:
    """Unit quaternions (N, 4) at fraction ``w`` of the shorter arc from ``q0`` to ``q1``."""
    dot = np.sum(q0 * q1, axis=1)
    q1 = np.where(dot[:, None] < 0, -q1, q1)
    angle = np.arccos(np.clip(np.abs(dot), 0.0, 1.0))
    sine = np.sin(angle)
    small = sine < 1e-6  # there the chord is the arc to 1e-12
    safe = np.where(small, 1.0, sine)
    a = np.where(small, 1.0 - w, np.sin((1.0 - w) * angle) / safe)
    b = np.where(small, w, np.sin(w * angle) / safe)
    q = a[:, None] * q0 + b[:, None] * q1
    unit: F64 = q / np.linalg.norm(q, axis=1, keepdims=True)
    return unit


def _rotate(q_nb: F64, vector_b: F64) -> F64:
    """C_nb v (N, 3): v + 2 w (r × v) + 2 r × (r × v)."""
    w, r = q_nb[:, :1], q_nb[:, 1:]
    cross = np.cross(r, vector_b)
    rotated: F64 = vector_b + 2.0 * (w * cross + np.cross(r, cross))
    return rotated


def _outage_error(outage: Outage, errors: Errors, aligned: Mask, origin_ns: int) -> OutageError:
    inside = aligned & (errors.t_ns >= outage.start_ns) & (errors.t_ns <= outage.end_ns)
    horizontal = np.hypot(errors.position_n[inside, 0], errors.position_n[inside, 1])
    known = horizontal[np.isfinite(horizontal)]
    ends_known = len(horizontal) > 0 and bool(np.isfinite(horizontal[-1]))
    return OutageError(
        start_s=(outage.start_ns - origin_ns) / NS,
        seconds=(outage.end_ns - outage.start_ns) / NS,
        max_horizontal_error_m=float(known.max()) if len(known) else None,
        end_horizontal_error_m=float(horizontal[-1]) if ends_known else None,
    )


def _nis_means(reports: AidingReports) -> dict[str, float]:
    out = {}
    fused = (reports.verdict == Verdict.ACCEPTED) & (reports.dof > 0) & np.isfinite(reports.nis)
    for channel in Channel:
        rows = fused & (reports.channel == channel)
        if rows.any() and channel not in (Channel.SOURCE_H, Channel.SOURCE_V):
            out[channel.name.lower()] = float(reports.nis[rows].sum() / reports.dof[rows].sum())
    return out


def _rms_columns(values: F64) -> F64:
    """Root mean square of each column over its known rows; NaN for a column without any."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    total = np.sum(np.where(known, values, 0.0) ** 2, axis=0)
    rms: F64 = np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)
    return rms


def _mean(values: F64) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else float("nan")


def _wrap(angle: F64) -> F64:
    wrapped: F64 = np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi
    return wrapped


def _null(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _nulls(values: dict[str, float]) -> dict[str, float | None]:
    return {key: _null(x) for key, x in values.items()}
