"""The WGS-84 Earth as seen from the navigation frame: radii, gravity, rotation rates.

Scalar jitted functions that the kernels call; plain Python may call them as well. Angles rad,
lengths m, NED. References: Groves 2013, chapter 2; NIMA TR8350.2 for the constants.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.types import F64

A = 6378137.0
"""Semi-major axis [m]."""
F = 1.0 / 298.257223563
"""Flattening."""
B = A * (1.0 - F)
E2 = F * (2.0 - F)
"""First eccentricity squared."""
RATE = 7.292115e-5
"""Earth rotation rate [rad/s]."""
GM = 3.986004418e14
"""Gravitational constant times mass [m³/s²]."""
GAMMA_EQUATOR = 9.7803253359
"""Normal gravity at the equator [m/s²]."""
SOMIGLIANA_K = 1.931852652458e-3
GRAVITY_M = RATE * RATE * A * A * B / GM


@njit("UniTuple(f8, 2)(f8)", cache=True, entry=True)
def radii(lat: float) -> tuple[float, float]:
    """Meridian and prime-vertical radii of curvature (M, N) [m] at latitude ``lat`` [rad].

    M = a (1 − e²) / (1 − e² sin²φ)^{3/2},  N = a / (1 − e² sin²φ)^{1/2}.  Groves eqs 2.105-2.106.
    """
    s = math.sin(lat)
    w2 = 1.0 - E2 * s * s
    w = math.sqrt(w2)
    return A * (1.0 - E2) / (w2 * w), A / w


@njit("f8(f8, f8)", cache=True)
def gravity_at(sin2_lat: float, height: float) -> float:
    """Normal gravity, positive down [m/s²], from the squared sine of latitude and ``height`` [m].

    Somigliana on the ellipsoid with the second-order height term; Groves eqs 2.134, 2.139.
    """
    g0 = GAMMA_EQUATOR * (1.0 + SOMIGLIANA_K * sin2_lat) / math.sqrt(1.0 - E2 * sin2_lat)
    up = height / A
    return g0 * (1.0 - 2.0 * up * (1.0 + F + GRAVITY_M - 2.0 * F * sin2_lat) + 3.0 * up * up)


@njit("f8(f8, f8)", cache=True, entry=True)
def gravity(lat: float, height: float) -> float:
    """Normal gravity, positive down [m/s²], at ``lat`` [rad] and ``height`` [m]."""
    return gravity_at(math.sin(lat) ** 2, height)


@njit("f8(f8, f8)", cache=True)
def gravity_gradient(lat: float, height: float) -> float:
    """Derivative of :func:`gravity` with height [1/s²], negative: gravity weakens upwards."""
    s2 = math.sin(lat) ** 2
    g0 = GAMMA_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / math.sqrt(1.0 - E2 * s2)
    return g0 * (-2.0 / A * (1.0 + F + GRAVITY_M - 2.0 * F * s2) + 6.0 * height / (A * A))


def earth_rate_n(lat: float) -> F64:
    """Earth rate w_ie in n (3,) [rad/s]: Ω (cos φ, 0, −sin φ)."""
    return np.array([RATE * math.cos(lat), 0.0, -RATE * math.sin(lat)])


def transport_rate_n(lat: float, height: float, vel_n: F64) -> F64:
    """Rate w_en of the navigation frame over the Earth, in n (3,) [rad/s]; Groves eq. 5.44."""
    m, n = radii(lat)
    east = vel_n[1] / (n + height)
    return np.array([east, -vel_n[0] / (m + height), -east * math.tan(lat)])


def ned_difference(lat: F64, lon: F64, height: F64, lat0: F64, lon0: F64, height0: F64) -> F64:
    """Small position difference (N, 3) in metres NED: (lat, lon, height) − (lat0, lon0, height0).

    First order in the angles, at the radii of ``lat0``; good to 1 mm within 1 km.
    """
    s2 = np.sin(lat0) ** 2
    w2 = 1.0 - E2 * s2
    n = A / np.sqrt(w2)
    m = n * (1.0 - E2) / w2
    dlon = np.remainder(lon - lon0 + np.pi, 2.0 * np.pi) - np.pi
    return np.stack(
        [(lat - lat0) * (m + height0), dlon * (n + height0) * np.cos(lat0), height0 - height],
        axis=-1,
    )


def ecef(lat: F64, lon: F64, height: F64) -> F64:
    """ECEF position (N, 3) [m]; Groves eq. 2.112."""
    s, c = np.sin(lat), np.cos(lat)
    n = A / np.sqrt(1.0 - E2 * s * s)
    return np.stack(
        [
            (n + height) * c * np.cos(lon),
            (n + height) * c * np.sin(lon),
            (n * (1 - E2) + height) * s,
        ],
        axis=-1,
    )
