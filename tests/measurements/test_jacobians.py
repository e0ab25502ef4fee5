"""Every H by central differences through the ⊞ of the filter, at random seeded states."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.gnss.geometry import ned_axes
from companion.measurements.barometer import height, pressure_height
from companion.measurements.gnss import position, velocity
from companion.measurements.heading import direction
from companion.measurements.non_holonomic import sideways
from companion.measurements.pseudorange import VIEW_SIZE, look, range_innovation, rate_innovation
from companion.measurements.standstill import zero_rate, zero_velocity
from companion.navigation import earth
from companion.navigation import layout as lo
from companion.navigation.error_model import box_plus
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64

ALL = lo.Layout.build(scale=True, lever=True, baro=True, gnss=True, clock=True)
LAY = ALL.vector()
STEP = np.full(ALL.n, 1e-4)
STEP[:3] = 1.0
Model = Callable[[F64, F64, F64], int]


def _state(seed: int) -> F64:
    rng = np.random.default_rng(seed)
    s = np.zeros(ALL.size)
    s[:4] = quat_from_rpy(*rng.uniform([-0.6, -0.6, -3.1], [0.6, 0.6, 3.1]))
    s[lo.LAT], s[lo.LON], s[lo.HEIGHT] = rng.uniform([-1.2, -3.1, 0], [1.2, 3.1, 3000])
    for offset, size in (
        (lo.VEL_N, 15), (lo.ACCEL_BIAS_B, 0.1), (lo.GYRO_BIAS_B, 0.01), (lo.LEVER_B, 2),
        (lo.GNSS_BIAS, 2), (lo.LAST_GYRO, 0.7),
        (lo.GYRO_SCALE_B, 0.005),
    ):  # fmt: skip
        s[offset : offset + 3] = rng.normal(0, size, 3)
    s[lo.BARO_BIAS] = rng.normal(0, 20)
    s[lo.EARTH_RATE] = earth.RATE
    return s


def _check(s: F64, model: Model, tolerance: float) -> F64:
    """H of ``model`` against −∂y/∂x; returns the innovation."""
    H, y = np.zeros((3, ALL.n)), np.zeros(3)
    m = model(s, H, y)
    assert m > 0
    numeric = np.empty((m, ALL.n))
    for j in range(ALL.n):
        ends = []
        for sign in (1.0, -1.0):
            moved, dx, out = s.copy(), np.zeros(ALL.n), np.zeros(3)
            dx[j] = sign * STEP[j]
            box_plus(moved, LAY, dx)
            model(moved, np.zeros((3, ALL.n)), out)
            ends.append(out[:m])
        numeric[:, j] = -(ends[0] - ends[1]) / (2 * STEP[j])
    assert np.abs(H[:m] - numeric).max() < tolerance
    return y


@pytest.mark.parametrize("seed", range(6))
def test_gnss_position(seed: int) -> None:
    s = _state(seed)
    z = s[lo.LAT : lo.LAT + 3] + np.array([1e-6, -1e-6, 3.0])

    def model(x: F64, H: F64, y: F64) -> int:
        position(x, LAY, matrix_from_quat(x[:4]), z, H, y)
        return 3

    # East metres per radian change with latitude: the 8 m of innovation over R · tan φ.
    _check(s, model, 1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_gnss_velocity(seed: int) -> None:
    def model(x: F64, H: F64, y: F64) -> int:
        velocity(x, LAY, matrix_from_quat(x[:4]), np.array([3.0, 2.0, 1.0]), H, y)
        return 3

    _check(_state(seed), model, 1e-6)


def test_gnss_of_the_antenna_of_a_turning_body() -> None:
    """A mast 2 m ahead, turning right at 0.5 rad/s while nose north: 1 m/s east, 2 m north."""
    s = _state(0)
    s[:4] = [1, 0, 0, 0]
    for offset in (lo.VEL_N, lo.GYRO_BIAS_B, lo.GYRO_SCALE_B, lo.GNSS_BIAS):
        s[offset : offset + 3] = 0
    s[lo.LEVER_B : lo.LEVER_B + 3] = [2, 0, 0]
    s[lo.LAST_GYRO : lo.LAST_GYRO + 3] = [0, 0, 0.5]
    H, y = np.zeros((3, ALL.n)), np.zeros(3)
    velocity(s, LAY, np.eye(3), np.zeros(3), H, y)
    assert np.allclose(y, [0, -1, 0])
    position(s, LAY, np.eye(3), s[lo.LAT : lo.LAT + 3].copy(), H, y)
    assert np.allclose(y, [-2, 0, 0], atol=1e-8)


def test_innovation_is_short_across_the_date_line() -> None:
    s = _state(1)
    s[lo.LON], s[lo.LEVER_B : lo.LEVER_B + 3], s[lo.GNSS_BIAS : lo.GNSS_BIAS + 3] = math.pi, 0, 0
    z = s[lo.LAT : lo.LAT + 3].copy()
    z[1] = -math.pi + 1e-6
    y = np.zeros(3)
    position(s, LAY, np.eye(3), z, np.zeros((3, ALL.n)), y)
    assert 0 < y[1] < 6.4


@pytest.mark.parametrize("seed", range(6))
def test_barometer(seed: int) -> None:
    def model(x: F64, H: F64, y: F64) -> int:
        height(x, LAY, 100.0, H, y)
        return 1

    _check(_state(seed), model, 1e-8)


def test_pressure_height_is_the_standard_atmosphere() -> None:
    found = pressure_height(np.array([101325.0, 89874.6, 54019.9, -1.0, np.nan]))
    # ICAO Doc 7488: 1000 m and 5000 m; the table is rounded to 0.1 Pa.
    assert np.allclose(found[:3], [0.0, 1000.0, 5000.0], atol=0.2)
    assert np.isnan(found[3:]).all()


@pytest.mark.parametrize("seed", range(6))
def test_heading_direction(seed: int) -> None:
    """Where the vector points to the azimuth it should have: that is where H is taken."""
    s = _state(seed)
    u = matrix_from_quat(s[:4]) @ np.array([0.9, 0.3, 0.8])
    azimuth = float(np.arctan2(u[1], u[0]))

    def model(x: F64, H: F64, y: F64) -> int:
        return int(direction(LAY, matrix_from_quat(x[:4]), 0.9, 0.3, 0.8, azimuth, H, y))

    _check(s, model, 1e-6)


def test_noise_of_the_field_does_not_lean_on_the_tilt() -> None:
    """At a dip of 63° and 1° of noise, Σ Hᵀ y over many samples is zero within 5 σ.

    With the measured direction in H it would be 2 σ² a sample, a dozen times as far from zero.
    """
    count, sd = 4000, np.radians(1.0)
    noise = np.random.default_rng(3).normal(0.0, sd, (count, 3))
    C = matrix_from_quat(np.array([1.0, 0.0, 0.0, 0.0]))
    H, y, leaning = np.zeros((3, ALL.n)), np.zeros(3), np.zeros(3)
    for n in noise:
        assert direction(LAY, C, 1.0 + n[0], n[1], 2.0 + n[2], 0.0, H, y)
        leaning += y[0] * H[0, lo.ATT : lo.ATT + 3]
    assert np.all(np.abs(leaning) < 5.0 * np.sqrt(count) * sd * np.array([2.0, 2.0 * sd, 1.0]))


def test_a_steep_vector_gives_no_heading() -> None:
    H, y = np.zeros((3, ALL.n)), np.zeros(3)
    assert not direction(LAY, np.eye(3), 0.05, 0.0, 1.0, 0.0, H, y)
    assert not direction(LAY, np.eye(3), 0.0, 0.0, 0.0, 0.0, H, y)
    assert direction(LAY, np.eye(3), 0.5, 0.0, 1.0, 3.1, H, y)
    assert y[0] == pytest.approx(3.1)


@pytest.mark.parametrize("seed", range(6))
def test_non_holonomic(seed: int) -> None:
    def model(x: F64, H: F64, y: F64) -> int:
        sideways(x, LAY, matrix_from_quat(x[:4]), -1.2, 0.3, 0.5, H, y)
        return 2

    # The attitude step's own curvature on 40 m/s.
    _check(_state(seed), model, 1e-5)


@pytest.mark.parametrize("seed", range(3))
def test_zero_velocity(seed: int) -> None:
    def model(x: F64, H: F64, y: F64) -> int:
        zero_velocity(x, LAY, H, y)
        return 3

    _check(_state(seed), model, 1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_zero_rate(seed: int) -> None:
    k = np.zeros(lo.INT_SIZE, np.int64)
    k[lo.STILL_COUNT] = 4

    def model(x: F64, H: F64, y: F64) -> int:
        zero_rate(x, k, LAY, matrix_from_quat(x[:4]), H, y)
        return 3

    # Earth rate through the attitude is left out of H: 7.3e-5 rad/s for a radian.
    _check(_state(seed), model, 1e-4)


def test_zero_rate_sees_bias_beside_earth_rate() -> None:
    s = _state(2)
    k = np.zeros(lo.INT_SIZE, np.int64)
    k[lo.STILL_COUNT] = 4
    C = matrix_from_quat(s[:4])
    bias = s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3]
    s[lo.STILL_RING + 36 : lo.STILL_RING + 39] = bias + C.T @ earth.earth_rate_n(s[lo.LAT])
    H, y = np.zeros((3, ALL.n)), np.ones(3)
    zero_rate(s, k, LAY, C, H, y)
    assert np.abs(y).max() < 1e-15


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("system", [0, 1, 2])
def test_pseudorange_and_rate(seed: int, system: int) -> None:
    s = _state(seed)
    rng = np.random.default_rng(seed + 50)
    s[lo.CLOCK : lo.CLOCK + 4] = rng.normal(0, [1e4, 50, 5, 5])
    axes, place = np.empty((3, 3)), np.empty(3)
    ned_axes(s[lo.LAT], s[lo.LON], axes)
    place[:] = earth.ecef(s[lo.LAT : lo.LAT + 1], s[lo.LON : lo.LON + 1], s[[lo.HEIGHT]])[0]
    azimuth, elevation = rng.uniform(-3, 3), rng.uniform(0.2, 1.4)
    flat = math.cos(elevation)
    line = np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), -math.sin(elevation)])
    row = np.zeros(12)
    row[:3] = place + 2.2e7 * (axes.T @ line)
    row[3:6] = rng.normal(0, 2e3, 3)
    row[6], row[7], row[10] = 2.2e7, -300.0, system

    def model(state: F64, H: F64, y: F64) -> int:
        J, view, axes = np.empty((6, ALL.n)), np.empty(VIEW_SIZE), np.empty((3, 3))
        look(state, LAY, matrix_from_quat(state[:4]), axes, J, view)
        y[0] = range_innovation(state, LAY, axes, J, view, row, H[0])
        y[1] = rate_innovation(state, LAY, axes, J, view, row, H[1])
        return 2

    # Ranges of 2e7 m round at 4e-9 m, differences over 2e-4 rad and more at 4e-5. What is left out:
    # Sagnac, 7e-6 of a position; troposphere, 3e-4 of a height at 20 degrees and more lower down.
    _check(s, model, 2e-3)
