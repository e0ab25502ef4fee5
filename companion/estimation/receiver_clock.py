"""A receiver's clock through time: bias, drift and its ramp, biases between systems.

    b' = d + n_b,   d' = a + n_d,   a' = −a/τ + n_a
    Φ = [1 T T²/2; 0 1 T; 0 0 e^{−T/τ}],
    Q = [q_b T + q_d T³/3, q_d T²/2, 0; ·, q_d T, 0; ·, ·, σ_a² (1 − e^{−2T/τ})]

Groves 2013, section 9.4.2 (clock states of GNSS/INS integration); the ramp is a quartz whose
temperature changes: after switching on, its drift moves steadily for minutes, 5 m/s in 30 s on a
receiver carried by hand, which the random walk of a drift explains to one. Nothing else moves these
states, and they move nothing else, so the step stands beside that of the strapdown error. T is a
covariance interval, so the noise of the ramp may enter the drift a step later. All three noises are
scaled by what was learned of the clock (:mod:`companion.gnss.clock_noise`).

A clock that jumped by who knows what is *let go*: its variance grows, its estimate stays. As noise
of one interval, so that a smoother reads it off the tape with the rest.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.estimation.parameters import (
    CLOCK_DRIFT_PSD,
    CLOCK_PSD,
    CLOCK_RAMP_TAU,
    CLOCK_RAMP_VAR,
    SYSTEM_BIAS_PSD,
)
from companion.navigation.layout import (
    BIAS,
    CLOCK,
    CLOCK_SCALE,
    DRIFT,
    DX,
    L_CLOCK,
    L_N,
    RAMP,
    SUM_XC,
    SYSTEM,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

LET_GO_VAR, LET_GO_DRIFT_VAR = 1e5**2, 10.0**2
"""What a clock that is let go may have jumped by: as at a start [m²]; its quartz is the same one,
at another temperature [(m/s)²]."""


@njit("void(f8, f8, f8[::1])", cache=True, counted=False)
def carry_clock(T: float, ramp_decay: float, x: F64) -> None:
    """``x`` (CLOCK_STATES,) ← Φ x over ``T`` [s]."""
    x[BIAS] += T * x[DRIFT] + 0.5 * T * T * x[RAMP]
    x[DRIFT] += T * x[RAMP]
    x[RAMP] *= ramp_decay


@njit("void(f8, f8[::1])", cache=True, counted=False)
def carry_clock_back(T: float, x: F64) -> None:
    """``x`` (CLOCK_STATES,) ← Φᵀ x but for the ramp's decay, which is every slow state's."""
    x[RAMP] += 0.5 * T * T * x[BIAS] + T * x[DRIFT]
    x[DRIFT] += T * x[BIAS]


@njit("f8(f8, f8, f8[::1])", cache=True, counted=False)
def clock_cross_noise(T: float, drift_scale: float, par: F64) -> float:
    """Covariance that bias and drift gain over ``T`` [s]."""
    return float(0.5 * drift_scale * par[CLOCK_DRIFT_PSD] * T * T)


@njit("void(f8, f8, f8, f8, f8, f8[::1], f8, f8[::1])", cache=True, counted=False)
def clock_noise(
    T: float, let_go: float, bias_scale: float, drift_scale: float, ramp_scale: float, par: F64,
    ramp_decay: float, q: F64,
) -> None:  # fmt: skip
    """``q`` (CLOCK_STATES,): variances that the states gain over ``T`` [s].

    The scales are factors on the configured noises.
    """
    drift = drift_scale * par[CLOCK_DRIFT_PSD]
    q[BIAS] = bias_scale * par[CLOCK_PSD] * T + drift * T * T * T / 3.0 + let_go * LET_GO_VAR
    q[DRIFT] = drift * T + let_go * LET_GO_DRIFT_VAR
    q[RAMP] = ramp_scale * par[CLOCK_RAMP_VAR] * (1.0 - ramp_decay * ramp_decay)
    for i in range(SYSTEM, SYSTEM + 2):
        q[i] = par[SYSTEM_BIAS_PSD] * T


@njit("void(f8[:, ::1], i8, f8, f8, f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def spread_clock(P: F64, b: int, T: float, let_go: float, scale: F64, par: F64, q: F64) -> None:
    """P ← Φ P Φᵀ + Q of the clock's states, which begin at ``b``, over ``T`` [s].

    ``let_go``: how often the clock was let go meanwhile; ``scale`` (3,): factors on the configured
    noises of bias, drift and ramp; ``q`` (≥ CLOCK_STATES,) is scratch.
    """
    n = P.shape[0]
    decay = math.exp(-T / par[CLOCK_RAMP_TAU])
    half = 0.5 * T * T
    for j in range(n):
        P[b, j] += T * P[b + DRIFT, j] + half * P[b + RAMP, j]
        P[b + DRIFT, j] += T * P[b + RAMP, j]
        P[b + RAMP, j] *= decay
    for j in range(n):
        P[j, b] += T * P[j, b + DRIFT] + half * P[j, b + RAMP]
        P[j, b + DRIFT] += T * P[j, b + RAMP]
        P[j, b + RAMP] *= decay
    # The two halves round differently inside the block.
    for i in range(RAMP + 1):
        for j in range(i):
            P[b + i, b + j] = P[b + j, b + i]
    clock_noise(T, let_go, scale[0], scale[1], scale[2], par, decay, q)
    for i in range(RAMP + 1):
        P[b + i, b + i] += q[i]
    cross = clock_cross_noise(T, scale[1], par)
    P[b, b + DRIFT] += cross
    P[b + DRIFT, b] += cross


@njit("void(f8[::1], i8[::1], f8[::1], f8, f8[::1])", cache=True, counted=False)
def step_clock(s: F64, lay: I64, par: F64, T: float, q: F64) -> None:
    """Carry clock and covariance in ``s`` over ``T`` [s]; ``q`` (≥ CLOCK_STATES,) is scratch."""
    b = lay[L_CLOCK]
    if b < 0:
        return
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    decay = math.exp(-T / par[CLOCK_RAMP_TAU])
    carry_clock(T, decay, s[CLOCK:])
    carry_clock(T, decay, s[DX + b :])
    spread_clock(P, b, T, s[SUM_XC], s[CLOCK_SCALE : CLOCK_SCALE + 3], par, q)
