"""Zero velocity and zero rate, and the detector that says when they hold.

A vehicle stands when the means of specific force and rate over four consecutive quarters of the
window agree, the spread inside each is no more than what was seen at rest before, and no recent
GNSS velocity says otherwise. The spread at rest is learned while GNSS itself says that there is no
motion: an engine at idle or a rotor on the ground sets its own measure, and a smooth cruise, which
means alone cannot tell from rest, shows more of it. Nothing learned and no GNSS: never standing.

A receiver that gives no vertical velocity cannot vouch for a steady climb, and one that starts or
ends smoothly keeps its means for a window: so the filter's own vertical velocity, as far as heights
have made it sure, and the amount of the force, which at rest is gravity's, have to agree as well.

A smooth pull-away passes all of that: its acceleration is constant within a window. So the force at
which the vehicle came to stand is kept, and a window that departs from it is motion, until it is
back, or something else shows that the vehicle has been elsewhere since.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.navigation.earth import gravity_at
from companion.navigation.layout import (
    ACCEL_BIAS,
    ACCEL_BIAS_B,
    EARTH_RATE,
    GNSS_SPEED,
    GNSS_SPEED_SD,
    GYRO_BIAS,
    GYRO_BIAS_B,
    GYRO_VIBRATION,
    HEIGHT,
    L_N,
    LAT,
    SATURATED,
    SATURATING,
    STANDING,
    STILL_ANCHOR,
    STILL_CELL,
    STILL_COUNT,
    STILL_LEARNED,
    STILL_RING,
    STILL_SUB,
    STILL_SUM,
    T_GNSS_SPEED,
    VEL,
    VEL_N,
    VIBRATION,
    P,
)
from companion.types import F64, I64

RISE_MPS = 0.1
"""Vertical speed that counts as none, on top of two standard deviations of the filter's own."""
FRESH_NS = 2_000_000_000
"""A GNSS velocity older than this says nothing about standing."""
SPREAD_RATIO = 4.0
"""Variance in the window over variance learned at rest that still counts as rest."""
FLOOR_GYRO = 7.6e-7
FLOOR_ACCEL = 1e-4
"""Variances that quantisation alone gives a quiet sensor: (0.05 °/s)², (0.01 m/s²)²."""


ANCHOR_SHARE = 0.25
"""Departure from the force kept that counts as motion, over the allowed spread; 3σ of white noise
of the window's mean come on top."""
ANCHOR_QUARTERS = 40.0
"""Quarters over which the force kept follows the mean (bias drift, a tyre that gives way), and for
which GNSS has to see no speed before another force is taken for rest."""


@njit("b1(f8[::1], f8, b1)", cache=True)
def _at_anchor(s: F64, tolerance: float, fresh: bool) -> bool:
    """Whether the window's mean force is the one kept from standing; keeps it up to date."""
    count = STILL_SUB * max(s[STILL_SUM], 1.0)
    mean = np.zeros(3)
    near = True
    for i in range(3):
        variance = 0.0
        for b in range(STILL_SUB):
            mean[i] += s[STILL_RING + 12 * b + 3 + i] / STILL_SUB
            variance += s[STILL_RING + 12 * b + 9 + i] / STILL_SUB
        limit = tolerance + 3.0 * math.sqrt(variance / count)
        near = near and abs(mean[i] - s[STILL_ANCHOR + 1 + i]) <= limit
    state = s[STILL_ANCHOR]
    if state == 0.0 or (state < -ANCHOR_QUARTERS and fresh):
        for i in range(3):
            s[STILL_ANCHOR + 1 + i] = mean[i]
    elif near:
        for i in range(3):
            s[STILL_ANCHOR + 1 + i] += (mean[i] - s[STILL_ANCHOR + 1 + i]) / ANCHOR_QUARTERS
    else:
        s[STILL_ANCHOR] = min(state, 0.0) - 1.0
        return False
    s[STILL_ANCHOR] = 1.0
    return True


@njit("b1(f8[::1], i8, f8)", cache=True, counted=False)
def _moves_vertically(s: F64, n: int, accel: float) -> bool:
    """Whether the filter knows of a climb, or the window's mean force is not gravity's amount."""
    diagonal = n + 1
    if abs(s[VEL_N + 2]) > RISE_MPS + 2.0 * math.sqrt(s[P + (VEL + 2) * diagonal]):
        return True
    square = 0.0
    variance = 0.0
    for i in range(3):
        mean = 0.0
        for b in range(STILL_SUB):
            mean += s[STILL_RING + 12 * b + 3 + i] / STILL_SUB
        square += (mean - s[ACCEL_BIAS_B + i]) ** 2
        variance = max(variance, s[P + (ACCEL_BIAS + i) * diagonal])
    off = math.sqrt(square) - gravity_at(math.sin(s[LAT]) ** 2, s[HEIGHT])
    return abs(off) > accel + 3.0 * math.sqrt(variance)


