"""A linear problem with the structure of the filter's, run forward by hand and put on a tape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.estimation import parameters as par
from companion.estimation import tape as tp
from companion.estimation.covariance import STRIDE, apply_transition, propagate
from companion.estimation.update import reset_covariance
from companion.navigation import layout as lo
from companion.navigation.earth import RATE
from companion.navigation.error_model import transition_blocks
from companion.smoothing.transition import decay_factors
from companion.types import F64, I64


@dataclass
class LinearRun:
    """What the forward filter did, and the same problem as one Gaussian vector."""

    lay: I64
    par: F64
    s0: F64
    kinds: tp.I8
    coarse: tp.F32
    fine: F64
    P0: F64
    forward: F64
    """(rows, n) filter's estimate at each row."""
    batch: F64
    """(rows, n) posterior mean from all measurements at once."""
    batch_cov: F64
    """(rows, n, n)."""
    steps: int


def _parameters() -> F64:
    """Powers of two, so that a float32 holds every product with a power-of-two interval."""
    p = np.zeros(par.SIZE)
    for name, value in (
        ("ACCEL_PSD", 2.0**-8),
        ("GYRO_PSD", 2.0**-18),
        ("ACCEL_BIAS_PSD", 2.0**-16),
        ("GYRO_BIAS_PSD", 2.0**-26),
        ("BARO_PSD", 2.0**-6),
        ("GNSS_PSD", 2.0**-4),
        ("GNSS_PSD_DOWN", 2.0**-3),
        ("GNSS_TAU", 32.0),
        ("GYRO_BIAS_TAU", 64.0),
        ("CLOCK_PSD", 2.0**-6),
        ("CLOCK_DRIFT_PSD", 2.0**-5),
        ("SYSTEM_BIAS_PSD", 2.0**-12),
        ("CLOCK_RAMP_VAR", 2.0**-4),
        ("CLOCK_RAMP_TAU", 16.0),
    ):
        p[getattr(par, name)] = value
    return p


def symmetric(P: F64, gain: F64) -> None:
    """P ← P − (PHᵀ)(PHᵀ)ᵀ/S, as the filter does it."""
    P -= np.outer(gain, gain)


