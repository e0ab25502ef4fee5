"""Satellites between knots of an orbit: a cubic through place and velocity at both ends.

Knots lie every 30 s of GPS time, whoever asks and when: what comes out depends on ephemeris and
time alone. Hermite's cubic errs by h⁴/384 · d⁴x/dt⁴, on a radius r that turns with ω by h⁴ r ω⁴ /
384: 2.5e-5 m and 4e-6 m/s for a GPS satellite.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.orbit import satellite_at
from companion.types import F64

KNOT_S = 30.0
KNOTS_A_WEEK = 20_160.0
K_NUMBER, K_STATE = 0, 1
"""Columns of a knot: which one since the GPS epoch, NaN for none yet; then what
:func:`companion.gnss.orbit.satellite_at` tells."""
KNOT_SIZE = 9


@njit("void(f8[::1], f8[:, ::1], f8, f8, f8[::1])", cache=True, counted=False)
def satellite_near(e: F64, knots: F64, week: float, second: float, out: F64) -> None:
    """As :func:`companion.gnss.orbit.satellite_at`, from ``knots`` (2, :data:`KNOT_SIZE`).

    They are of this ephemeris ``e``, and are moved on where the time has left them.
    """
    at = math.floor(second / KNOT_S)
    number = week * KNOTS_A_WEEK + at
    if knots[0, K_NUMBER] != number and knots[1, K_NUMBER] == number:
        for i in range(KNOT_SIZE):
            knots[0, i] = knots[1, i]
    for k in range(2):
        if knots[k, K_NUMBER] != number + k:
            satellite_at(e, week, KNOT_S * (at + k), knots[k, K_STATE:])
            knots[k, K_NUMBER] = number + k
    s = (second - KNOT_S * at) / KNOT_S
    left = 1.0 - s
    h00, h01 = (1.0 + 2.0 * s) * left * left, s * s * (3.0 - 2.0 * s)
    h10, h11 = KNOT_S * s * left * left, -KNOT_S * s * s * left
    slope = 6.0 * s * left / KNOT_S
    d0, d1 = left * (1.0 - 3.0 * s), s * (3.0 * s - 2.0)
    for i in range(4):
        # The clock [m] and its rate stand behind place and velocity.
        x, v = (i, i + 3) if i < 3 else (6, 7)
        a, b = knots[0, K_STATE + x], knots[1, K_STATE + x]
        va, vb = knots[0, K_STATE + v], knots[1, K_STATE + v]
        out[x] = h00 * a + h01 * b + h10 * va + h11 * vb
        out[v] = slope * (b - a) + d0 * va + d1 * vb
