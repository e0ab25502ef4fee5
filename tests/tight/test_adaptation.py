"""A satellite system that becomes noisy is trusted less, in the filter as in the test of faults."""

from __future__ import annotations

import numpy as np

from companion.gnss.systems import GALILEO, GPS
from tests.benchmarks.constellation_noise import fly


def test_a_noisy_system_is_trusted_less_and_the_flight_is_the_better_for_it() -> None:
    none, fuzzy = (fly(1, GALILEO, method) for method in ("none", "fuzzy"))
    assert fuzzy.position_m < none.position_m
    assert fuzzy.velocity_mps < none.velocity_mps
    for found in (fuzzy.r_range, fuzzy.r_rate):
        # The white part 25 times as large, in what is configured with a slow part: about 16.
        assert 8.0 < found[GALILEO] < 32.0
        assert found[GPS] < 2.0
    assert np.isnan(none.r_range).all()


def test_a_healthy_sky_is_left_alone() -> None:
    found = fly(1, None, "fuzzy")
    assert max(*found.r_range, *found.r_rate) < 1.1
