"""Φ of a recorded step as one row of numbers: worked out once, gone over in both directions.

What the biases do to position, velocity and attitude is one product each: p ← b_a is T/2 of
v ← b_a, p ← b_g is T/3 of v ← b_g, and φ ← b_g is v ← b_a; likewise for the scale factors. So the
row holds each once, and neither what is nought nor what is one.
"""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.tape import F32, F_STEP, F_STEP_WITH_SCALE, read_step
from companion.navigation.error_model import core_blocks, scale_blocks
from companion.navigation.layout import L_ACCEL_SCALE
from companion.types import F64, I64

# --- columns: T; p ← p (5: NN, ND, EN, EE, ED); p ← φ, a cross product (3); v ← v (8: by rows, DD
# is one); v ← p (DD); v ← φ (3); v ← b_a (9); v ← b_g (9); φ ← v (NE, EN, DE); φ ← φ (3)
K_T, K_PP, K_PA, K_VV, K_VP, K_VA, K_C, K_D, K_AV, K_AA = 0, 1, 6, 9, 17, 18, 21, 30, 39, 42
# --- with scale states: v ← s_a (9); v ← s_g (9); φ ← s_g (9)
K_S, K_R, K_Q = 45, 54, 63
K_SIZE = 72


@njit("i8(i8[::1])", cache=True, counted=False)
def step_size(lay: I64) -> int:
    """Numbers of a step in the column ``fine`` of a tape."""
    return F_STEP_WITH_SCALE if lay[L_ACCEL_SCALE] >= 0 else F_STEP


@njit(
    "void(f4[::1], f8[::1], i8[::1], f8[::1], f8[:, :, ::1], f8[::1])",
    cache=True,
    counted=False,
)
def coefficients(c: F32, f: F64, lay: I64, s: F64, B: F64, K: F64) -> None:
    """``K`` (K_SIZE,) of a step with the numbers ``c`` and ``f`` on the tape.

    ``s`` is scratch with the Earth's rate in place, ``B`` (24, 3, 3) scratch.
    """
    read_step(c, f, s)
    core_blocks(s, B)
    K[K_T] = f[0]
    K[K_PP], K[K_PP + 1], K[K_PP + 2] = B[0, 0, 0], B[0, 0, 2], B[0, 1, 0]
    K[K_PP + 3], K[K_PP + 4] = B[0, 1, 1], B[0, 1, 2]
    K[K_VP] = B[8, 2, 2]
    for at, block in ((K_PA, 2), (K_VA, 10), (K_AA, 18)):
        K[at], K[at + 1], K[at + 2] = B[block, 1, 2], B[block, 2, 0], B[block, 0, 1]
    for i in range(3):
        for j in range(3):
            if i + j < 4:
                K[K_VV + 3 * i + j] = B[9, i, j]
            K[K_C + 3 * i + j] = B[11, i, j]
            K[K_D + 3 * i + j] = B[12, i, j]
    K[K_AV], K[K_AV + 1], K[K_AV + 2] = B[17, 0, 1], B[17, 1, 0], B[17, 2, 1]
    if lay[L_ACCEL_SCALE] >= 0:
        scale_blocks(s, B)
        for i in range(3):
            for j in range(3):
                K[K_S + 3 * i + j] = B[13, i, j]
                K[K_R + 3 * i + j] = B[14, i, j]
                K[K_Q + 3 * i + j] = B[22, i, j]
