"""Shared by the navigation tests: states, a loop over the kernel, and an independent twin."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from companion.navigation import earth
from companion.navigation import layout as lo
from companion.navigation.mechanisation import advance
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64


def nominal(
    lat: float,
    lon: float,
    height: float,
    vel_n: tuple[float, float, float] | F64,
    rpy: tuple[float, float, float] | F64,
    earth_rate: float = earth.RATE,
) -> F64:
    """A state vector without covariance: position, velocity, attitude, the rest zero."""
    s = np.zeros(lo.P)
    s[lo.Q : lo.Q + 4] = quat_from_rpy(*rpy)
    s[lo.LAT], s[lo.LON], s[lo.HEIGHT] = lat, lon, height
    s[lo.VEL_N : lo.VEL_N + 3] = vel_n
    s[lo.EARTH_RATE] = earth_rate
    return s


@njit("void(f8[::1], f8[:, ::1], f8, b1)")  # type: ignore[untyped-decorator]
def steps(s: F64, imu: F64, dt: float, integral: bool) -> None:
    """``advance`` over the intervals between the rows of ``imu`` (N, 6)."""
    C = np.empty((3, 3))
    for i in range(imu.shape[0] - 1):
        advance(s, imu[i], imu[i + 1], dt, integral, True, C)


def metres(s: F64, lat: float, lon: float, height: float) -> F64:
    """(3,) truth − state, NED [m]."""
    return earth.ned_difference(
        np.array(lat), np.array(lon), np.array(height), s[lo.LAT], s[lo.LON], s[lo.HEIGHT]
    )


def still_imu(s: F64) -> F64:
    """(6,) rate and specific force of a sensor at rest in the attitude of ``s``."""
    C = matrix_from_quat(s[:4])
    down = np.array([0.0, 0.0, -earth.gravity(s[lo.LAT], s[lo.HEIGHT])])
    return np.concatenate([C.T @ earth.earth_rate_n(s[lo.LAT]), C.T @ down])


def integrate(s: F64, until: float, imu: Callable[[float], F64]) -> tuple[F64, F64, F64]:
    """(lat, lon, height), vel_n, q_nb at ``until`` [s] by DOP853 at a tolerance of 1e-12.

    The differential equations as Groves 2013 prints them (5.4-5.5), on a quaternion.
    """

    def slope(t: float, x: F64) -> F64:
        lat, _, h = x[:3]
        v, q = x[3:6], x[6:10] / np.linalg.norm(x[6:10])
        u = imu(t)
        m, n = earth.radii(lat)
        w_ie, w_en = earth.earth_rate_n(lat), earth.transport_rate_n(lat, h, v)
        acc = matrix_from_quat(q) @ u[3:] - np.cross(2 * w_ie + w_en, v)
        acc[2] += earth.gravity(lat, h)
        w, a, b = q[0], q[1:], u[:3]
        c = w_ie + w_en
        dq = np.empty(4)
        # q' = ½ q ⊗ ω_ib − ½ ω_in ⊗ q
        dq[0] = -0.5 * a @ b + 0.5 * c @ a
        dq[1:] = 0.5 * (w * b + np.cross(a, b)) - 0.5 * (w * c + np.cross(c, a))
        return np.concatenate([[v[0] / (m + h), v[1] / ((n + h) * np.cos(lat)), -v[2]], acc, dq])

    x0 = np.concatenate([s[lo.LAT : lo.LAT + 3], s[lo.VEL_N : lo.VEL_N + 3], s[:4]])
    x = solve_ivp(slope, (0.0, until), x0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return x[:3], x[3:6], x[6:] / np.linalg.norm(x[6:])
