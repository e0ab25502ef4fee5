"""Tuning: the fit of Allan deviations to known noise, innovations to a known receiver."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import DEG, parse
from replay.simulator import Scenario, load_scenario, matching_config, simulate
from replay.simulator.aids import GnssSpec
from replay.simulator.imu import ImuSpec
from replay.simulator.noise import gauss_markov
from replay.simulator.scenarios import TrajectorySpec
from replay.tuning.aiding_noise import aiding_parameters
from replay.tuning.allan import allan_deviation, fit, gauss_markov_variance
from replay.tuning.imu_noise import curves, imu_parameters
from replay.tuning.parameter import Parameter, as_toml
from replay.tuning.rest import longest_rest

SPEC = ImuSpec(
    rate_hz=25.0,
    gyro_noise_dps_rthz=0.006,
    gyro_instability_dps=0.004,
    gyro_instability_tau_s=120.0,
    accel_noise_mps2_rthz=0.002,
    accel_instability_mps2=0.001,
    accel_instability_tau_s=120.0,
)


def test_white_noise_falls_with_the_root_of_time() -> None:
    white = 0.3 * np.random.default_rng(0).standard_normal((200_000, 3)) / np.sqrt(0.01)
    curve = allan_deviation(white, 0.01)
    # The longest times hold eight clusters an axis: some fifteen percent.
    assert curve.deviation * np.sqrt(curve.tau_s) == pytest.approx(0.3, rel=0.5)
    assert fit(curve).density == pytest.approx(0.3, rel=0.01)
    assert fit(curve).walk is None


def test_variance_of_a_gauss_markov_process_is_the_closed_form() -> None:
    sd, correlation_s = 2.0, 10.0
    x = gauss_markov(np.random.default_rng(1), 400_000, 0.1, np.full(3, sd), correlation_s)
    curve = allan_deviation(x, 0.1)
    # Over a few samples a sum of them is not the mean that the closed form is of.
    known = (curve.tau_s > 0.5) & (curve.tau_s < 500)
    measured = curve.deviation[known] ** 2
    assert measured == pytest.approx(
        gauss_markov_variance(curve.tau_s[known], sd, correlation_s), rel=0.15
    )


def test_a_parked_log_gives_back_the_datasheet() -> None:
    """Angle and velocity random walk and bias instability of a simulated unit, within 20 %."""
    scenario = Scenario(
        trajectory=TrajectorySpec(kind="static", duration_s=14_400.0, rest_s=14_400.0),
        imu=(SPEC,),
        gnss=(),
    )
    vehicle = simulate(scenario, seed=3)
    rest = longest_rest(vehicle, vehicle.imu[0])
    assert len(rest) > 0.99 * len(vehicle.imu[0])
    gyro, accel = (fit(curve) for curve in curves(rest))
    assert gyro.density / DEG == pytest.approx(SPEC.gyro_noise_dps_rthz, rel=0.2)
    assert accel.density == pytest.approx(SPEC.accel_noise_mps2_rthz, rel=0.2)
    assert gyro.instability is not None
    assert accel.instability is not None
    assert gyro.instability / DEG == pytest.approx(SPEC.gyro_instability_dps, rel=0.2)
    assert accel.instability == pytest.approx(SPEC.accel_instability_mps2, rel=0.2)


def test_a_short_rest_says_what_it_cannot_tell() -> None:
    scenario = Scenario(
        trajectory=TrajectorySpec(kind="static", duration_s=60.0, rest_s=60.0), imu=(SPEC,), gnss=()
    )
    vehicle = simulate(scenario, seed=1)
    before = msgspec.to_builtins(matching_config(scenario).imu)
    found = {p.key: p for p in imu_parameters(vehicle.imu[0], before)}
    assert found["gyro_noise_dps_rthz"].after == pytest.approx(0.006, rel=0.2)
    assert found["gyro_bias_walk_dps_rts"].after is None
    assert "too short" in found["gyro_bias_walk_dps_rts"].reason


def test_rest_is_where_nothing_moves() -> None:
    scenario = load_scenario("multirotor-mission")
    brief = msgspec.structs.replace(scenario.trajectory, duration_s=90.0, rest_s=25.0)
    vehicle = simulate(msgspec.structs.replace(scenario, trajectory=brief), seed=2)
    rest = longest_rest(vehicle, vehicle.imu[0])
    truth = vehicle.truth
    assert truth is not None
    speed = np.linalg.norm(truth.vel_n, axis=1)
    first_motion_ns = truth.t_ns[np.flatnonzero(speed > 0.05)[0]]
    assert rest.t_ns[0] <= vehicle.imu[0].t_ns[0] + 2_000_000_000
    assert abs(int(rest.t_ns[-1]) - int(first_motion_ns)) < 3_000_000_000


@pytest.mark.parametrize("factor", [0.4, 3.0])
def test_innovations_give_back_the_receivers_own_noise(factor: float) -> None:
    """Whatever deviation the configuration had: the white part of position and velocity."""
    mission = load_scenario("multirotor-mission")
    brief = msgspec.structs.replace(mission.trajectory, duration_s=200.0)
    receiver = GnssSpec(correlated_sd_position_m=0.0, correlated_sd_height_m=0.0)
    scenario = msgspec.structs.replace(mission, trajectory=brief, gnss=(receiver,))
    config = matching_config(scenario)
    truth = config.gnss
    wrong = msgspec.structs.replace(
        truth,
        sd_position_m=factor * truth.sd_position_m,
        sd_velocity_mps=factor * truth.sd_velocity_mps,
    )
    tuned = aiding_parameters(
        simulate(scenario, seed=4), msgspec.structs.replace(config, gnss=wrong)
    )
    found = {p.key: p.after for p in tuned if p.section == "gnss"}
    assert found["sd_position_m"] == pytest.approx(truth.sd_position_m, rel=0.15)
    assert found["sd_velocity_mps"] == pytest.approx(truth.sd_velocity_mps, rel=0.2)


def test_the_file_is_a_configuration() -> None:
    text = as_toml(
        [
            Parameter("imu", "gyro_noise_dps_rthz", 0.02, 0.0061, "Allan deviation"),
            Parameter("imu", "gyro_bias_walk_dps_rts", 0.001, None, "too short"),
            Parameter("gnss", "sd_position_m", 1.5, 0.42, "innovations"),
        ],
        "title",
    )
    config = parse(text)
    assert config.imu.gyro_noise_dps_rthz == 0.0061
    assert config.gnss.sd_position_m == 0.42
    assert "# gyro_bias_walk_dps_rts = 0.001: too short" in text
