"""Starts with an unknown heading all round the compass: how soon and how well it is found.

``python -m tests.benchmarks.heading [STEP_DEG]``; the default of 15° takes about two minutes.
Simulated flights and drives, once with only the errors that the filter models and once with all
that the sensors have; the magnetometer and the course may serve only after the heading is found.
"""

from __future__ import annotations

import sys

import numpy as np

from companion.types import F64
from tests.benchmarks.common import table
from tests.consistency import headings

SENSORS = {"modelled errors only": headings.modelled, "all errors": headings.realistic}
LATER_S = 10.0


def _at(one: headings.Start, since_s: float, column: F64) -> float:
    """``column`` at the epoch nearest to ``since_s`` after the heading was found."""
    return float(column[int(np.argmin(np.abs(one.since_s - since_s)))])


def row(name: str, starts: list[headings.Start]) -> list[str]:
    """Median and worst over the starts that found their heading, and how many did."""
    found = [s for s in starts if np.isfinite(s.found_s)]
    if not found:
        return [name, f"0/{len(starts)}", *["-"] * 6]
    seconds = np.array([s.found_s for s in found])
    error, later = (np.abs([_at(s, since, s.error_deg) for s in found]) for since in (0.0, LATER_S))
    claimed = [_at(s, 0.0, s.sd_deg) for s in found]
    worst = found[int(np.argmax(seconds))].heading_deg
    return [
        name, f"{len(found)}/{len(starts)}", f"{np.median(seconds):.1f}",
        f"{seconds.max():.1f} at {worst:.0f}°", f"{np.median(error):.1f} ≤{error.max():.1f}",
        f"{np.median(claimed):.1f}", f"{np.median(later):.2f} ≤{later.max():.2f}",
        str(sum(s.early for s in starts)),
    ]  # fmt: skip


def main(step_deg: float) -> None:
    """Print the table."""
    rows = [
        row(f"{kind}, {name}", headings.sweep(make, kind, headings.compass(step_deg), 0))
        for kind in headings.DURATION_S
        for name, make in SENSORS.items()
    ]
    print(
        f"Heading unknown at the start, every {step_deg:g}° of the compass; seconds from "
        f"{headings.MOVING_MPS} m/s of horizontal speed; degrees, median ≤worst"
    )
    print(
        table(
            ["", "found", "after s", "worst s", "error when found", "claimed 1σ",
             f"error {LATER_S:.0f} s later", "aids too early"],
            rows,
        )
    )  # fmt: skip


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 15.0)
