"""What speaks for the model and what for a sensor, beside the innovations themselves.

A manoeuvre or vibration adds velocity and attitude error in proportion to itself (scale factor,
misalignment, timing; rectification and aliasing). The share that it may have in the whole noise,
r / (1 + r) with r the ratio of the two variances, is a number without a unit or a threshold. So is
the share of satellites, or of stated accuracy, that a receiver has lost against its usual.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.parameters import ACCEL_PSD, GNSS_VAR, GYRO_PSD
from companion.navigation.layout import (
    L_GNSS,
    RECEPTION,
    SATURATED,
    SATURATING,
    STILL_RING,
    STILL_SUB,
    VIBRATION,
)
from companion.types import F64, I64

VEL_H = 2  # as types.Channel
SCALE_VAR = 0.005**2
"""Of a scale factor or an angle of mounting that is not modelled: half a per cent, a usual MEMS."""
VIBRATION_VAR = 0.05**2
"""Noise density per vibration, squared [1/Hz]: as the default of imu.vibration_gain_rthz."""


@njit("f8(f8[::1], f8[::1])", cache=True)
def strain(s: F64, par: F64) -> float:
    """Share of the inertial unit's error that motion may have, 0 to 1, over the last second.

    All of it where a sample was at the end of its range: nothing says how large that error is.
    """
    if s[SATURATED] > 0.0 or s[SATURATING] > 0.0:
        return 1.0
    spread = np.zeros(2)
    for i in range(6):
        low = high = s[STILL_RING + i]
        for b in range(1, STILL_SUB):
            mean = s[STILL_RING + 12 * b + i]
            low, high = min(low, mean), max(high, mean)
        spread[i // 3] += (high - low) * (high - low)
    # Over a second: an error that lasts gives its square, noise of density d² gives d².
    r = SCALE_VAR * (spread[0] / par[GYRO_PSD] + spread[1] / par[ACCEL_PSD])
    r += VIBRATION_VAR * s[VIBRATION] / par[ACCEL_PSD]
    return float(r / (1.0 + r))


USUAL_FIXES = 300.0
"""Fixes over which it is learned what a receiver usually has."""


@njit("void(f8[::1], f8, f8, f8)", cache=True)
def reception(s: F64, satellites: float, variance: float, interference: float) -> None:
    """Note how much worse a fix was received than usual: 0 as usual, towards 1 much worse.

    ``satellites`` may be NaN; ``variance`` is that of horizontal position as it is taken [m²];
    ``interference`` is what the receiver says of jamming and spoofing, 0 to 1 or NaN.
    """
    lost = interference if interference == interference else 0.0
    if satellites == satellites:
        usual = s[RECEPTION + 1]
        if usual == 0.0:
            usual = satellites
        lost = max(lost, 1.0 - satellites / max(usual, 1.0))
        s[RECEPTION + 1] = usual + (satellites - usual) / USUAL_FIXES
    if variance == variance:
        usual = s[RECEPTION + 2]
        if usual == 0.0:
            usual = variance
        lost = max(lost, 1.0 - usual / max(variance, 1e-9))
        s[RECEPTION + 2] = usual + (variance - usual) / USUAL_FIXES
    s[RECEPTION] = lost


@njit("f8(f8[::1], i8[::1], i8, f8[::1], f8[::1], i8)", cache=True)
def least_factor(par: F64, lay: I64, channel: int, taken: F64, R: F64, m: int) -> float:
    """The factor on ``R`` (m,) that leaves what the configuration says of the receiver.

    ``taken`` (m,): variance of the fix without what is added for its time of validity. What a
    receiver claims beyond its configured deviation, its innovations may disprove; not of a position
    whose slow error is no state, because it is in R then, and does not scatter.
    """
    if channel < VEL_H and lay[L_GNSS] < 0:
        return 1.0
    least, total = 0.0, 0.0
    for i in range(m):
        least += R[i] - max(taken[i] - par[GNSS_VAR + channel], 0.0)
        total += R[i]
    return float(least / total)
