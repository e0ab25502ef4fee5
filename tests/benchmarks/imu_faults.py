"""Three inertial units, one of which fails in six ways: time to detection, and what it costs.

    python -m tests.benchmarks.imu_faults [--seeds 20]
    python -m tests.benchmarks.imu_faults --hours 0 1 2 3 4 [--units 2]

A fault begins at 60 s of 120 and stays; which unit has it goes round with the seed. Errors are RMS
from the fault on, published solution against truth, over those of the same flight without the
fault, and over those of its *twin*: the same flight in which that unit fell silent half a minute
before. What two units are worse than three is nobody's mistake; what the fault did on its way out
is the rest. With ``--hours``, an hour of nominal flight a seed, in which nothing may be excluded.
"""

from __future__ import annotations

import argparse

import msgspec
import numpy as np

from companion.types import F64, NS, Event, Outputs, Samples, Solution
from replay.evaluation import errors_against
from replay.player import play
from replay.simulator.simulation import run
from tests.benchmarks.common import table
from tests.intake.flights import FAULTS, config, failure, scenario

DURATION_S, BEGIN_S, TWIN_S = 120.0, 60.0, 30.0


def flown(
    kind: str, seed: int, unit: int, begin_s: float = BEGIN_S
) -> tuple[F64, list[tuple[str, float]]]:
    """RMS errors (position m, velocity m/s, attitude deg; 3-D) from 60 s on, and events."""
    of = scenario({unit: failure(kind, begin_s)} if kind else {}, duration_s=DURATION_S)
    simulation = run(of, seed)
    parts: list[Solution] = []
    events: list[Event] = []

    def sink(_: Samples, out: Outputs) -> None:
        parts.append(out.published)
        events.extend(out.events)

    play(simulation.recording, config(of), sink)
    solution = Solution.concatenate(parts)
    truth = simulation.recording.truth
    assert truth is not None
    errors = errors_against(solution, truth)
    late = errors.t_ns > simulation.t0_ns + round(BEGIN_S * NS)
    rms = [
        np.sqrt(np.nanmean((e[late] ** 2).sum(axis=1)))
        for e in (errors.position_n, errors.velocity_n, np.degrees(errors.attitude))
    ]
    said = [(e.kind, (e.t_ns - simulation.t0_ns) / NS) for e in events if e.kind[:4] == "imu-"]
    return np.array(rms), said


def _percent(after: F64, before: F64) -> str:
    """How much worse the means over the seeds are, by quantity."""
    return " ".join(f"{100 * x:+.1f}" for x in after.mean(axis=0) / before.mean(axis=0) - 1.0)


def _faults(seeds: int) -> None:
    nominal = [flown("", seed, 0) for seed in range(seeds)]
    false = sum(kind == "imu-excluded" for _, said in nominal for kind, _ in said)
    base = np.array([rms for rms, _ in nominal])
    twin = np.array([flown("silent", seed, seed % 3, TWIN_S)[0] for seed in range(seeds)])
    rows = [["none", "-", "-", f"{false}", *_means(base), "-", "-", "-"]]
    rows.append(["twin", "-", "-", "-", *_means(twin), _percent(twin, base), "-", "-"])
    for kind in FAULTS:
        found, others, errors = [], 0, []
        for seed in range(seeds):
            rms, said = flown(kind, seed, seed % 3)
            times = [t - BEGIN_S for what, t in said if what == "imu-excluded"]
            found += times[:1]
            others += len(times) - 1
            errors.append(rms)
        after = np.array(errors)
        worst = (after / base - 1.0).max(axis=0)
        rows.append([
            kind, f"{np.median(found):.2f}", f"{max(found):.2f}", f"{others}", *_means(after),
            _percent(after, base), " ".join(f"{100 * x:+.0f}" for x in worst),
            _percent(after, twin),
        ])  # fmt: skip
    head = ["fault", "found after s, median", "at most", "further exclusions", "position m",
            "velocity m/s", "attitude deg", "worse % (p v a)", "worst seed % (p v a)",
            "worse than twin % (p v a)"]  # fmt: skip
    print(f"{seeds} seeds of {DURATION_S:g} s, three consumer units at 100 Hz, vibration 0.5 m/s²")
    print(table(head, rows))


def _means(errors: F64) -> list[str]:
    return [f"{x:.3f}" for x in errors.mean(axis=0)]


def _hour(seed: int, units: int) -> None:
    of = scenario({}, units=units, duration_s=3600.0)
    simulation = run(of, seed)
    events: list[Event] = []
    cfg = config(of)
    cfg = msgspec.structs.replace(cfg, engine=msgspec.structs.replace(cfg.engine, output_rate_hz=1))
    engine = play(simulation.recording, cfg, lambda _, out: events.extend(out.events))
    said = [e for e in events if e.kind[:4] == "imu-"]
    assert engine.fusion is not None
    counts = engine.fusion.counts()
    left_out = sum(n for name, n in counts.items() if name.endswith("outlying_epochs"))
    heard = f"{len(said)} events of the units, {left_out} single samples left out"
    print(f"An hour of nominal flight, {units} units, seed {seed}: {heard}", flush=True)
    for e in said:
        print(f"{(e.t_ns - simulation.t0_ns) / NS:8.1f} s  {e.text}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--hours", type=int, nargs="*", default=[])
    parser.add_argument("--units", type=int, default=3)
    asked = parser.parse_args()
    for number in asked.hours:
        _hour(number, asked.units)
    if not asked.hours:
        _faults(asked.seeds)
