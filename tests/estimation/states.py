"""Random filter states for the tests of kernels, and the difference of two states."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.covariance import STRIDE, propagate
from companion.navigation import earth
from companion.navigation import layout as lo
from companion.navigation.earth import ned_difference
from companion.navigation.error_model import COLUMNS, transition_blocks
from companion.navigation.mechanisation import advance
from companion.navigation.rotation import attitude_error_n, quat_from_rpy
from companion.types import F64

ALL = lo.Layout.build(scale=True, lever=True, baro=True, gnss=True)
CORE = lo.Layout.build(scale=False, lever=False, baro=False, gnss=False)


def random_state(rng: np.random.Generator, layout: lo.Layout) -> F64:
    """A plausible state in flight with a random covariance of realistic and correlated sizes."""
    s = np.zeros(layout.size)
    s[lo.Q : lo.Q + 4] = quat_from_rpy(*rng.uniform([-0.6, -0.6, -3.1], [0.6, 0.6, 3.1]))
    s[lo.LAT], s[lo.LON], s[lo.HEIGHT] = rng.uniform([-1.2, -3.1, -50], [1.2, 3.1, 3000])
    s[lo.VEL_N : lo.VEL_N + 3] = rng.normal(0, 15, 3)
    s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = rng.normal(0, 0.1, 3)
    s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] = rng.normal(0, 0.005, 3)
    if layout.accel_scale >= 0:
        s[lo.ACCEL_SCALE_B : lo.ACCEL_SCALE_B + 6] = rng.normal(0, 0.005, 6)
    s[lo.LEVER_B : lo.LEVER_B + 3] = rng.normal(0, 1, 3)
    s[lo.LAST_GYRO : lo.LAST_GYRO + 3] = rng.normal(0, 0.5, 3)
    s[lo.LAST_ACCEL : lo.LAST_ACCEL + 3] = rng.normal([0, 0, -9.8], 2)
    s[lo.EARTH_RATE] = earth.RATE
    s[lo.R_SCALE : lo.RECEPTION] = s[lo.R_LEAST] = 1.0
    n = layout.n
    size = np.full(n, 0.3)
    size[:15] = np.repeat([2.0, 0.3, 0.02, 0.05, 0.002], 3)
    root = size[:, None] * rng.standard_normal((n, 2 * n)) / np.sqrt(2 * n)
    s[lo.P :] = (root @ root.T).ravel()
    return s


def covariance(s: F64, layout: lo.Layout) -> F64:
    """P (n, n) as a view."""
    return s[lo.P :].reshape(layout.n, layout.n)


def box_minus(a: F64, b: F64, layout: lo.Layout = CORE) -> F64:
    """The error (n,) that moves ``b`` to ``a``: the inverse of ⊞."""
    llh = ned_difference(a[4:5], a[5:6], a[6:7], b[4:5], b[5:6], b[6:7])[0]
    out = np.zeros(layout.n)
    out[:15] = np.concatenate(
        [llh, a[lo.VEL_N : lo.VEL_N + 3] - b[lo.VEL_N : lo.VEL_N + 3],
         attitude_error_n(a[:4], b[:4]), a[lo.ACCEL_BIAS_B : 16] - b[lo.ACCEL_BIAS_B : 16]]
    )  # fmt: skip
    for at, offset, size in (
        (layout.accel_scale, lo.ACCEL_SCALE_B, 3),
        (layout.gyro_scale, lo.GYRO_SCALE_B, 3),
        (layout.lever, lo.LEVER_B, 3),
        (layout.baro, lo.BARO_BIAS, 1),
        (layout.gnss, lo.GNSS_BIAS, 3),
    ):
        if at >= 0:
            out[at : at + size] = a[offset : offset + size] - b[offset : offset + size]
    return out


def fly(s: F64, imu: F64, dt: float, integral: bool = False) -> None:
    """The strapdown kernel over the intervals between the rows of ``imu`` (N, 6)."""
    C = np.empty((3, 3))
    for a, b in pairwise(imu):
        advance(s, a, b, dt, integral, True, C)


def samples(rng: np.random.Generator, count: int) -> F64:
    """Rates near 0.5 rad/s and forces near weight that vary slowly between samples."""
    base = np.concatenate([rng.normal(0, 0.4, 3), rng.normal([0, 0, -9.8], 2)])
    return base + np.cumsum(rng.normal(0, 0.01, (count, 6)), axis=0)


def dense(s: F64, layout: lo.Layout) -> F64:
    """Φ (n, n) of the running interval of ``s``; identity in the slow states."""
    B = np.zeros((24, 3, 3))
    transition_blocks(s, B)
    phi = np.eye(layout.n)
    offsets = [0, 3, 6, 9, 12, layout.accel_scale, layout.gyro_scale]
    for r in range(3):
        for c, at in enumerate(offsets):
            if at >= 0:
                phi[3 * r : 3 * r + 3, at : at + 3] = B[COLUMNS * r + c]
    return phi


def close_interval(s: F64, layout: lo.Layout, config: Config) -> bool:
    """Propagate the covariance over the running interval; False if it broke."""
    n = layout.n
    return bool(
        propagate(
            s, layout.vector(), par.parameter_vector(config), np.empty((24, 3, 3)),
            np.zeros((9 + n, STRIDE)),
        )
    )  # fmt: skip
