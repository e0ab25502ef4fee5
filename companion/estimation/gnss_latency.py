"""How late the fixes are, found from accelerations. It reports; it never changes a solution.

A fix stamped t was valid at t − L. The velocity that the IMU saw, U(t) = ∫ C_nb (f − b_a) + g dt,
is the antenna's up to a constant and a slow drift, whatever the filter made of the fixes; so in a
window of a few seconds, with the true L, only noise is left of

    y_k(L) = v_k − U(t_k − L) − c − d t_k        (c, d by least squares, axis by axis)

L is where the likelihood over all windows is greatest, each window with a noise of its own:
Λ(L) = Σ ν/2 ln Σ_k |y_k(L)|². It needs manoeuvres: without acceleration any L fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from companion.config import Config
from companion.types import (
    F64,
    I64,
    NS,
    AnySamples,
    Event,
    GnssSamples,
    ImuSamples,
    Mode,
    Outputs,
    Solution,
)

S = TypeVar("S", ImuSamples, GnssSamples)

WINDOW_NS = 10 * NS
_LATEST_NS = NS
"""A window is taken this long after its end: fixes come late, that is the point."""
_STEP_S = 0.01
_GRID_S: F64 = np.arange(0.0, 0.6 + _STEP_S / 2, _STEP_S)
"""Latencies that are tried."""
_BEFORE_NS = round((float(_GRID_S[-1]) + 0.1) * NS)
_FIXES = 12
"""In a window, at least."""
_WINDOWS = 10
"""Before an estimate is given: of fewer, a single one decides, and the scatter cannot tell."""
_KEPT = 180
"""Windows that count: the last half hour, so that a changed receiver shows."""
_GAP_NS = NS // 5
_FLOOR_MPS = 0.03
"""No receiver's velocity is better over a window: keeps windows at rest from counting much."""
_BLOCKS = 256
"""Single live samples are joined by so many, so that no window has to join thousands at once."""
_SYSTEMATIC_S = 0.005
"""The delay of the IMU's own filter, which this is measured against, is not known better."""
_GROUPS = 10
"""For the scatter: the windows are left out in turn, a tenth at a time."""
_USEFUL_SD_S = 0.03
_TELL_NS = 60 * NS
_TELL_CHANGE_S = 0.02


@dataclass(frozen=True, slots=True)
class LatencyEstimate:
    """Stamp minus validity of the fixes, as far as accelerations have shown it."""

    latency_s: float
    sd_s: float
    windows: int


