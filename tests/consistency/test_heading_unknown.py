"""A start with an unknown heading converges in motion from anywhere on the compass."""

from __future__ import annotations

import numpy as np
import pytest

from companion.types import Mode

from . import headings

KINDS = ("multirotor-mission", "car-with-stops")
STEP_DEG = {"multirotor-mission": 72.0, "car-with-stops": 30.0}
FOUND_S = 3.0
"""From 0.5 m/s on. A speed v seen by a receiver of 0.1 m/s gives a heading to 0.14 / v rad: 8° take
1 m/s, reached within a second at the 1.5 m/s² or more of both; then two fixes and two turns of the
half-second grid of decisions."""


def _check(one: headings.Start) -> None:
    assert one.found_s < FOUND_S
    assert one.lost == 0
    # Says so until then, and never again after.
    assert np.all(one.mode[one.since_s <= 0] == Mode.HEADING_UNKNOWN)
    assert np.all(one.mode[one.since_s > 0] == Mode.NAVIGATING)
    # Magnetometer and course had to wait, and were used once they could be.
    assert one.early == 0
    assert one.later > 10
    # Nothing is claimed before the motion, and 4 σ hold throughout: 6e-5 each, few independent.
    assert one.sd_deg[one.since_s < -FOUND_S].min() > 30.0
    assert np.all(np.abs(one.error_deg) < 4.0 * one.sd_deg)
    assert np.abs(one.error_deg[one.since_s > 10.0]).max() < 1.5


@pytest.mark.parametrize("kind", KINDS)
def test_heading_is_found_from_every_start(kind: str) -> None:
    for one in headings.sweep(headings.modelled, kind, headings.compass(STEP_DEG[kind]), 100):
        _check(one)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_heading_is_found_from_every_start_finer(kind: str) -> None:
    for one in headings.sweep(headings.modelled, kind, headings.compass(5.0) + 2.5, 200):
        _check(one)
