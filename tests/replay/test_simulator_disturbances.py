"""What happens to simulated sensors for a while: in its window, of its size, and nothing else."""

from __future__ import annotations

import numpy as np

from companion.config import DEG
from companion.types import F64
from replay.simulator.aids import GnssSpec
from replay.simulator.disturbances import BiasStep, NoiseChange, Shaking
from replay.simulator.imu import measure
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded, parse_scenario
from replay.simulator.simulation import simulate

HOVER = TrajectorySpec(kind="static", duration_s=100.0)


def at_rest(seed: int = 4, **changes: object) -> tuple[F64, ...]:
    """A level unit at rest for 60 s: gyro, accelerometer and their true biases, and the seconds."""
    spec = graded("mems-consumer", rate_hz=100.0, **changes)
    t = np.arange(6000) / 100.0
    ideal = np.tile([0.0, 0.0, -9.81], (len(t), 1))
    return (*measure(spec, np.random.default_rng(seed), 0.0 * ideal, ideal, t), t)


def test_more_noise_for_a_while_multiplies_the_white_errors() -> None:
    more = GnssSpec(
        correlated_sd_position_m=0.0,
        correlated_sd_height_m=0.0,
        noise_changes=(NoiseChange(start_s=20.0, length_s=60.0, factor=5.0),),
    )
    plain = GnssSpec(correlated_sd_position_m=0.0, correlated_sd_height_m=0.0)
    noisy = simulate(Scenario(trajectory=HOVER, gnss=(more,)), 2).gnss[0]
    clean = simulate(Scenario(trajectory=HOVER, gnss=(plain,)), 2).gnss[0]
    t = (noisy.t_ns - noisy.t_ns[0]) / 1e9
    window = (t >= 20.0) & (t < 80.0)
    # At rest the velocity is all error: the same draws, five times as large.
    np.testing.assert_allclose(noisy.vel_n[window], 5.0 * clean.vel_n[window], rtol=1e-9)
    assert np.array_equal(noisy.vel_n[~window], clean.vel_n[~window])
    assert np.array_equal(noisy.sd_pos, clean.sd_pos)


def test_a_bias_step_is_in_the_output_and_in_the_truth_of_the_bias() -> None:
    step = BiasStep(start_s=30.0, gyro_dps=(0.5, 0.0, -0.5), accel_mps2=(0.0, 0.3, 0.0))
    stepped, plain = at_rest(bias_steps=(step,)), at_rest()
    t = stepped[4]
    for column, size in ((2, np.array([0.5, 0.0, -0.5]) * DEG), (3, np.array([0.0, 0.3, 0.0]))):
        difference = stepped[column] - plain[column]
        np.testing.assert_allclose(difference[t >= 30.0], np.tile(size, (3000, 1)), atol=1e-15)
        assert not difference[t < 30.0].any()
    # The measured output moved with it, by whole quanta.
    moved = (stepped[1] - plain[1])[t >= 30.0].mean(axis=0)
    np.testing.assert_allclose(moved, [0.0, 0.3, 0.0], atol=1e-3)


def test_shaking_beyond_the_range_leaves_a_bias() -> None:
    shaking = (Shaking(start_s=20.0, length_s=20.0, accel_mps2=40.0),)
    losses = []
    for seed in range(20):
        wide, narrow = (
            at_rest(seed, shaking=shaking, accel_range_mps2=limit) for limit in (1e3, 78.5)
        )
        window = (wide[4] >= 20.0) & (wide[4] < 40.0)
        assert np.array_equal(wide[1][~window], narrow[1][~window])
        assert np.abs(narrow[1]).max() <= 78.5 + 0.005
        losses.append((narrow[1] - wide[1])[window].mean(axis=0))
    # Gravity pushes the vertical axis to one end: E[clip(x − g)] + g = g · P(|x| > 8 g) = 0.49. One
    # flight scatters by 0.23 about that (5 % of the samples cut off by 12 m/s² on average, some 280
    # of them independent), twenty by 0.05.
    np.testing.assert_allclose(np.mean(losses, axis=0), [0.0, 0.0, 0.49], atol=0.2)


def test_a_scenario_file_can_say_what_happens() -> None:
    text = """
    [gnss]
    noise_changes = [{ start_s = 10.0, length_s = 5.0, factor = 3.0 }]
    [imu]
    grade = "mems-consumer"
    shaking = [{ start_s = 1.0, length_s = 2.0, accel_mps2 = 20.0 }]
    bias_steps = [{ start_s = 4.0, gyro_dps = [1.0, 0.0, 0.0] }]
    """
    scenario = parse_scenario(text)
    assert scenario.gnss[0].noise_changes[0].factor == 3.0
    assert scenario.imu[0].shaking[0].accel_mps2 == 20.0
    assert scenario.imu[0].bias_steps[0].gyro_dps == (1.0, 0.0, 0.0)
