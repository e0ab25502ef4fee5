"""Adaptation: bounded for anything, right about R where it can be, and attributed before scaled."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import Config, Gnss, parse, to_toml
from companion.config.adaptation import METHODS, Adaptation, Fuzzy
from companion.estimation import parameters as par
from companion.estimation.adaptation import layout as al
from companion.estimation.adaptation import window as win
from companion.estimation.adaptation.adapt import adapt
from companion.estimation.adaptation.evidence import least_factor, reception
from companion.estimation.adaptation.parameters import adaptation_vector
from companion.navigation import layout as lo
from companion.types import F64

GATE = 18.4
"""χ² of two degrees of freedom, 99.99 %."""
POS_H, VEL_H, VEL_V, BARO, MAG = 0, 2, 3, 4, 5


class Channel:
    """Innovations of a two-component channel straight into a method, with a state of its own."""

    def __init__(self, method: str = "fuzzy", channel: int = POS_H, **fuzzy: float) -> None:
        section = Adaptation(method=method, fuzzy=Fuzzy(**fuzzy))
        config = Config(adaptation=section)
        self.par, self.ipar = par.parameter_vector(config), par.integer_vector(config)
        self.s = np.zeros(lo.P)
        self.s[lo.R_SCALE : lo.RECEPTION] = self.s[lo.R_LEAST] = 1.0
        self.channel = channel
        self.trace = np.zeros(al.TRACE_SIZE)

    def take(self, y: F64, foreseen: float = 0.5, R: float = 1.0) -> float:
        """One innovation ``y`` (2,); the factor on R."""
        full = np.array([*y, 0.0])
        u = full / np.sqrt(foreseen + R)
        return adapt(
            self.s, self.par, self.ipar, self.channel, 2, full, u,
            np.array([foreseen, foreseen, 0.0]), np.array([R, R, 0.0]), float(u @ u), GATE,
            self.trace,
        )  # fmt: skip


variances = st.floats(1e-12, 1e12)
innovations = st.floats(-1e12, 1e12)


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(METHODS[1:]),
    st.lists(st.tuples(innovations, innovations, variances, variances), min_size=1, max_size=40),
)
def test_scales_are_positive_and_bounded_for_any_innovations(
    method: str, sequence: list[tuple[float, float, float, float]]
) -> None:
    bounds = Adaptation().fuzzy
    channel = Channel(method)
    for a, b, foreseen, R in sequence:
        scale = channel.take(np.array([a, b]), foreseen, R)
        assert 0.0 < scale <= 1e6
        if method == "fuzzy":
            assert bounds.r_min <= scale <= bounds.r_max
        assert 1.0 <= channel.s[lo.Q_SCALE] <= np.float32(bounds.q_max)
    assert np.isfinite(channel.s).all()
    assert np.isfinite(channel.trace[al.TO_MODEL :]).all()


@settings(max_examples=50, deadline=None)
@given(st.permutations(Adaptation().fuzzy.rules), st.permutations(Adaptation().flac.rules))
def test_the_order_of_rules_changes_nothing(fuzzy: list[object], flac: list[object]) -> None:
    plain = Adaptation()
    replace = msgspec.structs.replace
    shuffled = replace(
        plain,
        fuzzy=replace(plain.fuzzy, rules=tuple(fuzzy)),
        flac=replace(plain.flac, rules=tuple(flac)),
    )
    read = parse(to_toml(Config(adaptation=shuffled))).adaptation
    assert np.array_equal(adaptation_vector(read), adaptation_vector(plain))


@pytest.mark.parametrize("method", ["fuzzy", "innovation", "variational"])
def test_the_noise_of_a_worse_sensor_is_found(method: str) -> None:
    """R nine times what was said: the factor's median is within the scatter of twenty innovations.

    The standard deviation of a variance estimated from 40 numbers is 22 %, the median of many such
    windows much closer; what is left is the winsorising and, for the fuzzy rules, the slew.
    """
    rng = np.random.default_rng(3)
    channel = Channel(method)
    found = [channel.take(rng.normal(0.0, np.sqrt(0.5 + 9.0), 2)) for _ in range(600)]
    assert 6.5 < np.median(found[100:]) < 11.5


def test_a_healthy_sensor_is_left_alone() -> None:
    """Ten thousand innovations: the mean factor costs less than a hundredth of the deviation."""
    rng = np.random.default_rng(4)
    channel = Channel()
    found = [channel.take(rng.normal(0.0, np.sqrt(1.5), 2)) for _ in range(10_000)]
    assert np.mean(np.sqrt(found)) < 1.01
    assert channel.s[lo.Q_SCALE] < 1.5


@pytest.mark.parametrize("size", [5.0, 50.0, 5e3, 5e8])
def test_no_single_innovation_decides(size: float) -> None:
    """In a window of healthy ones the largest counts as the second largest does."""
    rng = np.random.default_rng(5)
    quiet, spiked = Channel(), Channel()
    for at in range(60):
        y = rng.normal(0.0, np.sqrt(1.5), 2)
        without = quiet.take(y)
        with_spike = spiked.take(y + (size if at == 30 else 0.0))
        assert with_spike < 1.3 * without


def test_fewer_than_eight_innovations_say_nothing() -> None:
    channel = Channel()
    for at in range(win.FEWEST - 1):
        assert channel.take((-1.0) ** at * np.array([60.0, -60.0])) == 1.0
        assert np.isnan(channel.trace[al.IN_SPREAD])
        assert not channel.trace[al.FIRING : al.FIRING + 9].any()
    assert channel.take(np.array([60.0, -60.0])) > 1.0


def _biased(channel: Channel, strained: bool) -> None:
    """Forty innovations with a mean of two deviations."""
    if strained:
        # quarters of a second that differ by 5 m/s²: a manoeuvre
        channel.s[lo.STILL_RING + 3] = 5.0
    rng = np.random.default_rng(6)
    for _ in range(40):
        channel.take(np.sqrt(1.5) * (rng.normal(0.0, 1.0, 2) + np.array([2.0, -2.0])))


def test_a_mean_under_strain_is_the_inertial_units() -> None:
    channel = Channel()
    _biased(channel, strained=True)
    assert channel.trace[al.TO_MODEL] > 0.5
    assert channel.s[lo.Q_SCALE] > 2.0
    assert channel.s[lo.R_SCALE + POS_H] < 1.5


def test_a_correlated_mean_without_strain_is_the_sources_and_scales_nothing() -> None:
    channel = Channel()
    _biased(channel, strained=False)
    assert channel.trace[al.TO_SOURCE] > 0.9
    assert channel.s[lo.Q_SCALE] < 1.1
    assert channel.s[lo.R_SCALE + POS_H] < 1.3  # the scatter of the first few is what it is


def test_a_mean_of_doppler_velocity_is_the_inertial_units() -> None:
    channel = Channel(channel=VEL_H)
    _biased(channel, strained=False)
    assert channel.trace[al.TO_MODEL] == 1.0
    assert channel.s[lo.Q_SCALE] > 2.0


def test_what_drifts_in_velocity_is_no_witness_for_a_compass() -> None:
    shares = []
    for channel in (BARO, MAG):
        one = Channel(channel=channel)
        one.s[lo.WINDOWS + VEL_V * lo.WINDOW_SIZE + al.DRIFT] = 0.8
        _biased(one, strained=False)
        shares.append(float(one.trace[al.TO_MODEL]))
    assert shares == [0.8, 0.0]


@pytest.mark.parametrize("m", [1, 2])
@pytest.mark.parametrize("length", [8, 20, 32])
def test_inputs_of_a_healthy_sensor_are_standard_normal(m: int, length: int) -> None:
    """Shares beyond the 95 % quantile, of four thousand windows: 5 %, five deviations 1.7 %.

    The spread stays below: its largest term counts as the second largest.
    """
    rng = np.random.default_rng(length + m)
    windows, beyond = 4000, np.zeros(3)
    w, out = np.zeros(lo.WINDOW_SIZE), np.zeros(7)
    w[al.COUNT] = length
    for _ in range(windows):
        w[al.RING : al.RING + 3 * length] = rng.normal(size=3 * length)
        assert win.statistics(w, length, m, out)
        beyond += out[:3] > 1.645
    share = beyond / windows
    assert share[1] < 0.067
    assert np.all(share[[0, 2]] < 0.067)
    assert share[0] > 0.033


def test_a_receiver_that_lost_satellites_is_scaled_not_suspected() -> None:
    channel = Channel()
    channel.s[lo.RECEPTION] = 0.9
    _biased(channel, strained=False)
    assert channel.trace[al.TO_SOURCE] < 0.2
    assert channel.s[lo.R_SCALE + POS_H] > 1.5


def test_reception_is_held_against_what_is_usual() -> None:
    s = np.zeros(lo.P)
    for satellites, variance, lost in (
        (16.0, 4.0, 0.0),
        (16.0, 4.0, 0.0),
        (4.0, 4.0, 0.75),
        (np.nan, 16.0, 0.75),
        (20.0, 1.0, 0.0),
    ):
        reception(s, satellites, variance, np.nan)
        # what is usual has moved by a three-hundredth
        assert s[lo.RECEPTION] == pytest.approx(lost, abs=0.01)


@pytest.mark.parametrize("size", [4.0, 8.0, 40.0])
def test_a_step_inside_a_window_is_no_noise(size: float) -> None:
    """It scatters about the mean, not between neighbours: R stays, and the gate with it."""
    rng = np.random.default_rng(8)
    channel = Channel()
    for at in range(80):
        step = size if at >= 40 else 0.0
        scale = channel.take(rng.normal(0.0, np.sqrt(1.5), 2) + step)
        assert scale < 1.6  # two deviations of a variance from 20 innovations of 2: 1 + 2·0.26
    assert channel.trace[al.TO_SOURCE] > 0.9


def test_scatter_between_neighbours_is_noises_own() -> None:
    """Its share beyond the 95 % quantile, and the median of the factor, as of the other spread."""
    rng = np.random.default_rng(9)
    w, out = np.zeros(lo.WINDOW_SIZE), np.zeros(7)
    w[al.COUNT], found = 20.0, []
    for _ in range(4000):
        w[al.RING : al.RING + 60] = 3.0 * rng.normal(size=60)
        assert win.statistics(w, 20, 2, out)
        found.append(out[5:7].copy())
    between, deviate = np.array(found).T
    # the widest counts as the next: one of 19 is cut by a third
    assert 7.5 < np.median(between) < 9.0
    w[al.RING : al.RING + 60] /= 3.0
    assert np.mean(deviate > 1.645) > 0.9  # nine times the variance is seen


def test_a_unit_at_the_end_of_its_range_needs_no_other_witness() -> None:
    channel = Channel()
    channel.s[lo.SATURATING] = 0.5  # by a counter
    _biased(channel, strained=False)
    assert channel.trace[al.TO_MODEL] == 1.0
    assert channel.s[lo.Q_SCALE] > 2.0


def _claiming(channel: Channel, rng: np.random.Generator) -> float:
    """A receiver that claims 25 times the variance it has, against a configuration that knows."""
    channel.s[lo.R_LEAST] = 0.04
    for _ in range(100):
        scale = channel.take(rng.normal(0.0, np.sqrt(0.01 + 1.0), 2), foreseen=0.01 * 25, R=25.0)
    return scale


def test_a_claim_is_disproved_down_to_what_is_configured() -> None:
    rng = np.random.default_rng(10)
    believed = Channel()
    assert 0.04 <= _claiming(believed, rng) < 0.08


def test_a_claim_is_believed_where_the_receiver_says_that_it_receives_badly() -> None:
    rng = np.random.default_rng(10)
    channel = Channel()
    channel.s[lo.RECEPTION] = 1.0
    assert _claiming(channel, rng) == 1.0


def test_a_claim_is_not_disproved_by_innovations_that_are_alike() -> None:
    """An error that lasts does not scatter: small innovations one like the other say nothing."""
    rng = np.random.default_rng(11)
    channel, slow = Channel(), np.zeros(2)
    channel.s[lo.R_LEAST] = 0.04
    for _ in range(100):
        slow = 0.98 * slow + rng.normal(0.0, 0.2, 2)
        scale = channel.take(slow, foreseen=0.25, R=25.0)
    assert scale > 0.5


@pytest.mark.parametrize(("said", "lost"), [(np.nan, 0.0), (0.0, 0.0), (0.5, 0.5), (1.0, 1.0)])
def test_interference_is_reception_lost(said: float, lost: float) -> None:
    s = np.zeros(lo.P)
    reception(s, 16.0, 4.0, said)
    assert s[lo.RECEPTION] == lost


def test_what_is_configured_is_the_least_only_where_slow_errors_are_states() -> None:
    """Latency's part stays; without a state the slow error is in the claim."""
    config = Config(gnss=Gnss(sd_position_m=1.0, sd_velocity_mps=0.1))
    vector, taken = par.parameter_vector(config), np.array([25.0, 25.0, 25.0])
    R = taken + 5.0
    without, with_state = par.layout(config).vector(), par.layout(config).vector()
    with_state[lo.L_GNSS] = 15
    assert least_factor(vector, without, 0, taken, R, 2) == 1.0
    assert least_factor(vector, with_state, 0, taken, R, 2) == pytest.approx(6.0 / 30.0)
    assert least_factor(vector, without, 2, taken, R, 2) == pytest.approx(5.01 / 30.0)
    assert least_factor(vector, with_state, 0, np.full(2, 0.5), np.full(2, 0.5), 2) == 1.0
