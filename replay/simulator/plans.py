"""What the vehicles do: one function a kind, each a seeded :class:`Plan` of any duration.

Distances and speeds are those of real ones: a car in town, a light quadrotor, a small fixed wing.
Gravity here only shapes the attitude (how far a body banks); the exact Earth comes afterwards, in
:mod:`replay.simulator.trajectory`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.types import F64
from replay.simulator.shaping import Plan, Schedule, integral, knots, rate, smooth

STEP_S = 0.05
G = 9.81
DRAG_PER_S = 0.1
"""Linear drag of a multirotor: deceleration per speed [1/s]; 10 m/s of cruise cost 6° of tilt."""
CAR_IMU_AHEAD_M = 1.2
"""The car's IMU sits this far ahead of the rear axle, on its centre line [m]."""

PlanFunction = Callable[[float, float, float, np.random.Generator], Plan]
"""(duration_s, rest_s, heading [rad], rng) → plan."""


def static(duration_s: float, _rest_s: float, heading: float, rng: np.random.Generator) -> Plan:
    """At rest throughout, tilted by a degree or two as on real ground."""
    t = knots(duration_s, STEP_S)
    roll, pitch = rng.uniform(-0.03, 0.03, 2)
    return Plan(t, np.zeros((len(t), 3)), np.tile([roll, pitch, heading], (len(t), 1)))


def _multirotor_attitude(t: F64, vel_n: F64, yaw: F64) -> F64:
    """Roll, pitch, yaw (K, 3) that point the rotor thrust where acceleration and drag ask for it.

    thrust_n = dv/dt + drag · v − g;  the body's −z axis lies along it.
    """
    thrust = rate(t, vel_n) + DRAG_PER_S * vel_n
    thrust[:, 2] -= G
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = c * thrust[:, 0] + s * thrust[:, 1]
    right = -s * thrust[:, 0] + c * thrust[:, 1]
    roll = np.arcsin(right / np.linalg.norm(thrust, axis=1))
    pitch = np.arctan2(-ahead, -thrust[:, 2])
    return np.stack([roll, pitch, yaw], axis=-1)


def hover(duration_s: float, rest_s: float, heading: float, rng: np.random.Generator) -> Plan:
    """Take off to 15 m, then hold position within a metre as wind allows; heading wanders."""
    t = knots(duration_s, STEP_S)
    climb = Schedule(0.0)
    climb.stay(rest_s)
    climb.go(1.5, -2.5)
    climb.stay(4.5)
    climb.go(1.5, 0.0)
    airborne = smooth(np.interp(t, [climb.now, climb.now + 4.0], [0.0, 1.0]), 2.0, STEP_S)
    # White noise through a 10 s kernel, brought to unit variance: bounded, however long the flight.
    wander = smooth(rng.normal(size=(len(t), 4)), 10.0, STEP_S)
    wander *= airborne[:, None] / np.std(wander, axis=0)
    vel_n = rate(t, wander[:, :3] * [0.4, 0.4, 0.2])
    vel_n[:, 2] += smooth(climb.at(t)[:, 0], 1.5, STEP_S)
    return Plan(t, vel_n, _multirotor_attitude(t, vel_n, heading + 0.1 * wander[:, 3]))


def _fly(plan: Schedule, leg: F64, speed: float, accel: float) -> None:
    """Append a straight leg (3,) [m, NED] from hover to hover to channels (v_n, v_e, v_d, yaw)."""
    length = float(np.linalg.norm(leg))
    peak = min(speed, math.sqrt(length * accel))
    way = leg / length * peak
    yaw = plan.values[3]
    plan.go(peak / accel, way[0], way[1], way[2], yaw)
    plan.stay(length / peak - peak / accel)
    plan.go(peak / accel, 0.0, 0.0, 0.0, yaw)


def _leg_s(leg: F64, speed: float, accel: float) -> float:
    length = float(np.linalg.norm(leg))
    peak = min(speed, math.sqrt(length * accel))
    return length / peak + peak / accel


