"""The trajectory model over a time step: nominal state and covariance.

Over dt, with the rate held and the acceleration constant in n (Yu et al. 2018 eqs 12-18 in closed
form where the paper has the first terms of the series), both optionally fading to zero:

    p ← p + v dt + a c₂,   v ← v + a c₁,   a ← a e,        e = exp(−dt/τ_a)
    C ← C exp([ω c_w ×]),  ω ← ω e_w,                      e_w = exp(−dt/τ_ω)

Errors: δp, δv, δa are linear in each other and in nothing else; ψ ← exp(−[θ×]) ψ + J_r(θ) c_w δω
with θ = ω c_w. Jerk and angular acceleration are white noise in body axes. F touches fifteen rows
of P; those of the IMUs' errors only where a bias fades.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.direct.layout import (
    ACC,
    ACC_N,
    ATT,
    ATTITUDE_BIAS,
    CLOCK,
    GNSS_BIAS,
    HEIGHT,
    KINEMATIC,
    L_ATTITUDE,
    L_CLOCK,
    L_GNSS,
    L_N,
    L_P,
    L_UNITS,
    LAT,
    LON,
    POS,
    RATE,
    RATE_B,
    UNIT,
    UNIT_SIZE,
    UNITS,
    VEL,
    VEL_N,
)
from companion.estimation.direct.parameters import ACC_TAU, JERK_PSD, RATE_PSD, RATE_TAU
from companion.estimation.parameters import CLOCK_RAMP_TAU
from companion.estimation.receiver_clock import carry_clock, spread_clock
from companion.navigation.earth import radii
from companion.navigation.layout import CLOCK_SCALE, Q_SCALE
from companion.navigation.rotation import quat_to_matrix, rotate_body
from companion.types import F64, I64

MAX_STEP = 0.1
"""Longest step [s]: process noise is of leading order in it."""


@njit("UniTuple(f8, 3)(f8, f8)", cache=True)
def fading(dt: float, tau: float) -> tuple[float, float, float]:
    """(e, c₁, c₂) of a quantity that fades with ``tau`` [s]: itself, its integral, its second one.

    e = exp(−dt/τ), c₁ = τ(1−e), c₂ = τ(dt−c₁); for τ = 0, which stands for never, 1, dt, dt²/2.
    """
    if tau == 0.0:
        return 1.0, dt, 0.5 * dt * dt
    e = math.exp(-dt / tau)
    c1 = -tau * math.expm1(-dt / tau)
    return e, c1, tau * (dt - c1)


@njit("void(f8, f8, f8, f8[:, ::1], f8[:, ::1])", cache=True)
def rotation_step(x: float, y: float, z: float, E: F64, J: F64) -> None:
    """Fill E = exp(−[θ×]) and the right Jacobian J_r(θ) (3, 3) of θ = (x, y, z) [rad].

    J_r = I − (1−cos θ)/θ² [θ×] + (θ−sin θ)/θ³ [θ×]²  (Chirikjian 2011, eq. 10.86).
    """
    t2 = x * x + y * y + z * z
    if t2 < 1e-6:  # series: exact to double precision
        a, b, c = 1.0 - t2 / 6.0, 0.5 - t2 / 24.0, 1.0 / 6.0 - t2 / 120.0
    else:
        t = math.sqrt(t2)
        a, b, c = math.sin(t) / t, (1.0 - math.cos(t)) / t2, (t - math.sin(t)) / (t2 * t)
    v = (x, y, z)
    for i in range(3):
        for j in range(3):
            square = v[i] * v[j]
            if i == j:
                square -= t2
            E[i, j] = b * square
            J[i, j] = c * square
        E[i, i] += 1.0
        J[i, i] += 1.0
    for i, j, w in ((0, 1, -z), (0, 2, y), (1, 2, -x)):
        E[i, j] -= a * w
        E[j, i] += a * w
        J[i, j] -= b * w
        J[j, i] += b * w


@njit("void(f8[::1], i8[::1], f8[::1], f8[:, ::1], f8)", cache=True)
def carry(s: F64, lay: I64, par: F64, slow: F64, dt: float) -> None:
    """Move the nominal state on by ``dt`` [s]; ``slow`` as :func:`spread`."""
    e, c1, c2 = fading(dt, par[ACC_TAU])
    ew, cw, _ = fading(dt, par[RATE_TAU])
    m, n = radii(s[LAT])
    lat = s[LAT]
    s[LAT] = lat + (s[VEL_N] * dt + s[ACC_N] * c2) / (m + s[HEIGHT])
    middle = math.cos(0.5 * (lat + s[LAT]))
    s[LON] += (s[VEL_N + 1] * dt + s[ACC_N + 1] * c2) / ((n + s[HEIGHT]) * middle)
    s[HEIGHT] -= s[VEL_N + 2] * dt + s[ACC_N + 2] * c2
    rotate_body(s, s[RATE_B] * cw, s[RATE_B + 1] * cw, s[RATE_B + 2] * cw)
    for i in range(3):
        s[VEL_N + i] += s[ACC_N + i] * c1
        s[ACC_N + i] *= e
        s[RATE_B + i] *= ew
        if lay[L_GNSS] >= 0:
            s[GNSS_BIAS + i] *= math.exp(-dt * slow[0, lay[L_GNSS] + i])
        if lay[L_ATTITUDE] >= 0:
            s[ATTITUDE_BIAS + i] *= math.exp(-dt * slow[0, lay[L_ATTITUDE] + i])
    if lay[L_CLOCK] >= 0:
        carry_clock(dt, math.exp(-dt / par[CLOCK_RAMP_TAU]), s[CLOCK:])
    for i in range(UNIT_SIZE * lay[L_UNITS]):
        if slow[0, UNIT + i] > 0.0:
            s[UNITS + i] *= math.exp(-dt * slow[0, UNIT + i])


@njit("void(f8[::1], f8[::1], f8, f8[:, ::1], f8[:, ::1])", cache=True)
def _process_noise(s: F64, par: F64, dt: float, P: F64, C: F64) -> None:
    """Add white jerk and angular acceleration over ``dt`` to the upper half of P; C is scratch.

    Times the adaptation's factor: what is scaled is how far the vehicle may move unforeseen.
    """
    quat_to_matrix(s, C)
    scale = s[Q_SCALE]
    dt2 = dt * dt
    dt3 = dt2 * dt
    for i in range(3):
        for j in range(3):
            q = 0.0
            for m in range(3):
                q += C[i, m] * par[JERK_PSD + m] * C[j, m]
            q *= scale
            P[POS + i, VEL + j] += q * dt2 * dt2 / 8.0
            P[POS + i, ACC + j] += q * dt3 / 6.0
            P[VEL + i, ACC + j] += q * dt2 / 2.0
            if j >= i:
                P[POS + i, POS + j] += q * dt2 * dt3 / 20.0
                P[VEL + i, VEL + j] += q * dt3 / 3.0
                P[ACC + i, ACC + j] += q * dt
        w = par[RATE_PSD + i] * scale
        P[ATT + i, ATT + i] += w * dt3 / 3.0
        P[ATT + i, RATE + i] += w * dt2 / 2.0
        P[RATE + i, RATE + i] += w * dt


@njit("void(f8[::1], i8[::1], f8[::1], f8[:, ::1], f8, f8[:, ::1])", cache=True)
def spread(s: F64, lay: I64, par: F64, slow: F64, dt: float, W: F64) -> None:
    """P ← F P Fᵀ + Q over ``dt`` [s] from the state *before* the step; ``W`` (≥ 9, n) is scratch.

    ``slow`` (2, n): inverse fading time [1/s] and psd of every state behind the fifteen.
    """
    n = lay[L_N]
    P = s[lay[L_P] : lay[L_P] + n * n].reshape((n, n))
    e, c1, c2 = fading(dt, par[ACC_TAU])
    ew, cw, _ = fading(dt, par[RATE_TAU])
    E = np.empty((3, 3))
    J = np.empty((3, 3))
    rotation_step(s[RATE_B] * cw, s[RATE_B + 1] * cw, s[RATE_B + 2] * cw, E, J)
    for i in range(3):
        p, v, a = P[POS + i], P[VEL + i], P[ACC + i]
        for j in range(n):
            p[j] += dt * v[j] + c2 * a[j]
            v[j] += c1 * a[j]
            a[j] *= e
        for j in range(n):
            W[i, j] = P[ATT + i, j]
            W[3 + i, j] = P[RATE + i, j] * cw
    for i in range(3):
        t, w = P[ATT + i], P[RATE + i]
        for j in range(n):
            t[j] = (
                E[i, 0] * W[0, j]
                + E[i, 1] * W[1, j]
                + E[i, 2] * W[2, j]
                + J[i, 0] * W[3, j]
                + J[i, 1] * W[4, j]
                + J[i, 2] * W[5, j]
            )
            w[j] *= ew
    for r in range(KINEMATIC):
        row = P[r]
        for i in range(3):
            row[POS + i] += dt * row[VEL + i] + c2 * row[ACC + i]
            row[VEL + i] += c1 * row[ACC + i]
            row[ACC + i] *= e
        x, y, z = row[ATT], row[ATT + 1], row[ATT + 2]
        u, v, w = row[RATE] * cw, row[RATE + 1] * cw, row[RATE + 2] * cw
        for i in range(3):
            row[ATT + i] = (
                E[i, 0] * x + E[i, 1] * y + E[i, 2] * z + J[i, 0] * u + J[i, 1] * v + J[i, 2] * w
            )
            row[RATE + i] *= ew
    _process_noise(s, par, dt, P, E)
    for i in range(KINEMATIC):
        for j in range(i + 1, n):
            P[j, i] = P[i, j]
    for i in range(KINEMATIC, n):
        if slow[0, i] > 0.0:
            f = math.exp(-dt * slow[0, i])
            for j in range(n):
                P[i, j] *= f
            for j in range(n):
                P[j, i] = P[i, j]
            P[i, i] *= f
        P[i, i] += slow[1, i] * dt
    if lay[L_CLOCK] >= 0:
        scale = s[CLOCK_SCALE : CLOCK_SCALE + 3]
        spread_clock(P, lay[L_CLOCK], dt, 0.0, scale, par, W[0])
