"""The scenario suite: position error of each adaptation method in everything that can go wrong.

``python -m tests.benchmarks.scenarios [--seeds N] [--only NAME,…] [--methods A,B,…] [--jobs 2]``

A run is a simulated flight with truth (:mod:`replay.simulator.suite`), straight into the engine;
figures are from 40 s on: RMS of the 3-D position error over all seeds, and the largest of any.
Beside every method stands its change against the first one. For faults of position a second table
says what they moved, when they were declared and when taken back. Aiding is handed over when it is
valid: late aiding settles to the same bits, at four times the cost.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any, get_args, get_type_hints

import msgspec
import numpy as np

from companion.config import Config
from companion.navigation.earth import ned_difference
from companion.types import F64, NS, Channel, Event, Outputs, Solution, VehicleRecording, Verdict
from replay.player import play
from replay.simulator.simulation import Simulation, run
from replay.simulator.suite import BEGIN_S, DURATION_S, SETTLED_S, SUITE, Trial
from tests.benchmarks.common import table


class Outcome(msgspec.Struct):
    """One flight by one method."""

    square: float
    """Mean square of the 3-D position error [m²]."""
    worst: float
    resets: int
    bad_fused: int = 0
    """Of the faulty fixes, horizontally, how many were taken."""
    pull: float = float("nan")
    """Largest distance from the solution without the fault, at any time from its start [m]."""
    pull_declared: float = float("nan")
    """The largest distance up to the declaration of a source fault [m]."""
    declared: float = float("nan")
    """Seconds from the fault's start to its declaration."""
    returned: float = float("nan")
    """Seconds from the fault's end until the source was trusted again."""
    faults: int = 0
    """Source faults declared in the whole flight."""


def methods() -> tuple[str, ...]:
    """What the configuration knows; ``none`` first."""
    section = getattr(Config(), "adaptation", None)
    if section is None:
        return ("none",)
    names = get_args(get_type_hints(type(section))["method"])
    return ("none", *(n for n in names if n != "none"))


def with_method(config: Config, method: str) -> Config:
    """``config`` with the adaptation of that name."""
    section = getattr(config, "adaptation", None)
    if section is None:
        return config
    changed = msgspec.structs.replace(section, method=method)
    return msgspec.structs.replace(config, adaptation=changed)


class Flown(msgspec.Struct):
    """What a flight left behind."""

    solution: Solution
    events: list[Event]
    bad_fused: int


def prompt(vehicle: VehicleRecording, config: Config) -> VehicleRecording:
    """The same samples, each arriving when it is valid, aiding before an inertial sample."""
    latency = {"gnss": config.gnss.latency_ms, "baro": config.baro.latency_ms}
    streams = {"imu": vehicle.imu[0], "gnss": vehicle.gnss[0], "baro": vehicle.baro[0]}
    arrival = {
        kind: s.t_ns - (round(latency[kind] * 1e6) + 1 if kind in latency else 0)
        for kind, s in streams.items()
    }
    order = np.argsort(np.concatenate(list(arrival.values())), kind="stable")
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    cuts = np.cumsum([len(s) for s in streams.values()])[:-1]
    moved: dict[str, Any] = {
        kind: (replace(s, t_rx_ns=arrival[kind], seq=seq),)
        for (kind, s), seq in zip(streams.items(), np.split(number, cuts), strict=True)
    }
    return replace(vehicle, **moved)


def fly(sim: Simulation, config: Config, trial: Trial) -> Flown:
    """One flight through a new engine; its published solution."""
    parts: list[Solution] = []
    events: list[Event] = []
    fused = 0
    faults = trial.scenario.gnss[0].faults

    def sink(_: object, out: Outputs) -> None:
        nonlocal fused
        parts.append(out.published)
        events.extend(out.events)
        r = out.reports
        taken = (r.channel == Channel.GNSS_POSITION_H) & (r.verdict == Verdict.ACCEPTED)
        t = (r.t_ns[taken] - sim.t0_ns) / NS
        for fault in faults:
            fused += int(np.sum((t >= fault.start_s) & (t < fault.start_s + fault.length_s)))

    play(prompt(sim.recording, config), config, sink)
    return Flown(Solution.concatenate(parts), events, fused)


def position_error(sim: Simulation, solution: Solution) -> F64:
    """(N, 3) truth − estimate [m]."""
    truth = sim.trajectory.states((solution.t_ns - sim.t0_ns) / NS)
    return ned_difference(
        truth.lat, truth.lon, truth.height, solution.lat, solution.lon, solution.height
    )


def _first(events: Sequence[Event], kind: str, after_ns: int) -> float:
    """Seconds since ``after_ns`` of the first event of a kind from then on; NaN: none."""
    times = [e.t_ns for e in events if e.kind == kind and e.t_ns >= after_ns]
    return (min(times) - after_ns) / NS if times else float("nan")


