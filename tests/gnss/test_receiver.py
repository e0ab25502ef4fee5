"""One receiver's stream: least-squares position, faults, choice of satellites, clock steps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.clock_steps import STEP_M
from companion.gnss.corrected import S_SAT
from companion.gnss.geometry import ned_axes
from companion.gnss.single_point import P_CLOCK, P_COV, P_POS, P_VEL
from companion.intake.raw_gnss.epochs import Prepared
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64, NS
from replay.simulator.constellation import SatelliteFault, Sky, observe

LAT, LON = 0.8, 0.15


def _flight(seconds: int) -> F64:
    """(N, 6) ECEF of a straight flight at 36 m/s, one epoch a second."""
    R = np.empty((3, 3))
    ned_axes(LAT, LON, R)
    v = R.T @ np.array([30.0, 20.0, -1.0])
    start = ecef(np.array([LAT]), np.array([LON]), np.array([500.0]))[0]
    t = np.arange(seconds)[:, None]
    return np.concatenate([start + t * v, np.broadcast_to(v, (seconds, 3))], axis=1)


def _run(sky: Sky, config: RawGnss | None = None) -> list[Prepared]:
    receiver = Receiver(config or RawGnss())
    receiver.listen(sky.broadcast)
    return [receiver.take(sky.raw, i) for i in range(len(sky.raw))]


def sky_of(seconds: int, seed: int = 1, **kw: object) -> Sky:
    """What a receiver on that flight measures, an epoch a second."""
    t = np.arange(seconds, dtype=np.int64) * NS
    return observe(t, _flight(seconds), np.random.default_rng(seed), **kw)  # type: ignore[arg-type]


def _points(prepared: list[Prepared]) -> F64:
    points = [p.point for p in prepared]
    assert all(point is not None for point in points)
    return np.array(points)


def test_without_noise_the_place_is_exact_by_the_other_way_of_correcting() -> None:
    sky = sky_of(30, sd_range_m=0.0, sd_rate_mps=0.0)
    points, truth = _points(_run(sky)), _flight(30)
    # Sagnac's closed form is first order: 1e-4 m. Rates are taken at reception, not transmission:
    # (range rate)² / c = 2 mm/s.
    assert np.abs(points[:, P_POS : P_POS + 3] - truth[:, :3]).max() < 1e-3
    assert np.abs(points[:, P_VEL : P_VEL + 3] - truth[:, 3:]).max() < 5e-3
    assert np.abs(points[:, P_CLOCK] - sky.clock[:, 0]).max() < 1e-3
    biases = points[:, P_CLOCK + 1 : P_CLOCK + 3] - points[:, P_CLOCK : P_CLOCK + 1]
    assert np.abs(biases - [6.0, -9.0]).max() < 1e-3


def test_errors_of_many_epochs_fit_the_stated_covariance() -> None:
    config = RawGnss(sd_range_m=0.7, sd_multipath_m=0.0, iono_residual=0.0)
    points, truth = _points(_run(sky_of(400), config)), _flight(400)
    error = points[:, P_POS : P_POS + 3] - truth[:, :3]
    P = points[:, P_COV : P_COV + 9].reshape(-1, 3, 3)
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)
    # Mean of 400 chi-square values of 3 degrees: sd √(6/400) = 0.12; five of them.
    assert nees.mean() == pytest.approx(3.0, abs=0.6)


def test_a_step_of_one_satellite_is_excluded_while_it_lasts() -> None:
    fault = SatelliteFault(107, 20.0, 40.0, step_m=100.0)
    prepared = _run(sky_of(60, faults=(fault,)))
    excluded = [set(p.excluded) for p in prepared]
    assert all(107 in e for e in excluded[20:40])
    assert not any(107 in e for e in excluded[:20] + excluded[40:])
    texts = [e.text for p in prepared for e in p.events if e.kind == "satellite-refused"]
    assert texts.count("G07: its range contradicts the others") == 1
    error = _points(prepared)[:, P_POS : P_POS + 3] - _flight(60)[:, :3]
    assert np.linalg.norm(error, axis=1).max() < 6.0


def test_best_four_are_used_and_a_change_of_set_is_an_event() -> None:
    sky = sky_of(300, systems=(0,))
    prepared = _run(sky, RawGnss(choice="best", best_of=4))
    sets = [frozenset(p.rows[:, S_SAT].astype(int).tolist()) for p in prepared]
    assert {len(s) for s in sets} == {4}
    changes = sum(a != b for a, b in pairwise(sets))
    events = [e for p in prepared for e in p.events if e.kind == "satellite-set"]
    assert len(events) == changes + 1
    every = _run(sky)
    assert all(b.dop[0] >= a.dop[0] for a, b in zip(every, prepared, strict=True))


def test_steps_of_the_clock_are_taken_off_with_many_satellites_and_with_two() -> None:
    sky = sky_of(40)
    jump = np.where(np.arange(40) >= 20, STEP_M, 0.0)[:, None]
    stepped = replace(
        sky.raw,
        pseudorange=sky.raw.pseudorange + jump,
        tow=sky.raw.tow + jump[:, 0] / 299_792_458.0,
    )
    plain = _run(sky)
    few = stepped.take(slice(15, 30))
    two = np.isin(np.arange(few.sat.shape[1]), (8, 9))
    few = replace(few, sat=np.where(two, few.sat, 0))
    for raw in (stepped, few):
        receiver = Receiver(RawGnss())
        receiver.listen(sky.broadcast)
        first = 0 if raw is stepped else 15
        for i in range(first):
            receiver.take(sky.raw, i)
        for i in range(len(raw)):
            got, want = receiver.take(raw, i), plain[first + i]
            ranges = dict(zip(want.rows[:, S_SAT], want.rows[:, 6], strict=True))
            assert len(got.rows) >= 2
            for row in got.rows:
                # 1 ms later a satellite is up to 4 m further on, which its range says as well.
                assert row[6] == pytest.approx(ranges[row[S_SAT]], abs=5.0)
        assert receiver.clock.steps == 1


def test_rubbish_gives_no_place_rather_than_a_wrong_one() -> None:
    sky = sky_of(10)
    rng = np.random.default_rng(2)
    rubbish = replace(sky.raw, pseudorange=rng.uniform(2e7, 2.6e7, sky.raw.pseudorange.shape))
    receiver = Receiver(RawGnss())
    receiver.listen(sky.broadcast)
    prepared = [receiver.take(rubbish, i) for i in range(10)]
    assert all(p.point is None and len(p.rows) == 0 for p in prepared)
    assert receiver.unsolved == 10
    nothing = replace(sky.raw, pseudorange=np.full_like(sky.raw.pseudorange, np.nan))
    assert all(receiver.take(nothing, i).point is None for i in range(10))