class Pace(NamedTuple):
    """How hard a multirotor is flown between its waypoints."""

    speed: tuple[float, float]
    """Slowest and fastest leg [m/s]."""
    accel: tuple[float, float]
    """Of setting off and stopping [m/s²]; 8 m/s² is a bank of 39°."""
    turn_dps: float
    """Of the nose."""
    smoothing_s: float
    """Width of the kernel over the commands: how soon an acceleration is reached."""


_MISSION = Pace((5.0, 11.0), (1.5, 3.0), 45.0, 1.5)
_SPORT = Pace((12.0, 20.0), (6.0, 9.0), 200.0, 0.6)


def multirotor_mission(
    duration_s: float, rest_s: float, heading: float, rng: np.random.Generator
) -> Plan:
    """Waypoints within 80 m of home and 15-45 m up, with climbs, pauses and turns of the nose.

    The nose turns to the next waypoint in hover, or stays where it is (one leg in three, flown
    sideways). The last leg leads home, where the vehicle lands and rests. A leg is flown only if
    there is time to come home after it: a duration too short for that stays on the ground.
    """
    return _between_waypoints(duration_s, rest_s, heading, rng, _MISSION)


def multirotor_sport(
    duration_s: float, rest_s: float, heading: float, rng: np.random.Generator
) -> Plan:
    """The same as hard as a light quadrotor can: 20 m/s, banks of 40°, 200 °/s of the nose."""
    return _between_waypoints(duration_s, rest_s, heading, rng, _SPORT)


def _between_waypoints(
    duration_s: float, rest_s: float, heading: float, rng: np.random.Generator, pace: Pace
) -> Plan:
    t = knots(duration_s, STEP_S)
    plan = Schedule(0.0, 0.0, 0.0, heading)
    plan.stay(rest_s)
    at = np.zeros(3)
    target = np.array([0.0, 0.0, -20.0])
    speed, accel, turn = 3.0, 1.5, 0.0
    while True:
        # Pauses and slowing down on the way take at most 10 s beside the leg home and the descent.
        homeward = 10.0 + _leg_s(np.append(target[:2], 0.1), 8.0, 2.0) - target[2] / 2.0
        turn_s = abs(turn) / math.radians(pace.turn_dps)
        if plan.now + turn_s + _leg_s(target - at, speed, accel) + homeward > duration_s:
            break
        yaw = plan.values[3] + turn
        plan.go(turn_s, 0.0, 0.0, 0.0, yaw)
        _fly(plan, target - at, speed, accel)
        plan.stay(rng.uniform(1.5, 4.0))
        at = target
        target = np.append(rng.uniform(-80.0, 80.0, 2), -rng.uniform(15.0, 45.0))
        speed, accel = rng.uniform(*pace.speed), rng.uniform(*pace.accel)
        bearing = math.atan2(target[1] - at[1], target[0] - at[0])
        turn = math.remainder(bearing - yaw, 2 * math.pi) if rng.uniform() < 2 / 3 else 0.0
    if at[2] < 0.0:
        # 0.1 m of descent on the way: straight above home there would be no leg to fly.
        _fly(plan, np.append(-at[:2], 0.1), 8.0, 2.0)
        plan.stay(2.0)
        _fly(plan, np.array([0.0, 0.0, -at[2] - 0.1]), 2.0, 1.0)
    commands = smooth(plan.at(t), pace.smoothing_s, STEP_S)
    vel_n = commands[:, :3]
    return Plan(t, vel_n, _multirotor_attitude(t, vel_n, commands[:, 3]))


def _along(speed: F64, course: F64, climb: F64) -> F64:
    """Velocity (K, 3) NED of ``speed`` along ``course``, rising at angle ``climb`` [rad]."""
    level = speed * np.cos(climb)
    return np.stack(
        [level * np.cos(course), level * np.sin(course), -speed * np.sin(climb)], axis=-1
    )


