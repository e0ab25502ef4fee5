"""The modified Bryson-Frazier smoother over a recorded tape: no inverse of P anywhere.

    at an update:   λ̃ = −Hᵀ S⁻¹ y + (I − K H)ᵀ λ̂ ,  Λ̃ = Hᵀ S⁻¹ H + (I − K H)ᵀ Λ̂ (I − K H)
    between:        λ̂ = Φᵀ λ̃ ,                      Λ̂ = Φᵀ Λ̃ Φ
    smoothed:       δx = −P λ̂ ,                      P_s = P − P Λ̂ P

both zero at the end (Bierman 1973; ALGORITHMS: Kamil et al. 2014 name the aim). P is needed at the
start of a chunk only: inside it the smoothed error moves forward by its own recursion,

    over a step:    δx⁻ = Φ δx − Q λ̃ ,               at an update: δx = δx⁻ − K y

so the history grows with the rate of the covariance, not with states², and not with the IMU's rate;
where covariances are asked for, P is walked again from there (covariances.py).
Feedback changes nothing but the turn G of the attitude error at a reset: λ ← Gᵀ λ, δx ← G δx.
Where P was multiplied by α² (FLAC), λ and Λ are too, going back, and δx stays.
"""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.covariance import STRIDE
from companion.estimation.tape import (
    C_STEP,
    F32,
    F_FADE,
    F_GAIN,
    F_R,
    F_TURN,
    F_Y,
    FADE,
    I8,
    STEP,
    TURN,
    UPDATE,
    read_h,
)
from companion.navigation.layout import ATT, L_N
from companion.smoothing.composite import (
    S_D,
    S_DECAY,
    S_H,
    S_LAM,
    S_P,
    S_U,
    S_V,
    S_X,
    WIDTH,
    begin,
    flush,
    smoothed_blocks,
    step_back,
    take_back,
)
from companion.smoothing.phi import coefficients, step_size
from companion.smoothing.transition import (
    carry,
    carry_back,
    decay_factors,
    noise_diagonal,
    subtract_noise,
)
from companion.types import F64, I64

_CHUNK = "i1[::1], f4[::1], f8[::1], i8[::1], f8[::1], f8[::1]"
"""Numba's types of what every kernel takes first: the columns of exactly one chunk, layout and
parameters, and the scratch of composite.py."""


@njit("i8(i1[::1])", cache=True, counted=False)
def count_steps(kinds: I8) -> int:
    """How many steps there are."""
    count = 0
    for i in range(kinds.shape[0]):
        count += kinds[i] == STEP
    return int(count)


@njit("void(f8[::1], f8[::1])", cache=True, counted=False)
def turn_transposed(x: F64, g: F64) -> None:
    """``x`` (n,) ← Gᵀ x; ``g`` corrects φ, see update.py."""
    u, v, w = 0.5 * g[0], 0.5 * g[1], g[2]
    a, b, c = x[ATT], x[ATT + 1], x[ATT + 2]
    x[ATT] = a + w * b - v * c
    x[ATT + 1] = b - w * a + u * c
    x[ATT + 2] = c + v * a - u * b


@njit("void(f8[::1], f8[::1])", cache=True, counted=False)
def turn(x: F64, g: F64) -> None:
    """``x`` (n,) ← G x."""
    u, v, w = 0.5 * g[0], 0.5 * g[1], g[2]
    a, b, c = x[ATT], x[ATT + 1], x[ATT + 2]
    x[ATT] = a - w * b + v * c
    x[ATT + 1] = b + w * a - u * c
    x[ATT + 2] = c - v * a + u * b


@njit(f"void({_CHUNK}, f8[::1], f8[::1], f8[:, ::1])", cache=True, entry=True, counted=False)
def backward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    lay: I64,
    par: F64,
    scratch: F64,
    s: F64,
    lam: F64,
    steps: F64,
) -> None:
    """Take λ, ``lam`` (n,), from the end of a chunk to its start, in place.

    ``s`` is a state as scratch, with the Earth's rate in place.
    ``steps`` (≥ steps of the chunk, n + K_SIZE) keeps λ̃ after each step and its Φ, for
    :func:`forward` and :func:`backward_covariance`.
    """
    n = lay[L_N]
    size = step_size(lay)
    B = scratch[:S_D].reshape((24, 3, 3))
    d, H = scratch[S_D : S_D + n], scratch[S_H : S_H + n]
    c, f, m = coarse.shape[0], fine.shape[0], count_steps(kinds)
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            m -= 1
            c -= C_STEP
            f -= size
            T = float(fine[f])
            for j in range(n):
                steps[m, j] = lam[j]
            K = steps[m, n:]
            coefficients(coarse[c : c + C_STEP], fine[f : f + size], lay, s, B, K)
            decay_factors(T, lay, par, d)
            carry_back(K, lay, d, lam)
        elif kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            r = fine[f + F_R]
            g = r * fine[f + F_Y]
            for j in range(n):
                g += fine[f + F_GAIN + j] * lam[j]
            g *= r
            read_h(fine[f:], n, H)
            for j in range(n):
                lam[j] -= H[j] * g
        elif kind == TURN:
            f -= F_TURN
            turn_transposed(lam, fine[f:])
        elif kind == FADE:
            f -= F_FADE
            for j in range(n):
                lam[j] *= fine[f]


