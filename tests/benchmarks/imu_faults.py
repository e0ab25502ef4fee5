"""Three inertial units, one of which fails in six ways: time to detection, and what it costs.

Run as ``python -m tests.benchmarks.imu_faults [SEEDS] [hour]``: with ``hour``, an hour of nominal
flight beside it, in which nothing may be excluded. A fault begins at 60 s of 120 and stays; which
unit has it goes round with the seed. Errors are RMS from the fault on, published solution against
truth, over those of the same flight without the fault.
"""

from __future__ import annotations

import sys

import msgspec
import numpy as np

from companion.types import F64, NS, Event, Outputs, Samples, Solution
from replay.evaluation import errors_against
from replay.player import play
from replay.simulator.simulation import run
from tests.benchmarks.common import table
from tests.intake.flights import FAULTS, config, failure, scenario

DURATION_S, BEGIN_S = 120.0, 60.0


def flown(kind: str, seed: int, unit: int) -> tuple[F64, list[tuple[str, float]]]:
    """RMS errors (position m, velocity m/s, attitude deg; 3-D) from the fault on, and events."""
    of = scenario({unit: failure(kind, BEGIN_S)} if kind else {}, duration_s=DURATION_S)
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


def _faults(seeds: int) -> None:
    nominal = [flown("", seed, 0) for seed in range(seeds)]
    false = sum(kind == "imu-excluded" for _, said in nominal for kind, _ in said)
    base = np.array([rms for rms, _ in nominal])
    rows = [["none", "-", "-", f"{false}", *(f"{x:.3f}" for x in base.mean(axis=0)), "-", "-"]]
    for kind in FAULTS:
        found, others, after = [], 0, []
        for seed in range(seeds):
            rms, said = flown(kind, seed, seed % 3)
            times = [t - BEGIN_S for what, t in said if what == "imu-excluded"]
            found += times[:1]
            others += len(times) - 1
            after.append(rms)
        worse = np.array(after) / base - 1.0
        rows.append([
            kind, f"{np.median(found):.2f}", f"{max(found):.2f}", f"{others}",
            *(f"{x:.3f}" for x in np.mean(after, axis=0)),
            " ".join(f"{100 * (np.mean(after, axis=0) / base.mean(axis=0) - 1.0)[i]:+.1f}"
                     for i in range(3)),
            " ".join(f"{100 * worse[:, i].max():+.0f}" for i in range(3)),
        ])  # fmt: skip
    head = ["fault", "found after s, median", "at most", "further exclusions", "position m",
            "velocity m/s", "attitude deg", "worse % (p v a)", "worst seed % (p v a)"]  # fmt: skip
    print(
        f"\n{seeds} seeds of {DURATION_S:g} s, three consumer units at 100 Hz, vibration 0.5 m/s²"
    )
    print(table(head, rows))


def _hour(seed: int) -> None:
    of = scenario({}, duration_s=3600.0)
    simulation = run(of, seed)
    events: list[Event] = []
    cfg = config(of)
    cfg = msgspec.structs.replace(cfg, engine=msgspec.structs.replace(cfg.engine, output_rate_hz=1))
    engine = play(simulation.recording, cfg, lambda _, out: events.extend(out.events))
    said = [e for e in events if e.kind[:4] == "imu-"]
    print(f"\nOne hour of nominal flight, seed {seed}: {len(said)} events of the units")
    for e in said:
        print(f"{(e.t_ns - simulation.t0_ns) / NS:8.1f} s  {e.text}")
    assert engine.fusion is not None
    print(engine.fusion.counts())


if __name__ == "__main__":
    words = sys.argv[1:]
    if "hour" in words:
        for seed in range(2):
            _hour(seed)
    numbers = [int(word) for word in words if word.isdigit()]
    if numbers:
        _faults(numbers[0])
