"""Heading: from a horizontal direction known in n and seen in b. Magnetometer and course use it.

A body vector u_b whose horizontal direction in n is known to be ψ: y = ψ − atan2(u_E, u_N) with
u = C_nb u_b. From δu = φ × u:  H_φ = (−u_D u_N, −u_D u_E, u_h²) / u_h², taken where u points to ψ,
as it truly does: the measured u_E and u_N carry the noise that is in y, and a Jacobian that knows
of the noise turns it into tilt, 2 P_φφ a sample at a dip of 63°, always the same way.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.navigation.layout import ATT, L_N
from companion.types import F64, I64


@njit("b1(i8[::1], f8[:, ::1], f8, f8, f8, f8, f8[:, ::1], f8[::1])", cache=True, counted=False)
def direction(
    lay: I64, C: F64, bx: float, by: float, bz: float, azimuth: float, H: F64, y: F64
) -> bool:
    """Fill ``y[0]`` [rad] and row 0 of ``H``: body vector (bx, by, bz) should point to ``azimuth``.

    False when the vector stands too steep (horizontal part below a tenth) to give a heading.
    """
    un = C[0, 0] * bx + C[0, 1] * by + C[0, 2] * bz
    ue = C[1, 0] * bx + C[1, 1] * by + C[1, 2] * bz
    ud = C[2, 0] * bx + C[2, 1] * by + C[2, 2] * bz
    h2 = un * un + ue * ue
    if not h2 > 0.01 * (h2 + ud * ud):
        return False
    for j in range(lay[L_N]):
        H[0, j] = 0.0
    e = azimuth - math.atan2(ue, un)
    y[0] = e - 2.0 * math.pi * math.floor(e / (2.0 * math.pi) + 0.5)
    dip = ud / math.sqrt(h2)
    H[0, ATT] = -dip * math.cos(azimuth)
    H[0, ATT + 1] = -dip * math.sin(azimuth)
    H[0, ATT + 2] = 1.0
    return True
