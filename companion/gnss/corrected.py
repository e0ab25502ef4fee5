"""Corrected measurements of one epoch: what is left when satellite and ionosphere are taken off.

    pr  = ρ + c·(receiver clock) + c·(inter-system bias) + troposphere + noise
    ṗr  = ρ̇ + c·(receiver clock rate) + noise

with ρ = |x_s − x_r| + Ω (x_s y_r − y_s x_r) / c, the last term being the Earth's rotation while the
signal travels (Sagnac); x_s is the satellite at transmission in the Earth's frame of that moment.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.gnss.atmosphere import mapped, zenith_delay
from companion.gnss.orbit import OMEGA_E_GPS
from companion.gnss.systems import C
from companion.types import F64

# --- columns of a corrected satellite; also a row of the filter's aid table
S_POS, S_VEL = 0, 3
"""Satellite position [m] and velocity [m/s] at transmission, ECEF."""
S_RANGE, S_RATE = 6, 7
"""Corrected pseudorange [m] and its rate [m/s]; NaN where not measured."""
S_RANGE_VAR, S_RATE_VAR = 8, 9
S_SYSTEM, S_SAT = 10, 11
ROW_SIZE = 12


@njit("f8(f8[::1], f8, f8, f8, f8[::1])", cache=True, counted=False)
def line_of_sight(sat: F64, x: float, y: float, z: float, u: F64) -> float:
    """Range [m] with Sagnac to an ECEF point; ``u`` (3,): unit vector towards the satellite."""
    dx, dy, dz = sat[S_POS] - x, sat[S_POS + 1] - y, sat[S_POS + 2] - z
    r = math.sqrt(dx * dx + dy * dy + dz * dz)
    u[0], u[1], u[2] = dx / r, dy / r, dz / r
    return float(r + OMEGA_E_GPS / C * (sat[S_POS] * y - sat[S_POS + 1] * x))


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def range_rate(sat: F64, u: F64, x: F64, v: F64) -> float:
    """Derivative of :func:`line_of_sight` for a receiver at ``x`` (3,) moving with ``v`` (3,)."""
    rate = 0.0
    for i in range(3):
        rate += u[i] * (sat[S_VEL + i] - v[i])
    turn = sat[S_VEL] * x[1] + sat[S_POS] * v[1] - sat[S_VEL + 1] * x[0] - sat[S_POS + 1] * v[0]
    return float(rate + OMEGA_E_GPS / C * turn)


@njit("void(f8[::1], f8[::1])", cache=True, counted=False)
def overhead(here: F64, site: F64) -> None:
    """``site`` (4,): ECEF unit vector up and delay of the troposphere that way [m] at geodetic
    ``here`` (3,), for all satellites seen from there.
    """
    cp = math.cos(here[0])
    site[0], site[1] = cp * math.cos(here[1]), cp * math.sin(here[1])
    site[2] = math.sin(here[0])
    site[3] = zenith_delay(here[0], here[2])


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def range_from(sat: F64, x: F64, site: F64, u: F64) -> float:
    """As :func:`expected_range`, with ``site`` (4,) of :func:`overhead`."""
    r = line_of_sight(sat, x[0], x[1], x[2], u)
    up = site[0] * u[0] + site[1] * u[1] + site[2] * u[2]
    return float(r + site[3] * mapped(up))


@njit("f8(f8[::1], f8[::1], f8[::1], f8[::1])", cache=True, entry=True)
def expected_range(sat: F64, x: F64, here: F64, u: F64) -> float:
    """Range [m] to a receiver at ECEF ``x``, geodetic ``here``, with Sagnac and troposphere.

    ``u`` (3,) is filled: unit vector towards the satellite.
    """
    site = np.empty(4)
    overhead(here, site)
    return float(range_from(sat, x, site, u))
