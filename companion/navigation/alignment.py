"""Alignment: level from specific force, gyro bias from standstill, and how sure both are.

Levelling takes the mean specific force for the reaction to gravity: C_nb f̄ = (0, 0, −g). What is
not known of the accelerometer bias then tilts the solution by φ = (b_E, −b_N) / g; that correlation
is kept in P, because it decides how well the bias is found later.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64, I64

MOVING_TILT_SD = math.radians(6.0)
"""Tilt uncertainty of levelling in motion: 1 m/s² of unknown acceleration over the window."""

SCATTER = 11.345 / 3.0
"""Variance seen over variance stated that one window in a hundred exceeds: χ² of three quarters'
degrees of freedom."""


@dataclass(frozen=True, slots=True)
class Level:
    """A levelling: roll and pitch [rad], and what the window says of the gyro bias."""

    roll: float
    pitch: float
    static: bool
    gyro_bias_b: F64
    """(3,) mean rate over a static window, Earth's rate included; else the prior [rad/s]."""
    gyro_bias_var: F64
    tilt_var: float
    """Beyond what accelerometer bias does [rad²]."""


def level(
    t_ns: I64,
    imu: F64,
    *,
    spread_gyro: float,
    spread_accel: float,
    may_be_static: bool,
    gyro_psd: float,
    accel_psd: float,
    prior_bias: F64,
    prior_var: F64,
    accel_bias: F64,
) -> Level:
    """Level on a window of samples: ``t_ns`` (N,), ``imu`` (N, ≥ 6) rate and specific force.

    ``prior_bias``, ``prior_var`` (3,): gyro bias known before [rad/s]; ``accel_bias`` (3,) [m/s²]
    is taken off the specific force.

    Static when the means over four quarters of the window agree within ``spread_gyro`` [rad/s] and
    ``spread_accel`` [m/s²] and nothing else (``may_be_static``) speaks against it.
    """
    mean = imu[:, :6].mean(axis=0)
    quarters = np.array([part[:, :6].mean(axis=0) for part in np.array_split(imu, 4)])
    spread = np.ptp(quarters, axis=0)
    static = bool(
        may_be_static and np.all(spread[:3] <= spread_gyro) and np.all(spread[3:] <= spread_accel)
    )
    fx, fy, fz = mean[3:] - accel_bias
    roll = math.atan2(-fy, -fz)
    pitch = math.atan2(fx, math.hypot(fy, fz))
    span = max((t_ns[-1] - t_ns[0]) * 1e-9, 1e-3)
    g2 = fx * fx + fy * fy + fz * fz
    if static:
        bias = mean[:3].copy()  # Earth's rate included: it takes a heading to tell it apart
        seen = quarters.var(axis=0, ddof=1) / 4.0
        var = _variance_of_mean(gyro_psd / span, seen[:3])
        tilt = float(np.max(_variance_of_mean(accel_psd / span, seen[3:5]))) / g2
    else:
        bias, var = prior_bias.copy(), prior_var.copy()
        tilt = MOVING_TILT_SD**2
    return Level(roll, pitch, static, bias, var, tilt)


def _variance_of_mean(stated: float, seen: F64) -> F64:
    """Variance of the window's mean: as the noise density states it, unless it is seen to be more.

    The quarters scatter by the same noise that the density states, so what was ``seen`` of it is a
    draw about ``stated``, χ² with three degrees of freedom; taking the larger of the two would
    claim too little of every start. Only a scatter that chance would hardly give counts.
    """
    return np.where(seen > SCATTER * stated, seen, stated)


def attitude_covariance(
    q_nb: F64,
    accel_bias_var: F64,
    tilt_var: float,
    yaw_var: float,
    g: float,
    yaw_slope: tuple[float, float] = (0.0, 0.0),
) -> tuple[F64, F64]:
    """P_φφ (3, 3) and P_φb_a (3, 3) after levelling with an unknown accelerometer bias.

    φ = J C_nb b_a, J = [[0, 1/g, 0], [−1/g, 0, 0], [0, 0, 0]], from C_true (f̄ − b_a) = (0, 0, −g).
    ``yaw_slope``: φ_D = slope_N φ_N + slope_E φ_E + ν, ν of ``yaw_var`` [rad²], where the heading
    was taken through the tilted level (:func:`heading_from_field`).
    """
    J = np.zeros((3, 3))
    J[0, 1], J[1, 0] = 1.0 / g, -1.0 / g
    M = J @ matrix_from_quat(q_nb)
    cross = M * accel_bias_var[None, :]
    P = cross @ M.T + np.diag([tilt_var, tilt_var, yaw_var])
    T = np.eye(3)
    T[2, :2] = yaw_slope
    P, cross = T @ P @ T.T, T @ cross
    return 0.5 * (P + P.T), cross


def heading_from_field(
    roll: float, pitch: float, field_b: F64, declination: float
) -> tuple[float, tuple[float, float]]:
    """Heading [rad] from a magnetic field in body axes at a level attitude, and its slope.

    A tilt error turns the dip of the field u into heading: from 0 = H φ of heading.direction,
    φ_D = (u_D u_N φ_N + u_D u_E φ_E) / u_h². At a dip of 63° that is twice the tilt.
    """
    C = matrix_from_quat(quat_from_rpy(roll, pitch, 0.0))
    m = C @ field_b
    dip = m[2] / max(math.hypot(m[0], m[1]), 1e-12 * abs(m[2]))
    slope = (dip * math.cos(declination), dip * math.sin(declination))
    return declination - math.atan2(m[1], m[0]), slope
