"""Which satellites are used, and what their systems' clocks are apart, through the whole engine."""

from __future__ import annotations

import numpy as np
import pytest

from companion.config import Config, parse
from companion.navigation import layout as lo
from companion.types import Event, Outputs, Satellites
from replay.player import play
from tests.consistency import runs

from . import flights


def _flown(config: Config, systems: tuple[int, ...] = (0,)) -> tuple[Satellites, list[Event]]:
    """What was said of the satellites of a flight."""
    skies: list[Satellites] = []
    events: list[Event] = []

    def keep(_: object, out: Outputs) -> None:
        skies.append(out.satellites)
        events.extend(e for e in out.events if e.kind == "satellite-set")

    play(flights.flight(systems=systems).recording, config, keep)
    return Satellites.concatenate(skies), events


def _chosen(toml: str) -> Config:
    """The tests' configuration with satellites as a file asks for them."""
    asked = parse(f"[raw_gnss]\n{toml}").raw_gnss
    names = ("choice", "best_of", "best_margin", "elevation_mask_deg")
    return flights.config(raw_gnss={name: getattr(asked, name) for name in names})


def test_all_a_mask_or_the_best_few_are_used_and_a_change_is_an_event() -> None:
    every, _ = _flown(_chosen("elevation_mask_deg = 5.0"))
    masked, _ = _flown(_chosen("elevation_mask_deg = 20.0"))
    assert every.used.min() > masked.used.max() >= 4
    # Fewer satellites: none of the dilutions can become smaller.
    assert (masked.dop[:, :4] > every.dop[:, :4]).all()
    for count in (4, 5):
        best, changes = _flown(_chosen(f'choice = "best"\nbest_of = {count}\nbest_margin = 0.0'))
        assert set(best.used.tolist()) == {count}
        assert (best.dop[:, 0] > every.dop[:, 0]).all()
        assert all(e.text.startswith(f"{count} satellites, GDOP ") for e in changes)
        assert len(changes) >= 1


def test_the_best_four_navigate_nearly_as_well_as_their_dilution_says() -> None:
    vehicle = flights.flight(systems=(0,)).recording
    few = runs.fly(vehicle, _chosen('choice = "best"'))
    every = runs.fly(vehicle, _chosen("elevation_mask_deg = 5.0"))
    error = [np.linalg.norm(flights.errors(f.solution)[1], axis=1) for f in (few, every)]
    late = [flights.errors(f.solution)[0] > 30.0 for f in (few, every)]
    rms = [float(np.sqrt((e[x] ** 2).mean())) for e, x in zip(error, late, strict=True)]
    # GDOP of the best four is one and a half times that of all; an inertial unit carries both.
    assert rms[0] < 3.0 * rms[1]


@pytest.mark.parametrize(("systems", "at", "true_m"), [((0, 1), 0, 6.0), ((0, 2), 1, -9.0)])
def test_what_a_system_is_off_gps_is_a_state(
    systems: tuple[int, ...], at: int, true_m: float
) -> None:
    flown = runs.fly(flights.flight(systems=systems).recording, flights.config())
    f, setup = flown.engine.filter.phases[-1].filters[0], flown.engine.filter.setup
    index = setup.layout.clock + lo.SYSTEM + at
    sd = float(np.sqrt(setup.covariance(f.s)[index, index]))
    assert sd < 1.0
    assert abs(f.s[lo.CLOCK + lo.SYSTEM + at] - true_m) < 3.0 * sd
