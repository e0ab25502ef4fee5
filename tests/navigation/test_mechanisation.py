"""The strapdown step against closed forms, an ODE solver, exact trajectories, and reversed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.navigation import earth
from companion.navigation import layout as lo
from companion.navigation.rotation import attitude_error_n, matrix_from_quat, quat_from_rpy
from companion.types import F64
from replay.simulator import load_scenario
from replay.simulator.simulation import plan_trajectory

from .strapdown import integrate, metres, nominal, steps, still_imu


@pytest.mark.parametrize("lat_deg", [-80.0, -33.0, 0.0, 47.4, 75.0])
def test_an_hour_at_rest_drifts_below_a_centimetre(lat_deg: float) -> None:
    s = nominal(math.radians(lat_deg), 0.3, 500.0, (0, 0, 0), (0.02, -0.05, 2.1))
    lat, lon, height, q = s[lo.LAT], s[lo.LON], s[lo.HEIGHT], s[:4].copy()
    imu = np.tile(still_imu(s), (3600 * 50 + 1, 1))
    steps(s, imu, 0.02, False)
    assert np.abs(metres(s, lat, lon, height)).max() < 0.01
    # 1 cm over an hour is Schuler motion of 1e-9 rad: the attitude holds to that.
    assert np.abs(attitude_error_n(q, s[:4])).max() < 1e-9


@pytest.mark.parametrize("integral", [False, True])
def test_constant_rate_turn_closes_its_circle(integral: bool) -> None:
    """20 m/s and 0.5 rad/s: a circle of 40 m radius, driven 24 times in five minutes."""
    lat0, speed, turn, seconds = 0.8, 20.0, 0.5, 24 * 2 * math.pi / 0.5
    n = round(seconds / 0.005)
    dt = seconds / n
    radius = speed / turn
    imu = np.empty((n + 1, 6))
    for i, psi in enumerate(turn * dt * np.arange(n + 1)):
        C = matrix_from_quat(quat_from_rpy(0, 0, psi))
        lat = lat0 + radius * math.sin(psi) / earth.radii(lat0)[0]
        v = speed * np.array([math.cos(psi), math.sin(psi), 0])
        w_ie = earth.earth_rate_n(lat)
        w_in = w_ie + earth.transport_rate_n(lat, 0.0, v)
        acc = turn * speed * np.array([-math.sin(psi), math.cos(psi), 0])
        imu[i, :3] = C.T @ w_in + [0, 0, turn]
        imu[i, 3:] = C.T @ (acc + np.cross(w_in + w_ie, v) - [0, 0, earth.gravity(lat, 0.0)])
    if integral:
        imu[1:] = 0.5 * (imu[1:] + imu[:-1])
    s = nominal(lat0, 0.1, 0.0, (speed, 0, 0), (0, 0, 0))
    steps(s, imu, dt, integral)
    off = metres(s, lat0, 0.1, 0.0)
    # On the ellipsoid a circle in metres does not close: π r² tan φ / N east a turn, 0.8 mm.
    off[1] += 24 * math.pi * radius**2 * math.tan(lat0) / earth.radii(lat0)[1]
    # The trapezoid loses (ω dt)²/12 of the Earth rate that turns in body axes: 2.6e-11 rad/s of
    # tilt, g t³/6 of that is 1.2 mm.
    assert np.abs(off).max() < 2e-3
    assert np.abs(s[lo.VEL_N : lo.VEL_N + 3] - [speed, 0, 0]).max() < 2e-5
    assert np.abs(attitude_error_n(quat_from_rpy(0, 0, 0), s[:4])).max() < 2e-8


def test_great_circle_along_a_meridian_at_200_mps() -> None:
    """Half an hour north at 200 m/s and 1000 m: (M + h) φ' = v, level, nose north."""
    speed, h, dt, seconds = 200.0, 1000.0, 0.02, 1800
    t = np.arange(round(seconds / dt) + 1) * dt
    lat = np.empty(len(t))
    lat[0] = 0.5
    for i in range(len(t) - 1):
        # Runge-Kutta 4; the step is 6e-7 rad, its error far below rounding.
        k1 = speed / (earth.radii(lat[i])[0] + h)
        k2 = speed / (earth.radii(lat[i] + 0.5 * dt * k1)[0] + h)
        k4 = speed / (earth.radii(lat[i] + dt * k2)[0] + h)
        lat[i + 1] = lat[i] + dt * (k1 + 4 * k2 + k4) / 6
    imu = np.empty((len(t), 6))
    v = np.array([speed, 0.0, 0.0])
    for i, x in enumerate(lat):
        w_ie, w_en = earth.earth_rate_n(x), earth.transport_rate_n(x, h, v)
        imu[i, :3] = w_ie + w_en
        imu[i, 3:] = np.cross(2 * w_ie + w_en, v) - [0, 0, earth.gravity(x, h)]
    s = nominal(0.5, -1.0, h, v, (0, 0, 0))
    steps(s, imu, dt, False)
    # The radius is taken at a step's start, 2 m back: M'/M · 3e-7 rad = 3e-9 of 360 km is 1 mm.
    assert np.abs(metres(s, lat[-1], -1.0, h)).max() < 3e-3
    assert np.abs(s[lo.VEL_N : lo.VEL_N + 3] - v).max() < 1e-5
    assert np.abs(attitude_error_n(quat_from_rpy(0, 0, 0), s[:4])).max() < 1e-9


