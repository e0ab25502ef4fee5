"""Random states of the direct filter for the tests of its kernels."""

from __future__ import annotations

import numpy as np

from companion.config import Config, Direct, EngineConfig, FurtherImu, Gnss, RawGnss
from companion.estimation.direct import layout as lo
from companion.estimation.direct import parameters as par
from companion.estimation.direct.update import box_plus
from companion.navigation.earth import ned_difference
from companion.navigation.layout import CLOCK_STATES
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64

CONFIG = Config(
    engine=EngineConfig(estimator="direct"),
    raw_gnss=RawGnss(coupling="tight"),
    gnss=Gnss(slow_error_sd_m=1.0, slow_error_height_sd_m=2.0, lever_arm_b_m=(0.4, -0.2, -0.7)),
    further_imu=(
        FurtherImu(source="imu2", lever_arm_b_m=(0.0, -0.5, 0.1)),
        FurtherImu(source="imu3", lever_arm_b_m=(0.3, 0.5, 0.0)),
    ),
    direct=Direct(attitude=True, acceleration_tau_s=2.0, rate_tau_s=0.7),
)
LAYOUT = par.layout(CONFIG)
LAY = LAYOUT.vector()
STEP = np.full(LAYOUT.n, 1e-4)
STEP[:3] = 1.0


def random_state(rng: np.random.Generator) -> F64:
    """A plausible state in flight, three units, with a random correlated covariance."""
    s, _ = LAYOUT.blank()
    s[:4] = quat_from_rpy(*rng.uniform([-0.6, -0.6, -3.1], [0.6, 0.6, 3.1]))
    s[lo.LAT], s[lo.LON], s[lo.HEIGHT] = rng.uniform([-1.2, -3.1, -50], [1.2, 3.1, 3000])
    for at, size in (
        (lo.VEL_N, 15), (lo.ACC_N, 3), (lo.RATE_B, 0.6), (lo.GNSS_BIAS, 2), (lo.ATTITUDE_BIAS, 0.1)
    ):  # fmt: skip
        s[at : at + 3] = rng.normal(0, size, 3)
    s[lo.BARO_BIAS] = rng.normal(0, 20)
    s[lo.CLOCK : lo.CLOCK + CLOCK_STATES] = rng.normal(0, [1e3, 50.0, 5.0, 5.0, 0.1])
    spread = np.tile(np.repeat([0.01, 0.1, 0.005, 0.005], 3), LAYOUT.units)
    s[lo.UNITS : lo.UNITS + len(spread)] = rng.normal(0, spread)
    n = LAYOUT.n
    size = np.full(n, 0.01)
    size[:15] = np.repeat([2.0, 0.3, 0.5, 0.05, 0.1], 3)
    root = size[:, None] * rng.standard_normal((n, 2 * n)) / np.sqrt(2 * n)
    P = root @ root.T
    covariance(s)[:] = 0.5 * (P + P.T)
    return s


def covariance(s: F64) -> F64:
    """P (n, n) as a view."""
    return s[LAYOUT.covariance :].reshape(LAYOUT.n, LAYOUT.n)


def box_minus(a: F64, b: F64) -> F64:
    """The error (n,) that moves ``b`` to ``a``: the inverse of ⊞, small attitude differences."""
    out = np.zeros(LAYOUT.n)
    out[:3] = ned_difference(a[4:5], a[5:6], a[6:7], b[4:5], b[5:6], b[6:7])[0]
    for at, offset in ((lo.VEL, lo.VEL_N), (lo.ACC, lo.ACC_N), (lo.RATE, lo.RATE_B)):
        out[at : at + 3] = a[offset : offset + 3] - b[offset : offset + 3]
    D = matrix_from_quat(b[:4]).T @ matrix_from_quat(a[:4])
    sine = 0.5 * np.array([D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1]])
    norm = np.linalg.norm(sine)
    out[lo.ATT : lo.ATT + 3] = sine * (np.arcsin(norm) / norm if norm > 0 else 1.0)
    units = slice(lo.UNITS, lo.UNITS + lo.UNIT_SIZE * LAYOUT.units)
    out[lo.UNIT : lo.UNIT + lo.UNIT_SIZE * LAYOUT.units] = a[units] - b[units]
    out[LAYOUT.baro] = a[lo.BARO_BIAS] - b[lo.BARO_BIAS]
    for at, offset in ((LAYOUT.gnss, lo.GNSS_BIAS), (LAYOUT.attitude, lo.ATTITUDE_BIAS)):
        out[at : at + 3] = a[offset : offset + 3] - b[offset : offset + 3]
    clock = slice(lo.CLOCK, lo.CLOCK + CLOCK_STATES)
    out[LAYOUT.clock : LAYOUT.clock + CLOCK_STATES] = a[clock] - b[clock]
    return out


def moved(s: F64, j: int, step: float) -> F64:
    """``s`` ⊞ a step along error state ``j``."""
    out, dx = s.copy(), np.zeros(LAYOUT.n)
    dx[j] = step
    box_plus(out, LAY, dx)
    return out
