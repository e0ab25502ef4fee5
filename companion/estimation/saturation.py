"""Samples at the end of a sensor's range: bounds on what was there, not measurements of it.

By how much the true value was beyond the range nobody knows: a tenth of it is taken, independent
from sample to sample. And what drives an accelerometer to its end shakes the gyro beside it, whose
aliased and rectified vibration then counts as that of an accelerometer does.
"""

from __future__ import annotations

from companion._jit import njit
from companion.estimation.parameters import ACCEL_RANGE, GYRO_RANGE
from companion.navigation.layout import SATURATING, SUM_XA, SUM_XV
from companion.types import F64

SATURATION = 7
"""Column of an inertial row: :data:`ACCEL` + :data:`GYRO`, 0 for a sample within both ranges."""
COUNTED, ACCEL, GYRO = 0.5, 1.0, 2.0
"""``COUNTED``: an accelerometer's counter rose lately, and nobody knows which sample it was."""
BEYOND = 0.1
"""Share of the range that a value may be beyond it, 1σ."""


@njit("void(f8[::1], f8[::1], f8, f8)", cache=True)
def saturated(s: F64, par: F64, which: float, dt: float) -> None:
    """Take in that a sample of ``dt`` seconds was at the end of ``which`` range.

    Of what was only counted nobody knows how many it were: it speaks for the unit (evidence.py),
    and adds no noise.
    """
    s[SATURATING] = max(s[SATURATING], which)
    if which == ACCEL or which > GYRO:
        beyond = BEYOND * par[ACCEL_RANGE] * dt
        s[SUM_XV] += beyond * beyond
    if which >= GYRO:
        beyond = BEYOND * par[GYRO_RANGE] * dt
        s[SUM_XA] += beyond * beyond