def test_great_circle_along_the_equator_crosses_the_date_line() -> None:
    speed, dt, seconds, lon = 200.0, 0.02, 1800, math.pi - 0.01
    v = np.array([0.0, speed, 0.0])
    s = nominal(0.0, lon, 0.0, v, (0, 0, math.pi / 2))
    w_ie, w_en = earth.earth_rate_n(0.0), earth.transport_rate_n(0.0, 0.0, v)
    f = np.cross(2 * w_ie + w_en, v) - [0, 0, earth.gravity(0.0, 0.0)]
    C = matrix_from_quat(s[:4])
    imu = np.tile(np.concatenate([C.T @ (w_ie + w_en), C.T @ f]), (round(seconds / dt) + 1, 1))
    steps(s, imu, dt, False)
    assert np.abs(metres(s, 0.0, lon + speed * seconds / earth.A, 0.0)).max() < 1e-3


def _lively(t: float) -> F64:
    """Rates up to 1 rad/s and forces up to 5 m/s² beside weight, at 0.1 to 0.7 Hz."""
    return np.array(
        [
            0.8 * math.sin(2.1 * t),
            0.6 * math.cos(3.3 * t + 1.0),
            0.3 + 0.5 * math.sin(1.3 * t),
            3.0 * math.sin(0.9 * t) + 1.0,
            4.0 * math.cos(1.7 * t),
            -9.6 + 2.0 * math.sin(4.1 * t),
        ]
    )


@pytest.mark.parametrize("lat", [-1.2, 0.1, 0.9])
def test_lively_motion_agrees_with_an_ode_solver_to_second_order(lat: float) -> None:
    seconds = 20.0
    start = nominal(lat, 2.0, 300.0, (15.0, -8.0, 1.0), (0.3, -0.2, 1.0))
    llh, v, q = integrate(start, seconds, _lively)
    position, velocity, attitude = [], [], []
    for rate in (100, 200, 400):
        imu = np.array([_lively(i / rate) for i in range(round(seconds * rate) + 1)])
        s = start.copy()
        steps(s, imu, 1.0 / rate, False)
        position.append(np.abs(metres(s, *llh)).max())
        velocity.append(np.abs(s[lo.VEL_N : lo.VEL_N + 3] - v).max())
        attitude.append(np.abs(attitude_error_n(q, s[:4])).max())
    # The trapezoid of a sine errs by (ω dt)²/12 of its integral: 0.8/2.1 rad · 3.7e-5 at 100 Hz.
    assert attitude[0] < 1e-4
    for error in (position, velocity, attitude):
        # Second order: a quarter for half the step, with room for the next order and rounding.
        assert error[1] < 0.3 * error[0] + 1e-9
        assert error[2] < 0.3 * error[1] + 1e-9


@pytest.mark.parametrize("kind", ["multirotor-mission", "fixed-wing", "car-with-stops"])
def test_integral_samples_follow_a_trajectory_that_instantaneous_ones_nearly_do(
    kind: str,
) -> None:
    """Interval means lose nothing between samples; instants lose the error of the trapezoid."""
    trajectory = plan_trajectory(load_scenario(kind).trajectory, 2)
    seconds, rate = 60.0, 100.0
    t = np.arange(round(seconds * rate) + 1) / rate
    ends = trajectory.states(t[[0, -1]])
    worst = {}
    for integral in (False, True):
        gyro, accel = trajectory.inertial_means(t, 1 / rate) if integral else trajectory.inertial(t)
        s = nominal(ends.lat[0], ends.lon[0], ends.height[0], ends.vel_n[0], ends.rpy[0])
        steps(s, np.hstack([gyro, accel]), 1 / rate, integral)
        worst[integral] = np.abs(metres(s, ends.lat[1], ends.lon[1], ends.height[1])).max()
    # Below a centimetre in a minute: a hundredth of what the best IMU here drifts meanwhile.
    assert worst[True] < 0.01
    assert worst[False] < 0.1
    assert worst[True] <= worst[False] + 1e-3


