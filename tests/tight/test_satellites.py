"""Which satellites are used, and what their systems' clocks are apart, through the whole engine."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.config import Config, parse
from companion.navigation import layout as lo
from companion.types import Event, Outputs, Satellites, Solution
from replay.player import play
from tests.consistency import runs

from . import flights


@dataclass(frozen=True)
class _Flown:
    satellites: Satellites
    events: tuple[Event, ...]
    rms_m: float
    """Position error in space once it has settled."""


def _flown(config: Config) -> _Flown:
    """A flight under GPS alone."""
    parts: list[Outputs] = []
    play(flights.flight(systems=(0,)).recording, config, lambda _, out: parts.append(out))
    t, error = flights.errors(Solution.concatenate([out.settled for out in parts]))
    return _Flown(
        Satellites.concatenate([out.satellites for out in parts]),
        tuple(e for out in parts for e in out.events),
        float(np.sqrt((error[t > 30.0] ** 2).sum(axis=1).mean())),
    )


def _chosen(toml: str) -> Config:
    """The tests' configuration with satellites as a file asks for them."""
    asked = parse(f"[raw_gnss]\n{toml}").raw_gnss
    names = ("choice", "best_of", "best_margin", "elevation_mask_deg")
    return flights.config(raw_gnss={name: getattr(asked, name) for name in names})


def test_all_a_mask_or_the_best_few_are_used_and_a_change_is_an_event() -> None:
    every = _flown(_chosen("elevation_mask_deg = 5.0"))
    masked = _flown(_chosen("elevation_mask_deg = 20.0"))
    best = _flown(_chosen('choice = "best"\nbest_of = 4\nbest_margin = 0.0'))
    assert every.satellites.used.min() > masked.satellites.used.max() >= 4
    assert set(best.satellites.used.tolist()) == {4}
    # Of fewer satellites none of the dilutions can be smaller.
    for fewer in (masked, best):
        assert (fewer.satellites.dop[:, :4] > every.satellites.dop[:, :4]).all()
    assert (best.satellites.dop[:, 0] < 2.0 * every.satellites.dop[:, 0]).all()
    changes = [e for e in best.events if e.kind == "satellite-set"]
    assert len(changes) >= 1
    assert all(e.text.startswith("4 satellites, GDOP ") for e in changes)
    # The error goes with the dilution, and an inertial unit carries both.
    assert best.rms_m < 3.0 * every.rms_m
    for flown in (every, masked, best):
        assert not {"heading-lost", "level-lost"} & {e.kind for e in flown.events}


def test_what_a_system_is_off_gps_is_a_state() -> None:
    flown = runs.fly(flights.flight(systems=(0, 1, 2)).recording, flights.config())
    f, setup = flown.engine.filter.phases[-1].filters[0], flown.engine.filter.setup
    for at, true_m in ((0, 6.0), (1, -9.0)):
        index = setup.layout.clock + lo.SYSTEM + at
        sd = float(np.sqrt(setup.covariance(f.s)[index, index]))
        assert sd < 1.0
        assert abs(f.s[lo.CLOCK + lo.SYSTEM + at] - true_m) < 3.0 * sd
