"""Where a start places the vehicle, and what it may claim to know of it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import Config, Gnss
from companion.estimation.phases import Setup
from companion.estimation.start import place_at
from companion.navigation import layout as lo

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
