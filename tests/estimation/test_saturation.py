"""A unit driven beyond its range: told once an episode, and not believed to the last digit."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from companion.config import Config, ConfigError, Imu, parse
from companion.engine import Engine
from companion.intake.saturation import QUIET_NS, SaturationWatch
from companion.navigation.rotation import attitude_error_n, quat_from_rpy
from companion.types import COV_ATT, F64, NS, Event, ImuSamples, Outputs, Solution
from replay.player import play
from replay.simulator.simulation import Simulation, run
from replay.simulator.suite import BEGIN_S, SUITE

RANGED = Config(imu=Imu(gyro_range_dps=500.0, accel_range_mps2=78.5))


def samples(accel: F64, gyro_dps: F64 | float = 0.0) -> ImuSamples:
    """100 Hz of force along y (N,) and rate about z."""
    n = len(accel)
    t = np.arange(n, dtype=np.int64) * NS // 100
    force, rate = np.tile([0.0, 0.0, -9.8], (n, 1)), np.zeros((n, 3))
    force[:, 1], rate[:, 2] = accel, np.radians(gyro_dps)
    return ImuSamples("imu", t, t, np.arange(n, dtype=np.int64), rate, force, np.full(n, np.nan))


def told(block: ImuSamples, cuts: list[int]) -> tuple[list[Event], int]:
    """What a watch says of samples handed over in pieces, and how many it counted."""
    watch, events, count = SaturationWatch(RANGED), [], 0
    for a, b in zip([0, *cuts], [*cuts, len(block)], strict=True):
        part = block.take(slice(a, b))
        count += watch.note(part.t_ns, np.asarray(watch.flags(part)))
        events += watch.take_events()
    return [*events, *watch.take_events(final=True)], count


def test_an_episode_is_told_when_it_begins_and_when_it_is_over() -> None:
    accel, gyro = np.zeros(4000), np.zeros(4000)
    accel[100:150:2] = 78.5
    accel[3000] = -78.46  # the last code of a converter, short of the range by half a per mille
    gyro[150] = 500.0
    block = samples(accel, gyro)
    events, count = told(block, [])
    assert count == 27
    assert [(e.kind, e.t_ns) for e in events] == [
        ("imu-saturated", NS),
        ("imu-in-range", 150 * NS // 100 + QUIET_NS),
        ("imu-saturated", 30 * NS),
        ("imu-in-range", 30 * NS + QUIET_NS),
    ]
    assert "accelerometer 25 times and gyro 1 time within 0.5 s" in events[1].text
    rng = np.random.default_rng(1)
    cuts = np.sort(rng.integers(0, len(block), 40)).tolist()
    assert told(block, cuts) == (events, count)


def test_below_the_range_and_without_one_nothing_is_said() -> None:
    assert told(samples(np.full(200, 78.0)), []) == ([], 0)
    watch, block = SaturationWatch(Config()), samples(np.full(200, 78.5))
    assert watch.note(block.t_ns, watch.flags(block)) == 0
    assert watch.take_events(final=True) == ()


def test_what_a_driver_says_needs_no_range() -> None:
    """Its own flags count as samples at the end; its counter says that there were some."""
    for clipped, count, words in (
        (1.0, 5, "accelerometer 5 times within"),
        (3.0, 5, "accelerometer 5 times and gyro 5 times within"),
        (0.5, 5, "left: by the autopilot's counter of clipped accelerations within"),
    ):
        block = samples(np.zeros(200))
        block.clipped[50:55] = clipped
        for config in (Config(), RANGED):
            watch = SaturationWatch(config)
            assert watch.note(block.t_ns, watch.flags(block)) == count
            begun, over = watch.take_events(final=True)
            assert (begun.kind, begun.t_ns) == ("imu-saturated", NS // 2)
            assert words in over.text


def test_values_that_are_no_numbers_are_not_at_the_end_of_a_range() -> None:
    engine = Engine(RANGED)
    engine.step(samples(np.array([0.0, np.nan, 90.0, np.inf])))
    assert engine.counters.imu_saturated == 2  # the infinite one as well; it is dropped later
    assert engine.counters.imu_not_finite == 2


@pytest.mark.parametrize("key", ["gyro_range_dps", "accel_range_mps2"])
def test_a_range_is_positive_or_not_known(key: str) -> None:
    with pytest.raises(ConfigError, match=f"imu.{key}"):
        parse(f"[imu]\n{key} = -1.0")


def shaken(ranged: bool, seed: int) -> tuple[Simulation, Solution, list[Event]]:
    """The suite's vibration with clipping, the range of the unit known or not."""
    trial = SUITE["vibration"]
    sim = run(trial.scenario, seed)
    known = trial.config.imu.accel_range_mps2 if ranged else 0.0
    imu = msgspec.structs.replace(trial.config.imu, accel_range_mps2=known)
    parts: list[Outputs] = []
    play(
        sim.recording, msgspec.structs.replace(trial.config, imu=imu), lambda _, o: parts.append(o)
    )
    solution = Solution.concatenate([p.published for p in parts])
    return sim, solution, [e for p in parts for e in p.events]


@pytest.mark.parametrize("seed", [0, 1])
def test_what_shakes_an_accelerometer_beyond_its_range_is_not_an_exact_gyro(seed: int) -> None:
    """Attitude while shaken: claimed to 0.06° and 5° off where the range is unknown.

    With it within four deviations (90 looks, 1e-4 each); what scale factors add later, which no
    state stands for, is another matter.
    """
    sim, solution, events = shaken(True, seed)
    assert [e.kind for e in events if e.kind.startswith("imu-")] == [
        "imu-saturated",
        "imu-in-range",
    ]
    assert not [e for e in events if e.kind == "level-lost"]
    t = (solution.t_ns - sim.t0_ns) / NS
    part = solution.take(np.flatnonzero((t > BEGIN_S + 5.0) & (t < BEGIN_S + 20.0))[::5])
    truth = sim.trajectory.states((part.t_ns - sim.t0_ns) / NS)
    true = np.array([quat_from_rpy(*rpy) for rpy in truth.rpy])
    ratio = attitude_error_n(true, part.q_nb) / part.sd[:, COV_ATT]
    assert np.abs(ratio).max() < 4.0
    _, _, without = shaken(False, seed)
    assert [e for e in without if e.kind == "level-lost"]
