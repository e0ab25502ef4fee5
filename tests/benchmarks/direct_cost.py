"""What the direct filter costs an epoch of its inertial units, and how it grows with them.

    python -m tests.benchmarks.direct_cost [ROUNDS]

The one-minute track of Yu et al. with 1 to 6 units at 100 Hz and a fix a second, all in memory: CPU
time of the walk, rounds interleaved, medians. The states are 15 + 12 N; a step in which nothing is
known of the structure would cost (15 + 12 N)³, an update of full rows (15 + 12 N)² a component,
and there are 6 N components an epoch.
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np

from replay.reproduce.yu.experiment import JERK
from replay.reproduce.yu.run import fly
from replay.reproduce.yu.track import Levers, measure, table_one

MOST = 6


def levers(units: int) -> Levers:
    """The first in the middle, the others on both sides of it."""
    return tuple((0.0, (-1) ** i * 0.5 * ((i + 1) // 2), 0.0) for i in range(units))


def main(rounds: int) -> None:
    """Print a row for each number of units."""
    track = table_one()
    epochs = len(track.t)
    rng = np.random.default_rng(1)
    start = rng.standard_normal(12)
    flights = {n: measure(track, rng, levers(n)) for n in range(1, MOST + 1)}
    spent: dict[int, list[float]] = {n: [] for n in flights}
    errors: dict[int, float] = {}
    for _ in range(rounds + 1):
        for n, sensors in flights.items():
            begin = time.process_time()
            flown = fly(track, sensors, start, JERK, True, levers(n))
            spent[n].append(time.process_time() - begin)
            errors[n] = float(np.sqrt(np.mean(np.sum(flown.attitude_deg**2, axis=1))))
    # The first round loads the kernels.
    us = {n: 1e6 * statistics.median(times[1:]) / epochs for n, times in spent.items()}
    print("units  states  us an epoch  us a unit's sample  to one unit  attitude RMS deg")
    for n, cost in us.items():
        print(
            f"{n:5} {15 + 12 * n:7} {cost:12.1f} {cost / n:19.1f} {cost / us[1]:12.1f}"
            f" {errors[n]:17.2f}"
        )
    power = np.polyfit(np.log([15 + 12 * n for n in us]), np.log(list(us.values())), 1)[0]
    print(f"cost goes with the number of states to the power {power:.2f}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