@njit("i8(f8[::1], i8[::1], i8, i8, f8, f8, f8)", cache=True, counted=False)
def _decide(s: F64, k: I64, n: int, t: int, gyro: float, accel: float, speed: float) -> int:
    if k[STILL_COUNT] < STILL_SUB:
        return 0
    fresh = t - k[T_GNSS_SPEED] < FRESH_NS and k[T_GNSS_SPEED] > 0
    if fresh and s[GNSS_SPEED] > speed + 2.0 * s[GNSS_SPEED_SD]:
        s[STILL_ANCHOR] = 0.0
        return 0
    if _moves_vertically(s, n, accel):
        s[STILL_ANCHOR] = 0.0
        return 0
    learned = s[STILL_LEARNED] > 0.0
    if not learned and not fresh:
        return 0
    for i in range(6):
        low = high = s[STILL_RING + i]
        variance = 0.0
        for b in range(STILL_SUB):
            mean = s[STILL_RING + 12 * b + i]
            low, high = min(low, mean), max(high, mean)
            variance = max(variance, s[STILL_RING + 12 * b + 6 + i])
        if high - low > (gyro if i < 3 else accel):
            s[STILL_ANCHOR] = 0.0
            return 0
        floor = FLOOR_GYRO if i < 3 else FLOOR_ACCEL
        if learned and variance > SPREAD_RATIO * s[STILL_LEARNED + 1 + i] + floor:
            return 0
    if not _at_anchor(s, ANCHOR_SHARE * accel, fresh):
        return 0
    if fresh:
        # A running mean over about ten quarters; GNSS vouches for each of them.
        weight = min(s[STILL_LEARNED] + 1.0, 10.0)
        for i in range(6):
            variance = 0.0
            for b in range(STILL_SUB):
                variance = max(variance, s[STILL_RING + 12 * b + 6 + i])
            s[STILL_LEARNED + 1 + i] += (variance - s[STILL_LEARNED + 1 + i]) / weight
        s[STILL_LEARNED] = weight
    return 1


@njit("void(f8[::1], i8[::1], i8, f8[:], i8, i8, f8, f8, f8)", cache=True, counted=False)
def observe(
    s: F64,
    k: I64,
    n: int,
    sample: F64,
    t: int,
    quarter_ns: int,
    gyro: float,
    accel: float,
    speed: float,
) -> None:
    """Take in one inertial sample (≥ 6,); at the end of a quarter window, decide.

    Sets ``k[STANDING]`` to 1 (standing), 0 (moving) and to 2 + that at the sample which
    closed a quarter, so that the walker applies the updates once a quarter. ``gyro``, ``accel``:
    largest spread of the means; ``speed``: fastest GNSS speed that counts as none; ``n``: states
    of the filter.
    """
    k[STANDING] &= 1
    if t >= (k[STILL_CELL] + 1) * quarter_ns:
        count = s[STILL_SUM]
        if count >= 3.0:
            slot = STILL_RING + 12 * (k[STILL_COUNT] % STILL_SUB)
            for i in range(6):
                mean = s[STILL_SUM + 1 + i] / count
                s[slot + i] = mean
                s[slot + 6 + i] = max(0.0, s[STILL_SUM + 7 + i] / count - mean * mean)
            s[VIBRATION] = (s[slot + 9] + s[slot + 10] + s[slot + 11]) / 3.0
            for i in range(3):
                s[GYRO_VIBRATION + i] = s[slot + 6 + i]
            s[SATURATED] = s[SATURATING]
            s[SATURATING] = 0.0
            k[STILL_COUNT] += 1
            k[STANDING] = 2 + _decide(s, k, n, t, gyro, accel, speed)
        else:
            k[STILL_COUNT] = 0
            k[STANDING] = 0
        k[STILL_CELL] = t // quarter_ns
        for i in range(13):
            s[STILL_SUM + i] = 0.0
    s[STILL_SUM] += 1.0
    for i in range(6):
        x = sample[i]
        s[STILL_SUM + 1 + i] += x
        s[STILL_SUM + 7 + i] += x * x


@njit("void(f8[::1], i8[::1], f8[:, ::1], f8[::1])", cache=True, counted=False)
def zero_velocity(s: F64, lay: I64, H: F64, y: F64) -> None:
    """Fill ``y`` (3,) [m/s] and ``H`` (3, n): v_n = 0."""
    for i in range(3):
        for j in range(lay[L_N]):
            H[i, j] = 0.0
        H[i, VEL + i] = 1.0
        y[i] = -s[VEL_N + i]


@njit("void(f8[::1], i8[::1], i8[::1], f8[:, ::1], f8[:, ::1], f8[::1])", cache=True, counted=False)
def zero_rate(s: F64, k: I64, lay: I64, C: F64, H: F64, y: F64) -> None:
    """The last quarter's mean rate is bias plus Earth rate: ``y`` (3,) [rad/s] and ``H`` (3, n)."""
    slot = STILL_RING + 12 * ((k[STILL_COUNT] - 1) % STILL_SUB)
    north, down = s[EARTH_RATE] * math.cos(s[LAT]), -s[EARTH_RATE] * math.sin(s[LAT])
    for i in range(3):
        for j in range(lay[L_N]):
            H[i, j] = 0.0
        H[i, GYRO_BIAS + i] = 1.0
        y[i] = s[slot + i] - s[GYRO_BIAS_B + i] - (C[0, i] * north + C[2, i] * down)
