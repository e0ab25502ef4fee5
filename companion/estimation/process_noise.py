"""Noise of an inertial unit over one covariance interval, from the sums of the interval.

Adaptation scales all of it by one factor, which is a float32 too.

Rounded to single precision: seven digits of a noise are plenty, and so a smoother's tape holds what
the filter used, to the bit.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.parameters import (
    ACCEL_PSD,
    GYRO_PSD,
    GYRO_VIBRATION_GAIN,
    VIBRATION_GAIN,
)
from companion.estimation.saturation import ACCEL
from companion.navigation.layout import (
    GYRO_VIBRATION,
    Q_SCALE,
    SATURATED,
    SUM_C,
    SUM_T,
    SUM_XA,
    SUM_XV,
    VIBRATION,
)
from companion.types import F64

SATURATED_GAIN = 0.05**2
"""Gyro noise density per vibration, squared [1/Hz], while the unit is driven beyond its range: as
the default of imu.vibration_gain_rthz, and for the same reasons."""


@njit("f8(f8[::1], f8[::1])", cache=True, counted=False)
def velocity_noise(s: F64, par: F64) -> float:
    """Variance that each component of velocity gains [m²/s²].

    Vibration is rectified and aliased by every accelerometer, in proportion to its strength.
    """
    psd = (par[ACCEL_PSD] + par[VIBRATION_GAIN] * s[VIBRATION]) * s[Q_SCALE]
    return float(np.float32(psd * s[SUM_T] + s[SUM_XV]))


@njit("void(f8[::1], f8[::1], f8[::1])", cache=True, counted=False)
def attitude_noise(s: F64, par: F64, q: F64) -> None:
    """``q`` (6,): covariance that φ gains [rad²], as xx, xy, xz, yy, yz, zz.

    Engines and roads shake a vehicle about one axis more than about another, so each gyro has a
    noise of its own: C_nb diag(q) C_nbᵀ T, with the mean of C_nb over the interval. In ordinary
    flight a gyro's spread is motion; beyond the range of the unit it is taken for noise.
    """
    T = s[SUM_T]
    even = par[GYRO_PSD] * T * s[Q_SCALE] + s[SUM_XA]
    gain = par[GYRO_VIBRATION_GAIN]
    if s[SATURATED] >= ACCEL:
        gain = max(gain, SATURATED_GAIN)
    if gain <= 0.0:
        q[1] = q[2] = q[4] = 0.0
        q[0] = q[3] = q[5] = np.float32(even)
        return
    at = 0
    for i in range(3):
        for j in range(i, 3):
            x = 0.0
            for k in range(3):
                x += s[SUM_C + 3 * i + k] * s[SUM_C + 3 * j + k] * s[GYRO_VIBRATION + k]
            x *= gain * s[Q_SCALE] / T
            q[at] = np.float32(x + (even if i == j else 0.0))
            at += 1


@njit("f8(f8[::1])", cache=True, counted=False)
def bias_noise(s: F64) -> float:
    """Factor on what drives the biases: the square of that on noise.

    A unit that goes wrong does so by a step more often than by noise; what drives a bias is so
    small that only its square lets a filter that has settled learn the bias anew.
    """
    return float(np.float32(s[Q_SCALE] * s[Q_SCALE]))
