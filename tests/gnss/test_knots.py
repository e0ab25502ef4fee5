"""Orbits between knots against orbits without."""

from __future__ import annotations

import numpy as np
import pytest

from companion.gnss import orbit as ob
from companion.gnss.knots import KNOT_SIZE, satellite_near
from companion.types import F64
from replay.simulator.constellation import ephemerides

WEEK, START = 2300, 200_000.0


def _of(sat: int) -> F64:
    rows = ephemerides((sat // 100 - 1,), WEEK, START, START)
    row = next(row for row in rows if row[ob.E_SAT] % 100 > 5).copy()
    row[ob.E_SAT] = sat
    return row


# 303 is geostationary, in a frame of its own.
@pytest.mark.parametrize("sat", [107, 212, 319, 303])
@pytest.mark.parametrize("ecc", [0.0, 0.02])
def test_between_knots_an_orbit_is_that_of_its_ephemeris(sat: int, ecc: float) -> None:
    row = _of(sat)
    row[ob.E_ECC] = ecc
    knots, near, at = np.full((2, KNOT_SIZE), np.nan), np.empty(8), np.empty(8)
    error = []
    for second in np.arange(row[ob.E_TOE] - 600.0, row[ob.E_TOE] + 600.0, 7.31):
        satellite_near(row, knots, float(WEEK), second, near)
        ob.satellite_at(row, float(WEEK), second, at)
        error.append(near - at)
    worst = np.abs(error).max(axis=0)
    # h⁴ r ω⁴ / 384 = 2.5e-5 m for GPS, and its derivative; half as much again for eccentricity.
    assert worst[[0, 1, 2, 6]].max() < 5e-5
    assert worst[[3, 4, 5, 7]].max() < 1e-5


def test_who_asked_before_changes_no_bit() -> None:
    row, on_its_way = _of(107), np.full((2, KNOT_SIZE), np.nan)
    a, b = np.empty(8), np.empty(8)
    for second in [*np.arange(START, START + 300.0, 3.7).tolist(), START - 50.0, START + 10_000.0]:
        satellite_near(row, on_its_way, float(WEEK), second, a)
        satellite_near(row, np.full((2, KNOT_SIZE), np.nan), float(WEEK), second, b)
        assert a.tobytes() == b.tobytes()


def test_nothing_happens_at_the_turn_of_the_week() -> None:
    row, knots = _of(107), np.full((2, KNOT_SIZE), np.nan)
    row[ob.E_TOE] = row[ob.E_TOC] = 604_000.0
    a, b = np.empty(8), np.empty(8)
    for past in (-40.0, -1.0, 0.0, 25.0, 31.0):
        satellite_near(row, knots, WEEK + 1.0, past, a)
        satellite_near(row, knots, float(WEEK), 604_800.0 + past, b)
        # Seconds are whole numbers here: nothing is rounded on the way.
        assert a == pytest.approx(b, rel=1e-14)
