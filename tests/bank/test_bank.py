"""Unlike estimators on one stream: the same bits however it is cut, and a switch where one errs."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.bank import Bank, navigator
from companion.config import Bank as BankConfig
from companion.config import parse
from companion.config.settings import alone
from companion.engine import Engine
from companion.types import NS, ConfigError, Outputs, Recording, Smoothed, Solution
from replay.configuration import choose_config
from replay.evaluation import errors_against
from replay.player import arrivals, play
from replay.simulator.simulation import Simulation, run
from replay.simulator.suite import SUITE

from ..intake.flights import flown


@pytest.fixture(scope="module")
def flight() -> Simulation:
    scenario = SUITE["nominal"].scenario
    spec = msgspec.structs.replace(scenario.trajectory, duration_s=60.0)
    return run(msgspec.structs.replace(scenario, trajectory=spec), 2)


def _config(*names: str):  # type: ignore[no-untyped-def]
    return msgspec.structs.replace(SUITE["nominal"].config, bank=BankConfig(estimators=names))


def test_blocks_of_any_length_and_single_arrivals_publish_the_same(flight: Simulation) -> None:
    config = _config("error-state", "direct")
    outputs: list[Outputs] = []
    long = play(flight.recording, config, lambda _, out: outputs.append(out))
    short = play(flight.recording, config, block_s=0.3)
    turn = navigator(config)
    for samples in arrivals(flight.recording, config):
        turn.step(samples)
    turn.finish()
    assert long.digest == short.digest == turn.digest
    assert long.digest_published == short.digest_published == turn.digest_published
    # Each has its own output, the same as alone.
    names = [name for out in outputs for name, _ in out.members]
    assert set(names) == {"error-state", "direct"}
    for name in ("error-state", "direct"):
        alone = msgspec.structs.replace(config, bank=BankConfig())
        alone = msgspec.structs.replace(
            alone, engine=msgspec.structs.replace(alone.engine, estimator=name)
        )
        mine = [s for out in outputs for member, s in out.members if member == name]
        reference: list[Solution] = []
        play(flight.recording, alone, lambda _, out, to=reference: to.append(out.published))
        one, other = Solution.concatenate(mine), Solution.concatenate(reference)
        assert np.array_equal(one.t_ns, other.t_ns)
        assert np.array_equal(one.vel_n, other.vel_n)


def test_a_member_whose_imu_goes_wrong_is_left_for_one_that_has_others() -> None:
    """The first of three units reads a fifth too much from 40 s on; the preferred member has it
    alone."""
    simulation, config = flown("scaled", unit=0)
    names = ("error-state+one-imu", "error-state")
    config = msgspec.structs.replace(config, bank=BankConfig(estimators=names))
    outputs: list[Outputs] = []
    engine = play(simulation.recording, config, lambda _, out: outputs.append(out))
    assert isinstance(engine, Bank)
    said = [e for out in outputs for e in out.events if e.kind == "estimator-switched"]
    assert len(said) == engine.selector.switches == 1
    assert 40.0 < (said[0].t_ns - simulation.t0_ns) / NS < 50.0
    assert said[0].text.startswith("error-state is published in place of error-state+one-imu: ")
    published = Solution.concatenate([out.published for out in outputs])
    assert np.all(np.diff(published.t_ns) > 0)
    truth = simulation.recording.truth
    assert truth is not None

    def late_error(solution: Solution) -> float:
        errors = errors_against(solution, truth)
        late = errors.t_ns > simulation.t0_ns + 60 * NS
        return float(np.sqrt(np.mean((errors.position_n[late] ** 2).sum(axis=1))))

    alone = [s for out in outputs for name, s in out.members if name == names[0]]
    assert late_error(published) < 3.0
    assert late_error(Solution.concatenate(alone)) > 10.0


def test_one_estimator_is_an_engine_and_bad_banks_are_refused() -> None:
    assert isinstance(navigator(_config()), Engine)
    with pytest.raises(ConfigError, match=r"bank.estimators.*unknown 'kalman'"):
        parse('[bank]\nestimators = ["error-state", "kalman"]')
    with pytest.raises(ConfigError, match="two or more"):
        parse('[bank]\nestimators = ["direct"]')
    with pytest.raises(ConfigError, match="error-state estimator in the bank"):
        parse('[bank]\nestimators = ["direct", "direct+none"]\n[smoothing]\nenabled = true')


def test_the_first_estimator_that_can_be_is_smoothed_on_line(flight: Simulation) -> None:
    config = _config("direct", "error-state")
    config = msgspec.structs.replace(
        config, smoothing=msgspec.structs.replace(config.smoothing, enabled=True, rate_hz=5.0)
    )
    parts: list[Smoothed] = []
    bank = play(flight.recording, config, lambda _, out: parts.append(out.smoothed))
    mine = play(flight.recording, alone(config, "error-state"))
    assert bank.digest_smoothed == mine.digest_smoothed is not None
    assert sum(len(p) for p in parts) > 200


def test_a_slow_imu_leaves_a_bank_what_it_can_run(flight: Simulation) -> None:
    """At 4 Hz: those that are the direct filter, by name or because nothing else is said."""
    imu = tuple(s.take(slice(None, None, 25)) for s in flight.recording.imu)
    vehicle = replace(flight.recording, imu=imu)

    def chosen(names: str) -> tuple[tuple[str, ...], str, str]:
        text = f"[bank]\nestimators = {names}"
        found = choose_config(Recording("slow", "folder", (vehicle,), config_toml=text))
        return found.config.bank.estimators, found.config.engine.estimator, found.origin

    names, estimator, origin = chosen('["error-state", "direct", "no-mag"]')
    assert (names, estimator) == (("direct", "no-mag"), "direct")
    assert "left out of the bank: error-state" in origin
    assert chosen('["error-state", "direct"]')[:2] == ((), "direct")
    assert "left out" not in chosen('["direct", "no-baro"]')[2]
