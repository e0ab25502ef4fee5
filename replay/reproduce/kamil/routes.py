"""Eight campus routes: what section 5 of the paper says of them, no more being in print.

"Predominantly straight, only left- or right curves, alternating curve directions", 350 to 1700 m in
about 70 to 350 s, some in heavy traffic with frequent stops.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.types import F64
from replay.simulator.plans import STEP_S, roll_without_slip
from replay.simulator.shaping import Plan, Schedule, integral, knots, rate, smooth

REST_S = 12.0
"""Before the first motion, for levelling; and after the last."""
_ACCEL = 1.4
"""Of a car among pedestrians [m/s²], along and across."""
_CORNER_MPS = 4.0
_IMU_AHEAD_M = 1.2
_STOP = "stop"

Leg = tuple[float, float | str]
"""Metres straight on, then a turn in degrees (right positive) or a stop."""


@dataclass(frozen=True, slots=True)
class Route:
    """A drive from rest to rest."""

    name: str
    cruise_mps: float
    legs: tuple[Leg, ...]
    stops_s: tuple[float, ...] = ()
    """How long each stop lasts, the last one at the end of the route not counted."""

    @property
    def turns(self) -> int:
        return sum(end != _STOP for _, end in self.legs)

    @property
    def stops(self) -> int:
        return len(self.stops_s)


def _legs(*legs: Leg) -> tuple[Leg, ...]:
    return (*legs[:-1], (legs[-1][0], _STOP))


ROUTES = (
    Route("straight", 7.0, _legs((190.0, 8.0), (170.0, _STOP))),
    Route("left turns", 6.5, _legs((130.0, -90.0), (120.0, -80.0), (90.0, -95.0), (110.0, _STOP))),
    Route("right turns", 7.0, _legs((180.0, 90.0), (150.0, 85.0), (160.0, 95.0), (120.0, _STOP))),
    Route(
        "alternating",
        7.0,
        _legs((110.0, 90.0), (90.0, -90.0), (120.0, 60.0), (100.0, -120.0), (130.0, 80.0),
              (120.0, _STOP)),
    ),
    Route(
        "alternating, reversed",
        7.0,
        _legs((120.0, -80.0), (130.0, 120.0), (100.0, -60.0), (120.0, 90.0), (90.0, -90.0),
              (110.0, _STOP)),
    ),
    Route(
        "straight, heavy traffic",
        7.0,
        _legs((120.0, _STOP), (160.0, 5.0), (90.0, _STOP), (140.0, _STOP), (170.0, _STOP)),
        (9.0, 14.0, 7.0),
    ),
    Route(
        "both ways, heavy traffic",
        8.0,
        _legs((150.0, 90.0), (120.0, _STOP), (180.0, -90.0), (140.0, -70.0), (110.0, _STOP),
              (160.0, 100.0), (180.0, _STOP), (140.0, _STOP)),
        (12.0, 8.0, 10.0),
    ),
    Route(
        "long round",
        8.0,
        _legs((190.0, -90.0), (160.0, 90.0), (150.0, _STOP), (180.0, -85.0), (170.0, -95.0),
              (140.0, _STOP), (200.0, 90.0), (180.0, -90.0), (150.0, _STOP)),
        (15.0, 12.0),
    ),
)  # fmt: skip


def drive(route: Route) -> tuple[Plan, float]:
    """The plan of a route, and its duration with the rests at both ends [s]."""
    command = Schedule(0.0, 0.0)  # speed, heading
    command.stay(REST_S)
    pauses = iter((*route.stops_s, REST_S))
    for metres, then in route.legs:
        if isinstance(then, str):
            _straight(command, metres, route.cruise_mps, 0.0)
            command.stay(next(pauses))
        else:
            _straight(command, metres, route.cruise_mps, _CORNER_MPS)
            angle = math.radians(then)
            command.stay(1.5)
            command.go(abs(angle) * _CORNER_MPS / _ACCEL, _CORNER_MPS, command.values[1] + angle)
            command.stay(1.5)
    duration = command.now
    t = knots(duration, STEP_S)
    speed, yaw = smooth(command.at(t), 1.5, STEP_S).T
    way = integral(t, speed)
    pitch = 0.02 * np.sin(way / 90.0)
    roll = -0.006 * speed * rate(t, yaw)
    return roll_without_slip(t, speed, yaw, pitch, roll, _IMU_AHEAD_M), duration


def _straight(command: Schedule, metres: float, cruise: float, end: float) -> None:
    """Append ``metres`` straight on, from the present speed by ``cruise`` [m/s] to ``end``."""
    begin, heading = command.values
    peak = min(cruise, math.sqrt(_ACCEL * metres + 0.5 * (begin**2 + end**2)))
    ramps = (2.0 * peak**2 - begin**2 - end**2) / (2.0 * _ACCEL)
    command.go((peak - begin) / _ACCEL, peak, heading)
    command.stay((metres - ramps) / peak)
    command.go((peak - end) / _ACCEL, end, heading)


def length_m(plan: Plan, duration_s: float) -> float:
    """Way over ground [m]."""
    inside = (plan.t >= 0) & (plan.t <= duration_s)
    speed: F64 = np.hypot(plan.vel_n[:, 0], plan.vel_n[:, 1])[inside]
    return float(np.trapezoid(speed, plan.t[inside]))
