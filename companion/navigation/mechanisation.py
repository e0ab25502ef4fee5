"""Strapdown mechanisation in NED with full Earth and transport rate.

    C_nb' = C_nb [ω_ib×] − [ω_in×] C_nb
    v'    = C_nb f_b − (2 ω_ie + ω_en) × v + g(φ, h)
    φ'    = v_N / (M + h),   λ' = v_E / ((N + h) cos φ),   h' = −v_D

Groves 2013, sections 5.4-5.5; coning and sculling after Savage 1998, two samples. One step is a
jitted function of scalars on the flat state vector: the same for a block of a million samples and
for a live one. The equations hold with time reversed once rates, gyro bias, velocity and Earth
rate change sign (specific force and gravity stay): a backward filter walks the same kernel.
"""

from __future__ import annotations

import math

from companion._jit import njit
from companion.navigation.earth import E2, A, gravity_at
from companion.navigation.layout import (
    ACCEL_BIAS_B,
    ACCEL_SCALE_B,
    EARTH_RATE,
    GYRO_BIAS_B,
    GYRO_SCALE_B,
    HEIGHT,
    LAT,
    LON,
    SUM_C,
    SUM_CF,
    SUM_CW,
    SUM_P,
    SUM_T,
    SUM_V,
    VEL_N,
)
from companion.navigation.rotation import quat_to_matrix, rotate_body, rotate_nav
from companion.types import F64