def test_coning_is_corrected() -> None:
    """A cone of 2° at 10 Hz, means at 200 Hz: rate vectors alone would drift about its axis.

    q = (cos ½a, sin ½a cos Ωt, sin ½a sin Ωt, 0): ω = Ω (−sin a sin Ωt, sin a cos Ωt, cos a − 1).
    """
    a, W, dt, seconds = math.radians(2.0), 2 * math.pi * 10.0, 0.005, 30.0
    n = round(seconds / dt)
    ends = np.arange(-1, n + 1) * dt
    x, y = np.cos(W * ends), np.sin(W * ends)
    means = np.empty((n + 1, 6))
    means[:, 0] = math.sin(a) * np.diff(x) / dt
    means[:, 1] = math.sin(a) * np.diff(y) / dt
    means[:, 2] = W * (math.cos(a) - 1.0)
    g = earth.gravity(0.0, 0.0)
    nodes, weights = np.polynomial.legendre.leggauss(4)
    means[:, 3:] = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        for i, t in enumerate(ends[1:] + 0.5 * (node - 1.0) * dt):
            q = np.array(
                [
                    math.cos(a / 2),
                    math.sin(a / 2) * math.cos(W * t),
                    math.sin(a / 2) * math.sin(W * t),
                    0,
                ]
            )
            means[i, 3:] += 0.5 * weight * (matrix_from_quat(q).T @ [0, 0, -g])
    s = nominal(0.0, 0.0, 0.0, (0, 0, 0), (0, 0, 0), earth_rate=0.0)
    s[:4] = [math.cos(a / 2), math.sin(a / 2), 0, 0]
    steps(s, means, dt, True)
    end = W * seconds
    truth = np.array(
        [math.cos(a / 2), math.sin(a / 2) * math.cos(end), math.sin(a / 2) * math.sin(end), 0]
    )
    drift = abs(attitude_error_n(truth, s[:4])[2])
    uncorrected = W * (1 - math.cos(a)) * seconds * (W * dt) ** 2 / 12 * 0.5
    # Two-sample coning leaves (Ω dt)⁴/… of the motion; without it drift is second order in Ω dt.
    assert drift < 0.1 * uncorrected
    # Sculling: a cone whose force turns with it must not push.
    assert np.abs(s[lo.VEL_N : lo.VEL_N + 2]).max() < 1e-3 * seconds


def _reversed(s: F64, imu: F64) -> tuple[F64, F64]:
    """State and samples of the motion run backwards: rate, gyro bias, velocity, Earth reversed."""
    back = s.copy()
    for offset in (lo.VEL_N, lo.GYRO_BIAS_B):
        back[offset : offset + 3] *= -1.0
    back[lo.EARTH_RATE] *= -1.0
    samples = imu[::-1].copy()
    samples[:, :3] *= -1.0
    return back, samples


@pytest.mark.parametrize("kind", ["multirotor-mission", "fixed-wing", "car-with-stops"])
def test_time_reversed_run_returns_to_its_start(kind: str) -> None:
    trajectory = plan_trajectory(load_scenario(kind).trajectory, 4)
    rate = 100.0
    t = np.arange(round(200 * rate) + 1) / rate
    first = trajectory.states(t[:1])
    rng = np.random.default_rng(3)
    s = nominal(first.lat[0], first.lon[0], first.height[0], first.vel_n[0], first.rpy[0])
    s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] = 1e-3 * rng.standard_normal(3)
    s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = 0.01 * rng.standard_normal(3)
    imu = np.hstack(trajectory.inertial(t))
    start = s.copy()
    steps(s, imu, 1 / rate, False)
    assert np.abs(metres(s, start[lo.LAT], start[lo.LON], start[lo.HEIGHT])).max() > 1.0
    s, samples = _reversed(s, imu)
    steps(s, samples, 1 / rate, False)
    assert np.abs(metres(s, start[lo.LAT], start[lo.LON], start[lo.HEIGHT])).max() < 1e-3
    assert np.abs(s[lo.VEL_N : lo.VEL_N + 3] + start[lo.VEL_N : lo.VEL_N + 3]).max() < 1e-5
    assert np.abs(attitude_error_n(start[:4], s[:4])).max() < 1e-8


def test_the_reversed_run_needs_the_reversed_earth() -> None:
    """The test above would notice: with Earth rate kept, an hour-angle of error stays."""
    s = nominal(0.8, 0.1, 0.0, (0, 0, 0), (0, 0, 0))
    imu = np.tile(still_imu(s), (6001, 1))
    start = s.copy()
    steps(s, imu, 0.01, False)
    back, samples = _reversed(s, imu)
    back[lo.EARTH_RATE] *= -1.0
    steps(back, samples, 0.01, False)
    assert np.abs(attitude_error_n(start[:4], back[:4])).max() > 1e-3