class GnssLatencyEstimator:
    """Fed with every arrival and what the engine made of it; a sink of a player or a live core."""

    def __init__(self, config: Config) -> None:
        self._imu_latency_ns = round(config.imu.latency_ms * 1e6)
        self._configured_s = config.gnss.latency_ms * 1e-3
        self._min_fix_type = config.gnss.min_fix_type
        self._axes = np.array(config.imu.axes)
        self._lever_b = np.array(config.gnss.lever_arm_b_m)
        self._imu: list[ImuSamples] = []
        self._fresh: list[ImuSamples] = []
        """The newest of them, not joined yet."""
        self._fixes: list[GnssSamples] = []
        self._solution: list[Solution] = []
        self._start_ns: int | None = None
        self._newest_ns = 0
        self._likelihoods: list[F64] = []
        self._told: LatencyEstimate | None = None
        self._told_ns = 0
        self._events: list[Event] = []

    def add(self, samples: AnySamples, out: Outputs) -> None:
        """One arrival, as it went to the engine, and what came out."""
        if isinstance(samples, ImuSamples) and len(samples):
            self._fresh.append(samples)
            if len(self._fresh) >= _BLOCKS:
                self._imu.append(_joined(self._fresh))
                self._fresh = []
        elif isinstance(samples, GnssSamples) and len(samples):
            self._fixes.append(samples)
        if not len(out.published):
            return
        first, newest = int(out.published.t_ns[0]), int(out.published.t_ns[-1])
        if self._start_ns is None or first <= self._newest_ns or first > self._newest_ns + NS:
            # The first epochs, or the first on another clock or after a silence.
            self._begin(first + _BEFORE_NS)
        self._newest_ns = newest
        self._solution.append(out.published)
        if self._start_ns is not None and newest >= self._start_ns + WINDOW_NS + _LATEST_NS:
            self._take_windows(self._start_ns, newest)

    def _take_windows(self, start_ns: int, newest_ns: int) -> None:
        """All windows that are complete; what is older than the next one is forgotten."""
        solution = Solution.concatenate(self._solution)
        inertial = [*self._imu, *self._fresh]
        imu = _joined(inertial) if inertial else None
        fixes = _joined(self._fixes) if self._fixes else None
        while newest_ns >= start_ns + WINDOW_NS + _LATEST_NS:
            if imu is not None and fixes is not None:
                found = self._window(start_ns, imu, solution, fixes)
                if found is not None:
                    self._likelihoods = [*self._likelihoods[1 - _KEPT :], found]
            start_ns += WINDOW_NS
        keep_ns = start_ns - 2 * _BEFORE_NS
        after = int(np.searchsorted(solution.t_ns, keep_ns))
        self._begin(start_ns)
        self._solution = [_rows(solution, slice(after, None))]
        self._imu = [imu.take(imu.t_ns >= keep_ns)] if imu is not None else []
        self._fixes = [fixes.take(fixes.t_ns >= keep_ns)] if fixes is not None else []
        self._tell(newest_ns)

    def _begin(self, start_ns: int) -> None:
        """The next window begins there; nothing is held."""
        self._start_ns = start_ns
        self._imu, self._fresh, self._fixes, self._solution = [], [], [], []

    def _window(
        self, start_ns: int, imu: ImuSamples, solution: Solution, fixes: GnssSamples
    ) -> F64 | None:
        """(G,) minus log likelihood over the grid; None where the window cannot say anything."""
        first, end = start_ns - _BEFORE_NS, start_ns + WINDOW_NS
        t_imu = imu.t_ns - self._imu_latency_ns
        imu = imu.take((t_imu >= first) & (t_imu < end))
        a, b = np.searchsorted(solution.t_ns, [first - _GAP_NS, end + _GAP_NS])
        part = _rows(solution, slice(int(a), int(b)))
        fixes = fixes.take(
            (fixes.t_ns >= start_ns)
            & (fixes.t_ns < end)
            & (fixes.fix_type >= self._min_fix_type)
            & np.isfinite(fixes.vel_n[:, 0] + fixes.vel_n[:, 1])
        )
        if len(fixes) < _FIXES or not _whole(imu.t_ns) or not _whole(part.t_ns):
            return None
        if (part.mode < Mode.NAVIGATING).any() or part.resets[0] != part.resets[-1]:
            return None
        t_s = (imu.t_ns - self._imu_latency_ns - first) / NS
        return _likelihood(
            (fixes.t_ns - first) / NS,
            fixes.vel_n[:, :2],
            t_s,
            self._velocity(t_s, imu, part, first),
        )

    def _velocity(self, t_s: F64, imu: ImuSamples, part: Solution, first_ns: int) -> F64:
        """(N, 2) U of the antenna, horizontal [m/s], at the inertial samples' times."""
        at_s = (part.t_ns - first_ns) / NS
        q = np.stack([np.interp(t_s, at_s, part.q_nb[:, i]) for i in range(4)], axis=1)
        accel_n = _turn(q, imu.accel_b @ self._axes.T - part.accel_bias_b.mean(axis=0))
        # Integrals end at their stamp; instantaneous samples are joined by straight lines.
        integral = imu.interval_s[1:, np.newaxis] > 0
        mean = np.where(integral, accel_n[1:], 0.5 * (accel_n[1:] + accel_n[:-1]))
        velocity = np.zeros_like(accel_n)
        np.cumsum(mean * np.diff(t_s)[:, np.newaxis], axis=0, out=velocity[1:])
        if self._lever_b.any():
            rate_b = imu.gyro_b @ self._axes.T - part.gyro_bias_b.mean(axis=0)
            velocity += _turn(q, np.cross(rate_b, self._lever_b))
        return velocity[:, :2]

    def estimate(self) -> LatencyEstimate | None:
        """The latency over the windows so far; None while they are few or too calm."""
        count = len(self._likelihoods)
        if count < _WINDOWS:
            return None
        table = np.array(self._likelihoods)
        best, sd = _minimum(table.sum(axis=0))
        groups = min(_GROUPS, count)
        member = np.arange(count) % groups
        without = [_minimum(table[member != g].sum(axis=0))[0] for g in range(groups)]
        # Errors of a receiver are correlated, which the likelihood does not know: the scatter does.
        scatter = float(np.std(without)) * float(np.sqrt(groups - 1))
        sd = float(np.hypot(max(sd, scatter), _SYSTEMATIC_S))
        if sd > _USEFUL_SD_S or not _GRID_S[0] < best < _GRID_S[-1]:
            return None
        return LatencyEstimate(best, sd, count)

    def _tell(self, now_ns: int) -> None:
        estimate = self.estimate()
        if estimate is None:
            return
        before = self._told
        if before is not None and (
            abs(estimate.latency_s - before.latency_s) < _TELL_CHANGE_S
            or now_ns - self._told_ns < _TELL_NS
        ):
            return
        self._told, self._told_ns = estimate, now_ns
        off = abs(estimate.latency_s - self._configured_s)
        wrong = off > max(3 * estimate.sd_s, _TELL_CHANGE_S)
        text = (
            f"GNSS latency {estimate.latency_s * 1e3:.0f} ± {estimate.sd_s * 1e3:.0f} ms by "
            f"accelerations; gnss.latency_ms is {self._configured_s * 1e3:g}"
        )
        self._events.append(Event(now_ns, "gnss-latency", text, "warning" if wrong else "info"))

    def events(self) -> list[Event]:
        """Findings since the last call: the first estimate, and each that differs from it."""
        out, self._events = self._events, []
        return out