def _coordinated_roll(t: F64, vel_n: F64, pitch: F64, yaw: F64) -> F64:
    """Roll (K,) [rad] that leaves no lateral specific force: tan φ = −f_y / f_z before rolling."""
    f = rate(t, vel_n)
    f[:, 2] -= G
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = c * f[:, 0] + s * f[:, 1]
    right = -s * f[:, 0] + c * f[:, 1]
    down = np.sin(pitch) * ahead + np.cos(pitch) * f[:, 2]
    return np.arctan2(right, -down)


def fixed_wing(duration_s: float, rest_s: float, heading: float, rng: np.random.Generator) -> Plan:
    """Take-off run, climb-out, then legs with coordinated banked turns, climbs, speed changes."""
    t = knots(duration_s, STEP_S)
    plan = Schedule(0.0, heading, 0.0)  # speed, course, climb angle
    plan.stay(rest_s)
    plan.go(5.0, 16.0, heading, 0.0)
    plan.go(2.5, 19.0, heading, math.radians(8.0))
    plan.stay(30.0)
    plan.go(2.5, 20.0, heading, 0.0)
    height, speed, course = 85.0, 20.0, heading
    while plan.now < duration_s:
        plan.stay(rng.uniform(4.0, 15.0))
        bank = math.radians(rng.uniform(15.0, 35.0))
        turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.7, 3.5)
        course += turn
        plan.go(abs(turn) * speed / (G * math.tan(bank)), speed, course, 0.0)
        plan.stay(rng.uniform(4.0, 10.0))
        speed = rng.uniform(17.0, 24.0)
        plan.go(6.0, speed, course, 0.0)
        climb = math.copysign(math.radians(rng.uniform(2.0, 5.0)), 120.0 - height)
        seconds = rng.uniform(5.0, 12.0)
        plan.go(2.0, speed, course, climb)
        plan.stay(seconds)
        plan.go(2.0, speed, course, 0.0)
        height += (seconds + 2.0) * speed * math.sin(climb)
    commands = smooth(plan.at(t), 2.5, STEP_S)
    speed_mps, yaw, climb_angle = commands.T
    vel_n = _along(speed_mps, yaw, climb_angle)
    # Angle of attack: the wing carries from about 12 m/s on, the nose then 3° above the path.
    attack = math.radians(3.0) * smooth(np.clip((speed_mps - 10.0) / 6.0, 0.0, 1.0), 1.0, STEP_S)
    pitch = climb_angle + attack
    return Plan(t, vel_n, np.stack([_coordinated_roll(t, vel_n, pitch, yaw), pitch, yaw], axis=-1))


def roll_without_slip(t: F64, speed: F64, yaw: F64, pitch: F64, roll: F64, ahead_m: float) -> Plan:
    """Plan of an IMU ``ahead_m`` in front of an axle that moves along body x and nowhere else.

    v_n = C_nb ((s, 0, 0) + w_nb_b × (ahead, 0, 0))
    """
    rpy = np.stack([roll, pitch, yaw], axis=-1)
    d_pitch, d_yaw = rate(t, rpy)[:, 1:].T
    q = d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch)
    r = -d_pitch * np.sin(roll) + d_yaw * np.cos(roll) * np.cos(pitch)
    v_y, v_z = r * ahead_m, -q * ahead_m
    # C_nb = R_z(yaw) R_y(pitch) R_x(roll), applied from the right.
    right = np.cos(roll) * v_y - np.sin(roll) * v_z
    under = np.sin(roll) * v_y + np.cos(roll) * v_z
    front = np.cos(pitch) * speed + np.sin(pitch) * under
    down = -np.sin(pitch) * speed + np.cos(pitch) * under
    north = np.cos(yaw) * front - np.sin(yaw) * right
    east = np.sin(yaw) * front + np.cos(yaw) * right
    return Plan(t, np.stack([north, east, down], axis=-1), rpy)


