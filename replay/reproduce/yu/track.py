"""The one-minute track of Table I, and what three IMUs and a receiver say of it.

Level, northward, then a quarter turn to the left (a_n = −5π/4 m/s² at 5 m/s). Steps of acceleration
are steps here, as in the table. Body axes are forward, right, down: the paper's x is our y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.config import DEG
from companion.navigation import earth
from companion.types import F64

RATE_HZ = 100
SECONDS = 60
STEPS = (
    (0.0, 2.0, 0.0),
    (10.0, 0.0, 0.0),
    (50.0, -3.0, 0.0),
    (55.0, 0.0, -math.pi / 4),
    (57.0, 0.0, 0.0),
)
"""Start of an interval [s], tangential acceleration [m/s²], turn rate [rad/s]."""
PLACE = (45.77 * DEG, 126.68 * DEG, 150.0)
"""Harbin, where the authors are: they print no place."""
LEVERS_B = ((0.0, 0.0, 0.0), (0.0, -0.5, 0.0), (0.0, 0.5, 0.0))

GYRO_NOISE = 4.5 / 60.0 * DEG
"""4.5 °/√h [rad/√s]."""
GYRO_BIAS = 10.0 / 3600.0 * DEG
ACCEL_NOISE = 1.0 / 60.0
"""1 m/s/√h [m/s/√s]."""
ACCEL_BIAS = 1e-4 * earth.gravity(PLACE[0], PLACE[2])
SCALE = 1e-3
"""1σ of every scale factor: the paper estimates them and does not say how large they are."""
GPS_WHITE = (2.5, 2.5, 4.0)
GPS_SLOW = (2.0, 2.0, 3.5)
GPS_SLOW_TAU_S = 300.0
"""Pseudorange positions of a single-band receiver: NED, 1σ [m]; what the air left is slow."""


@dataclass(frozen=True)
class Track:
    """Truth at every IMU epoch, NED and body FRD."""

    t: F64
    position_n: F64
    """(N, 3) metres from :data:`PLACE`."""
    vel_n: F64
    acc_n: F64
    """Just after a step, where there is one."""
    yaw: F64
    rate: F64
    """(N,) turn rate [rad/s]."""


def table_one() -> Track:
    """Table I in closed form: straight stretches, and one arc."""
    t = np.arange(1, SECONDS * RATE_HZ + 1) / RATE_HZ
    out = {name: np.zeros((len(t), 3)) for name in ("position_n", "vel_n", "acc_n")}
    yaw, rate = np.zeros(len(t)), np.zeros(len(t))
    place, speed, heading = np.zeros(2), 0.0, 0.0
    ends = [step[0] for step in STEPS[1:]] + [float(SECONDS) + 1.0]
    for (start, along, turning), end in zip(STEPS, ends, strict=True):
        inside = (t >= start - 1e-9) & (t < end - 1e-9)
        for tau, rows in ((t[inside] - start, inside), (np.array([end - start]), None)):
            v, psi = speed + along * tau, heading + turning * tau
            if turning:
                radius = speed / turning
                north = radius * (np.sin(psi) - math.sin(heading))
                east = radius * (math.cos(heading) - np.cos(psi))
            else:
                way = speed * tau + 0.5 * along * tau * tau
                north, east = way * math.cos(heading), way * math.sin(heading)
            if rows is None:
                place = place + np.array([north[0], east[0]])
                speed, heading = float(v[0]), float(psi[0])
                continue
            c, s = np.cos(psi), np.sin(psi)
            out["position_n"][rows, :2] = place + np.stack([north, east], axis=1)
            out["vel_n"][rows, :2] = np.stack([v * c, v * s], axis=1)
            across = v * turning
            out["acc_n"][rows, :2] = np.stack([along * c - across * s, along * s + across * c], 1)
            yaw[rows], rate[rows] = psi, turning
    return Track(t, yaw=yaw, rate=rate, **out)


@dataclass(frozen=True)
class Sensors:
    """What is measured along the track in one run."""

    imu: F64
    """(3, N, 7) rate, specific force, 0: as the filter takes them."""
    fixes: F64
    """(60, 3) antenna position, NED metres from :data:`PLACE`; at full seconds."""
    first_fix: F64
    """(3,) the fix at the start, at rest."""


def measure(track: Track, rng: np.random.Generator) -> Sensors:
    """Simulated outputs, independent of the filter's own equations but for the centripetal term."""
    lat, _, height = PLACE
    count = len(track.t)
    c, s = np.cos(track.yaw), np.sin(track.yaw)
    spin, gravity = earth.earth_rate_n(lat), earth.gravity(lat, height)
    moving = np.array([earth.transport_rate_n(lat, height, v) for v in track.vel_n])
    force_n = track.acc_n + np.cross(2.0 * spin + moving, track.vel_n) - [0.0, 0.0, gravity]

    def body(v: F64) -> F64:
        return np.stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]], axis=1)

    rate = body(spin + moving) + track.rate[:, None] * [0.0, 0.0, 1.0]
    force = body(force_n)
    imu = np.zeros((3, count, 7))
    for unit, lever in enumerate(np.array(LEVERS_B)):
        centripetal = np.cross(rate, np.cross(rate, lever))
        gyro_scale, accel_scale = 1.0 + SCALE * rng.standard_normal((2, 3))
        imu[unit, :, :3] = gyro_scale * rate + GYRO_BIAS * rng.standard_normal(3)
        imu[unit, :, 3:6] = accel_scale * force + centripetal + ACCEL_BIAS * rng.standard_normal(3)
        white = rng.standard_normal((count, 6)) * np.sqrt(RATE_HZ)
        imu[unit, :, :3] += GYRO_NOISE * white[:, :3]
        imu[unit, :, 3:6] += ACCEL_NOISE * white[:, 3:]
    at = np.arange(RATE_HZ - 1, count, RATE_HZ)
    fade = math.exp(-1.0 / GPS_SLOW_TAU_S)
    slow = rng.standard_normal(3) * GPS_SLOW
    first = slow + rng.standard_normal(3) * GPS_WHITE
    fixes = np.empty((len(at), 3))
    for i, row in enumerate(at):
        slow = fade * slow + math.sqrt(1.0 - fade * fade) * rng.standard_normal(3) * GPS_SLOW
        fixes[i] = track.position_n[row] + slow + rng.standard_normal(3) * GPS_WHITE
    return Sensors(imu, fixes, first)
