"""F and every H of the direct filter by central differences through its own ⊞."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from companion.estimation import parameters as common
from companion.estimation.direct import aids, inertial
from companion.estimation.direct import layout as lo
from companion.estimation.direct import parameters as par
from companion.estimation.direct.motion import carry, spread
from companion.estimation.direct.ranges import satellite
from companion.estimation.direct.update import WIDTH
from companion.gnss.corrected import ROW_SIZE, S_SYSTEM
from companion.navigation.earth import ecef
from companion.navigation.rotation import matrix_from_quat, rpy_from_quat
from companion.types import F64, I64

from .states import CONFIG, LAY, LAYOUT, STEP, box_minus, covariance, moved, random_state

Model = Callable[[F64, F64, F64, I64, F64], int]
"""(state, C_nb, H, cols, y) → columns."""
PAR = par.parameter_vector(CONFIG)
UNITS = par.units(CONFIG)


def _innovation(s: F64, model: Model) -> tuple[F64, F64]:
    """Dense H (3, n) and y (3,)."""
    H, cols, y = np.zeros((3, WIDTH)), np.zeros(WIDTH, np.int64), np.zeros(3)
    nc = model(s, matrix_from_quat(s[:4]), H, cols, y)
    assert nc > 0
    dense = np.zeros((3, LAYOUT.n))
    for c in range(nc):
        dense[:, cols[c]] += H[:, c]
    return dense, y


def _check(s: F64, m: int, model: Model, tolerance: float) -> None:
    H, _ = _innovation(s, model)
    numeric = np.empty((m, LAYOUT.n))
    for j in range(LAYOUT.n):
        ends = [_innovation(moved(s, j, x), model)[1][:m] for x in (STEP[j], -STEP[j])]
        numeric[:, j] = -(ends[0] - ends[1]) / (2 * STEP[j])
    assert np.abs(H[:m] - numeric).max() < tolerance


@pytest.mark.parametrize("seed", range(4))
def test_aids(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = random_state(rng)
    lever = PAR[par.LEVER : par.LEVER + 3]
    place = s[lo.LAT : lo.LAT + 3] + np.array([1e-6, -1e-6, 3.0])
    rpy = rpy_from_quat(s[:4]) + rng.normal(0, 0.1, 3)
    # East metres per radian change with latitude: 8 m of innovation over R · tan φ.
    _check(s, 3, lambda x, C, H, k, y: aids.position(x, LAY, C, lever, place, H, k, y), 1e-5)
    z = np.array([3.0, 2.0, 1.0])
    _check(s, 3, lambda x, C, H, k, y: aids.velocity(x, C, lever, z, H, k, y), 1e-7)
    _check(s, 1, lambda x, _, H, k, y: aids.pressure_height(x, LAY, 50.0, H, k, y), 1e-7)
    field = matrix_from_quat(s[:4]).T @ np.array([0.2, 0.05, 0.4])
    _check(s, 1, lambda _, C, H, k, y: aids.direction(C, *field, 0.3, H, k, y), 1e-6)
    _check(s, 2, lambda x, C, H, k, y: aids.sideways(x, C, H, k, y), 1e-6)
    _check(s, 1, lambda x, C, H, k, y: aids.lateral(x, C, H, k, y), 1e-6)
    # H = I is exact at zero difference only: half of it, 0.1 rad, enters as a turn of the axes.
    _check(s, 3, lambda x, C, H, k, y: aids.attitude(x, LAY, C, rpy, H, k, y), 0.15)
    same = rpy_from_quat(s[:4])
    _check(s, 3, lambda x, C, H, k, y: aids.attitude(x, LAY, C, same, H, k, y), 1e-6)


@pytest.mark.parametrize("system", range(3))
def test_ranges(system: int) -> None:
    s = random_state(np.random.default_rng(system))
    lever = PAR[par.LEVER : par.LEVER + 3]
    here = ecef(s[lo.LAT : lo.LAT + 1], s[lo.LON : lo.LON + 1], s[lo.HEIGHT : lo.HEIGHT + 1])[0]
    # 20 000 km away, 30 to 60 degrees up, and crossing at 3 km/s.
    aside = np.cross(here, [0.3, -0.5, 0.8])
    ahead = here / np.linalg.norm(here) + aside / np.linalg.norm(aside)
    row = np.zeros(ROW_SIZE)
    row[:3] = here + 2e7 * ahead / np.linalg.norm(ahead)
    row[3:6] = 3e3 * np.cross(row[:3], here) / np.linalg.norm(np.cross(row[:3], here))
    row[S_SYSTEM] = system
    for rate in (False, True):
        # A metre turns the line of sight by 5e-8: 25 m of altitude in the troposphere's 2.3 m.
        _check(
            s, 1, lambda x, C, H, k, y, r=rate: satellite(x, LAY, C, lever, row, r, H, k, y), 1e-3
        )


@pytest.mark.parametrize("unit", range(3))
def test_inertial_units(unit: int) -> None:
    s = random_state(np.random.default_rng(unit))
    z = np.array([0.1, -0.3, 0.2])

    def gyro(x: F64, C: F64, H: F64, cols: I64, y: F64) -> int:
        inertial.rate(x, unit, C, z, H, cols, y)
        return 9

    def accelerometer(x: F64, C: F64, H: F64, cols: I64, y: F64) -> int:
        inertial.force(x, unit, UNITS[unit], C, z, H, cols, y, np.zeros(3))
        return 15

    # Left out on purpose: Earth's rate turned by attitude, 7e-5 rad/s; Coriolis, 1.5e-4 per m/s.
    _check(s, 3, gyro, 1e-4)
    _check(s, 3, accelerometer, 3e-4)


@pytest.mark.parametrize("seed", range(4))
def test_propagation_is_f_p_f_transposed_plus_noise_that_is_definite(seed: int) -> None:
    s = random_state(np.random.default_rng(seed))
    dt, n = 0.1, LAYOUT.n
    slow = par.slow_errors(CONFIG, LAYOUT)

    def ahead(x: F64) -> F64:
        x = x.copy()
        carry(x, LAY, PAR, slow, dt)
        return x

    F = np.empty((n, n))
    for j in range(n):
        ends = [ahead(moved(s, j, x)) for x in (STEP[j], -STEP[j])]
        F[:, j] = box_minus(*ends) / (2 * STEP[j])
    out = s.copy()
    spread(out, LAY, PAR, slow, dt, np.zeros((9, n)))
    Q = covariance(out) - F @ covariance(s) @ F.T
    silent = s.copy()
    without = PAR.copy()
    without[par.JERK_PSD : par.ACC_TAU] = 0.0
    without[common.CLOCK_PSD : common.CLOCK_RAMP_TAU] = 0.0
    spread(silent, LAY, without, slow * [[1], [0]], dt, np.zeros((9, n)))
    # Position in metres is carried at one radius of curvature and latitude: 1e-7 of 2 m.
    assert np.abs(covariance(silent) - F @ covariance(s) @ F.T).max() < 1e-5
    assert np.linalg.eigvalsh(0.5 * (Q + Q.T)).min() > -1e-5
    assert np.array_equal(covariance(out), covariance(out).T)