def _drive_block(plan: Schedule, rng: np.random.Generator) -> None:
    """Append one stretch between two stops to channels (speed, heading)."""
    yaw = plan.values[1]
    cruise = rng.uniform(9.0, 17.0)
    plan.go(cruise / rng.uniform(1.2, 2.2), cruise, yaw)
    plan.stay(rng.uniform(3.0, 12.0))
    for _ in range(rng.integers(1, 4)):
        # Lane changes and bends at speed, corners at walking-to-cycling speed.
        corner = rng.uniform() < 0.6
        speed = rng.uniform(5.0, 7.0) if corner else cruise
        angle = rng.choice([-1.0, 1.0]) * (math.pi / 2 if corner else rng.uniform(0.1, 0.5))
        plan.go((cruise - speed) / 1.8, speed, yaw)
        plan.stay(1.5)
        yaw += angle
        plan.go(abs(angle) * speed / rng.uniform(1.2, 2.4), speed, yaw)
        plan.stay(1.5)
        plan.go((cruise - speed) / 1.6, cruise, yaw)
        plan.stay(rng.uniform(2.0, 8.0))
    plan.go(cruise / rng.uniform(1.5, 2.5), 0.0, yaw)
    plan.stay(rng.uniform(4.0, 15.0))


def car_with_stops(
    duration_s: float, rest_s: float, heading: float, rng: np.random.Generator
) -> Plan:
    """A town drive: starts at rest, corners, bends, a hilly road, stops of 4-15 s at lights.

    The rear axle, ``CAR_IMU_AHEAD_M`` behind the IMU, never slips: it moves along body x.
    """
    t = knots(duration_s, STEP_S)
    plan = Schedule(0.0, heading)
    plan.stay(rest_s)
    while plan.now < duration_s:
        _drive_block(plan, rng)
    # Turning commands begin and end 1.5 s from any stop, further than half this width.
    speed, yaw = smooth(plan.at(t), 1.5, STEP_S).T
    phase = rng.uniform(0.0, 2 * math.pi, 2)
    way = integral(t, speed)
    # The slope belongs to the road, so it is a function of distance: at a light it stays.
    pitch = 0.03 * np.sin(way / 110.0 + phase[0]) + 0.015 * np.sin(way / 40.0 + phase[1])
    # The springs let the body lean outwards, 0.35° per m/s² of lateral acceleration.
    roll = -0.006 * speed * rate(t, yaw)
    return roll_without_slip(t, speed, yaw, pitch, roll, CAR_IMU_AHEAD_M)


YU_STEP_S = 0.01
YU_SMOOTHING_S = 0.2
"""Steps of acceleration in Table I last this long instead: no real jerk is infinite. The kernel is
symmetric, so speeds away from the steps and the time of each are those of the table, and
distances differ from it by a_step · (0.028 s)² / 2, below 3 mm."""


def yu_table1(duration_s: float, rest_s: float, heading: float, _rng: np.random.Generator) -> Plan:
    """The one-minute track of Yu et al. 2018, Table I, after ``rest_s`` at rest, then straight on.

    0-10 s a_t = 2 m/s²; to 50 s 20 m/s; to 55 s a_t = −3; to 57 s a_n = −5π/4 at 5 m/s, 90° to
    the left (their body x points right); to 60 s straight. The IMU is at the rear axle, on a plane.
    """
    t = knots(duration_s, YU_STEP_S)
    plan = Schedule(0.0, heading)
    plan.stay(rest_s)
    plan.go(10.0, 20.0, heading)
    plan.stay(40.0)
    plan.go(5.0, 5.0, heading)
    plan.go(2.0, 5.0, heading - math.pi / 2)
    plan.stay(3.0)
    speed, yaw = smooth(plan.at(t), YU_SMOOTHING_S, YU_STEP_S).T
    level = np.zeros(len(t))
    return roll_without_slip(t, speed, yaw, level, level, 0.0)


PLANS: dict[str, PlanFunction] = {
    "static": static,
    "hover": hover,
    "multirotor-mission": multirotor_mission,
    "multirotor-sport": multirotor_sport,
    "fixed-wing": fixed_wing,
    "car-with-stops": car_with_stops,
    "yu-table1": yu_table1,
}
"""Plans by the name of their kind."""
