"""An epoch of ranges against dense algebra: one update by all of it, gates, both corrections."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import Config, EngineConfig
from companion.estimation import parameters as par
from companion.estimation import update as up
from companion.estimation.range_update import fuse_epoch
from companion.estimation.recording import nothing
from companion.gnss.geometry import ned_axes
from companion.measurements.pseudorange import VIEW_SIZE, look, range_innovation, rate_innovation
from companion.navigation import layout as lo
from companion.navigation.earth import ecef
from companion.navigation.error_model import box_plus
from companion.navigation.rotation import matrix_from_quat
from companion.types import F64, I64, Channel, Flags, Verdict

from .states import covariance, random_state

TIGHT = lo.Layout.build(scale=False, lever=False, baro=False, gnss=False, clock=True)
LAY = TIGHT.vector()
OPEN = Config(engine=EngineConfig(gate_probability=1 - 1e-12))
FORWARD = Config(engine=EngineConfig(correction="feedforward", gate_probability=1 - 1e-12))
SATELLITES = 9
RANGE_SD, RATE_SD = 1.5, 0.06


def _model(s: F64, rows: F64) -> tuple[F64, F64]:
    """Innovations (2 M,) and H (2 M, n) of ranges and rates in turn."""
    J, view, axes = np.empty((6, TIGHT.n)), np.empty(VIEW_SIZE), np.empty((3, 3))
    look(s, LAY, matrix_from_quat(s[:4]), axes, J, view)
    y, H = np.empty(2 * len(rows)), np.empty((2 * len(rows), TIGHT.n))
    for m, row in enumerate(rows):
        y[2 * m] = range_innovation(s, LAY, axes, J, view, row, H[2 * m])
        y[2 * m + 1] = rate_innovation(s, LAY, axes, J, view, row, H[2 * m + 1])
    return y, H


def _sky(s: F64, rng: np.random.Generator) -> F64:
    """Satellites of three systems, measured as the filter foresees plus its own doubt and noise."""
    axes = np.empty((3, 3))
    ned_axes(s[lo.LAT], s[lo.LON], axes)
    place = ecef(s[lo.LAT : lo.LAT + 1], s[lo.LON : lo.LON + 1], s[[lo.HEIGHT]])[0]
    rows = np.zeros((SATELLITES, 12))
    for m, row in enumerate(rows):
        azimuth, elevation = 2.4 * m, rng.uniform(0.2, 1.4)
        flat = np.cos(elevation)
        line = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(elevation)])
        row[:3], row[3:6] = place + 2.2e7 * (axes.T @ line), rng.normal(0, 2e3, 3)
        row[8], row[9], row[10], row[11] = RANGE_SD**2, RATE_SD**2, m % 3, 100 * (m % 3 + 1) + m
    y, H = _model(s, rows)
    R = np.tile([RANGE_SD**2, RATE_SD**2], SATELLITES)
    S = H @ covariance(s, TIGHT) @ H.T + np.diag(R)
    z = np.linalg.cholesky(S) @ rng.standard_normal(len(R)) - y
    rows[:, 6], rows[:, 7] = z[::2], z[1::2]
    return rows


def _fuse(s: F64, rows: F64, config: Config = OPEN) -> tuple[F64, I64]:
    """One epoch at 7 ns: its reports, and the integer state behind it."""
    k = np.zeros(lo.INT_SIZE, np.int64)
    kinds = np.stack([np.full(len(rows), 5), rows[:, 11].astype(np.int64)], axis=1)
    times, reports = np.zeros(2 * len(rows), np.int64), np.zeros((2 * len(rows), up.REPORT_SIZE))
    count = fuse_epoch(
        s, k, LAY, par.parameter_vector(config), par.integer_vector(config), rows, kinds,
        0, len(rows), 7, np.empty((3, 3)), np.empty((3, 3)), np.empty((9 + TIGHT.n, 40)),
        times, reports, 0, nothing(k),
    )  # fmt: skip
    assert (times[:count] == 7).all()
    return reports[:count], k


def _dense(s: F64, rows: F64, keep: Flags) -> tuple[F64, F64, float]:
    """State and P behind one update by the kept rows of (2 M,), and its NIS."""
    P = covariance(s, TIGHT)
    y, H = _model(s, rows)
    y, H = y[keep], H[keep]
    S = H @ P @ H.T + np.diag(np.tile([RANGE_SD**2, RATE_SD**2], len(rows))[keep])
    K = np.linalg.solve(S, H @ P).T
    state, left = s.copy(), P - K @ S @ K.T
    box_plus(state, LAY, K @ y)
    up.reset_covariance(left, K @ y, TIGHT.n)
    return state, left, float(y @ np.linalg.solve(S, y))


def _same(s: F64, state: F64, left: F64) -> None:
    # Differences of ranges of 2e7 m, which round at 4e-9 m.
    assert np.allclose(s[: lo.LAST_GYRO], state[: lo.LAST_GYRO], rtol=0, atol=1e-6)
    P = covariance(s, TIGHT)
    sd = np.sqrt(np.diag(left))
    assert np.abs((P - left) / np.outer(sd, sd)).max() < 1e-6
    assert np.array_equal(P, P.T)


@pytest.mark.parametrize("seed", range(5))
def test_an_epoch_equals_the_dense_update_by_all_of_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = random_state(rng, TIGHT)
    rows = _sky(s, rng)
    state, left, nis = _dense(s, rows, np.full(2 * SATELLITES, True))
    reports, k = _fuse(s, rows)
    assert (reports[:, up.R_VERDICT] == Verdict.ACCEPTED).all()
    # The squares of innovations that follow one another sum up to the square of all of them.
    assert reports[:, up.R_NIS].sum() == pytest.approx(nis, rel=1e-6)
    _same(s, state, left)
    assert k[lo.T_POSITION_AID] == k[lo.T_VELOCITY_AID] == 7
    assert reports[:4, up.R_CHANNEL].tolist() == [
        Channel.RANGE_GPS, Channel.RATE_GPS, Channel.RANGE_GALILEO, Channel.RATE_GALILEO,
    ]  # fmt: skip


def test_a_range_at_fault_is_refused_alone() -> None:
    rng = np.random.default_rng(1)
    s = random_state(rng, TIGHT)
    rows = _sky(s, rng)
    rows[6, 6] += 100.0
    rows[3, 7] = np.nan  # a rate that was not measured is none
    keep = np.full(2 * SATELLITES, True)
    keep[[12, 7]] = False
    state, left, _ = _dense(s, rows, keep)
    reports, _ = _fuse(s, rows)
    assert len(reports) == 2 * SATELLITES - 1
    refused = reports[reports[:, up.R_VERDICT] != Verdict.ACCEPTED]
    assert refused[:, up.R_SOURCE].tolist() == [rows[6, 11]]
    assert refused[0, up.R_VERDICT] == Verdict.REJECTED_GATE
    _same(s, state, left)


def test_an_epoch_that_most_satellites_contradict_is_no_fix() -> None:
    rng = np.random.default_rng(2)
    s = random_state(rng, TIGHT)
    rows = _sky(s, rng)
    rows[:5, 6] += 1e3 * np.arange(1, 6)
    _, k = _fuse(s, rows)
    assert k[lo.T_POSITION_AID] == 0
    assert k[lo.REFUSED_SINCE] == 7


def test_feedforward_learns_what_feedback_is_told() -> None:
    rng = np.random.default_rng(3)
    s = random_state(rng, TIGHT)
    rows = _sky(s, rng)
    forward, told = s.copy(), rows.copy()
    error = rng.normal(0, 0.01, TIGHT.n)
    forward[lo.DX : lo.DX + TIGHT.n] = error
    _, H = _model(s, rows)
    # Who knows of an error already is as surprised by measurements that have it.
    told[:, 6] += H[::2] @ error
    told[:, 7] += H[1::2] @ error
    _fuse(forward, told, FORWARD)
    _fuse(s, rows)
    total = forward.copy()
    box_plus(total, LAY, forward[lo.DX : lo.DX + TIGHT.n] - error)
    assert np.allclose(total[: lo.LAST_GYRO], s[: lo.LAST_GYRO], rtol=0, atol=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_range_that_is_no_number_changes_nothing(bad: float) -> None:
    rng = np.random.default_rng(4)
    s = random_state(rng, TIGHT)
    rows = _sky(s, rng)[:1]
    rows[0, 6], rows[0, 7] = bad, np.nan
    before = s.copy()
    reports, _ = _fuse(s, rows)
    assert reports[0, up.R_VERDICT] != Verdict.ACCEPTED
    assert np.array_equal(covariance(s, TIGHT), covariance(before, TIGHT))
    assert np.allclose(s[: lo.LAST_GYRO], before[: lo.LAST_GYRO], rtol=0, atol=1e-15)
