"""Sources that err: what is kept out, how far it pulls, who comes back, and no alarm without one.

Trials of the simulator's suite; a *twin* is the same flight without the fault, so that what a fault
moved is told from what errs anyway.
"""

from __future__ import annotations

from functools import cache

import msgspec
import numpy as np
import pytest

from companion.navigation.earth import ned_difference
from companion.types import NS, AidingReports, Channel, Event, Outputs, Solution, Verdict
from replay.player import play
from replay.simulator.aids import Fault, GnssSpec, Outage
from replay.simulator.simulation import Simulation, run
from replay.simulator.suite import BEGIN_S, SUITE, Trial, suite_config

replace = msgspec.structs.replace


class Flown(msgspec.Struct):
    """What came of a flight."""

    sim: Simulation
    solution: Solution
    reports: AidingReports
    events: list[Event]
    digest: str

    def seconds(self, kind: str) -> list[float]:
        """When events of a kind happened, since the start."""
        return [(e.t_ns - self.sim.t0_ns) / NS for e in self.events if e.kind == kind]

    def error(self, begin_s: float, end_s: float) -> np.ndarray:
        """(N, 3) truth − estimate [m] between two times."""
        t = (self.solution.t_ns - self.sim.t0_ns) / NS
        part = self.solution.take(np.flatnonzero((t >= begin_s) & (t < end_s)))
        truth = self.sim.trajectory.states((part.t_ns - self.sim.t0_ns) / NS)
        return ned_difference(truth.lat, truth.lon, truth.height, part.lat, part.lon, part.height)

    def verdicts(self, begin_s: float, end_s: float) -> set[Verdict]:
        """What became of horizontal positions between two times."""
        t = (self.reports.t_ns - self.sim.t0_ns) / NS
        mine = self.reports.channel == Channel.GNSS_POSITION_H
        rows = mine & (t >= begin_s - 1e-6) & (t < end_s - 1e-6)
        return {Verdict(int(v)) for v in self.reports.verdict[rows]}


def fly(trial: Trial, seed: int) -> Flown:
    """A flight with no adaptation: what is seen here, detection alone sees."""
    sim = run(trial.scenario, seed)
    config = replace(trial.config, adaptation=replace(trial.config.adaptation, method="none"))
    parts: list[Outputs] = []
    engine = play(sim.recording, config, lambda _, out: parts.append(out))
    return Flown(
        sim,
        Solution.concatenate([p.published for p in parts]),
        AidingReports.concatenate([p.reports for p in parts]),
        [e for p in parts for e in p.events],
        engine.digest,
    )


@cache
def suite(name: str, seed: int) -> Flown:
    return fly(SUITE[name], seed)


def with_receiver(name: str, gnss: GnssSpec) -> Trial:
    """The nominal trial with another receiver."""
    scenario = replace(SUITE["nominal"].scenario, gnss=(gnss,))
    return Trial(name, name, scenario, suite_config(scenario))


def moved(flown: Flown, twin: Flown, until_s: float) -> float:
    """Largest distance between two flights' solutions up to a time [m]."""
    _, a, b = np.intersect1d(flown.solution.t_ns, twin.solution.t_ns, return_indices=True)
    one, other = flown.solution.take(a), twin.solution.take(b)
    t = (one.t_ns - flown.sim.t0_ns) / NS
    way = ned_difference(one.lat, one.lon, one.height, other.lat, other.lon, other.height)
    return float(np.linalg.norm(way[t <= until_s], axis=1).max())


@pytest.mark.parametrize("seed", [0, 1])
def test_spikes_from_20_m_on_move_the_solution_by_less_than_a_metre(seed: int) -> None:
    flown = suite("spikes", seed)
    assert moved(flown, suite("nominal", seed), 180.0) < 1.0
    assert not flown.seconds("source-fault")


