"""Which ephemeris a measurement may be corrected with, and which must not be."""

from __future__ import annotations

import numpy as np
import pytest

from companion.gnss import orbit as ob
from companion.gnss.broadcast import CONTRADICTORY, MISSING, STALE, UNHEALTHY, Ephemerides
from companion.gnss.systems import BEIDOU, GALILEO, GPS
from companion.types import F64, BroadcastSamples
from replay.simulator.constellation import ephemerides

WEEK, START = 2300, 200_000.0


def _messages(rows: list[F64]) -> BroadcastSamples:
    n = len(rows)
    t = np.zeros(n, np.int64)
    values = np.array(rows)
    return BroadcastSamples("test", t, t, np.arange(n), values[:, 0].astype(np.int64), values)


def _of(sat: int, count: int) -> list[F64]:
    """Consecutive ephemerides of one satellite, two hours apart."""
    system = sat // 100 - 1
    rows = ephemerides((system,), WEEK, START, START + 7_200.0 * (count - 1))
    return [row for row in rows if row[ob.E_SAT] == sat][:count]


def test_nearest_in_time_is_chosen_and_old_ones_are_refused() -> None:
    store, rows = Ephemerides(), _of(103, 2)
    store.take(_messages(rows))
    toe = rows[0][ob.E_TOE]
    assert store.choose(103, WEEK, toe + 1_000)[0] is not None
    assert store.choose(103, WEEK, toe + 1_000)[0][ob.E_TOE] == toe  # type: ignore[index]
    assert store.choose(103, WEEK, toe + 5_000)[0][ob.E_TOE] == toe + 7_200  # type: ignore[index]
    assert store.choose(103, WEEK, toe + 15_000) == (None, STALE)
    assert store.choose(104, WEEK, toe) == (None, MISSING)


def test_age_counts_across_the_end_of_a_week() -> None:
    store, row = Ephemerides(), _of(103, 1)[0]
    row[ob.E_TOE] = row[ob.E_TOC] = row[ob.E_TOE_OWN] = 604_784.0
    store.take(_messages([row]))
    assert store.choose(103, WEEK + 1, 600.0)[0] is not None
    assert store.choose(103, WEEK, 600.0) == (None, STALE)
    # A receiver that lost 1024 weeks.
    assert store.choose(103, WEEK - 1023, 600.0) == (None, STALE)


def test_unhealthy_satellites_are_refused() -> None:
    store, row = Ephemerides(), _of(103, 1)[0]
    row[ob.E_HEALTH] = 1
    store.take(_messages([row]))
    assert store.choose(103, WEEK, row[ob.E_TOE]) == (None, UNHEALTHY)


@pytest.mark.parametrize("sat", [103, 205, 324], ids=["GPS", "Galileo", "BeiDou"])
def test_neighbours_that_contradict_are_both_refused_until_one_comes_again(sat: int) -> None:
    store, (first, second) = Ephemerides(), _of(sat, 2)
    bad = second.copy()
    bad[ob.E_M0] += 1e-3  # 27 km along the orbit
    now = first[ob.E_TOE] + 3_600.0
    store.take(_messages([first]))
    assert store.choose(sat, WEEK, now)[0] is not None
    store.take(_messages([bad]))
    assert store.choose(sat, WEEK, now) == (None, CONTRADICTORY)
    assert store.refused == {CONTRADICTORY: 1}
    store.take(_messages([first]))
    chosen = store.choose(sat, WEEK, now)[0]
    assert chosen is not None
    assert np.array_equal(chosen, first)
    store.take(_messages([second]))
    assert store.choose(sat, WEEK, second[ob.E_TOE])[0] is not None


@pytest.mark.parametrize(
    ("column", "value"),
    [(ob.E_SQRT_A, 3_000.0), (ob.E_ECC, 0.5), (ob.E_TOE, 7e5), (ob.E_M0, np.nan), (ob.E_AF0, 1.0)],
)
def test_orbits_that_no_satellite_has_are_counted_and_dropped(column: int, value: float) -> None:
    store, row = Ephemerides(), _of(103, 1)[0]
    row[column] = value
    store.take(_messages([row]))
    assert store.refused == {"impossible": 1}
    assert store.choose(103, WEEK, START) == (None, MISSING)


def test_all_systems_have_limits() -> None:
    rows = ephemerides((GPS, GALILEO, BEIDOU), WEEK, START, START)
    store = Ephemerides()
    store.take(_messages(rows))
    assert len(store) == len(rows)
    assert store.refused == {}
