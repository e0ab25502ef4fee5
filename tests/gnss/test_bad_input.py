"""Bad ephemerides and bad time: said clearly, and never a wrong place."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss import orbit as ob
from companion.gnss.geometry import ned_axes
from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, leap_seconds
from companion.gnss.single_point import P_POS
from companion.intake.raw_gnss.epochs import Prepared
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64, NS, BroadcastSamples, RawGnssSamples
from replay.simulator.constellation import Sky, observe

LAT, LON, SECONDS = 0.8, 0.15, 20
WEEK_S = 604_800.0
HONEST_M = 8.0
"""Five times what noise of 0.7 m and the geometry make of one epoch."""


def _sky(start: tuple[int, float] = (2300, 200_000.0)) -> tuple[Sky, F64]:
    """A flight of 36 m/s, one epoch a second, and where it was (N, 3)."""
    R = np.empty((3, 3))
    ned_axes(LAT, LON, R)
    v = R.T @ np.array([30.0, 20.0, -1.0])
    begin = ecef(np.array([LAT]), np.array([LON]), np.array([500.0]))[0]
    t = np.arange(SECONDS, dtype=np.int64)
    place = begin + t[:, None] * v
    state = np.concatenate([place, np.broadcast_to(v, place.shape)], axis=1)
    return observe(t * NS, state, np.random.default_rng(1), start=start), place


def _run(raw: RawGnssSamples, *messages: BroadcastSamples) -> tuple[list[Prepared], Receiver]:
    receiver = Receiver(RawGnss())
    for m in messages:
        receiver.listen(m)
    return [receiver.take(raw, i) for i in range(len(raw))], receiver


def _errors(prepared: list[Prepared], place: F64) -> F64:
    return np.array(
        [
            np.linalg.norm(p.point[P_POS : P_POS + 3] - x)
            for p, x in zip(prepared, place, strict=True)
            if p.point is not None
        ]
    )


def _said(prepared: list[Prepared]) -> set[str]:
    events = [e for p in prepared for e in p.events]
    return {e.text.split(": ")[1] for e in events if e.kind == "satellite-refused"}


def _changed(messages: BroadcastSamples, who: range, change: dict[int, float]) -> BroadcastSamples:
    """Ephemerides of satellites ``who`` with something added to columns."""
    values = messages.values.copy()
    mine = np.isin(messages.sat, np.array(who))
    for column, value in change.items():
        values[mine, column] += value
    return replace(messages, values=values)


def test_missing_ephemerides_cost_their_satellites_and_nothing_else() -> None:
    sky, place = _sky()
    some = sky.broadcast.take(~np.isin(sky.broadcast.sat, np.arange(101, 118)))
    prepared, _ = _run(sky.raw, some)
    assert _errors(prepared, place).max() < HONEST_M
    assert len(_errors(prepared, place)) == SECONDS
    assert all(set(p.without["missing"]) <= set(range(101, 118)) for p in prepared)
    later = replace(sky.raw, tow=sky.raw.tow + np.linspace(0.0, 100.0, SECONDS))
    none, _ = _run(later)
    assert all(p.point is None and len(p.rows) == 0 for p in none)
    assert [e.kind for p in none for e in p.events].count("no-ephemerides") == 1


@pytest.mark.parametrize("weeks", [-1, -1024, 1024])
def test_ephemerides_of_another_week_give_no_place_and_a_reason(weeks: int) -> None:
    """A navigation file of last week; a receiver that lost, or gained, 1024 weeks."""
    sky, _ = _sky()
    every = range(101, 400)
    old = _changed(sky.broadcast, every, {ob.E_WEEK: weeks, ob.E_TOC_WEEK: weeks})
    prepared, _ = _run(sky.raw, old)
    assert all(p.point is None and len(p.rows) == 0 for p in prepared)
    assert _said(prepared) == {"ephemeris stale"}


@pytest.mark.parametrize(
    "change",
    [{ob.E_M0: 2.0**-8}, {ob.E_AF0: 2.0**-14}, {ob.E_I0: 2.0**-9}, {ob.E_OMEGA0: -(2.0**-7)}],
)
def test_contradictory_ephemerides_are_said_and_give_no_wrong_place(
    change: dict[int, float],
) -> None:
    sky, place = _sky()
    spoiled = _changed(sky.broadcast, range(101, 105), change)
    # One of the two issues of each: bits turned over in one message.
    _, first = np.unique(spoiled.sat, return_index=True)
    prepared, receiver = _run(sky.raw, sky.broadcast, spoiled.take(first))
    assert receiver.ephemerides.refused["contradictory"] >= 4
    assert "ephemeris contradictory" in _said(prepared)
    assert _errors(prepared, place).max() < HONEST_M
    # Where the spoiled ones are all there is, their ranges contradict those of the others.
    prepared, _ = _run(sky.raw, spoiled)
    assert "its range contradicts the others" in _said(prepared)
    assert _errors(prepared, place).max() < HONEST_M


def test_nothing_happens_at_the_turn_of_the_week() -> None:
    sky, place = _sky((2300, WEEK_S - 10.0))
    over = sky.raw.tow >= WEEK_S
    assert 5 < over.sum() < 15
    turned = replace(sky.raw, week=sky.raw.week + over, tow=sky.raw.tow - over * WEEK_S)
    # Ephemerides as they are sent, within their week.
    values = sky.broadcast.values.copy()
    for second, week in ((ob.E_TOE, ob.E_WEEK), (ob.E_TOC, ob.E_TOC_WEEK)):
        turns = values[:, second] >= WEEK_S
        values[turns, second] -= WEEK_S
        values[turns, week] += 1
    prepared, receiver = _run(turned, replace(sky.broadcast, values=values))
    assert len(_errors(prepared, place)) == SECONDS
    assert _errors(prepared, place).max() < HONEST_M
    assert receiver.clock.jumps == 0
    assert len({tuple(sorted(p.rows[:, 11].tolist())) for p in prepared}) == 1


@pytest.mark.parametrize("seconds", [-18.0, 1.0])
def test_epochs_whose_time_is_off_by_leap_seconds_give_no_place(seconds: float) -> None:
    """A receiver that stamps in UTC, or took its leap second too late: satellites are elsewhere."""
    sky, place = _sky()
    shifted = replace(sky.raw, tow=sky.raw.tow + seconds)
    prepared, receiver = _run(shifted, sky.broadcast)
    errors = _errors(prepared, place)
    # A second is 3 km along each orbit; what is left of it after the clock contradicts itself.
    assert len(errors) == 0 or errors.max() < HONEST_M
    assert receiver.unsolved + len(errors) == SECONDS
    assert [e.kind for p in prepared for e in p.events].count("ranges-contradict") == 1


@pytest.mark.parametrize(
    ("utc", "before", "after"),
    [((1981, 7, 1), 0, 1), ((2006, 1, 1), 13, 14), ((2015, 7, 1), 16, 17), ((2017, 1, 1), 17, 18)],
)
def test_leap_seconds_are_those_of_the_bulletins(
    utc: tuple[int, int, int], before: int, after: int
) -> None:
    gps_s = datetime(*utc, tzinfo=UTC).timestamp() - GPS_EPOCH_POSIX_S + after
    assert (leap_seconds(gps_s - 1.0), leap_seconds(gps_s)) == (before, after)


def test_a_satellite_that_says_so_of_itself_is_no_warning_and_too_few_have_no_geometry() -> None:
    sky, _ = _sky()
    some = np.unique(sky.raw.sat[0])[1:4]
    sick = _changed(sky.broadcast, range(int(some[0]), int(some[0]) + 1), {ob.E_HEALTH: 1.0})
    raw = replace(sky.raw, sat=np.where(np.isin(sky.raw.sat, some), sky.raw.sat, 0))
    prepared, _ = _run(raw, sick)
    events = {e.kind: e for p in prepared for e in p.events}
    assert "ephemeris unhealthy" in events["satellite-refused"].text
    assert events["satellite-refused"].level == "info"
    assert events["satellite-set"].text.startswith("2 satellites, of which no place is fixed; new")
