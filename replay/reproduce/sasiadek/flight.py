"""Two and a half hours in the air: a racetrack over a test range, an INS that drifts, GPS.

The paper does not print its flight. Ours turns every twenty minutes; its INS errs as a free one
does, horizontally by Schuler's pendulum, vertically held by a barometer to tens of metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.gnss.geometry import ned_axes
from companion.navigation.earth import ecef
from companion.types import F64, I64, NS
from replay.simulator.constellation import Sky, observe

HOURS = 2.5
EVERY_S = 1.0
SPEED_MPS = 90.0
LEG_S, TURN_S = 1_080.0, 120.0
LAT, LON, HEIGHT_M = math.radians(45.3), math.radians(-75.7), 3_000.0
WHITE_M, MULTIPATH_M = 1.5, 1.0
SD_RANGE_M = math.hypot(WHITE_M, MULTIPATH_M)
"""Of a range at the zenith, 1σ."""
EARTH_M, GRAVITY = 6.371e6, 9.81


@dataclass(frozen=True, slots=True)
class Flight:
    """Truth, what the INS says, and what the receiver measured."""

    seconds: F64
    truth: F64
    """(N, 3) latitude, longitude [rad], height [m]."""
    ins: F64
    """(N, 3) the same as the INS has it."""
    velocity_error: F64
    """(N, 3) truth − INS, east, north, up [m/s]."""
    sky: Sky


def fly(seed: int) -> Flight:
    """A flight with its errors."""
    rng = np.random.default_rng(seed)
    n = int(HOURS * 3_600 / EVERY_S)
    t: F64 = np.arange(n, dtype=np.float64) * EVERY_S
    velocity = _velocity(t)
    offset = np.cumsum(velocity, axis=0) * EVERY_S
    truth = _placed(offset)
    error, rate = _drift(rng, n)
    axes = np.empty((3, 3))
    ned_axes(LAT, LON, axes)
    east_north_up = np.stack([axes[1], axes[0], -axes[2]])
    state = np.concatenate([ecef(*truth.T), velocity @ east_north_up], axis=1)
    # The axes of the start serve for the velocity: 30 km are half a degree, whose 0.7 m/s the
    # range rates would see, but this filter takes none.
    t_ns: I64 = (t * NS).astype(np.int64)
    sky = observe(t_ns, state, rng, systems=(0,), mask_deg=5.0, sd_range_m=WHITE_M,
                  multipath_m=MULTIPATH_M, clock_m=(2_000.0, 30.0))  # fmt: skip
    return Flight(t, truth, _placed(offset - error), rate, sky)


def _velocity(t: F64) -> F64:
    """(N, 3) east, north, up [m/s]: straight legs with half circles between them."""
    phase = t % (LEG_S + TURN_S)
    turns = np.floor(t / (LEG_S + TURN_S))
    heading = math.pi * (turns + np.clip((phase - LEG_S) / TURN_S, 0.0, 1.0)) + 0.6
    climb = 2.0 * np.sin(2 * math.pi * t / 3_000.0)
    return np.stack([SPEED_MPS * np.sin(heading), SPEED_MPS * np.cos(heading), climb], axis=1)


def _placed(offset: F64) -> F64:
    """Latitude, longitude, height of ENU offsets on a sphere's tangent; truth and INS alike."""
    lat = LAT + offset[:, 1] / EARTH_M
    lon = LON + offset[:, 0] / (EARTH_M * math.cos(LAT))
    return np.stack([lat, lon, HEIGHT_M + offset[:, 2]], axis=1)


def _drift(rng: np.random.Generator, n: int) -> tuple[F64, F64]:
    """Error of the INS (N, 3) [m] and its rate [m/s], ENU, truth − INS.

    Horizontally e'' = −(g/R) e + b t + n: gyro drift tilts the platform, noise does the rest.
    """
    error, rate = np.zeros((n, 3)), np.zeros((n, 3))
    place, speed = rng.normal(0, 200.0, 2), rng.normal(0, 1.0, 2)
    tilt = rng.normal(0, 5e-5, 2) * GRAVITY
    ramp = rng.normal(0, math.radians(0.02) / 3_600, 2) * GRAVITY
    height, climb = 20.0, 0.0
    for i in range(n):
        error[i], rate[i] = (*place, height), (*speed, climb)
        accel = -GRAVITY / EARTH_M * place + tilt + ramp * i * EVERY_S
        accel = accel + rng.normal(0, 3e-3, 2) / math.sqrt(EVERY_S)
        place = place + speed * EVERY_S + 0.5 * accel * EVERY_S**2
        speed = speed + accel * EVERY_S
        # A second-order loop of 60 s around a barometer that wanders.
        climb += EVERY_S * (-0.02 * climb - 1e-4 * height) + rng.normal(0, 0.01)
        height += EVERY_S * climb
    return error, rate
