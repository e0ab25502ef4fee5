"""Pseudorange and range rate of one satellite, at the antenna.

    z = ρ(p + C_nb l) + troposphere + clock + bias of the system,   ż = ρ̇ + clock drift

Groves 2013, section 14.3.1 (tight coupling). With u the line of sight in n, towards the satellite:
∂ρ/∂p = −uᵀ. What the antenna's place depends on comes from the position measurement's H, likewise
for the rate: H = −uᵀ H_position, −uᵀ H_velocity. A place that is wrong also turns u, which makes a
rate of v⊥/r: 2e-4 1/s, kept.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.gnss.corrected import (
    S_POS,
    S_RANGE,
    S_RATE,
    S_SYSTEM,
    S_VEL,
    overhead,
    range_from,
    range_rate,
)
from companion.gnss.geometry import ned_axes
from companion.measurements.gnss import position, velocity
from companion.navigation.earth import E2, radii
from companion.navigation.layout import CLOCK, DRIFT, HEIGHT, L_CLOCK, L_N, LAT, LON, POS, SYSTEM
from companion.types import F64, I64

# --- what the satellites of an epoch share, and the line of sight to the one at hand
V_ECEF, V_VELOCITY, V_SITE = 0, 3, 6
"""Antenna's position [m] and velocity [m/s], ECEF; its site (4), see corrected.overhead."""
V_PLACE, V_LINE_ECEF, V_LINE = 10, 13, 16
"""Scratch (3); unit vectors towards the satellite, ECEF and NED."""
VIEW_SIZE = 19


@njit("void(f8[::1], f8[::1], f8[:, ::1], f8[::1], f8[::1])", cache=True, counted=False)
def antenna(s: F64, lever_n: F64, axes: F64, here: F64, x: F64) -> None:
    """ECEF ``x`` (3,) and geodetic ``here`` (3,) of the antenna, and C_ne in ``axes``."""
    lat, lon, height = s[LAT], s[LON], s[HEIGHT]
    ned_axes(lat, lon, axes)
    _, n = radii(lat)
    x[0] = (n + height) * math.cos(lat) * math.cos(lon)
    x[1] = (n + height) * math.cos(lat) * math.sin(lon)
    x[2] = (n * (1.0 - E2) + height) * math.sin(lat)
    for i in range(3):
        for j in range(3):
            x[i] += axes[j, i] * lever_n[j]
    here[0], here[1], here[2] = lat, lon, height - lever_n[2]


@njit(
    "void(f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1])", cache=True, counted=False
)
def look(s: F64, lay: I64, C: F64, axes: F64, J: F64, view: F64) -> None:
    """What the satellites of an epoch share: where the antenna is, how it moves, what moves both.

    ``C`` (3, 3) is C_nb. Filled: ``axes`` (3, 3) C_ne; ``J`` (6, ≥ n), derivatives of the antenna's
    position and velocity, NED; ``view`` (:data:`VIEW_SIZE`,).
    """
    place, w = view[V_PLACE : V_PLACE + 3], view[V_LINE : V_LINE + 3]
    # The innovation of "measured where we are" is less the lever arm and the slow error.
    position(s, lay, C, s[LAT : LAT + 3], J[:3], w)
    for i in range(3):
        w[i] = -w[i]
    antenna(s, w, axes, place, view[V_ECEF : V_ECEF + 3])
    overhead(place, view[V_SITE : V_SITE + 4])
    for i in range(3):
        place[i] = 0.0
    velocity(s, lay, C, place, J[3:6], w)
    for i in range(3):
        view[V_VELOCITY + i] = -(axes[0, i] * w[0] + axes[1, i] * w[1] + axes[2, i] * w[2])


@njit(
    "f8(f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1])",
    cache=True,
    counted=False,
)
def range_innovation(
    s: F64, lay: I64, axes: F64, J: F64, view: F64, row: F64, H: F64
) -> float:  # fmt: skip
    """Innovation of a satellite's range [m], and its ``H`` (n,).

    ``row`` (12,): columns ``S_`` of :mod:`companion.gnss.corrected`; the others as :func:`look`
    left them. The line of sight in ``view`` becomes this satellite's.
    """
    e, u = view[V_LINE_ECEF : V_LINE_ECEF + 3], view[V_LINE : V_LINE + 3]
    expected = range_from(row, view[V_ECEF : V_ECEF + 3], view[V_SITE : V_SITE + 4], e)
    for i in range(3):
        u[i] = axes[i, 0] * e[0] + axes[i, 1] * e[1] + axes[i, 2] * e[2]
    for j in range(lay[L_N]):
        H[j] = -(u[0] * J[0, j] + u[1] * J[1, j] + u[2] * J[2, j])
    y = row[S_RANGE] - expected - s[CLOCK]
    H[lay[L_CLOCK]] = 1.0
    system = int(row[S_SYSTEM])
    if system > 0:
        y -= s[CLOCK + SYSTEM - 1 + system]
        H[lay[L_CLOCK] + SYSTEM - 1 + system] = 1.0
    return float(y)


@njit(
    "f8(f8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8[::1])",
    cache=True,
    counted=False,
)
def rate_innovation(
    s: F64, lay: I64, axes: F64, J: F64, view: F64, row: F64, H: F64
) -> float:  # fmt: skip
    """The same of its range rate [m/s]; :func:`range_innovation` of this satellite goes before."""
    e, u = view[V_LINE_ECEF : V_LINE_ECEF + 3], view[V_LINE : V_LINE + 3]
    x, v = view[V_ECEF : V_ECEF + 3], view[V_VELOCITY : V_VELOCITY + 3]
    for j in range(lay[L_N]):
        H[j] = -(u[0] * J[3, j] + u[1] * J[4, j] + u[2] * J[5, j])
    H[lay[L_CLOCK] + DRIFT] = 1.0
    along, square = 0.0, 0.0
    for i in range(3):
        along += e[i] * (row[S_VEL + i] - v[i])
        square += (row[S_POS + i] - x[i]) ** 2
    distance = math.sqrt(square)
    for k in range(3):
        across = 0.0
        for i in range(3):
            across += axes[k, i] * (row[S_VEL + i] - v[i])
        H[POS + k] -= (across - u[k] * along) / distance
    return float(row[S_RATE] - range_rate(row, e, x, v) - s[CLOCK + DRIFT])