@njit("void(f8[::1], f8[::1], f8[::1], f8, b1, b1, f8[:, ::1])", cache=True, counted=False)
def advance(s: F64, first: F64, last: F64, dt: float, integral: bool, scale: bool, C: F64) -> None:
    """Move the nominal state in ``s`` on by one inertial interval and add to the interval sums.

    ``first``, ``last`` (6,): rate [rad/s] and specific force [m/s²] at the two ends of the
    interval of ``dt`` [s]; ``integral``: ``last`` is the mean over the interval and ``first`` the
    mean over the one before it. ``scale``: also sum what scale-factor states need. ``C`` (3, 3) is
    scratch; on return it holds C_nb at the end.

    Increments: linear rate between samples gives Δθ = ½(ω₀ + ω₁) dt, and in both cases the coning
    term is ω₀ × ω₁ dt²/12 and the sculling term (ω₀ × f₁ + f₀ × ω₁) dt²/12.
    """
    # Bias and scale off: the filter's best knowledge of the sensor.
    w0x = first[0] - s[GYRO_BIAS_B] - s[GYRO_SCALE_B] * first[0]
    w0y = first[1] - s[GYRO_BIAS_B + 1] - s[GYRO_SCALE_B + 1] * first[1]
    w0z = first[2] - s[GYRO_BIAS_B + 2] - s[GYRO_SCALE_B + 2] * first[2]
    w1x = last[0] - s[GYRO_BIAS_B] - s[GYRO_SCALE_B] * last[0]
    w1y = last[1] - s[GYRO_BIAS_B + 1] - s[GYRO_SCALE_B + 1] * last[1]
    w1z = last[2] - s[GYRO_BIAS_B + 2] - s[GYRO_SCALE_B + 2] * last[2]
    f0x = first[3] - s[ACCEL_BIAS_B] - s[ACCEL_SCALE_B] * first[3]
    f0y = first[4] - s[ACCEL_BIAS_B + 1] - s[ACCEL_SCALE_B + 1] * first[4]
    f0z = first[5] - s[ACCEL_BIAS_B + 2] - s[ACCEL_SCALE_B + 2] * first[5]
    f1x = last[3] - s[ACCEL_BIAS_B] - s[ACCEL_SCALE_B] * last[3]
    f1y = last[4] - s[ACCEL_BIAS_B + 1] - s[ACCEL_SCALE_B + 1] * last[4]
    f1z = last[5] - s[ACCEL_BIAS_B + 2] - s[ACCEL_SCALE_B + 2] * last[5]
    if integral:
        wx, wy, wz = w1x * dt, w1y * dt, w1z * dt
        ax, ay, az = f1x * dt, f1y * dt, f1z * dt
    else:
        h = 0.5 * dt
        wx, wy, wz = (w0x + w1x) * h, (w0y + w1y) * h, (w0z + w1z) * h
        ax, ay, az = (f0x + f1x) * h, (f0y + f1y) * h, (f0z + f1z) * h
    k = dt * dt / 12.0
    # velocity increment in body axes of the interval's start: Δv + ½Δθ×Δv + Δθ×(Δθ×Δv)/6 + sculling
    rx = wy * az - wz * ay
    ry = wz * ax - wx * az
    rz = wx * ay - wy * ax
    bx = ax + 0.5 * rx + (wy * rz - wz * ry) / 6.0
    by = ay + 0.5 * ry + (wz * rx - wx * rz) / 6.0
    bz = az + 0.5 * rz + (wx * ry - wy * rx) / 6.0
    bx += k * (w0y * f1z - w0z * f1y + f0y * w1z - f0z * w1y)
    by += k * (w0z * f1x - w0x * f1z + f0z * w1x - f0x * w1z)
    bz += k * (w0x * f1y - w0y * f1x + f0x * w1y - f0y * w1x)
    # rotation increment with coning
    tx = wx + k * (w0y * w1z - w0z * w1y)
    ty = wy + k * (w0z * w1x - w0x * w1z)
    tz = wz + k * (w0x * w1y - w0y * w1x)

    quat_to_matrix(s, C)
    ux = C[0, 0] * bx + C[0, 1] * by + C[0, 2] * bz
    uy = C[1, 0] * bx + C[1, 1] * by + C[1, 2] * bz
    uz = C[2, 0] * bx + C[2, 1] * by + C[2, 2] * bz

    lat, height = s[LAT], s[HEIGHT]
    vn, ve, vd = s[VEL_N], s[VEL_N + 1], s[VEL_N + 2]
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    # Divisions are what a step waits for: one over each radius, used everywhere.
    w2 = 1.0 - E2 * sin_lat * sin_lat
    n = A / math.sqrt(w2)
    m = 1.0 / (n * (1.0 - E2) / w2 + height)
    n = 1.0 / (n + height)
    # Latitude at mid-interval: rates taken at its start cost 0.1 m in half an hour at 200 m/s.
    to_mid = 0.5 * vn * dt * m
    sin_lat, cos_lat = sin_lat + to_mid * cos_lat, cos_lat - to_mid * sin_lat
    tan_lat = sin_lat / cos_lat
    iex, iez = s[EARTH_RATE] * cos_lat, -s[EARTH_RATE] * sin_lat
    g = gravity_at(sin_lat * sin_lat, height - 0.5 * vd * dt)

    # Velocity at mid-interval for Coriolis and transport: makes the step symmetric in time.
    enx, eny, enz = ve * n, -vn * m, -ve * n * tan_lat
    cx, cy, cz = 2.0 * iex + enx, eny, 2.0 * iez + enz
    mn = vn + 0.5 * (ux - (cy * vd - cz * ve) * dt)
    me = ve + 0.5 * (uy - (cz * vn - cx * vd) * dt)
    md = vd + 0.5 * (uz + (g - (cx * ve - cy * vn)) * dt)
    enx, eny, enz = me * n, -mn * m, -me * n * tan_lat
    cx, cy, cz = 2.0 * iex + enx, eny, 2.0 * iez + enz
    inx, iny, inz = iex + enx, eny, iez + enz
    # specific force seen from n as it turns by ω_in dt/2
    h = 0.5 * dt
    fx = ux - h * (iny * uz - inz * uy)
    fy = uy - h * (inz * ux - inx * uz)
    fz = uz - h * (inx * uy - iny * ux)
    vn1 = vn + fx - (cy * md - cz * me) * dt
    ve1 = ve + fy - (cz * mn - cx * md) * dt
    vd1 = vd + fz + (g - (cx * me - cy * mn)) * dt

    # Position by the mean velocity, with the radii and cosine at mid-interval: there the height is
    # `up` more, and 1/(r + up) = (1 − up/r)/r to 1e-13 for a step of 2 m.
    mn, me, md = 0.5 * (vn + vn1), 0.5 * (ve + ve1), 0.5 * (vd + vd1)
    up = -md * h
    s[LAT] = lat + mn * dt * m * (1.0 - up * m)
    s[LON] += me * dt * n * (1.0 - up * n) / cos_lat
    s[HEIGHT] = height - md * dt
    s[VEL_N], s[VEL_N + 1], s[VEL_N + 2] = vn1, ve1, vd1

    rotate_body(s, tx, ty, tz)
    rotate_nav(s, -inx * dt, -iny * dt, -inz * dt)

    # Sums for the covariance interval, about the middle of this step where that is free.
    s[SUM_P] += (s[SUM_V] + 0.5 * fx) * dt
    s[SUM_P + 1] += (s[SUM_V + 1] + 0.5 * fy) * dt
    s[SUM_P + 2] += (s[SUM_V + 2] + 0.5 * fz) * dt
    s[SUM_V] += fx
    s[SUM_V + 1] += fy
    s[SUM_V + 2] += fz
    s[SUM_T] += dt
    part = 0.0 if integral else 0.5 * dt
    rest = dt - part
    for i in range(3):
        c0, c1, c2 = C[i, 0], C[i, 1], C[i, 2]
        s[SUM_C + 3 * i] += c0 * dt
        s[SUM_C + 3 * i + 1] += c1 * dt
        s[SUM_C + 3 * i + 2] += c2 * dt
        if scale:
            # A scale factor multiplies what was measured, biases included.
            s[SUM_CF + 3 * i] += c0 * (part * first[3] + rest * last[3])
            s[SUM_CF + 3 * i + 1] += c1 * (part * first[4] + rest * last[4])
            s[SUM_CF + 3 * i + 2] += c2 * (part * first[5] + rest * last[5])
            s[SUM_CW + 3 * i] += c0 * (part * first[0] + rest * last[0])
            s[SUM_CW + 3 * i + 1] += c1 * (part * first[1] + rest * last[1])
            s[SUM_CW + 3 * i + 2] += c2 * (part * first[2] + rest * last[2])
