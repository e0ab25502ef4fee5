"""The bank's selector when the preferred estimator goes wrong: what is published, and why.

    python -m tests.benchmarks.selector [--seeds 10]

The preferred member has the first of three inertial units alone, which goes wrong at 40 s of 90;
the second has all three, fused; the third is the direct filter. Position errors, 3-D RMS from 45 s
on: of what is published, and of each member; *best*: of the member that is best in that flight.
"""

from __future__ import annotations

import argparse
import re
from collections import Counter

import msgspec
import numpy as np

from companion.bank import Bank
from companion.config import Bank as BankConfig
from companion.types import NS, Event, Outputs, Samples, Solution
from replay.evaluation import errors_against
from replay.player import play
from replay.simulator.simulation import Simulation, run
from tests.benchmarks.common import table
from tests.intake.flights import config, failure, scenario

NAMES = ("error-state+one-imu", "error-state", "direct+one-imu")
BEGIN_S, JUDGED_S, DURATION_S = 40.0, 45.0, 90.0
_NUMBER = re.compile(r"\d+\.\d+")


def _rms(solution: Solution, simulation: Simulation) -> float:
    truth = simulation.recording.truth
    assert truth is not None
    errors = errors_against(solution, truth)
    late = errors.t_ns > simulation.t0_ns + round(JUDGED_S * NS)
    return float(np.sqrt(np.nanmean((errors.position_n[late] ** 2).sum(axis=1))))


def flown(kind: str, seed: int) -> tuple[list[float], list[tuple[float, str]]]:
    """RMS of what was published and of each member; switches: seconds after the fault, text."""
    of = scenario({0: failure(kind, BEGIN_S)} if kind else {}, duration_s=DURATION_S)
    simulation = run(of, seed)
    chosen = msgspec.structs.replace(config(of), bank=BankConfig(estimators=NAMES))
    chosen = msgspec.structs.replace(
        chosen, engine=msgspec.structs.replace(chosen.engine, output_rate_hz=10.0)
    )
    published: list[Solution] = []
    members: dict[str, list[Solution]] = {name: [] for name in NAMES}
    events: list[Event] = []

    def sink(_: Samples, out: Outputs) -> None:
        published.append(out.published)
        events.extend(out.events)
        for name, solution in out.members:
            members[name].append(solution)

    assert isinstance(play(simulation.recording, chosen, sink), Bank)
    errors = [_rms(Solution.concatenate(p), simulation) for p in (published, *members.values())]
    switched = [e for e in events if e.kind == "estimator-switched"]
    return errors, [((e.t_ns - simulation.t0_ns) / NS - BEGIN_S, e.text) for e in switched]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = parser.parse_args().seeds
    rows, reasons = [], Counter[str]()
    for kind in ("", "scaled", "frozen", "drifting", "noisy"):
        errors, switches, after = [], 0, []
        for seed in range(seeds):
            one, switched = flown(kind, seed)
            errors.append([*one, min(one[1:])])
            switches += len(switched)
            after += [t for t, _ in switched[:1]]
            reasons.update(f"{kind or 'none'}: {_NUMBER.sub('N', text)}" for _, text in switched)
        first = f"{np.median(after):.1f} {max(after):.1f}" if after else "-"
        rows.append([kind or "none", *(f"{x:.2f}" for x in np.median(errors, axis=0)),
                     f"{max(e[0] for e in errors):.2f}", str(switches), first])  # fmt: skip
    print(f"{seeds} flights each; position m, medians")
    print(table(["fault", "published", *NAMES, "best", "published, worst", "switches, all",
                 "first after s, median, last"], rows))  # fmt: skip
    print("\nReasons, N for their numbers")
    for text, count in reasons.most_common():
        print(f"{count:4}  {text}")


if __name__ == "__main__":
    main()