def _joined(parts: Sequence[S]) -> S:
    """Blocks of one stream as one, with the name of the first."""
    if len(parts) == 1:
        return parts[0]
    names = [f.name for f in fields(parts[0])][1:]
    columns = [np.concatenate([getattr(p, name) for p in parts]) for name in names]
    return type(parts[0])(parts[0].source, *columns)


def _rows(solution: Solution, rows: slice) -> Solution:
    """The same columns, restricted to ``rows``."""
    return Solution(*(getattr(solution, f.name)[rows] for f in fields(solution)))


def _whole(t_ns: I64) -> bool:
    """Whether a series covers its window without a gap."""
    if len(t_ns) < 3:
        return False
    steps = np.diff(t_ns)
    return bool(steps.min() > 0 and steps.max() <= _GAP_NS)


def _turn(q_nb: F64, v_b: F64) -> F64:
    """(N, 3) body vectors in n by quaternions (N, 4), which need not be quite of unit length."""
    w, u = q_nb[:, :1], q_nb[:, 1:]
    uv = np.cross(u, v_b)
    norm2 = (q_nb * q_nb).sum(axis=1, keepdims=True)
    out: F64 = v_b + 2.0 * (w * uv + np.cross(u, uv)) / norm2
    return out


def _likelihood(t_fix_s: F64, vel: F64, t_s: F64, seen: F64) -> F64 | None:
    """(G,) minus log likelihood of each latency of the grid, up to a constant.

    ``vel`` (K, A) of the receiver at its stamps ``t_fix_s`` (K,); ``seen`` (N, A) by the IMU.
    None where the IMU does not reach over all shifted fixes.
    """
    if t_fix_s[0] - _GRID_S[-1] < t_s[0] or t_fix_s[-1] > t_s[-1]:
        return None
    # Constant and drift are projected out of both: they do not depend on the latency.
    base = np.stack([np.ones_like(t_fix_s), t_fix_s - t_fix_s.mean()], axis=1)
    base /= np.linalg.norm(base, axis=0)
    shifted = t_fix_s - _GRID_S[:, np.newaxis]
    total = np.zeros(_GRID_S.shape[0])
    for axis in range(vel.shape[1]):
        y = vel[:, axis] - np.interp(shifted.ravel(), t_s, seen[:, axis]).reshape(shifted.shape)
        y -= (y @ base) @ base.T
        total += (y * y).sum(axis=1)
    freedom = vel.shape[1] * (t_fix_s.shape[0] - 2)
    out: F64 = 0.5 * freedom * np.log(total + freedom * _FLOOR_MPS**2)
    return out


def _minimum(cost: F64) -> tuple[float, float]:
    """Where a cost over the grid is least [s], by a parabola, and its sd by the curvature."""
    i = int(np.clip(np.argmin(cost), 1, cost.shape[0] - 2))
    left, middle, right = cost[i - 1 : i + 2]
    curvature = float(left - 2 * middle + right)
    if curvature <= 0:
        return float(_GRID_S[i]), float("inf")
    shift = float(np.clip(0.5 * (left - right) / curvature, -1.0, 1.0))
    return float(_GRID_S[i]) + shift * _STEP_S, _STEP_S / float(np.sqrt(curvature))