@njit(f"void({_CHUNK}, f8[::1], f8[:, ::1], f8[:, ::1])", cache=True, entry=True, counted=False)
def forward(
    kinds: I8,
    coarse: F32,
    fine: F64,
    lay: I64,
    par: F64,
    scratch: F64,
    dx: F64,
    steps: F64,
    rows: F64,
) -> None:
    """Take the smoothed error, ``dx`` (n,), from the start of a chunk to its end, in place.

    At a chunk's start it is −P λ̂. ``rows`` (rows of the chunk, n) is filled with the error to add
    to the forward solution at each output row.
    """
    n = lay[L_N]
    size = step_size(lay)
    d, q = scratch[S_D : S_D + n], scratch[S_H : S_H + n]
    c, f, m, row = 0, 0, 0, 0
    for i in range(kinds.shape[0]):
        kind = kinds[i]
        if kind == STEP:
            numbers, T = coarse[c : c + C_STEP], float(fine[f])
            decay_factors(T, lay, par, d)
            noise_diagonal(numbers, T, lay, par, d, q)
            carry(steps[m, n:], lay, d, dx)
            subtract_noise(numbers, T, lay, par, q, steps[m], dx)
            c += C_STEP
            f += size
            m += 1
        elif kind >= UPDATE:
            y = fine[f + F_R] * fine[f + F_Y]
            for j in range(n):
                dx[j] -= fine[f + F_GAIN + j] * y
            f += F_GAIN + n + kind - UPDATE
        elif kind == TURN:
            turn(dx, fine[f:])
            f += F_TURN
        elif kind == FADE:
            f += F_FADE
        else:
            for j in range(n):
                rows[row, j] = dx[j]
            row += 1


@njit(
    f"void({_CHUNK}, f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
    entry=True,
    counted=False,
)
def backward_covariance(
    kinds: I8,
    coarse: F32,
    fine: F64,
    lay: I64,
    par: F64,
    scratch: F64,
    steps: F64,
    before: F64,
    Lam: F64,
    rows: F64,
) -> None:
    """Take Λ, ``Lam`` (n, n), from the end of a chunk to its start, in place.

    ``rows`` (rows of the chunk, 30) is filled with the covariance blocks of the smoothed errors, as
    :attr:`companion.types.Solution.cov`, from P ``before`` (rows, n, n) smoothing; ``steps`` is
    what :func:`backward` left of the same chunk.
    """
    n = lay[L_N]
    size = step_size(lay)
    d, w, D = scratch[S_D : S_D + n], scratch[S_H : S_H + n], scratch[S_DECAY : S_DECAY + n]
    X = scratch[S_X : S_X + n * WIDTH]
    P, L = scratch[S_P : S_P + n * STRIDE], scratch[S_LAM : S_LAM + n * STRIDE]
    U, V = scratch[S_U : S_U + n * STRIDE], scratch[S_V : S_V + n * STRIDE]
    for j in range(n):
        for k in range(n):
            L[j * STRIDE + k] = Lam[j, k]
    begin(X, lay)
    D[:] = 1.0
    pending = False
    c, f, m, row = coarse.shape[0], fine.shape[0], count_steps(kinds), rows.shape[0]
    for i in range(kinds.shape[0] - 1, -1, -1):
        kind = kinds[i]
        if kind == STEP:
            m -= 1
            c -= C_STEP
            f -= size
            decay_factors(float(fine[f]), lay, par, d)
            step_back(steps[m, n:], lay, d, X, D)
            pending = True
            continue
        if pending:
            flush(X, D, L, lay, U, V)
            pending = False
        if kind >= UPDATE:
            f -= F_GAIN + n + kind - UPDATE
            take_back(kind, fine[f:], n, X, L, d, w)
        elif kind in (TURN, FADE):
            f -= F_TURN if kind == TURN else F_FADE
            take_back(kind, fine[f:], n, X, L, d, w)
        else:
            row -= 1
            for j in range(n):
                for k in range(n):
                    P[j * STRIDE + k] = before[row, j, k]
            smoothed_blocks(P, L, n, V, rows[row])
    if pending:
        flush(X, D, L, lay, U, V)
    for j in range(n):
        for k in range(n):
            Lam[j, k] = L[j * STRIDE + k]
