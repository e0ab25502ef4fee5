"""Barometric height: pressure turned into height by the standard atmosphere, plus a slow offset.

z = h + b, b a random walk that takes up weather and the difference between pressure height and the
GNSS datum.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.navigation.layout import BARO_BIAS, HEIGHT, L_BARO, L_N, POS
from companion.types import F64, I64

P0 = 101325.0
"""Standard pressure at sea level [Pa]."""
T0 = 288.15
LAPSE = 0.0065
EXPONENT = 0.190263
"""R L / (g M) of the standard atmosphere (ICAO Doc 7488)."""


def pressure_height(pressure: F64) -> F64:
    """Height (N,) [m] in the standard atmosphere of static pressure (N,) [Pa]; NaN if ≤ 0."""
    ratio = np.where(pressure > 0, pressure, np.nan) / P0
    return np.asarray(T0 / LAPSE * (1.0 - ratio**EXPONENT))


@njit("void(f8[::1], i8[::1], f8, f8[:, ::1], f8[::1])", cache=True, counted=False)
def height(s: F64, lay: I64, z: float, H: F64, y: F64) -> None:
    """Fill ``y[0]`` [m] and row 0 of ``H`` for pressure height ``z`` [m]."""
    for j in range(lay[L_N]):
        H[0, j] = 0.0
    y[0] = z - s[HEIGHT] - s[BARO_BIAS]
    H[0, POS + 2] = -1.0  # height is minus down
    if lay[L_BARO] >= 0:
        H[0, lay[L_BARO]] = 1.0
