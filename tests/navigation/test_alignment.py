"""Levelling, its correlation with the accelerometer bias, and heading from the field."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.navigation.alignment import attitude_covariance, heading_from_field, level
from companion.navigation.rotation import attitude_error_n, matrix_from_quat, quat_from_rpy
from companion.types import F64

G = 9.81


def _level(force_b: F64, rng: np.random.Generator, rate_b: F64 | None = None, slope: float = 0.0):  # type: ignore[no-untyped-def]
    t = np.arange(101) * 10_000_000
    imu = np.zeros((101, 7))
    imu[:, :3] = (np.zeros(3) if rate_b is None else rate_b) + rng.normal(0, 1e-3, (101, 3))
    imu[:, 3:6] = force_b + rng.normal(0, 0.01, (101, 3))
    imu[:, 3] += slope * t * 1e-9
    return level(
        t, imu, spread_gyro=0.01, spread_accel=0.1, may_be_static=True, gyro_psd=1e-8,
        accel_psd=1e-6, prior_bias=np.zeros(3), prior_var=np.full(3, 1e-4),
        accel_bias=np.zeros(3),
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(8))
def test_levelling_finds_roll_and_pitch(seed: int) -> None:
    rng = np.random.default_rng(seed)
    roll, pitch = rng.uniform(-1, 1, 2)
    C = matrix_from_quat(quat_from_rpy(roll, pitch, rng.uniform(-3, 3)))
    rate = rng.normal(0, 0.01, 3)
    found = _level(C.T @ [0, 0, -G], rng, rate)
    # Mean of 101 samples of 0.01 m/s²: 1e-4 rad, five sigma.
    assert found.roll == pytest.approx(roll, abs=6e-4 / math.cos(pitch))
    assert found.pitch == pytest.approx(pitch, abs=5e-4)
    assert found.static
    assert np.allclose(found.gyro_bias_b, rate, atol=5e-4)


def test_a_window_in_motion_says_nothing_of_the_gyro() -> None:
    found = _level(np.array([0, 0, -G]), np.random.default_rng(0), np.full(3, 0.01), slope=0.5)
    assert not found.static
    assert np.array_equal(found.gyro_bias_b, np.zeros(3))
    assert found.tilt_var > math.radians(5) ** 2


@pytest.mark.parametrize("seed", range(5))
def test_correlation_of_tilt_and_accelerometer_bias_by_simulation(seed: int) -> None:
    """Level many biased sensors: the sample covariance of (φ, b) is the one claimed, signs too."""
    rng = np.random.default_rng(seed)
    truth = quat_from_rpy(*rng.uniform([-0.3, -0.3, -3], [0.3, 0.3, 3]))
    roll, pitch, yaw = 0.0, 0.0, 0.0
    sd, count = 0.05, 4000
    C = matrix_from_quat(truth)
    both = np.empty((count, 6))
    yaw = math.atan2(C[1, 0], C[0, 0])
    for i in range(count):
        b = rng.normal(0, sd, 3)
        f = C.T @ [0, 0, -G] + b
        roll, pitch = math.atan2(-f[1], -f[2]), math.atan2(f[0], math.hypot(f[1], f[2]))
        both[i, :3] = attitude_error_n(truth, quat_from_rpy(roll, pitch, yaw))
        both[i, 3:] = b
    P, cross = attitude_covariance(truth, np.full(3, sd**2), 0.0, 0.0, G)
    sample = both.T @ both / count
    # 4000 draws give 1/√4000 of each entry's size; five sigma and 1 % of curvature.
    scale = sd * sd / G
    assert np.abs(sample[:2, 3:] - cross[:2]).max() < (5 / math.sqrt(count) + 0.02) * scale
    assert np.abs(sample[:2, :2] - P[:2, :2]).max() < (5 / math.sqrt(count) + 0.02) * scale / G


@pytest.mark.parametrize("seed", range(8))
def test_heading_from_the_field_and_its_slope_with_tilt(seed: int) -> None:
    rng = np.random.default_rng(seed)
    roll, pitch, yaw = rng.uniform([-0.5, -0.5, -3.1], [0.5, 0.5, 3.1])
    declination = rng.uniform(-0.3, 0.3)
    field_n = 5e-5 * np.array([0.4 * math.cos(declination), 0.4 * math.sin(declination), 0.9])
    C = matrix_from_quat(quat_from_rpy(roll, pitch, yaw))
    found, slope = heading_from_field(roll, pitch, C.T @ field_n, declination)
    assert math.remainder(found - yaw, 2 * math.pi) == pytest.approx(0, abs=1e-12)
    # A small tilt error: φ_D of the resulting attitude follows from φ_N, φ_E by the slope.
    for dr, dp in ((1e-4, 0.0), (0.0, 1e-4)):
        wrong, _ = heading_from_field(roll + dr, pitch + dp, C.T @ field_n, declination)
        phi = attitude_error_n(
            quat_from_rpy(roll, pitch, yaw), quat_from_rpy(roll + dr, pitch + dp, wrong)
        )
        assert phi[2] == pytest.approx(slope[0] * phi[0] + slope[1] * phi[1], abs=1e-7)


def test_tilt_goes_into_heading_through_the_dip() -> None:
    """2° of tilt at a slope of 2 are 4° of heading, fully correlated."""
    q = quat_from_rpy(0, 0, 0)
    P, cross = attitude_covariance(q, np.full(3, 0.01), 0.0, 1e-6, G, (2.0, 0.0))
    assert P[2, 2] == pytest.approx(4 * P[0, 0] + 1e-6)
    assert P[0, 2] == pytest.approx(2 * P[0, 0])
    assert np.allclose(cross[2], 2 * cross[0])
