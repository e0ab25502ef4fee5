"""Errors against the covariance that was claimed, where the truth moves as the model says.

Truth is drawn from the model itself, process noise and all, and measured by three units, GNSS and a
barometer with the noise that the filter is told: the normalised squared error of each 3-vector is
then χ² with 3 degrees of freedom, but for what linearisation costs.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from companion.estimation import parameters as common
from companion.estimation.aid_table import AID_SIZE, KIND_BARO, KIND_GNSS, KIND_IMU
from companion.estimation.direct import aids, inertial
from companion.estimation.direct import layout as lo
from companion.estimation.direct import parameters as par
from companion.estimation.direct.motion import carry, spread
from companion.estimation.direct.start import Setup
from companion.estimation.direct.update import WIDTH, box_plus
from companion.estimation.direct.walk import walk
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.update import REPORT_SIZE
from companion.estimation.walk import DONE
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64, NS

from .states import CONFIG, LAY, LAYOUT, box_minus, covariance

SEEDS, SECONDS, RATE_HZ = 20, 8, 20
STEP_NS = NS // RATE_HZ
BLOCKS = {
    "position": lo.POS,
    "velocity": lo.VEL,
    "acceleration": lo.ACC,
    "attitude": lo.ATT,
    "rate": lo.RATE,
    "gyro bias": lo.UNIT,
    "accelerometer bias": lo.UNIT + lo.ACCEL_BIAS,
}


def _start(rng: np.random.Generator) -> tuple[F64, F64]:
    """A believed state with its covariance, and a truth drawn from it."""
    s, _ = LAYOUT.blank()
    s[:4] = quat_from_rpy(*rng.uniform([-0.3, -0.3, -3.1], [0.3, 0.3, 3.1]))
    s[lo.LAT], s[lo.LON], s[lo.HEIGHT] = 0.8, 0.2, 300.0
    s[lo.VEL_N : lo.VEL_N + 3] = rng.normal(0, 10, 3)
    var = par.initial_variances(CONFIG, LAYOUT)
    var[LAYOUT.baro] = 100.0
    var[:15] = np.repeat([9.0, 0.25, 1.0, 0.02**2, 0.2**2], 3)
    covariance(s)[np.diag_indices(LAYOUT.n)] = var
    truth = s.copy()
    box_plus(truth, LAY, rng.normal(0.0, np.sqrt(var)))
    return s, truth


def _sample(truth: F64, unit: int, setup: Setup, rng: np.random.Generator) -> F64:
    """What a unit reads in a state: a zero reading differs from the prediction by minus it."""
    C, H, cols, y = (
        matrix_from_quat(truth[:4]),
        np.zeros((3, WIDTH)),
        np.zeros(WIDTH, int),
        np.zeros(3),
    )
    known, out = setup.units[unit], np.zeros(7)
    zero = np.zeros(3)
    inertial.rate(truth, unit, C, zero, H, cols, y)
    out[:3] = -y + rng.normal(0, np.sqrt(known[par.U_GYRO_PSD] / par.LONGEST_S), 3)
    inertial.force(truth, unit, known, C, zero, H, cols, y, np.zeros(3))
    out[3:6] = -y + rng.normal(0, np.sqrt(known[par.U_ACCEL_PSD] / par.LONGEST_S), 3)
    return out


def _fix(truth: F64, setup: Setup, rng: np.random.Generator) -> F64:
    C, H, cols, y = (
        matrix_from_quat(truth[:4]),
        np.zeros((3, WIDTH)),
        np.zeros(WIDTH, int),
        np.zeros(3),
    )
    row, lever = np.full(AID_SIZE, np.nan), setup.par[par.LEVER : par.LEVER + 3]
    aids.position(truth, LAY, C, lever, truth[lo.LAT : lo.LAT + 3], H, cols, y)
    off = -y + rng.normal(0, [1.5, 1.5, 3.0])
    there = truth.copy()
    box_plus(there, LAY, np.concatenate([off, np.zeros(LAYOUT.n - 3)]))
    row[:3] = there[lo.LAT : lo.LAT + 3]
    aids.velocity(truth, C, lever, np.zeros(3), H, cols, y)
    row[3:6] = -y + rng.normal(0, [0.2, 0.2, 0.3])
    row[6:12] = np.square([1.5, 1.5, 3.0, 0.2, 0.2, 0.3])
    return row


def _run(seed: int) -> tuple[F64, F64]:
    """NEES of each block at the end, and variances of the end over those of the start."""
    rng = np.random.default_rng(seed)
    setup = Setup(CONFIG)
    # Fixes aid and the clock runs free; no adaptation, or innovations would fit by construction.
    setup.ipar[common.TIGHT] = setup.ipar[common.ADAPTATION] = 0
    s, truth = _start(rng)
    first = np.diag(covariance(s)).copy()
    _, k = LAYOUT.blank()
    k[lo.T_NOW] = k[lo.T_IMU] = t0 = NS
    k[lo.T_OUTPUT] = t0 // int(setup.ipar[common.OUTPUT_NS])
    dt, n = 1.0 / RATE_HZ, LAYOUT.n
    count = SECONDS * RATE_HZ
    t = t0 + STEP_NS * np.arange(1, count + 1)
    first_unit = np.zeros((count, 7))
    rows: list[tuple[int, int, int, F64]] = []
    for i in range(count):
        noise = truth.copy()
        covariance(noise)[:] = 0.0
        spread(noise, LAY, setup.par, setup.slow, dt, np.zeros((9, n)))
        carry(truth, LAY, setup.par, setup.slow, dt)
        eigen, axes = np.linalg.eigh(covariance(noise)[:15, :15])
        moved = np.sqrt(np.diag(covariance(noise))) * rng.standard_normal(n)
        moved[:15] = axes @ (np.sqrt(np.maximum(eigen, 0)) * rng.standard_normal(15))
        box_plus(truth, LAY, moved)
        first_unit[i] = _sample(truth, 0, setup, rng)
        for unit in (1, 2):
            row = np.full(AID_SIZE, np.nan)
            row[:7] = _sample(truth, unit, setup, rng)
            rows.append((int(t[i]), KIND_IMU, unit - 1, row))
        if i % RATE_HZ == 0:
            rows.append((int(t[i]), KIND_GNSS, 0, _fix(truth, setup, rng)))
            row = np.full(AID_SIZE, np.nan)
            row[0] = truth[lo.HEIGHT] + truth[lo.BARO_BIAS] + rng.normal(0, 1.0)
            row[6] = 1.0
            rows.append((int(t[i]), KIND_BARO, 0, row))
    m = len(rows)
    at = np.array([0, count, 0, m, 0, 0, 0])
    code = walk(
        s, k, LAY, setup.par, setup.ipar, setup.units, setup.slow, t, first_unit,
        np.array([r[0] for r in rows]), np.array([r[1:3] for r in rows]),
        np.array([r[3] for r in rows]),
        np.zeros(4 * count, np.int64), np.zeros((4 * count, ROW_SIZE)),
        np.zeros(3 * count + 5 * m, np.int64), np.zeros((3 * count + 5 * m, REPORT_SIZE)),
        np.zeros((8, len(s))), np.zeros((8, len(k)), np.int64), np.zeros((count, 2), np.int64), at,
    )  # fmt: skip
    assert code == DONE
    error, P = box_minus(truth, s), covariance(s)
    nees = [
        error[a : a + 3] @ np.linalg.solve(P[a : a + 3, a : a + 3], error[a : a + 3])
        for a in BLOCKS.values()
    ]
    return np.array(nees), np.diag(P) / first


def test_errors_are_as_large_as_claimed_with_three_units() -> None:
    runs = [_run(seed) for seed in range(SEEDS)]
    mean = np.mean([nees for nees, _ in runs], axis=0)
    print(dict(zip(BLOCKS, mean.round(2).tolist(), strict=True)))
    # Two-sided 99.9 % for seven blocks together.
    low, high = chi2.ppf([0.0005 / 7, 1 - 0.0005 / 7], 3 * SEEDS) / SEEDS
    assert np.all((low < mean) & (mean < high))
    # The run teaches something: turn rate, and how the units err.
    gain = np.mean([gain for _, gain in runs], axis=0)
    assert gain[lo.RATE] < 0.05
    assert gain[lo.UNIT] < 0.9
