"""Faults of single satellites in simulated flights: what is refused, what is not, and the clock.

A satellite of an epoch is *refused* where the receiver's own test leaves it out or a gate does. A
*miss* is a range that was fused though it was further off than :data:`HARMLESS_M`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from companion.config import Config, RawGnss
from companion.engine import Engine
from companion.gnss.corrected import S_SAT
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation import layout as lo
from companion.types import F64, NS, Channel, Solution, Verdict
from replay.player import blocks
from replay.simulator import Simulation
from replay.simulator.constellation import SatelliteFault
from replay.simulator.raw_gnss import RawFlight, with_raw_gnss
from tests.consistency import runs

from . import flights

SECONDS = 100.0
SCENARIO = runs.honest("multirotor-mission", SECONDS)
START_S, END_S = 50.0, 90.0
WHITE_M, MULTIPATH_M = 0.7, 0.7
HARMLESS_M = 20.0
"""Less is what a low satellite's multipath does: a fault that nobody could tell from it."""
KINDS = {"none": (0.0, 0.0), "step 100 m": (100.0, 0.0), "ramp 1 m/s": (0.0, 1.0)}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one flight."""

    missed: int
    """Ranges that were fused with an error beyond :data:`HARMLESS_M`."""
    faulty: int
    """Ranges with such an error."""
    detected_m: float
    """Error at which the satellite was first refused; NaN: never."""
    false: int
    """Healthy ranges that were refused."""
    healthy: int
    largest_m: float
    """Position error while the fault lasts, 3-D."""
    clock_nees: F64
    """(N,) of bias and drift together, once a second from START_S on; 2 is honest."""


CLOCKS: dict[str, dict[str, object]] = {
    "given": {
        "clock_noise": "configured", "clock_walk_m_rts": 0.01, "clock_drift_walk_mps_rts": 0.15,
        "clock_ramp_mps2": 1e-3,
    },
    "default": {"clock_noise": "configured"},
    "learned": {},
}  # fmt: skip
"""What the filter is told of the clock: that of the simulation, a random walk of its drift alone,
the rest all but off; what anybody gets; what anybody gets, learned from there."""


def config(multipath_m: float, method: str = "none", clock: str = "given") -> Config:
    """Tight coupling that knows the noise of its ranges, and of its clock as ``clock`` says."""
    noise = {"sd_range_m": WHITE_M, "sd_multipath_m": multipath_m, "multipath_tau_s": 60.0}
    return flights.config(raw_gnss=noise | CLOCKS[clock], adaptation={"method": method})


def fly(
    seed: int, kind: str, multipath_m: float = MULTIPATH_M, method: str = "none",
    clock: str = "given",
) -> Outcome:  # fmt: skip
    """One flight with one fault, of a satellite that the seed chooses; ``method`` adapts.

    ``clock``: of :data:`CLOCKS`.
    """
    simulation = runs.run(SCENARIO, seed)
    healthy, usable = _healthy(seed, multipath_m)
    raw = healthy.recording.raw[0]
    t = flights.seconds(healthy.recording)
    inside = [usable[i] for i in np.flatnonzero((t >= START_S) & (t < END_S))]
    sat = int(np.random.default_rng(seed).choice(sorted(set.intersection(*inside))))
    step, ramp = KINDS[kind]
    fault = SatelliteFault(sat, START_S, END_S, step_m=step, ramp_mps=ramp)
    made = healthy if kind == "none" else _flight(simulation, seed, multipath_m, (fault,))
    accepted, solution, nees = _run(made, config(multipath_m, method, clock))
    error = np.where((t >= START_S) & (t < END_S), step + ramp * (t - START_S), 0.0)
    bad = np.abs(error) > HARMLESS_M
    own = np.array([sat in accepted.get(int(ns), ()) for ns in raw.t_ns])
    active = np.flatnonzero(error != 0.0)
    out = [i for i in active if not own[i]]
    settled = np.flatnonzero((t > 30.0) & (t < SECONDS - 5.0))
    tried = [(i, s) for i in settled for s in usable[i] if s != sat or error[i] == 0.0]
    false = sum(s not in accepted.get(int(raw.t_ns[i]), ()) for i, s in tried)
    at, position = (solution.t_ns - simulation.t0_ns) / NS, runs.errors(simulation, solution)[:, 0]
    during = (at > START_S) & (at < END_S)
    return Outcome(
        int((own & bad).sum()),
        int(bad.sum()),
        float(abs(error[out[0]])) if out else float("nan"),
        false,
        len(tried),
        float(np.linalg.norm(position[during], axis=1).max()),
        nees,
    )


@lru_cache(maxsize=1)
def _healthy(seed: int, multipath_m: float) -> tuple[RawFlight, list[set[int]]]:
    """A flight without a fault, and the satellites of its epochs."""
    flight = _flight(runs.run(SCENARIO, seed), seed, multipath_m)
    return flight, usable_satellites(flight)


def _flight(
    simulation: Simulation,
    seed: int,
    multipath_m: float,
    faults: tuple[SatelliteFault, ...] = (),
) -> RawFlight:
    return with_raw_gnss(
        simulation, seed, lever_arm_b_m=flights.LEVER, systems=(0, 1), faults=faults,
        sd_range_m=WHITE_M, multipath_m=multipath_m,
    )  # fmt: skip


def usable_satellites(flight: RawFlight) -> list[set[int]]:
    """Satellites of each epoch that are above the mask and have an ephemeris."""
    receiver = Receiver(RawGnss(exclude=False))
    receiver.listen(flight.recording.broadcast[0])
    raw = flight.recording.raw[0]
    return [set(receiver.take(raw, i).rows[:, S_SAT].astype(int).tolist()) for i in range(len(raw))]


def _run(flight: RawFlight, config_: Config) -> tuple[dict[int, set[int]], Solution, F64]:
    """Satellites whose range was accepted, by epoch; the solution; NEES of the clock."""
    engine = Engine(config_)
    settled: list[Solution] = []
    accepted: dict[int, set[int]] = {}
    nees: list[float] = []
    start = int(flight.recording.imu[0].t_ns[0]) + round(START_S * NS)
    known = int(flight.recording.raw[0].t_ns[-1])
    for imu, aids in blocks(flight.recording, config_, 1.0):
        out = engine.step_block(imu, aids)
        settled.append(out.settled)
        r = out.reports
        ranges = (r.channel >= Channel.RANGE_GPS) & (r.channel < Channel.RATE_GPS)
        taken = ranges & (r.verdict == Verdict.ACCEPTED)
        for ns, sat in zip(r.t_ns[taken].tolist(), r.source[taken].tolist(), strict=True):
            accepted.setdefault(ns, set()).add(sat)
        if start < imu.t_ns[-1] <= known:
            nees.append(_clock_nees(engine, flight))
    settled.append(engine.finish().settled)
    return accepted, Solution.concatenate(settled), np.array(nees)


def _clock_nees(engine: Engine, flight: RawFlight) -> float:
    """Bias and drift of the filter as it stands against the true ones."""
    f, setup = engine.filter.phases[-1].filters[0], engine.filter.setup
    now, at = int(f.k[lo.T_NOW]), setup.layout.clock
    offset = engine._ranges.receiver.clock.offset or 0.0
    t = flight.recording.raw[0].t_ns
    truth = np.array([np.interp(now, t, flight.sky.clock[:, k]) for k in range(2)])
    # The clock is carried with the covariance, which may be an interval behind the sample.
    behind = f.s[lo.SUM_T] * f.s[lo.CLOCK + lo.DRIFT]
    error = truth - f.s[lo.CLOCK : lo.CLOCK + 2] - [offset + behind, 0.0]
    P = setup.covariance(f.s)[at : at + 2, at : at + 2]
    return float(error @ np.linalg.solve(P, error))