def judge(sim: Simulation, trial: Trial, flown: Flown, twin: Flown | None) -> Outcome:
    """Errors of one flight; with a ``twin``, what the fault did."""
    solution = flown.solution
    t = (solution.t_ns - sim.t0_ns) / NS
    size = np.linalg.norm(position_error(sim, solution)[t >= SETTLED_S], axis=1)
    if not len(size) or t[-1] < DURATION_S - 1.0:
        return Outcome(float("inf"), float("inf"), -1)
    out = Outcome(float(np.mean(size**2)), float(size.max()), int(solution.resets[-1]))
    out.bad_fused = flown.bad_fused
    out.faults = sum(e.kind == "source-fault" for e in flown.events)
    if twin is not None:
        other = twin.solution
        common, a, b = np.intersect1d(solution.t_ns, other.t_ns, return_indices=True)
        moved = ned_difference(
            solution.lat[a], solution.lon[a], solution.height[a],
            other.lat[b], other.lon[b], other.height[b],
        )  # fmt: skip
        distance = np.linalg.norm(moved, axis=1)
        since = (common - sim.t0_ns) / NS - BEGIN_S
        begin, end = sim.t0_ns + round(BEGIN_S * NS), sim.t0_ns + round(trial.end_s * NS)
        out.pull = float(distance[since >= 0.0].max())
        out.declared = _first(flown.events, "source-fault", begin)
        out.returned = _first(flown.events, "source-returned", end)
        if np.isfinite(out.declared):
            before = (since >= 0.0) & (since <= out.declared)
            out.pull_declared = float(distance[before].max())
    return out


def one_seed(seed: int, names: Sequence[str], ways: Sequence[str]) -> dict[str, dict[str, Outcome]]:
    """All trials of a seed by all methods: trial → method → outcome."""
    found: dict[str, dict[str, Outcome]] = {}
    flights: dict[tuple[str, str], Flown] = {}
    twins = {SUITE[n].twin for n in names} - {""}
    # Twins go first: they are held against.
    for name in sorted({*names, *twins}, key=lambda n: (n not in twins, n)):
        trial = SUITE[name]
        sim = run(trial.scenario, seed)
        for way in ways:
            flown = fly(sim, with_method(trial.config, way), trial)
            if name in twins:
                flights[name, way] = flown
            twin = flights[trial.twin, way] if trial.twin else None
            found.setdefault(name, {})[way] = judge(sim, trial, flown, twin)
    return found


def errors_table(runs: Sequence[dict[str, dict[str, Outcome]]], names: Sequence[str]) -> str:
    """RMS and worst of every method; the first is what the others are compared with."""
    ways = list(runs[0][names[0]])
    head = ["RMS, worst [m]", *(w if i == 0 else f"{w}, against {ways[0]}"
                                for i, w in enumerate(ways))]  # fmt: skip
    rows = []
    for name in names:
        cells, base = [SUITE[name].title], 0.0
        for i, way in enumerate(ways):
            every = [r[name][way] for r in runs]
            rms = float(np.sqrt(np.mean([o.square for o in every])))
            resets = sum(o.resets for o in every)
            cell = f"{rms:6.2f} {max(o.worst for o in every):6.1f}"
            if i == 0:
                base = rms
            else:
                cell += f" {100.0 * (rms / base - 1.0):+6.1f} %"
            cells.append(cell + (f" ({resets}r)" if resets else ""))
        rows.append(cells)
    return table(head, rows)


def faults_table(runs: Sequence[dict[str, dict[str, Outcome]]], names: Sequence[str]) -> str:
    """What each fault of position did, by method."""
    head = ["", "moved at most m", "before declared m", "declared", "after s (median, last)",
            "bad fixes taken", "back after s", "other faults"]  # fmt: skip
    rows = []
    for name in names:
        for way in runs[0][name]:
            every = [r[name][way] for r in runs]
            after = np.array([o.declared for o in every])
            known = after[np.isfinite(after)]
            back = np.array([o.returned for o in every])
            before = np.array([o.pull_declared for o in every])
            twin = bool(SUITE[name].twin)
            rows.append([
                f"{SUITE[name].title}, {way}",
                f"{max(o.pull for o in every):.2f}" if twin else "",
                f"{np.nanmax(before):.2f}" if np.isfinite(before).any() else "",
                f"{len(known)}/{len(every)}" if twin else "",
                f"{np.median(known):.1f}, {known.max():.1f}" if len(known) else "",
                f"{sum(o.bad_fused for o in every)}" if twin else "",
                f"{np.nanmax(back):.1f}" if np.isfinite(back).any() else "",
                f"{sum(o.faults for o in every) - len(known)}",
            ])  # fmt: skip
    return table(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--only", default="", help="trials, separated by commas")
    parser.add_argument("--methods", default="", help="methods, separated by commas")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    names = given.only.split(",") if given.only else list(SUITE)
    if unknown := [n for n in names if n not in SUITE]:
        sys.exit(f"no trial {', '.join(unknown)}; there are {', '.join(SUITE)}")
    ways = given.methods.split(",") if given.methods else list(methods())
    # Spawned, not forked: kernels are loaded by each process for itself.
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        jobs = [pool.submit(one_seed, seed, names, ways) for seed in range(given.seeds)]
        runs = [job.result() for job in jobs]
    print(f"{given.seeds} seeds; RMS over all, worst of all; (r): declared resets, all seeds")
    print(errors_table(runs, names))
    print("\nFaults of GNSS position: largest over all seeds; other faults: where there was none")
    print(faults_table(runs, names))


if __name__ == "__main__":
    main()
