"""The gate and the update against dense algebra, long double, scipy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from companion.config import Adaptation, Config, EngineConfig
from companion.estimation import parameters as par
from companion.estimation import update as up
from companion.estimation.recording import nothing
from companion.navigation import layout as lo
from companion.navigation.alignment import attitude_covariance
from companion.navigation.error_model import box_plus
from companion.navigation.rotation import attitude_error_n, matrix_from_quat
from companion.types import F64

from .states import ALL, CORE, box_minus, covariance, random_state

OPEN = Config(engine=EngineConfig(gate_probability=1 - 1e-12))
FORWARD = Config(engine=EngineConfig(correction="feedforward", gate_probability=1 - 1e-12))


def _fuse(
    s: F64, layout: lo.Layout, H: F64, y: F64, R: F64, config: Config = OPEN
) -> tuple[bool, F64]:
    """One update; H (m, n), y (m,), R (m,): accepted or not, and the report row."""
    m = len(y)
    full, innovation, variance = np.zeros((3, layout.n)), np.zeros(3), np.zeros(3)
    full[:m], innovation[:m], variance[:m] = H, y, R
    report = np.zeros(up.REPORT_SIZE)
    good = up.fuse(
        s, layout.vector(), par.parameter_vector(config), par.integer_vector(config), 0, 0, 0.0,
        full, innovation, variance, m, np.empty((9 + layout.n, layout.n)), report,
        nothing(np.zeros(lo.INT_SIZE, np.int64)),
    )  # fmt: skip
    return bool(good), report


def _cross(x: F64) -> F64:
    return np.array([[0, -x[2], x[1]], [x[2], 0, -x[0]], [-x[1], x[0], 0]])


@pytest.mark.parametrize("m", [1, 2, 3])
@pytest.mark.parametrize("seed", range(5))
def test_update_equals_the_dense_one(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = random_state(rng, ALL)
    P = covariance(s, ALL).copy()
    H = rng.standard_normal((m, ALL.n))
    R = rng.uniform(0.1, 2.0, m)
    S = H @ P @ H.T + np.diag(R)
    y = np.linalg.cholesky(S) @ rng.standard_normal(m)
    K = np.linalg.solve(S, H @ P).T
    dx = K @ y
    expected = s.copy()
    box_plus(expected, ALL.vector(), dx)
    joseph = (np.eye(ALL.n) - K @ H) @ P @ (np.eye(ALL.n) - K @ H).T + K @ np.diag(R) @ K.T
    G = np.eye(ALL.n)
    G[6:9, 6:9] += _cross(dx[6:9] * [0.5, 0.5, 1.0])
    joseph = G @ joseph @ G.T
    good, report = _fuse(s, ALL, H, y, R)
    assert good
    after = covariance(s, ALL)
    assert np.array_equal(after, after.T)
    sd = np.sqrt(np.diag(P))
    # Condition 1e3 of the random P: a thousand roundings of 1e-16.
    assert np.max(np.abs(after - joseph) / np.outer(sd, sd)) < 1e-12
    assert np.allclose(s[: lo.DX], expected[: lo.DX], rtol=1e-12, atol=1e-12)
    assert report[up.R_NIS] == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-10)
    assert np.allclose(report[up.R_SD : up.R_SD + m], np.sqrt(np.diag(S)), rtol=1e-12)
    assert np.isnan(report[up.R_INNOVATION + m : up.R_SD]).all()


@pytest.mark.parametrize("m", [1, 2, 3])
def test_gate_is_chi_square(m: int) -> None:
    rng = np.random.default_rng(m)
    # Without adaptation, which learns from what is refused, too.
    config = Config(
        engine=EngineConfig(gate_probability=0.99), adaptation=Adaptation(method="none")
    )
    limit = chi2.ppf(0.99, m)
    for factor, wanted in ((0.999, True), (1.001, False)):
        s = random_state(rng, CORE)
        H, R = rng.standard_normal((m, 15)), rng.uniform(0.1, 1, m)
        S = H @ covariance(s, CORE) @ H.T + np.diag(R)
        u = rng.standard_normal(m)
        y = np.linalg.cholesky(S) @ (u / np.linalg.norm(u) * np.sqrt(limit * factor))
        before = s.copy()
        good, report = _fuse(s, CORE, H, y, R, config)
        assert good is wanted
        assert report[up.R_GATE] == pytest.approx(limit)
        assert report[up.R_VERDICT] == (up.ACCEPTED if wanted else up.REJECTED_GATE)
        assert np.array_equal(s, before) is not wanted


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_not_finite_changes_nothing(bad: float) -> None:
    s = random_state(np.random.default_rng(0), CORE)
    before = s.copy()
    good, _ = _fuse(s, CORE, np.eye(15)[:1], np.array([bad]), np.ones(1))
    assert not good
    assert np.array_equal(s, before)


def test_covariance_survives_wildly_different_variances() -> None:
    """A hundred thousand scalar updates, R over twelve decades, against long double."""
    rng = np.random.default_rng(11)
    s = random_state(rng, CORE)
    P = covariance(s, CORE)
    exact = P.astype(np.longdouble)
    drive = 1e-3 * np.diag(P).copy()
    size = np.sqrt(np.diag(P))
    compared = 5_000
    for count in range(100_000):
        h = np.zeros(15)
        h[rng.integers(0, 15, 2)] = rng.standard_normal(2)
        R = float((h * size) @ (h * size) + 1e-30) * 10.0 ** rng.uniform(-9, 3)
        _fuse_quick(s, h, R)
        P[np.diag_indices(15)] += drive
        if count < compared:
            a = exact @ h.astype(np.longdouble)
            exact -= np.outer(a, a) / (h @ a + np.longdouble(R))
            exact[np.diag_indices(15)] += drive
        if count == compared - 1:
            # R a billion times below P cancels nine digits at the worst update.
            scale = np.sqrt(np.diag(exact).astype(float))
            off = (P - exact).astype(float) / np.outer(scale, scale)
            assert np.abs(off).max() < 1e-6
    assert np.array_equal(P, P.T)
    sd = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(sd, sd)).min() > 0


_LAY = CORE.vector()
_PAR, _IPAR = par.parameter_vector(OPEN), par.integer_vector(OPEN)
_W, _REPORT, _H = np.empty((24, 15)), np.zeros(up.REPORT_SIZE), np.zeros((3, 15))
_Y, _R = np.zeros(3), np.zeros(3)
_NO_TAPE = nothing(np.zeros(lo.INT_SIZE, np.int64))


def _fuse_quick(s: F64, h: F64, R: float) -> None:
    _H[0], _R[0] = h, R
    assert up.fuse(s, _LAY, _PAR, _IPAR, 0, 0, 0.0, _H, _Y, _R, 1, _W, _REPORT, _NO_TAPE)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_independent_updates_commute_on_a_linear_problem(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start = random_state(rng, CORE)
    rows, y, R = rng.standard_normal((4, 15)), rng.standard_normal(4), rng.uniform(0.01, 1, 4)
    ends = []
    for order in ([0, 1, 2, 3], [3, 1, 0, 2]):
        s = start.copy()
        for i in order:
            # Feedforward: the error is carried beside the state, so the problem is linear.
            assert _fuse(s, CORE, rows[i : i + 1], y[i : i + 1], R[i : i + 1], FORWARD)[0]
        ends.append(s)
    sd = np.sqrt(np.diag(covariance(start, CORE)))
    difference = covariance(ends[0], CORE) - covariance(ends[1], CORE)
    assert np.max(np.abs(difference) / np.outer(sd, sd)) < 1e-10
    dx = [s[lo.DX : lo.DX + 15] / sd for s in ends]
    assert np.allclose(dx[0], dx[1], atol=1e-9)
    assert np.array_equal(ends[0][: lo.DX], start[: lo.DX])


def test_reset_jacobian_of_tilt_by_finite_differences() -> None:
    """φ' of exp(φ') = exp(φ) exp(−φ̂), differentiated at φ = φ̂; φ̂ level, so no turn of heading."""
    rng = np.random.default_rng(4)
    s = random_state(rng, CORE)
    dx = np.zeros(15)
    dx[6:8] = 0.02, -0.01
    corrected = s.copy()
    box_plus(corrected, _LAY, dx)
    numeric = np.empty((3, 3))
    for j in range(3):
        ends = []
        for sign in (1, -1):
            true, error = s.copy(), dx.copy()
            error[6 + j] += sign * 1e-5
            box_plus(true, _LAY, error)
            ends.append(attitude_error_n(true[:4], corrected[:4]))
        numeric[:, j] = (ends[0] - ends[1]) / 2e-5
    P = covariance(s, CORE).copy()
    G = np.eye(15)
    G[6:9, 6:9] = numeric
    expected = G @ P @ G.T
    up.reset_covariance(P, dx, 15)
    sd = np.sqrt(np.diag(P))
    # The next term of the series is φ̂²/6.
    assert np.max(np.abs(P - expected) / np.outer(sd, sd)) < 2 * (0.02**2 + 0.01**2) / 6
    assert np.array_equal(P, P.T)


def test_a_heading_correction_turns_the_level_with_it() -> None:
    """Levelling ties φ to the bias in body axes; it stays so whatever heading is found later."""
    s = random_state(np.random.default_rng(2), CORE)
    s[:4] = [1.0, 0, 0, 0]
    P = covariance(s, CORE)
    P[:] = np.diag(np.repeat([1.0, 1.0, 0.0, 0.01, 1e-8], 3))
    attitude, cross = attitude_covariance(s[:4], np.full(3, 0.01), 1e-8, 0.09, 9.8)
    P[6:9, 6:9], P[6:9, 9:12], P[9:12, 6:9] = attitude, cross, cross.T
    turn = 0.25
    assert _fuse(s, CORE, np.eye(15)[8:9], np.array([turn]), np.array([1e-9]))[0]
    expected, tied = attitude_covariance(s[:4], np.full(3, 0.01), 1e-8, 0.0, 9.8)
    # I + [φ̂×] for a rotation by φ̂: second order, φ̂²/2 = 3 %.
    assert np.abs(P[6:9, 9:12] - tied).max() < 0.6 * turn**2 * np.abs(tied).max()
    assert np.abs(P[6:8, 6:8] - expected[:2, :2]).max() < 1.1 * turn**2 * expected.max()


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_box_plus_and_minus_are_inverse(seed: int) -> None:
    rng = np.random.default_rng(seed)
    s = random_state(rng, CORE)
    dx = rng.standard_normal(15) * np.repeat([10.0, 1, 0.5, 0.1, 0.01], 3)
    moved = s.copy()
    box_plus(moved, _LAY, dx)
    # Position through radii at one end: 10 m of 6e6, squared, at most.
    assert np.allclose(box_minus(moved, s), dx, rtol=1e-5, atol=1e-8)
    C = matrix_from_quat(moved[:4])
    assert np.allclose(C @ C.T, np.eye(3), atol=1e-12)
