"""Single-satellite faults under multipath: what is missed, what is refused without reason, clock.

Run as ``python -m tests.benchmarks.range_faults [--seeds N] [--adaptation HOW] [--clock KNOWN]``.
Flights of 100 s under two systems at 5 Hz; ranges with 0.7 m of white noise and 0.7 m of multipath
(τ 60 s) at the zenith, growing as 1/sin of the elevation. One satellite errs from 50 to 90 s. The
noise of the receiver's clock is given, the default, or learned from that. Missed: ranges fused with
an error beyond 20 m. False: ranges of healthy satellites that were refused.
"""

from __future__ import annotations

import argparse

import numpy as np

from companion.config.adaptation import METHODS
from tests.consistency.runs import mean_bounds
from tests.tight.faults import CLOCKS, KINDS, MULTIPATH_M, Outcome, fly

WIDTHS = (12, 9, 15, 32, 20, 27, 12)


def _cells(done: list[Outcome]) -> tuple[str, ...]:
    """A row of the table, behind the fault and the number of flights."""
    missed, faulty = sum(d.missed for d in done), sum(d.faulty for d in done)
    false, healthy = sum(d.false for d in done), sum(d.healthy for d in done)
    detected = np.array([d.detected_m for d in done])
    known = detected[~np.isnan(detected)]
    when = f"{np.median(known):.1f} {known.max():.1f}" if len(known) else "-"
    largest = np.array([d.largest_m for d in done])
    nees = np.mean([d.clock_nees.mean() for d in done])
    return (
        f"{missed} of {faulty}", when, f"{false} of {healthy}",
        f"{np.median(largest):.2f} {largest.max():.2f}", f"{nees:.2f}",
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--adaptation", default="none", choices=METHODS)
    parser.add_argument("--clock", default="given", choices=CLOCKS)
    asked = parser.parse_args()
    seeds = asked.seeds
    head = ("fault", "flights", "missed", "refused from m, median, worst", "false of healthy",
            "position m, median, worst", "clock NEES")  # fmt: skip
    print("".join(f"{name:>{width}}" for name, width in zip(head, WIDTHS, strict=True)))
    rows = [("none", 0.0), *((kind, MULTIPATH_M) for kind in KINDS)]
    done: dict[tuple[str, float], list[Outcome]] = {row: [] for row in rows}
    for seed in range(seeds):
        for row in rows:
            done[row].append(fly(seed, *row, asked.adaptation, asked.clock))
    for (kind, multipath), outcomes in done.items():
        words = kind if multipath else "none, white"
        cells = (words, f"{seeds}", *_cells(outcomes))
        print("".join(f"{cell:>{width}}" for cell, width in zip(cells, WIDTHS, strict=True)))
    low, high = mean_bounds(seeds, dof=2)
    print(f"Clock NEES of {seeds} flights at one epoch is honest between {low:.2f} and {high:.2f}")


if __name__ == "__main__":
    main()
