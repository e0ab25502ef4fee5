"""The floor: the least that a 15-state filter must compute, with everything else left out.

One jitted loop: strapdown and covariance at every sample, position and velocity at every fix. No
gate, report, output row beyond a thinned trace, delay ring, alignment or detector. What an engine
costs above this is the price of those; what it is worse by is a fault.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from companion.config import DEG, Config
from companion.navigation.earth import RATE, gravity, radii
from companion.navigation.rotation import quat_to_matrix, rotate_body, rotate_nav
from companion.types import F64, I64, NS, Solution, VehicleRecording
from replay.bench.flight import inertial_rows

_Q, _LAT, _VEL, _BA, _BG = 0, 4, 7, 10, 13
"""Nominal state (16,): quaternion, lat/lon/height, velocity, accelerometer bias, gyro bias."""


@dataclass(frozen=True, slots=True)
class FloorInput:
    """Arrays for the loop, made beforehand: only the loop is timed."""

    t_ns: I64
    dt_s: F64
    imu: F64
    """(N, 6) of :func:`~replay.bench.flight.inertial_rows`."""
    fix_at: I64
    """(M,) index of the sample at which each fix is valid."""
    fixes: F64
    """(M, 12) lat, lon, height, velocity, six variances."""
    psd: F64
    """(4,) accelerometer and gyro noise, and the walks of their biases."""
    state: F64
    P: F64
    every: int
    """Samples between two rows of the trace."""


def prepare(vehicle: VehicleRecording, config: Config, start: Solution, at: int) -> FloorInput:
    """Input that begins with row ``at`` of an aligned solution of the same recording."""
    imu, gnss = vehicle.imu[0], vehicle.gnss[0]
    first = int(np.searchsorted(imu.t_ns, start.t_ns[at], side="right"))
    t = imu.t_ns[first:]
    place = np.searchsorted(t, gnss.t_ns)
    used = (gnss.t_ns > start.t_ns[at]) & (place < len(t)) & (gnss.fix_type >= 3)
    floor_sd = np.array([config.gnss.sd_position_m] * 2 + [config.gnss.sd_height_m])
    floor_sd_vel = np.array([config.gnss.sd_velocity_mps] * 2 + [config.gnss.sd_velocity_down_mps])
    fixes = np.column_stack(
        [
            gnss.lat,
            gnss.lon,
            gnss.height,
            gnss.vel_n,
            np.fmax(gnss.sd_pos, floor_sd) ** 2,
            np.fmax(gnss.sd_vel, floor_sd_vel) ** 2,
        ]
    )
    state = np.concatenate(
        [
            start.q_nb[at],
            [start.lat[at], start.lon[at], start.height[at]],
            start.vel_n[at],
            start.accel_bias_b[at],
            start.gyro_bias_b[at],
        ]
    )
    i = config.imu
    return FloorInput(
        t,
        np.diff(imu.t_ns[first - 1 :]) / NS,
        inertial_rows(imu)[first:],
        place[used],
        np.ascontiguousarray(fixes[used]),
        np.array(
            [
                i.accel_noise_mps2_rthz,
                i.gyro_noise_dps_rthz * DEG,
                i.accel_bias_walk_mps2_rts,
                i.gyro_bias_walk_dps_rts * DEG,
            ]
        )
        ** 2,
        state,
        np.diag(start.cov[at][:, [0, 3, 5]].ravel()),
        4,
    )


def run(given: FloorInput) -> Solution:
    """The trace of one pass; only position and velocity are filled in with meaning."""
    rows = np.zeros((len(given.t_ns) // given.every, 16))
    _loop(
        given.state.copy(), given.P.copy(), given.dt_s, given.imu, given.fix_at, given.fixes,
        given.psd, given.every, rows,
    )  # fmt: skip
    n = len(rows)
    t = given.t_ns[given.every - 1 :: given.every][:n]
    zero = np.zeros(n, np.int64)
    return Solution(
        t, rows[:, _LAT], rows[:, _LAT + 1], rows[:, _LAT + 2], rows[:, _VEL : _VEL + 3],
        rows[:, _Q:_LAT], rows[:, _BA:_BG], rows[:, _BG:], np.zeros((n, 5, 6)), zero, zero,
    )  # fmt: skip


# No signatures: compiled at its first call, since only this benchmark needs it (ADR 0004 is about
# what a vehicle runs).
@njit(cache=True)
def _strapdown(s: F64, row: F64, dt: float, C: F64, f_n: F64) -> None:
    """Move the nominal state on by one sample; ``f_n`` (3,) [m/s²] is the force it used."""
    quat_to_matrix(s, C)
    fx, fy, fz = row[3] - s[_BA], row[4] - s[_BA + 1], row[5] - s[_BA + 2]
    for i in range(3):
        f_n[i] = C[i, 0] * fx + C[i, 1] * fy + C[i, 2] * fz
    lat, height = s[_LAT], s[_LAT + 2]
    m, n = radii(lat)
    m += height
    n += height
    cos_lat, sin_lat = math.cos(lat), math.sin(lat)
    vn, ve, vd = s[_VEL], s[_VEL + 1], s[_VEL + 2]
    enx, eny, enz = ve / n, -vn / m, -ve / n * sin_lat / cos_lat
    iex, iez = RATE * cos_lat, -RATE * sin_lat
    cx, cy, cz = 2.0 * iex + enx, eny, 2.0 * iez + enz
    s[_VEL] += (f_n[0] - cy * vd + cz * ve) * dt
    s[_VEL + 1] += (f_n[1] - cz * vn + cx * vd) * dt
    s[_VEL + 2] += (f_n[2] + gravity(lat, height) - cx * ve + cy * vn) * dt
    s[_LAT] += 0.5 * (vn + s[_VEL]) / m * dt
    s[_LAT + 1] += 0.5 * (ve + s[_VEL + 1]) / (n * cos_lat) * dt
    s[_LAT + 2] -= 0.5 * (vd + s[_VEL + 2]) * dt
    rotate_body(s, (row[0] - s[_BG]) * dt, (row[1] - s[_BG + 1]) * dt, (row[2] - s[_BG + 2]) * dt)
    rotate_nav(s, -(iex + enx) * dt, -eny * dt, -(iez + enz) * dt)


@njit(cache=True)
def _covariance(P: F64, C: F64, f_n: F64, psd: F64, dt: float) -> None:
    """P ← Φ P Φᵀ + Q in place, Φ = I + F dt without its zeros; rows, then columns.

    Rows in the order p, v, φ: each needs only rows that are still the old ones.
    """
    a, b, c = f_n[0] * dt, f_n[1] * dt, f_n[2] * dt
    for j in range(15):
        P[0, j] += dt * P[3, j]
        P[1, j] += dt * P[4, j]
        P[2, j] += dt * P[5, j]
        x, y, z = P[6, j], P[7, j], P[8, j]
        u, v, w = P[9, j] * dt, P[10, j] * dt, P[11, j] * dt
        P[3, j] += c * y - b * z - (C[0, 0] * u + C[0, 1] * v + C[0, 2] * w)
        P[4, j] += a * z - c * x - (C[1, 0] * u + C[1, 1] * v + C[1, 2] * w)
        P[5, j] += b * x - a * y - (C[2, 0] * u + C[2, 1] * v + C[2, 2] * w)
        u, v, w = P[12, j] * dt, P[13, j] * dt, P[14, j] * dt
        P[6, j] -= C[0, 0] * u + C[0, 1] * v + C[0, 2] * w
        P[7, j] -= C[1, 0] * u + C[1, 1] * v + C[1, 2] * w
        P[8, j] -= C[2, 0] * u + C[2, 1] * v + C[2, 2] * w
    for j in range(15):
        r = P[j]
        r[0] += dt * r[3]
        r[1] += dt * r[4]
        r[2] += dt * r[5]
        x, y, z = r[6], r[7], r[8]
        u, v, w = r[9] * dt, r[10] * dt, r[11] * dt
        r[3] += c * y - b * z - (C[0, 0] * u + C[0, 1] * v + C[0, 2] * w)
        r[4] += a * z - c * x - (C[1, 0] * u + C[1, 1] * v + C[1, 2] * w)
        r[5] += b * x - a * y - (C[2, 0] * u + C[2, 1] * v + C[2, 2] * w)
        u, v, w = r[12] * dt, r[13] * dt, r[14] * dt
        r[6] -= C[0, 0] * u + C[0, 1] * v + C[0, 2] * w
        r[7] -= C[1, 0] * u + C[1, 1] * v + C[1, 2] * w
        r[8] -= C[2, 0] * u + C[2, 1] * v + C[2, 2] * w
    for i in range(3):
        P[3 + i, 3 + i] += psd[0] * dt
        P[6 + i, 6 + i] += psd[1] * dt
        P[9 + i, 9 + i] += psd[2] * dt
        P[12 + i, 12 + i] += psd[3] * dt


@njit(cache=True)
def _fix(s: F64, P: F64, fix: F64, dx: F64) -> None:
    """Position and velocity of one fix as six scalar updates, then feedback."""
    m, n = radii(s[_LAT])
    m += s[_LAT + 2]
    n = (n + s[_LAT + 2]) * math.cos(s[_LAT])
    dx[:] = 0.0
    for i in range(6):
        if i == 0:
            y = (fix[0] - s[_LAT]) * m
        elif i == 1:
            y = (fix[1] - s[_LAT + 1]) * n
        elif i == 2:
            y = s[_LAT + 2] - fix[2]
        else:
            y = fix[i] - s[_VEL + i - 3]
        y = (y - dx[i]) / (P[i, i] + fix[6 + i])
        w = 1.0 / (P[i, i] + fix[6 + i])
        k = P[i].copy()
        for a in range(15):
            dx[a] += k[a] * y
            for b in range(15):
                P[a, b] -= k[a] * k[b] * w
    s[_LAT] += dx[0] / m
    s[_LAT + 1] += dx[1] / n
    s[_LAT + 2] -= dx[2]
    rotate_nav(s, dx[6], dx[7], dx[8])
    for i in range(3):
        s[_VEL + i] += dx[3 + i]
        s[_BA + i] += dx[9 + i]
        s[_BG + i] += dx[12 + i]


@njit(cache=True)
def _loop(
    s: F64, P: F64, dt: F64, imu: F64, fix_at: I64, fixes: F64, psd: F64, every: int, rows: F64
) -> None:
    C, f_n, dx = np.empty((3, 3)), np.empty(3), np.empty(15)
    m = 0
    for i in range(imu.shape[0]):
        _strapdown(s, imu[i], dt[i], C, f_n)
        _covariance(P, C, f_n, psd, dt[i])
        if m < fix_at.shape[0] and fix_at[m] == i:
            _fix(s, P, fixes[m], dx)
            m += 1
        if (i + 1) % every == 0:
            rows[(i + 1) // every - 1] = s
