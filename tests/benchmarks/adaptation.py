"""What adaptation costs: CPU time of the forward filter with each method, against none.

``python -m tests.benchmarks.adaptation``; about a minute. Ten minutes of 200 Hz IMU and 5 Hz GNSS
in memory, all methods in turn, five rounds; medians of each round's ratio to ``none``.
"""

from __future__ import annotations

import statistics
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
    vehicle, config = flight(60.0 * MINUTES)
    replace = msgspec.structs.replace
    configs = {
        method: replace(config, adaptation=replace(config.adaptation, method=method))
        for method in METHODS
    }
    ratios: dict[str, list[float]] = {method: [] for method in METHODS}
    play(vehicle, config)  # kernels and memory
    for _ in range(ROUNDS):
        cpu: dict[str, float] = {}
        for method in METHODS:
            begin = time.process_time()
            play(vehicle, configs[method])
            cpu[method] = time.process_time() - begin
        for method in METHODS:
            ratios[method].append(cpu[method] / cpu["none"])
    rows = [
        [method, f"{100.0 * (statistics.median(ratios[method]) - 1.0):+.1f} %"]
        for method in METHODS
        if method != "none"
    ]
    print(table(["adaptation", "CPU of the filter against none"], rows))


if __name__ == "__main__":
    main()