@pytest.mark.parametrize("seed", [0, 1])
def test_a_ramp_of_1_mps_is_declared_before_it_has_pulled_10_m(seed: int) -> None:
    flown = suite("ramp-1", seed)
    declared = flown.seconds("source-fault")
    assert len(declared) == 1
    assert moved(flown, suite("nominal", seed), declared[0]) < 10.0
    # Out for as long as it drifts, back when it is right again, by itself.
    assert flown.verdicts(declared[0], BEGIN_S + 60.0) == {Verdict.REJECTED_SOURCE}
    returned = flown.seconds("source-returned")
    assert len(returned) == 1
    assert BEGIN_S + 60.0 < returned[0] < BEGIN_S + 65.0
    assert Verdict.ACCEPTED in flown.verdicts(170.0, 180.0)


@pytest.mark.parametrize("trial", ["burst", "multipath"])
def test_fixes_of_a_wrong_place_are_never_fused(trial: str) -> None:
    flown = suite(trial, 0)
    begin = BEGIN_S + (20.0 if trial == "burst" else 0.0)
    assert Verdict.ACCEPTED not in flown.verdicts(begin, SUITE[trial].end_s)
    assert Verdict.ACCEPTED in flown.verdicts(SUITE[trial].end_s + 2.0, 180.0)
    assert flown.seconds("source-fault")
    assert not flown.seconds("relocked")


def test_the_first_fix_after_a_gap_waits_for_others_that_agree_with_it() -> None:
    """One fix 15 m off, as uncertain as the position is after 30 s: the gate alone takes it."""
    outage = Outage(start_s=BEGIN_S, length_s=30.0)
    back = BEGIN_S + 30.0
    wrong = Fault(start_s=back - 0.1, length_s=0.2, step_n_m=(9.0, -12.0, 0.0))
    flown = fly(with_receiver("gap", GnssSpec(outages=(outage,), faults=(wrong,))), 0)
    assert flown.verdicts(back, back + 0.2) == {Verdict.REJECTED_UNCONFIRMED}
    assert Verdict.ACCEPTED in flown.verdicts(back + 0.2, back + 1.0)
    t = (flown.reports.t_ns - flown.sim.t0_ns) / NS
    row = (np.abs(t - back) < 1e-6) & (flown.reports.channel == Channel.GNSS_POSITION_H)
    assert (flown.reports.nis[row] < flown.reports.gate[row]).all()


def test_a_receiver_that_is_always_slow_is_none_after_a_gap() -> None:
    """A fix every 20 s: none of them has a neighbour, and none is refused for want of one."""
    flown = fly(with_receiver("slow", GnssSpec(rate_hz=0.05)), 0)
    assert flown.verdicts(40.0, 180.0) == {Verdict.ACCEPTED}


def test_a_receiver_that_starts_at_a_wrong_place_does_not_lock_the_filter_out() -> None:
    """20 m off for its first 25 s: believed, then contradicted, and soon believed again."""
    off = Fault(start_s=0.0, length_s=25.0, step_n_m=(16.0, -12.0, 0.0))
    flown = fly(with_receiver("start", GnssSpec(faults=(off,))), 1)
    assert np.linalg.norm(flown.error(65.0, 180.0)[:, :2], axis=1).max() < 6.0


@pytest.mark.parametrize("trial", ["nominal", "wandering", "manoeuvres"])
def test_no_fault_is_declared_where_there_is_none(trial: str) -> None:
    for seed in range(2):
        assert not suite(trial, seed).seconds("source-fault")


@pytest.mark.slow
@pytest.mark.parametrize("trial", ["nominal", "wandering"])
def test_no_fault_in_an_hour_without_one(trial: str) -> None:
    """20 flights of three minutes; the wandering receiver errs 1.5 m for two minutes on end."""
    declared = sum(len(fly(SUITE[trial], seed).seconds("source-fault")) for seed in range(20))
    assert declared == 0


def test_late_fixes_settle_to_the_same_bits_through_a_fault() -> None:
    """Detection, what it takes back and when it trusts again depend on times of validity alone."""
    ramp = SUITE["ramp-1"].scenario.gnss[0]
    digests = {
        fly(with_receiver("late", replace(ramp, latency_ms=ms)), 3).digest for ms in (0.0, 180.0)
    }
    assert len(digests) == 1
