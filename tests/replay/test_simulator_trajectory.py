"""The simulator's truth against a second derivation, and the vehicles against what they are."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad_vec

from companion.navigation import earth
from companion.types import F64
from replay.simulator.plans import CAR_IMU_AHEAD_M, PLANS
from replay.simulator.shaping import Plan, knots, smooth
from replay.simulator.trajectory import Trajectory

LAT, LON, HEIGHT = math.radians(47.4), math.radians(8.5), 488.0
W_IE_E = np.array([0.0, 0.0, earth.RATE])
MOVING = ["hover", "multirotor-mission", "fixed-wing", "car-with-stops", "yu-table1"]


def build(kind: str, duration_s: float = 120.0, rest_s: float = 8.0, seed: int = 3) -> Trajectory:
    plan = PLANS[kind](duration_s, rest_s, 0.7, np.random.default_rng(seed))
    return Trajectory(plan, LAT, LON, HEIGHT)


def C_en(lat: float, lon: float) -> F64:
    """Navigation (NED) to ECEF; columns are north, east, down. Groves 2013, eq. 2.150."""
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def geodetic(r: F64) -> tuple[float, float, float]:
    """Latitude, longitude, height of an ECEF position, by fixed-point iteration to convergence."""
    p, lat = math.hypot(r[0], r[1]), math.atan2(r[2], math.hypot(r[0], r[1]))
    for _ in range(8):
        n = earth.A / math.sqrt(1.0 - earth.E2 * math.sin(lat) ** 2)
        lat = math.atan2(r[2] + earth.E2 * n * math.sin(lat), p)
    return lat, math.atan2(r[1], r[0]), p / math.cos(lat) - n


def ecef_of(trajectory: Trajectory, t: float) -> tuple[F64, F64, F64]:
    s = trajectory.states(np.array([t]))
    C = C_en(s.lat[0], s.lon[0])
    return earth.ecef(s.lat, s.lon, s.height)[0], C @ s.vel_n[0], C @ s.C_nb[0]


def skew(v: F64) -> F64:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def integrate(trajectory: Trajectory, start: float, end: float, step: float) -> tuple[F64, ...]:
    """ECEF position, velocity and C_eb that the ideal IMU leads to, from the truth at ``start``.

    r' = v,  v' = C_eb f_b − 2 w_ie × v + γ(r),  C_eb' = C_eb [w_ib_b×] − [w_ie×] C_eb.
    Groves 2013, section 5.3: the ECEF equations, with no transport rate and no NED in them.
    Classical Runge-Kutta; steps end on the spline's knots, where derivatives have corners.
    """
    r0, v0, C0 = ecef_of(trajectory, start)
    count = round((end - start) / step)
    gyro, accel = trajectory.inertial(start + np.arange(2 * count + 1) * (step / 2))
    earth_turn = skew(W_IE_E)

    def slope(half: int, x: F64) -> F64:
        lat, lon, h = geodetic(r0 + x[0])
        C = x[2:]
        v_dot = (
            C @ accel[half] - 2.0 * earth_turn @ x[1] + C_en(lat, lon)[:, 2] * earth.gravity(lat, h)
        )
        return np.vstack([x[1], v_dot, C @ skew(gyro[half]) - earth_turn @ C])

    x = np.vstack([np.zeros(3), v0, C0])
    for i in range(0, 2 * count, 2):
        k1 = slope(i, x)
        k2 = slope(i + 1, x + step / 2 * k1)
        k3 = slope(i + 1, x + step / 2 * k2)
        k4 = slope(i + 2, x + step * k3)
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return r0 + x[0], x[1], x[2:]


@pytest.mark.parametrize("kind", MOVING)
def test_the_ideal_imu_integrates_back_to_the_truth(kind: str) -> None:
    trajectory = build(kind)
    r, v, C_eb = integrate(trajectory, 5.0, 65.0, 0.01)
    r_true, v_true, C_true = ecef_of(trajectory, 65.0)
    # Runge-Kutta at 10 ms errs by (ω h)^4 / 2880 of an acceleration, below 1e-8 at ω = 6 rad/s;
    # over 60 s, 1e-8 m/s² is 2e-5 m. The requirement is 1 mm.
    assert np.linalg.norm(r - r_true) < 2e-5
    assert np.linalg.norm(v - v_true) < 1e-6
    assert np.linalg.norm(C_eb - C_true) < 1e-6


def test_at_rest_the_imu_feels_gravity_and_the_turning_earth() -> None:
    trajectory = build("static")
    gyro, accel = trajectory.inertial(np.array([10.0]))
    assert np.linalg.norm(accel[0]) == pytest.approx(earth.gravity(LAT, HEIGHT), rel=1e-14)
    assert np.linalg.norm(gyro[0]) == pytest.approx(earth.RATE, rel=1e-12)
    assert accel[0, 2] < -9.8


def test_means_over_an_interval_are_the_integrals() -> None:
    trajectory = build("multirotor-mission")
    t, interval = np.array([20.0, 31.4, 47.205]), 0.02
    means = np.hstack(trajectory.inertial_means(t, interval))
    for i, end in enumerate(t):
        exact, _ = quad_vec(
            lambda s: np.hstack(trajectory.inertial(np.array([s])))[0],
            end - interval,
            end,
            epsabs=1e-14,
            epsrel=1e-13,
        )
        # At 50 Hz; three nodes are exact to the sixth power of the interval.
        np.testing.assert_allclose(means[i], exact / interval, rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", list(PLANS))
def test_every_kind_begins_at_rest(kind: str) -> None:
    vel_n = build(kind, rest_s=8.0).states(np.arange(0.0, 6.0, 0.02)).vel_n
    # Rest ends half a smoothing width early; splines ring by less than a micrometre per second.
    assert np.abs(vel_n).max() < 1e-6


@pytest.mark.parametrize("kind", [k for k in MOVING if k != "yu-table1"])
def test_long_runs_keep_moving_within_bounds(kind: str) -> None:
    trajectory = build(kind, duration_s=3600.0)
    s = trajectory.states(np.arange(0.0, 3600.0, 1.0))
    speed = np.linalg.norm(s.vel_n, axis=1)
    assert speed[3000:3500].max() > 0.1
    assert speed.max() < 30.0
    assert np.all(s.height > HEIGHT - 60.0)
    assert np.all(s.height < HEIGHT + 400.0)
    assert np.abs(s.rpy[:, :2]).max() < math.radians(50.0)


def test_the_rear_axle_of_the_car_does_not_slip() -> None:
    trajectory = build("car-with-stops", duration_s=300.0)
    t = np.arange(0.0, 300.0, 0.05) + 0.01
    s = trajectory.states(t)
    w_ie_n = earth.RATE * np.stack([np.cos(s.lat), 0 * t, -np.sin(s.lat)], axis=-1)
    w_eb_b = trajectory.inertial(t)[0] - np.einsum("nji,nj->ni", s.C_nb, w_ie_n)
    axle = np.cross(w_eb_b, [-CAR_IMU_AHEAD_M, 0.0, 0.0])
    axle += np.einsum("nji,nj->ni", s.C_nb, s.vel_n)
    # Left over: transport rate times the lever (4e-6 m/s at 20 m/s) and the interpolation of
    # velocity and attitude between knots 0.05 s apart.
    assert np.abs(axle[:, 1:]).max() < 2e-5
    assert axle[:, 0].max() > 9.0
    assert axle[:, 0].min() > -1e-4
    stopped = np.abs(axle[:, 0]) < 1e-6
    assert np.count_nonzero(np.diff(stopped.astype(int)) == 1) >= 2


def test_the_fixed_wing_turns_without_lateral_specific_force() -> None:
    trajectory = build("fixed-wing", duration_s=200.0)
    t = np.arange(20.0, 200.0, 0.1)
    roll, accel = trajectory.states(t).rpy[:, 0], trajectory.inertial(t)[1]
    assert np.abs(roll).max() > math.radians(15.0)
    # Coordinated against g = 9.81 m/s² flat: the rest is Coriolis and gravity's own value.
    assert np.abs(accel[:, 1]).max() < 0.02


def test_the_multirotor_tilts_into_its_acceleration() -> None:
    trajectory = build("multirotor-mission", duration_s=200.0)
    t = np.arange(30.0, 160.0, 0.1)
    s = trajectory.states(t)
    acc_n = (trajectory.states(t + 0.05).vel_n - trajectory.states(t - 0.05).vel_n) / 0.1
    thrust_n = acc_n + 0.1 * s.vel_n - [0.0, 0.0, 9.81]
    lateral = np.einsum("nji,nj->ni", s.C_nb, thrust_n)[:, :2]
    # Finite differences over 0.1 s see acceleration to a few mm/s².
    assert np.abs(lateral).max() < 0.02
    assert np.abs(s.rpy[:, :2]).max() > math.radians(8.0)


def test_yu_track_has_the_distances_of_table_1() -> None:
    rest = 5.0
    trajectory = build("yu-table1", duration_s=65.0, rest_s=rest)
    t = np.arange(0.0, 65.0 + 1e-9, 0.001)
    speed = np.linalg.norm(trajectory.states(t).vel_n, axis=1)
    way = np.concatenate([[0.0], np.cumsum((speed[1:] + speed[:-1]) / 2) * 0.001])
    marks = np.array([0.0, 10.0, 50.0, 55.0, 57.0, 60.0]) + rest
    travelled = np.diff(np.interp(marks, t, way))
    # The smoothing moves a distance by a_step · (0.028 s)² / 2 at each of its two ends, 2.5 mm.
    np.testing.assert_allclose(travelled, [100.0, 800.0, 62.5, 10.0, 15.0], atol=2.5e-3)
    yaw = trajectory.states(np.array([rest + 54.0, rest + 58.0])).rpy[:, 2]
    assert yaw[1] - yaw[0] == pytest.approx(-math.pi / 2, abs=1e-9)
    lateral = trajectory.inertial(np.array([rest + 56.0]))[1][0, 1]
    # Coriolis at 5 m/s adds 5e-4 m/s².
    assert lateral == pytest.approx(-5 * math.pi / 4, abs=1e-3)


def test_smoothing_keeps_ramps_and_integrals() -> None:
    t = knots(20.0, 0.05)
    ramp = np.interp(t, [5.0, 9.0], [0.0, 8.0])
    out = smooth(ramp, 1.0, 0.05)
    middle = (t > 6.0) & (t < 8.0)
    np.testing.assert_allclose(out[middle], ramp[middle], atol=1e-12)
    assert out.sum() == pytest.approx(ramp.sum(), abs=1e-9)
    assert out.max() <= 8.0 + 1e-12


def test_a_seed_names_a_trajectory() -> None:
    t = np.arange(0.0, 100.0, 0.5)
    first, again, other = (build("multirotor-mission", seed=s).states(t).vel_n for s in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.allclose(first, other)


def test_a_plan_at_high_speed_stays_on_its_great_circle() -> None:
    """200 m/s due east at the equator: longitude advances by v / (a + h) and nothing else moves."""
    t = knots(100.0, 0.05)
    vel_n = np.tile([0.0, 200.0, 0.0], (len(t), 1))
    trajectory = Trajectory(Plan(t, vel_n, np.tile([0.0, 0.0, np.pi / 2], (len(t), 1))), 0, 0, 1e4)
    s = trajectory.states(np.array([100.0]))
    assert s.lon[0] == pytest.approx(100.0 * 200.0 / (earth.A + 1e4), rel=1e-13)
    assert abs(s.lat[0]) < 1e-15
    _, accel = trajectory.inertial(np.array([50.0]))
    w = earth.RATE + 200.0 / (earth.A + 1e4)
    # Circular motion about the axis at inertial rate w, minus the Earth's own share in gravity.
    felt = earth.gravity(0.0, 1e4) - (earth.A + 1e4) * (w * w - earth.RATE**2)
    assert -accel[0, 2] == pytest.approx(felt, rel=1e-12)
