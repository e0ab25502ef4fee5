"""What speaks for the model and what for a sensor, beside the innovations themselves.

A manoeuvre or vibration adds velocity and attitude error in proportion to itself (scale factor,
misalignment, timing; rectification and aliasing). The share that it may have in the whole noise,
r / (1 + r) with r the ratio of the two variances, is a number without a unit or a threshold. So is
the share of satellites, or of stated accuracy, that a receiver has lost against its usual.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.parameters import ACCEL_PSD, GYRO_PSD
from companion.navigation.layout import (
    RECEPTION,
    SATURATED,
    SATURATING,
    STILL_RING,
    STILL_SUB,
    VIBRATION,
)
from companion.types import F64

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


@njit("void(f8[::1], f8, f8)", cache=True)
def reception(s: F64, satellites: float, variance: float) -> None:
    """Note how much worse a fix was received than usual: 0 as usual, towards 1 much worse.

    ``satellites`` may be NaN; ``variance`` is that of horizontal position as it is taken [m²].
    """
    lost = 0.0
    if satellites == satellites:
        usual = s[RECEPTION + 1]
        if usual == 0.0:
            usual = satellites
        lost = max(0.0, 1.0 - satellites / max(usual, 1.0))
        s[RECEPTION + 1] = usual + (satellites - usual) / USUAL_FIXES
    if variance == variance:
        usual = s[RECEPTION + 2]
        if usual == 0.0:
            usual = variance
        lost = max(lost, 1.0 - usual / max(variance, 1e-9))
        s[RECEPTION + 2] = usual + (variance - usual) / USUAL_FIXES
    s[RECEPTION] = lost
