"""A receiver's clock through time: bias and drift random walks, biases between systems.

    b' = d + n_b,   d' = n_d:   Φ = [1 T; 0 1],   Q = [q_b T + q_d T³/3, q_d T²/2; ·, q_d T]

Groves 2013, section 9.4.2 (clock states of GNSS/INS integration). Nothing else moves the four
states, and they move nothing else, so the step stands beside that of the strapdown error.
"""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.parameters import CLOCK_DRIFT_PSD, CLOCK_PSD, SYSTEM_BIAS_PSD
from companion.navigation.layout import CLOCK, DX, L_CLOCK, L_N
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64


@njit("void(f8[::1], i8[::1], f8[::1], f8)", cache=True)
def step_clock(s: F64, lay: I64, par: F64, T: float) -> None:
    """Carry clock and covariance in ``s`` over ``T`` [s]."""
    b = lay[L_CLOCK]
    if b < 0:
        return
    n = lay[L_N]
    P = s[P_OFFSET : P_OFFSET + n * n].reshape((n, n))
    s[CLOCK] += T * s[CLOCK + 1]
    s[DX + b] += T * s[DX + b + 1]
    for j in range(n):
        P[b, j] += T * P[b + 1, j]
    for j in range(n):
        P[j, b] += T * P[j, b + 1]
    cross = 0.5 * par[CLOCK_DRIFT_PSD] * T * T
    P[b, b] += par[CLOCK_PSD] * T + par[CLOCK_DRIFT_PSD] * T * T * T / 3.0
    P[b, b + 1] += cross
    P[b + 1, b] += cross
    P[b + 1, b + 1] += par[CLOCK_DRIFT_PSD] * T
    for i in range(b + 2, b + 4):
        P[i, i] += par[SYSTEM_BIAS_PSD] * T