def linear_run(
    seed: int, steps: int = 30, update: Callable[[F64, F64], None] = symmetric
) -> LinearRun:
    """A seeded run with every optional state, about two updates a step, turns, fades and rows.

    A fade P ← α² P is a weight on the data: the same as all later R and Q divided by the product of
    all α² so far, and the covariance in hand times it.
    """
    rng = np.random.default_rng(seed)
    layout = lo.Layout.build(scale=True, lever=True, baro=True, gnss=True, clock=True)
    n, lay, p = layout.n, layout.vector(), _parameters()
    s = np.zeros(layout.size)
    s[0], s[lo.EARTH_RATE] = 1.0, RATE
    faded = 1.0
    fade_at: list[float] = []
    s[lo.LAT], s[lo.HEIGHT] = np.float32(0.8), 300.0
    sd = np.array(
        [3.0] * 3 + [1.0] * 3 + [0.05] * 3 + [0.1] * 3 + [0.01] * 3 + [0.01] * 6 + [0.5] * 3
        + [5.0] + [1.0] * 3 + [3.0, 1.0, 2.0, 2.0, 0.3]
    )  # fmt: skip
    P = s[lo.P :].reshape(n, n)
    P[:] = np.diag(sd**2)
    run_s0, P0 = s.copy(), P.copy()
    kinds = np.zeros(10_000, np.int8)
    coarse, fine = np.zeros(400_000, np.float32), np.zeros(400_000)
    at = np.array([0, 0, 0, tp.MARKED, 0, 0], np.int64)
    tape = (kinds, coarse, fine, at)
    # the joint Gaussian of the states at all instants, grown as the run goes on
    mean, joint = np.zeros(n), np.diag(sd**2)
    x = np.zeros(n)
    seen: list[tuple[int, F64, float, float]] = []
    row_at: list[int] = []
    rows: list[F64] = []
    now = 0

    def extend(F: F64, Q: F64) -> None:
        nonlocal mean, joint, now
        last = slice(now * n, (now + 1) * n)
        cross = F @ joint[last]
        corner = cross[:, last] @ F.T + Q
        joint = np.block([[joint, cross.T], [cross, corner]])
        mean = np.concatenate([mean, F @ mean[last]])
        now += 1

    B, W = np.zeros((24, 3, 3)), np.zeros((n + 9, STRIDE))
    for step in range(steps):
        s[lo.SUM_T] = 2.0 ** -rng.integers(2, 6)
        T = s[lo.SUM_T]
        s[lo.Q_SCALE] = 2.0 ** rng.integers(0, 4)
        s[lo.CLOCK_SCALE : lo.CLOCK_SCALE + 3] = 2.0 ** rng.integers(-3, 4, 3)
        s[lo.VEL_N : lo.VEL_N + 3] = rng.normal(0, 20, 3).astype(np.float32)
        s[lo.SUM_V : lo.SUM_V + 33] = (T * rng.normal(0, 1, 33)).astype(np.float32)
        s[lo.SUM_V : lo.SUM_V + 3] *= 8.0
        tp.record_step(tape, s, lay, p)
        F = np.eye(n)
        transition_blocks(s, B)
        apply_transition(B, layout.accel_scale, layout.gyro_scale, np.eye(n), n, F[:9])
        b = layout.clock
        F[b, [b + lo.DRIFT, b + lo.RAMP]] = T, T * T / 2
        F[b + lo.DRIFT, b + lo.RAMP] = T
        d = np.ones(n)
        decay_factors(T, lay, p, d)
        F = d[:, None] * F
        before = P.copy()
        assert propagate(s, lay, p, B, W)
        extend(F, (P - F @ before @ F.T) / faded)
        x = F @ x
        for _ in range(rng.integers(0, 4)):
            H = np.zeros(n)
            H[rng.choice(n, 5, replace=False)] = rng.normal(0, 1, 5).astype(np.float32)
            R = float(rng.uniform(0.01, 1.0))
            z = float(rng.normal(0, 3))
            S = H @ P @ H + R
            gain, y = P @ H / np.sqrt(S), z - H @ x
            tp.record_update(tape, H, gain, 1 / np.sqrt(S), y, n)
            x = x + gain * y / np.sqrt(S)
            update(P, gain)
            seen.append((now, H, R / faded, z))
        if step % 3 == 1:
            turn = np.zeros(n)
            turn[6:9] = rng.normal(0, 0.1, 3)
            tp.record_turn(tape, turn)
            G = np.eye(n)
            a, b, c = 0.5 * turn[6], 0.5 * turn[7], turn[8]
            G[6:9, 6:9] = [[1, -c, b], [c, 1, -a], [-b, a, 1]]
            reset_covariance(P, turn, n)
            extend(G, np.zeros((n, n)))
            x = G @ x
        if step % 4 == 1:
            square = float(rng.uniform(1.0, 1.3))
            tp.record_fade(tape, square)
            P *= square
            faded *= square
        tp.record_row(tape, s, lay, 0, s[:1])
        fade_at.append(faded)
        row_at.append(now)
        rows.append(x.copy())
    A = np.zeros((len(seen), len(mean)))
    for m, (instant, H, _, _) in enumerate(seen):
        A[m, instant * n : (instant + 1) * n] = H
    cross = joint @ A.T
    S_all = A @ cross + np.diag([R for _, _, R, _ in seen])
    gain_all = np.linalg.solve(S_all, cross.T).T
    posterior = mean + gain_all @ (np.array([z for *_, z in seen]) - A @ mean)
    cov = joint - gain_all @ cross.T
    picks = [slice(i * n, (i + 1) * n) for i in row_at]
    return LinearRun(
        lay, p, run_s0, kinds[: at[0]], coarse[: at[1]], fine[: at[2]], P0,
        np.array(rows), np.array([posterior[i] for i in picks]),
        np.array([f * cov[i, i] for f, i in zip(fade_at, picks, strict=True)]), steps,
    )  # fmt: skip
