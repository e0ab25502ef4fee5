"""Simulated errors against their specification, by chi-square bounds on seeded runs."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.stats import chi2

from companion.config import DEG
from companion.navigation.earth import ned_difference
from companion.types import F64, NS, GnssSamples
from replay.simulator.aids import BaroSpec, Fault, GnssSpec, MagSpec, Outage, isa_pressure
from replay.simulator.imu import IMU_GRADES, ImuSpec, measure
from replay.simulator.noise import gauss_markov, narrow_band, random_walk
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded
from replay.simulator.simulation import Simulation, run

STATIC = TrajectorySpec(kind="static", duration_s=600.0)
MISSION = TrajectorySpec(kind="multirotor-mission", duration_s=150.0)


def assert_variance(samples: F64, variance: float, effective: float | None = None) -> None:
    """Σ x² / σ² of independent samples lies within the central 99.9 % of its chi-square."""
    count = samples.size if effective is None else effective
    statistic = count * float(np.mean(samples**2)) / variance
    low, high = chi2.ppf([0.0005, 0.9995], count)
    assert low < statistic < high, (statistic / count, low / count, high / count)


def still(spec: ImuSpec, seconds: float, seed: int = 5) -> tuple[F64, F64, F64, F64]:
    count = round(seconds * spec.rate_hz)
    zero = np.zeros((count, 3))
    return measure(spec, np.random.default_rng(seed), zero, zero, zero[:, 0])


def fix_errors(sim: Simulation) -> tuple[F64, F64]:
    """Position and velocity errors (N, 3) of the first receiver, stamped at validity."""
    gnss = sim.recording.gnss[0]
    truth = sim.trajectory.states((gnss.t_ns - sim.t0_ns) / NS)
    position = ned_difference(gnss.lat, gnss.lon, gnss.height, truth.lat, truth.lon, truth.height)
    return position, gnss.vel_n - truth.vel_n


# --------------------------------------------------------------------------- processes


def test_gauss_markov_is_stationary_with_its_correlation_time() -> None:
    x = gauss_markov(np.random.default_rng(1), 400, 1.0, np.full(2000, 3.0), 20.0)
    for epoch in (0, 50, 399):
        assert_variance(x[epoch], 9.0)
    lag = np.mean(x[:-20] * x[20:]) / 9.0
    # One lag of τ leaves 1/e; 2000 paths × 10 correlation times know it to about 1 %.
    assert lag == pytest.approx(math.exp(-1.0), abs=0.03)


def test_random_walk_grows_with_the_root_of_time() -> None:
    x = random_walk(np.random.default_rng(2), 1001, 0.1, np.full(3000, 0.5))
    assert not x[0].any()
    assert_variance(x[1000], 0.25 * 100.0)
    assert_variance(x[250], 0.25 * 25.0)


def test_vibration_has_its_rms_and_leaves_low_frequencies_alone() -> None:
    x = narrow_band(np.random.default_rng(3), 40000, 0.005, 0.5, 60.0, 3)
    # Bandwidth 6 Hz: about 2 · 6 · 200 s independent samples an axis.
    assert_variance(x, 0.25, effective=3 * 2400)
    power = np.mean(np.abs(np.fft.rfft(x, axis=0)) ** 2, axis=1)
    hz = np.fft.rfftfreq(40000, 0.005)
    assert power[(hz > 0.5) & (hz < 20.0)].sum() < 0.02 * power.sum()
    assert 55.0 < hz[np.argmax(power)] < 65.0


# --------------------------------------------------------------------------- IMU


@pytest.mark.parametrize("grade", ["mems-consumer", "mems-industrial", "tactical", "yu-2018"])
def test_allan_deviation_at_one_second_is_the_white_noise_density(grade: str) -> None:
    """σ_A(τ) = N / √τ where white noise rules; biases and steps are switched off."""
    spec = msgspec.structs.replace(
        graded(grade, rate_hz=100.0).modelled_only(),
        gyro_bias_walk_dps_rts=0.0,
        accel_bias_walk_mps2_rts=0.0,
    )
    gyro, accel, _, _ = still(spec, 3000.0)
    for output, density in (
        (gyro / DEG, spec.gyro_noise_dps_rthz),
        (accel, spec.accel_noise_mps2_rthz),
    ):
        means = output.reshape(3000, 100, 3).mean(axis=1)
        # Non-overlapping pairs are independent: an exact chi-square.
        assert_variance((means[1::2] - means[::2]) / math.sqrt(2.0), density**2)


def test_turn_on_bias_and_its_history_are_what_the_unit_reports() -> None:
    spec = graded("mems-consumer", rate_hz=10.0).modelled_only()
    first = np.array([still(spec, 1.0, seed)[2][0] for seed in range(200)])
    assert_variance(first / DEG, spec.gyro_bias_sd_dps**2)
    gyro, accel, gyro_bias, accel_bias = still(spec, 2000.0)
    white = gyro - gyro_bias
    assert_variance(white / DEG, spec.gyro_noise_dps_rthz**2 * spec.rate_hz)
    assert_variance(accel - accel_bias, spec.accel_noise_mps2_rthz**2 * spec.rate_hz)
    steps = np.diff(gyro_bias, axis=0) / DEG
    assert_variance(steps, spec.gyro_bias_walk_dps_rts**2 / spec.rate_hz)


def test_outputs_are_quantised_and_saturate() -> None:
    spec = ImuSpec(gyro_step_dps=0.5, gyro_range_dps=100.0, accel_range_mps2=20.0)
    ideal = np.array([[2.0, -0.03, 0.01], [0.0, 0.0, -3.0]])
    gyro, accel, _, _ = measure(spec, np.random.default_rng(0), ideal, ideal * 15.0, ideal[:, 0])
    np.testing.assert_allclose(gyro / DEG, [[100.0, -1.5, 0.5], [0.0, 0.0, -100.0]], atol=1e-12)
    np.testing.assert_allclose(accel, [[20.0, -0.45, 0.15], [0.0, 0.0, -20.0]], atol=1e-12)


def test_scale_factor_and_misalignment_have_their_spread() -> None:
    spec = ImuSpec(accel_scale_ppm=1000.0, accel_misalignment_mrad=2.0)
    axis = np.array([[0.0, 0.0, 10.0]])
    zero = axis[:, 0]
    runs = [measure(spec, np.random.default_rng(s), axis, axis, zero) for s in range(300)]
    out = np.array([accel[0] for _, accel, _, _ in runs])
    assert_variance(out[:, 2] - 10.0, (10.0 * 1e-3) ** 2)
    assert_variance(out[:, :2], (10.0 * 2e-3) ** 2)


def test_a_perfect_integrating_unit_loses_no_motion() -> None:
    imu = graded("perfect", rate_hz=50.0, output="integral")
    sim = run(Scenario(trajectory=MISSION, imu=(imu,)), 4)
    block = sim.recording.imu[0]
    t = (block.t_ns - sim.t0_ns) / NS
    np.testing.assert_allclose(block.interval_s[1:], np.diff(t), atol=1e-12)
    gyro, accel = sim.trajectory.inertial_means(t, block.interval_s)
    assert np.array_equal(block.gyro_b, gyro)
    assert np.array_equal(block.accel_b, accel)


def test_vibration_comes_with_the_motors() -> None:
    imu = graded("perfect", rate_hz=200.0, vibration_mps2=0.5)
    sim = run(Scenario(trajectory=MISSION, imu=(imu,)), 4)
    block = sim.recording.imu[0]
    t = (block.t_ns - sim.t0_ns) / NS
    shaking = block.accel_b - sim.trajectory.inertial(t)[1]
    assert not shaking[t < 8.0].any()
    flying = shaking[(t > 11.0) & (t < 100.0)]
    # Bandwidth 8 Hz: about 2 · 8 · 89 s independent samples an axis.
    assert_variance(flying, 0.25, effective=3 * 1424)


def test_a_late_unit_stamps_after_it_measures() -> None:
    imu = graded("perfect", rate_hz=100.0, latency_ms=10.0)
    sim = run(Scenario(trajectory=MISSION, imu=(imu,)), 4)
    block = sim.recording.imu[0]
    gyro, _ = sim.trajectory.inertial((block.t_ns - sim.t0_ns) / NS - 0.01)
    assert np.array_equal(block.gyro_b, gyro)
    assert np.isnan(block.interval_s).all()


# --------------------------------------------------------------------------- GNSS


def test_white_gnss_errors_have_the_sizes_that_are_reported() -> None:
    spec = GnssSpec(rate_hz=10.0, correlated_sd_position_m=0.0, correlated_sd_height_m=0.0)
    sim = run(Scenario(trajectory=MISSION, gnss=(spec,)), 6)
    position, velocity = fix_errors(sim)
    gnss = sim.recording.gnss[0]
    assert_variance(position / gnss.sd_pos, 1.0)
    assert_variance(velocity / gnss.sd_vel, 1.0)
    assert gnss.sd_pos[0].tolist() == [0.5, 0.5, 0.9]


def test_correlated_gnss_error_has_its_size_over_many_seeds() -> None:
    spec = GnssSpec(rate_hz=1.0)
    static = TrajectorySpec(kind="static", duration_s=2.0)
    last = [
        fix_errors(run(Scenario(trajectory=static, gnss=(spec,)), seed))[0][-1]
        for seed in range(150)
    ]
    horizontal, vertical = spec.total_sd_m
    assert_variance(np.array(last) / [horizontal, horizontal, vertical], 1.0)


def test_the_antenna_moves_with_its_lever_arm() -> None:
    lever = (0.8, -0.3, -0.5)
    spec = GnssSpec(
        sd_position_m=0.0,
        sd_height_m=0.0,
        correlated_sd_position_m=0.0,
        correlated_sd_height_m=0.0,
        sd_velocity_mps=0.0,
        sd_velocity_down_mps=0.0,
        lever_arm_b_m=lever,
    )
    sim = run(Scenario(trajectory=MISSION, gnss=(spec,)), 8)
    position, _ = fix_errors(sim)
    gnss = sim.recording.gnss[0]
    t = (gnss.t_ns - sim.t0_ns) / NS
    expected = sim.trajectory.states(t).C_nb @ np.array(lever)
    # First-order geodesy over a metre.
    np.testing.assert_allclose(position, expected, atol=1e-6)
    # The velocity is that of the moving antenna: its change between 2 ms before and after.
    arms = [sim.trajectory.states(t + dt) for dt in (-0.002, 0.002)]
    arm_rate = (arms[1].C_nb @ np.array(lever) - arms[0].C_nb @ np.array(lever)) / 0.004
    np.testing.assert_allclose(gnss.vel_n - sim.trajectory.states(t).vel_n, arm_rate, atol=2e-5)


def receiver(**fields: object) -> tuple[GnssSamples, F64]:
    """Fixes of a receiver and the seconds of their stamps."""
    spec = msgspec.convert(fields, GnssSpec)
    sim = run(Scenario(trajectory=MISSION, gnss=(spec,)), 9)
    gnss = sim.recording.gnss[0]
    return gnss, (gnss.t_ns - sim.t0_ns) / NS


def test_latency_separates_validity_and_arrival() -> None:
    gnss, t = receiver(latency_ms=120.0)
    assert np.all(gnss.t_rx_ns - gnss.t_ns == 120_000_000)
    np.testing.assert_allclose(t, np.arange(len(t)) * 0.2, atol=1e-9)
    stamped, late = receiver(latency_ms=120.0, stamped="arrival")
    assert np.array_equal(stamped.t_ns, stamped.t_rx_ns)
    np.testing.assert_allclose(late - t, 0.12, atol=1e-9)
    assert np.array_equal(stamped.lat, gnss.lat)


def test_jitter_keeps_the_order_of_arrival() -> None:
    gnss, _ = receiver(latency_ms=100.0, latency_jitter_ms=600.0)
    delay = (gnss.t_rx_ns - gnss.t_ns) / NS
    assert delay.min() >= 0.1
    assert delay.max() > 0.5
    assert np.all(np.diff(gnss.t_rx_ns) >= 0)
    assert np.all(np.diff(gnss.seq) > 0)


def test_outages_are_silent_or_say_so() -> None:
    outage = [{"start_s": 40.0, "length_s": 10.0}]
    silent, t = receiver(outages=outage)
    assert not np.any((t >= 40.0) & (t < 50.0))
    assert np.diff(t).max() == pytest.approx(10.2)
    telling, t = receiver(outages=outage, during_outage="no-fix")
    out = (t >= 40.0) & (t < 50.0)
    assert np.count_nonzero(out) == 50
    assert np.all(telling.fix_type[out] < 2)
    assert np.isnan(telling.lat[out]).all()
    assert np.isnan(telling.vel_n[out]).all()
    # The outage changes nothing about the other fixes.
    assert np.array_equal(telling.lat[~out], silent.lat)
    assert np.all(silent.fix_type == 3)


def test_glitches_and_ramps_add_to_position_alone() -> None:
    glitch = Fault(start_s=20.0, length_s=3.0, step_n_m=(30.0, -10.0, 5.0))
    ramp = Fault(start_s=60.0, length_s=40.0, ramp_n_mps=(0.0, 1.0, 0.0))
    clean = run(Scenario(trajectory=MISSION), 3)
    faulty = run(Scenario(trajectory=MISSION, gnss=(GnssSpec(faults=(glitch, ramp)),)), 3)
    error = fix_errors(faulty)[0] - fix_errors(clean)[0]
    t = np.arange(len(error)) * 0.2
    expected = np.zeros_like(error)
    expected[(t > 19.9) & (t < 22.9)] = [30.0, -10.0, 5.0]
    ramping = (t > 59.9) & (t < 99.9)
    expected[ramping, 1] = t[ramping] - 60.0
    np.testing.assert_allclose(error, expected, atol=1e-2)
    assert np.array_equal(faulty.recording.gnss[0].vel_n, clean.recording.gnss[0].vel_n)


def test_a_receiver_can_claim_more_than_it_gives() -> None:
    honest, _ = receiver()
    boasting, _ = receiver(reported_factor=0.1)
    np.testing.assert_allclose(boasting.sd_pos, 0.1 * honest.sd_pos)
    assert np.array_equal(boasting.lat, honest.lat)


# --------------------------------------------------------------------------- baro, mag, seeds


def test_pressure_is_the_standard_atmosphere() -> None:
    # ICAO Doc 7488: 89874.6 Pa at 1000 m, 54019.9 Pa at 5000 m geopotential height.
    np.testing.assert_allclose(
        isa_pressure(np.array([0.0, 1000.0, 5000.0])), [101325.0, 89874.6, 54019.9], rtol=2e-6
    )


def heights(spec: BaroSpec, seed: int, seconds: float = 600.0) -> F64:
    """Pressure heights of a resting barometer over the true one [m]."""
    trajectory = msgspec.structs.replace(STATIC, duration_s=seconds)
    measured = run(Scenario(trajectory=trajectory, baro=spec), seed).recording.baro[0].pressure
    # The standard atmosphere inverted: h = T0 / L (1 − (p / p0)^(1 / 5.255876)).
    height = 288.15 / 0.0065 * (1.0 - (measured / 101325.0) ** (1.0 / 5.255876))
    return np.asarray(height - trajectory.height_hae_m)


def test_baro_noise_and_drift_are_as_specified() -> None:
    white = heights(BaroSpec(sd_m=0.3, walk_m_rts=0.0), 2)
    assert_variance(white - white.mean(), 0.09, effective=len(white) - 1)
    walk = heights(BaroSpec(sd_m=0.0, walk_m_rts=0.05), 2)
    assert_variance(np.diff(walk), 0.05**2 / 10.0)
    offsets = np.array([heights(BaroSpec(), seed, 1.0)[0] for seed in range(60)])
    assert_variance(offsets, 20.0**2 + 0.3**2)


def test_magnetometer_sees_the_world_magnetic_model_and_hard_iron() -> None:
    iron = (1e-6, -2e-6, 5e-7)
    sim = run(Scenario(trajectory=STATIC, mag=MagSpec(sd_t=0.0, hard_iron_t=iron)), 2)
    block = sim.recording.mag[0]
    C_nb = sim.trajectory.states(np.zeros(1)).C_nb[0]
    field_n = C_nb @ (block.field_b[0] - iron)
    # Zürich in 2025: 3.5° declination, 64° inclination, 48.5 µT, by any WMM calculator.
    assert math.degrees(math.atan2(field_n[1], field_n[0])) == pytest.approx(3.5, abs=0.4)
    assert np.linalg.norm(field_n) == pytest.approx(48.5e-6, rel=0.01)


def test_seeds_decide_everything_and_sensors_do_not_disturb_each_other() -> None:
    plain = run(Scenario(trajectory=MISSION), 1).recording
    again = run(Scenario(trajectory=MISSION), 1).recording
    other = run(Scenario(trajectory=MISSION), 2).recording
    richer = run(Scenario(trajectory=MISSION, baro=BaroSpec(), mag=MagSpec()), 1).recording
    assert np.array_equal(plain.imu[0].accel_b, again.imu[0].accel_b)
    assert np.array_equal(plain.gnss[0].lat, again.gnss[0].lat)
    assert not np.array_equal(plain.gnss[0].lat, other.gnss[0].lat)
    assert np.array_equal(plain.gnss[0].lat, richer.gnss[0].lat)
    assert np.array_equal(plain.imu[0].accel_b, richer.imu[0].accel_b)


def test_a_fixed_trajectory_seed_varies_the_errors_only() -> None:
    fixed = msgspec.structs.replace(MISSION, seed=42)
    one, two = (run(Scenario(trajectory=fixed), seed).recording for seed in (1, 2))
    assert one.truth is not None
    assert two.truth is not None
    assert np.array_equal(one.truth.vel_n, two.truth.vel_n)
    assert not np.array_equal(one.imu[0].gyro_b, two.imu[0].gyro_b)


def test_arrival_numbers_follow_arrival_over_all_streams() -> None:
    scenario = Scenario(
        trajectory=MISSION,
        baro=BaroSpec(),
        mag=MagSpec(),
        gnss=(GnssSpec(outages=(Outage(start_s=30.0, length_s=5.0),)),),
    )
    r = run(scenario, 1).recording
    blocks = [*r.imu, *r.gnss, *r.baro, *r.mag, r.truth]
    seq = np.concatenate([b.seq for b in blocks if b is not None])
    rx = np.concatenate([b.t_rx_ns for b in blocks if b is not None])
    order = np.argsort(seq)
    assert np.array_equal(seq[order], np.arange(len(seq)))
    assert np.all(np.diff(rx[order]) >= 0)


def test_every_grade_is_finite_and_named() -> None:
    for name, spec in IMU_GRADES.items():
        assert spec.grade == name
        assert all(np.isfinite(column).all() for column in still(spec, 1.0))
