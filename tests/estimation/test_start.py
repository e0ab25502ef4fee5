"""Where a start places the vehicle, and what it may claim to know of it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import Alignment, Config, Gnss, LastHeading
from companion.engine import Engine
from companion.estimation.phases import Setup
from companion.estimation.start import place_at
from companion.navigation import layout as lo
from companion.types import COV_ATT, NS, GnssSamples, ImuSamples, Mode, Outputs

from .states import random_state

PLACE = np.array([0.8, 0.2, 500.0])
WHITE = np.array([0.25, 0.25, 0.81])


def _placed(gnss: Gnss) -> tuple[Setup, np.ndarray]:
    setup = Setup(Config(gnss=gnss))
    s = random_state(np.random.default_rng(4), setup.layout)
    place_at(setup, s, PLACE, WHITE)
    return setup, s


def test_the_first_fix_is_no_better_than_white_and_slow_error_together() -> None:
    setup, s = _placed(Gnss(slow_error_sd_m=1.5, slow_error_height_sd_m=2.5))
    P, at = setup.covariance(s), setup.layout.gnss
    slow = np.array([1.5, 1.5, 2.5]) ** 2
    assert np.diag(P)[:3] == pytest.approx(WHITE + slow)
    # What the next fix of the same receiver is compared with: its slow error cancels.
    H = np.zeros((3, setup.layout.n))
    H[:, :3] = H[:, at : at + 3] = np.eye(3)
    assert np.allclose(H @ P @ H.T, np.diag(WHITE), rtol=0, atol=1e-12)
    assert np.array_equal(s[lo.LAT : lo.LAT + 3], PLACE)
    assert not s[lo.GNSS_BIAS : lo.GNSS_BIAS + 3].any()
    assert np.linalg.eigvalsh(P).min() > -1e-12


def test_without_slow_states_the_place_is_as_sure_as_the_fix() -> None:
    setup, s = _placed(Gnss())
    P = setup.covariance(s)
    assert np.diag(P)[:3] == pytest.approx(WHITE)
    assert not P[:3, 3:].any()


T0 = 1_700_000_000 * NS


def _started(config: Config, *, moving: bool = False) -> Outputs:
    """Three seconds of samples at 100 Hz, level and at rest or swaying, and a fix at 2.5 s."""
    n = 300
    t = T0 + np.arange(n) * (NS // 100)
    force = np.tile([0.0, 0.0, -9.80665], (n, 1))
    force[:, 0] += 2.0 * np.sin(np.arange(n) / 30.0) * moving
    engine, seq, nan = Engine(config), np.arange(n), np.full(n, np.nan)
    imu = ImuSamples("imu", t, t, seq, np.zeros((n, 3)), force, nan)
    engine.step(imu.take(slice(0, 260)))
    at, one = t[250:251], np.ones(1)
    place = 0.8 * one, 0.2 * one, 100.0 * one
    three = np.ones((1, 3))
    sky = np.array([12]), np.array([3])
    engine.step(GnssSamples("gnss", at, at, seq[:1], *place, 0 * three, three, three, *sky))
    engine.step(imu.take(slice(260, n)))
    return engine.finish()


@pytest.mark.parametrize(
    ("age_s", "moving", "used"),
    [(2.0, False, True), (12.0, False, True), (20.0, False, False), (-9.0, False, False),
     (2.0, True, False)],
)  # fmt: skip
def test_the_heading_that_an_earlier_run_left(age_s: float, moving: bool, used: bool) -> None:
    """While nobody can have turned the vehicle far: it stood, it stands, moments have passed."""
    left = LastHeading(heading_deg=75.0, sd_deg=2.0, t_ns=T0 - round(age_s * NS))
    out = _started(Config(alignment=Alignment(last_heading=left)), moving=moving)
    first = out.settled.take([0])
    assert first.mode[0] == (Mode.NAVIGATING if used else Mode.HEADING_UNKNOWN)
    if used:
        sd_deg = np.degrees(first.sd[0, COV_ATT, 2])
        # A degree a second, until the fix.
        assert sd_deg == pytest.approx(np.hypot(2.0, age_s + 2.5), rel=0.02)


def test_a_heading_that_is_left_gives_way_to_what_was_asked_for() -> None:
    left = LastHeading(heading_deg=75.0, sd_deg=2.0, t_ns=T0)
    out = _started(Config(alignment=Alignment(heading="unknown", last_heading=left)))
    assert out.settled.mode[0] == Mode.HEADING_UNKNOWN
