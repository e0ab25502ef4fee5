"""Raw epochs in runs: however a stream is cut, the same bits, events and traces come out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import msgspec
import numpy as np
import pytest

from companion.config import Config
from companion.gnss import orbit as ob
from companion.gnss.broadcast import Ephemerides, choice_of
from companion.gnss.clock_steps import STEP_M
from companion.gnss.geometry import ned_axes
from companion.gnss.single_point import P_POS, P_VEL
from companion.gnss.systems import C
from companion.intake.ranges import RangeIntake
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import (
    F64,
    NS,
    AidingSamples,
    BroadcastSamples,
    Event,
    RawGnssSamples,
    Samples,
)
from replay.simulator.constellation import SatelliteFault, Sky, SystemNoise, ephemerides, observe

RATE_HZ, SECONDS = 2, 120
LAT, LON = 0.8, 0.15
WEEK, START = 2300, 200_000.0


def _track(t: F64) -> F64:
    """(N, 6) ECEF of a straight flight at 36 m/s."""
    R = np.empty((3, 3))
    ned_axes(LAT, LON, R)
    v = R.T @ np.array([30.0, 20.0, -1.0])
    begin = ecef(np.array([LAT]), np.array([LON]), np.array([500.0]))[0]
    return np.concatenate([begin + t[:, None] * v, np.broadcast_to(v, (len(t), 3))], axis=1)


def _sky(seconds: float = SECONDS, rate_hz: float = RATE_HZ, **kw: Any) -> Sky:
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    return observe((t * NS).astype(np.int64), _track(t), np.random.default_rng(5), **kw)


def _eventful() -> tuple[RawGnssSamples, BroadcastSamples]:
    """Faults, noise, a step and a jump of the clock, gaps, satellites that come and go, news."""
    sky = _sky(
        faults=(SatelliteFault(107, 30.0, 50.0, step_m=100.0),),
        noises=(SystemNoise(1, 60.0, 90.0, 5.0),),
    )
    raw, t = sky.raw, np.arange(0.0, SECONDS, 1.0 / RATE_HZ)
    jump = np.where(t >= 40.0, STEP_M, 0.0) + np.where(t >= 70.0, 43_210.9, 0.0)
    pseudorange = raw.pseudorange + jump[:, None]
    rng = np.random.default_rng(9)
    pseudorange[(t >= 80.0) & (t < 82.0)] = rng.uniform(2e7, 2.6e7, raw.sat.shape[1])
    sat = raw.sat.copy()
    sat[(t >= 55.0) & (t < 58.0), 3:] = 0
    sat[rng.random(sat.shape) < 0.01] = 0
    tow = raw.tow + jump / C
    tow[13] = np.nan
    raw = replace(raw, pseudorange=pseudorange, tow=tow, sat=sat)
    return _numbered(raw, _messages(sky.broadcast, raw))


def _messages(first: BroadcastSamples, raw: RawGnssSamples) -> BroadcastSamples:
    """All at the start and, every other second, one again, every tenth of them with a bit turned;
    unhealthy ones from the middle on."""
    n = SECONDS // 2
    again = 1 + np.arange(n) % (len(first) - 1)
    more = replace(
        first.take(again),
        t_ns=raw.t_ns[0] + 2 * NS * np.arange(n),
        t_rx_ns=raw.t_ns[0] + 2 * NS * np.arange(n),
        values=first.values[again].copy(),
    )
    more.values[5::10, ob.E_M0] += 2.0**-8
    more.values[n // 2 :: 7, ob.E_HEALTH] = 1.0
    return _joined([first, more])


def _joined(parts: list[Any]) -> Any:
    names = [f.name for f in fields(parts[0])][1:]
    return type(parts[0])(
        parts[0].source, *[np.concatenate([getattr(p, n) for p in parts]) for n in names]
    )


def _numbered(
    raw: RawGnssSamples, messages: BroadcastSamples
) -> tuple[RawGnssSamples, BroadcastSamples]:
    """Both numbered by time of arrival, messages first."""
    arrival = np.concatenate([messages.t_rx_ns, raw.t_rx_ns])
    seq = np.empty(len(arrival), np.int64)
    seq[np.argsort(arrival, kind="stable")] = np.arange(len(arrival))
    n = len(messages)
    return replace(raw, seq=seq[n:]), replace(messages, seq=seq[:n])


def _whole(raw: RawGnssSamples, messages: BroadcastSamples) -> list[list[AidingSamples]]:
    return [[messages, raw]]


def _several_at_once(raw: RawGnssSamples, messages: BroadcastSamples) -> list[list[AidingSamples]]:
    """Every other epoch in an arrival of its own: both in one take, with the messages."""
    odd = np.arange(len(raw)) % 2 == 1
    return [[raw.take(odd), messages, raw.take(~odd)]]


def _one_by_one(raw: RawGnssSamples, messages: BroadcastSamples) -> list[list[AidingSamples]]:
    each: list[AidingSamples] = [s.take(slice(i, i + 1)) for s in (raw, messages) for i in _of(s)]
    return [[one] for one in sorted(each, key=lambda one: int(one.seq[0]))]


def _of(samples: Samples) -> range:
    return range(len(samples))


def _at_random(raw: RawGnssSamples, messages: BroadcastSamples) -> list[list[AidingSamples]]:
    cuts = np.sort(np.random.default_rng(3).integers(0, len(raw) + len(messages), 12))
    pieces = []
    for low, high in zip([0, *cuts], [*cuts, 10**9], strict=True):
        parts = [s.take((s.seq >= low) & (s.seq < high)) for s in (raw, messages)]
        pieces.append([part for part in parts if len(part)])
    return pieces


Taken = tuple[dict[str, Any], list[Event]]


def _taken(config: Config, pieces: list[list[AidingSamples]]) -> Taken:
    """All columns that come out of a stream in ``pieces``, and its events."""
    intake, columns, events = RangeIntake(config), {}, []
    for piece in pieces:
        made, said = intake.take(piece)
        events += said.events
        for part in (*made, said.satellites, said.adaptation):
            for f in fields(part):
                key = f"{type(part).__name__}.{f.name}"
                columns.setdefault(key, []).append(getattr(part, f.name))
    return {k: v[0] if isinstance(v[0], str) else np.concatenate(v) for k, v in columns.items()}, [
        *events
    ]


def _config(**raw_gnss: Any) -> Config:
    said = {"coupling": "tight", "sd_range_m": 0.7, "sd_multipath_m": 0.0, **raw_gnss}
    return msgspec.convert({"raw_gnss": said}, Config)


@pytest.mark.parametrize("cut", [_one_by_one, _at_random, _several_at_once])
@pytest.mark.parametrize("choice", [{}, {"choice": "best", "best_of": 5, "systems": ["gps"]}])
def test_however_a_stream_is_cut_the_same_bits_and_events_come_out(
    cut: Callable[..., list[list[AidingSamples]]], choice: dict[str, Any]
) -> None:
    stream, config = _eventful(), _config(**choice)
    (want, said), (got, told) = (_taken(config, c(*stream)) for c in (_whole, cut))
    assert said == told
    assert want.keys() == got.keys()
    for name, column in want.items():
        np.testing.assert_array_equal(got[name], column, err_msg=name)
    # That it was eventful: else this says little.
    kinds = {event.kind for event in said}
    assert {"satellite-set", "satellite-refused"} <= kinds
    if not choice:
        assert {"receiver-clock", "ranges-contradict"} <= kinds
        reasons = {e.text.split(": ")[1] for e in said if e.kind == "satellite-refused"}
        assert {"ephemeris contradictory", "its range contradicts the others"} <= reasons
        assert want["AdaptationTrace.r_scale"].max() > 5.0
        assert len(set(want["Satellites.used"].tolist())) > 5


def test_a_repeated_message_does_not_touch_the_table_and_another_does() -> None:
    sky, store = _sky(2.0), Ephemerides()
    store.take(sky.broadcast)
    at = int(choice_of(np.array([WEEK * 604_800.0 + START]))[0])
    held = store.table(at)
    store.take(sky.broadcast)
    assert store.table(at) is held
    values = sky.broadcast.values.copy()
    values[:, ob.E_AF0] += 1e-9
    store.take(replace(sky.broadcast, values=values))
    assert store.table(at) is not held


def test_a_held_table_is_what_would_be_chosen_anew() -> None:
    rows = np.array(ephemerides((0, 1, 2), WEEK, START, START + 20_000.0))
    t = np.zeros(len(rows), np.int64)
    messages = BroadcastSamples("test", t, t, t, rows[:, ob.E_SAT].astype(np.int64), rows)
    store = Ephemerides()
    store.take(messages)
    first = WEEK * 604_800.0 + START - 9_000.0
    tables = set()
    for now in np.arange(first, first + 30_000.0, 60.0):
        at = int(choice_of(np.array([now]))[0])
        table = store.table(at)
        tables.add(id(table.rows))
        fresh = Ephemerides()
        fresh._of = store._of
        other = fresh.table(at)
        assert table.begin <= at < table.end
        np.testing.assert_array_equal(table.row_of, other.row_of)
        np.testing.assert_array_equal(table.rows, other.rows)
    assert 3 < len(tables) < 60


def test_where_a_solution_starts_from_does_not_matter() -> None:
    """From nowhere, from the epoch before, from a place that is minutes and kilometres old."""
    sky = _sky(400.0, 0.1)
    last = len(sky.raw) - 1
    places = []
    for heard in (range(last), (), (0,)):
        receiver = Receiver(_config().raw_gnss)
        receiver.listen(sky.broadcast)
        for i in heard:
            receiver.take(sky.raw, i)
        point = receiver.take(sky.raw, last).point
        assert point is not None
        places.append(point[P_POS : P_VEL + 3])
    # Minutes are 14 km: 7e-4 rad of elevation, of which ionosphere and weights make millimetres.
    assert np.abs(np.array(places) - places[0]).max() < 1e-2


def test_a_wild_rate_takes_no_satellite_below_the_horizon() -> None:
    sky = _sky(10.0)
    rate = sky.raw.rate.copy()
    rate[8, 2] = 5e6
    wild = replace(sky.raw, rate=rate)
    used = []
    for raw in (sky.raw, wild):
        receiver = Receiver(_config().raw_gnss)
        receiver.listen(sky.broadcast)
        used.append(receiver.prepare(raw))
    np.testing.assert_array_equal(used[1].counts, used[0].counts)
    near = np.abs(used[1].points[:, P_POS : P_POS + 3] - used[0].points[:, P_POS : P_POS + 3])
    assert near.max() < 1e-3


def test_numbers_that_are_none_cost_their_satellites_and_nothing_else() -> None:
    sky = _sky(10.0)
    raw = replace(
        sky.raw, sat=sky.raw.sat.copy(), pseudorange=sky.raw.pseudorange.copy(),
        tow=sky.raw.tow.copy(), week=sky.raw.week.copy(), cn0=np.full_like(sky.raw.cn0, np.nan),
    )  # fmt: skip
    raw.pseudorange[5, :3] = np.nan, np.inf, 1e300
    raw.sat[6, :4] = -5, 999, 150, 400
    raw.tow[7], raw.tow[8] = np.nan, 1e300
    raw.week[9] = 2**62
    receiver = Receiver(_config().raw_gnss)
    receiver.listen(sky.broadcast)
    made = receiver.prepare(raw)
    assert np.isfinite(made.rows).all()
    full = made.counts[0]
    assert made.counts[5] >= full - 3
    assert made.counts[6] >= full - 4
    assert (made.counts[7:10] == 0).all()
    assert (made.counts[10:] >= full - 1).all()
    assert made.solved[[*range(7), *range(10, len(raw))]].all()
