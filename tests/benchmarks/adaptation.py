"""What adaptation costs: CPU time of the forward filter with each method, against none.

``python -m tests.benchmarks.adaptation [--methods A,B,…] [--rounds N]``; about a minute. Ten
minutes of 200 Hz IMU and 5 Hz GNSS in memory, all methods in turn; medians of each round's ratio to
``none``, and the range over the rounds.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time

import msgspec

from companion.config.adaptation import METHODS
from replay.bench.flight import flight
from replay.player import play
from tests.benchmarks.common import table

ROUNDS = 5
MINUTES = 10.0


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--methods", default="", help="methods, separated by commas; empty: all")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    given = parser.parse_args()
    wanted = given.methods.split(",") if given.methods else [m for m in METHODS if m != "none"]
    if unknown := [m for m in wanted if m not in METHODS]:
        sys.exit(f"no method {', '.join(unknown)}; there are {', '.join(METHODS)}")
    ways = ["none", *wanted]
    vehicle, config = flight(60.0 * MINUTES)
    replace = msgspec.structs.replace
    configs = {
        method: replace(config, adaptation=replace(config.adaptation, method=method))
        for method in ways
    }
    ratios: dict[str, list[float]] = {method: [] for method in ways}
    play(vehicle, config)  # kernels and memory
    for _ in range(given.rounds):
        cpu: dict[str, float] = {}
        for method in ways:
            begin = time.process_time()
            play(vehicle, configs[method])
            cpu[method] = time.process_time() - begin
        for method in ways:
            ratios[method].append(cpu[method] / cpu["none"])
    rows = [
        [
            method,
            *(
                f"{100.0 * (of(ratios[method]) - 1.0):+.1f} %"
                for of in (statistics.median, min, max)
            ),
        ]
        for method in wanted
    ]
    print(table(["adaptation, CPU of the filter against none", "median", "least", "most"], rows))


if __name__ == "__main__":
    main()
