"""Satellites from ephemerides against RTKLIB, and their velocities against differences of it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.gnss import orbit as ob
from companion.gnss.orbit import satellite_at
from companion.gnss.systems import C, satellite_name
from companion.types import F64
from tests.gnss.rtklib import position_and_clock

ORBITS = ((101, 26_560e3), (132, 26_560e3), (211, 29_600e3), (303, 42_164e3), (310, 42_164e3),
          (330, 27_906e3), (360, 42_164e3))  # fmt: skip
"""GPS, Galileo, BeiDou geostationary (3, 60), inclined synchronous (10), medium (30)."""


def _made_up(sat: int, axis: float, seed: int) -> F64:
    """An orbit with every term of the message in use, at its largest."""
    rng = np.random.default_rng(seed)
    row = np.zeros(ob.EPHEMERIS_SIZE)
    row[ob.E_SAT], row[ob.E_WEEK], row[ob.E_TOC_WEEK] = sat, 2300, 2300
    row[ob.E_TOE] = row[ob.E_TOC] = 302_400.0
    row[ob.E_TOE_OWN] = 302_400.0 - (14.0 if sat > 300 else 0.0)
    row[ob.E_SQRT_A], row[ob.E_ECC] = np.sqrt(axis), rng.uniform(0, 0.02)
    row[ob.E_I0 : ob.E_M0 + 1] = [rng.uniform(0, 1), *rng.uniform(-3, 3, 3)]
    row[ob.E_DELTA_N : ob.E_IDOT + 1] = rng.normal(0, [5e-9, 8e-9, 4e-10])
    row[ob.E_CUC : ob.E_CIS + 1] = rng.normal(0, [5e-6, 5e-6, 200, 200, 1e-7, 1e-7])
    row[ob.E_AF0 : ob.E_AF2 + 1] = rng.normal(0, [1e-4, 1e-11, 1e-19])
    return row


@pytest.mark.parametrize(("sat", "axis"), ORBITS, ids=[satellite_name(s) for s, _ in ORBITS])
def test_position_velocity_and_clock_are_those_of_rtklib(sat: int, axis: float) -> None:
    row, out = _made_up(sat, axis, sat), np.empty(8)
    for dt in (-7_200.0, -1_234.5, 0.0, 3_600.0, 7_200.0):
        satellite_at(row, row[ob.E_WEEK], row[ob.E_TOE] + dt, out)
        place, clock = position_and_clock(row, dt)
        # Rounding of angles around 1e2 rad at 4e7 m.
        assert np.abs(out[:3] - place).max() < 1e-5
        assert abs(out[6] / C - clock) < 1e-15
        later, clock_later = position_and_clock(row, dt + 0.5)
        before, clock_before = position_and_clock(row, dt - 0.5)
        assert np.abs(out[3:6] - (later - before)).max() < 1e-5
        assert abs(out[7] / C - (clock_later - clock_before)) < 1e-15


def test_group_delay_comes_off_the_clock_and_the_week_may_turn_over() -> None:
    row, a, b = _made_up(101, 26_560e3, 1), np.empty(8), np.empty(8)
    satellite_at(row, 2300.0, 302_500.0, a)
    row[ob.E_GROUP_DELAY] = 1e-8
    satellite_at(row, 2300.0, 302_500.0, b)
    assert a[6] - b[6] == pytest.approx(1e-8 * C, abs=1e-9)
    # The same moment, said in the week after.
    satellite_at(row, 2301.0, 302_500.0 - 604_800.0, a)
    assert np.array_equal(a, b)
