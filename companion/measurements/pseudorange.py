"""Pseudorange and range rate of one satellite, at the antenna.

    z = ρ(p + C_nb l) + troposphere + clock + bias of the system,   ż = ρ̇ + clock drift

Groves 2013, section 14.3.1 (tight coupling). With u the line of sight in n, towards the satellite:
∂ρ/∂p = −uᵀ. What the antenna's place depends on comes from the position measurement's H, likewise
for the rate: H = −uᵀ H_position, −uᵀ H_velocity. A place that is wrong also turns u, which makes a
rate of v⊥/r: 2e-4 1/s, kept.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.gnss.corrected import S_RANGE, S_RATE, S_SYSTEM, S_VEL, expected_range, range_rate
from companion.gnss.geometry import ned_axes
from companion.measurements.gnss import position, velocity
from companion.navigation.earth import E2, radii
from companion.navigation.layout import CLOCK, DRIFT, HEIGHT, L_CLOCK, L_N, LAT, LON, POS, SYSTEM
from companion.types import F64, I64

NO_RATE = 1
"""Answer where only the pseudorange was measured; 2 with the rate."""


@njit("void(f8[::1], f8[::1], f8[:, ::1], f8[::1], f8[::1])", cache=True)
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


@njit("i8(f8[::1], i8[::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[::1])", cache=True)
def satellite(s: F64, lay: I64, C: F64, row: F64, H: F64, y: F64) -> int:
    """Fill ``y`` (2,) [m, m/s] and ``H`` (2, n) of a corrected satellite's range and rate.

    ``row`` (12,): columns ``S_`` of :mod:`companion.gnss.corrected`; ``C`` (3, 3) is C_nb. Returns
    how many of the two were measured, the range first.
    """
    n = lay[L_N]
    full, w = np.empty((3, n)), np.empty(3)
    axes, here, x = np.empty((3, 3)), np.empty(3), np.empty(3)
    u_e, u, v_e = np.empty(3), np.empty(3), np.empty(3)
    # The innovation of "measured where we are" is less the lever arm and the slow error.
    position(s, lay, C, s[LAT : LAT + 3], full, w)
    for i in range(3):
        w[i] = -w[i]
    antenna(s, w, axes, here, x)
    clock = lay[L_CLOCK]
    system = int(row[S_SYSTEM])
    y[0] = row[S_RANGE] - expected_range(row, x, here, u_e) - s[CLOCK]
    if system > 0:
        y[0] -= s[CLOCK + SYSTEM - 1 + system]
    for i in range(3):
        u[i] = axes[i, 0] * u_e[0] + axes[i, 1] * u_e[1] + axes[i, 2] * u_e[2]
    for j in range(n):
        H[0, j] = -(u[0] * full[0, j] + u[1] * full[1, j] + u[2] * full[2, j])
    H[0, clock] = 1.0
    if system > 0:
        H[0, clock + SYSTEM - 1 + system] = 1.0
    if math.isnan(row[S_RATE]):
        return NO_RATE
    w[:] = 0.0
    velocity(s, lay, C, w, full, v_e)
    for i in range(3):
        w[i] = -v_e[i]
    for i in range(3):
        v_e[i] = axes[0, i] * w[0] + axes[1, i] * w[1] + axes[2, i] * w[2]
    y[1] = row[S_RATE] - range_rate(row, u_e, x, v_e) - s[CLOCK + DRIFT]
    for j in range(n):
        H[1, j] = -(u[0] * full[0, j] + u[1] * full[1, j] + u[2] * full[2, j])
    H[1, clock + DRIFT] = 1.0
    along, distance = 0.0, 0.0
    for i in range(3):
        along += u_e[i] * (row[S_VEL + i] - v_e[i])
        distance += (row[i] - x[i]) ** 2
    distance = math.sqrt(distance)
    for k in range(3):
        across = 0.0
        for i in range(3):
            across += axes[k, i] * (row[S_VEL + i] - v_e[i])
        H[1, POS + k] -= (across - u[k] * along) / distance
    return NO_RATE + 1
