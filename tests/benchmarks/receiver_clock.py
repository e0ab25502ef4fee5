"""What few satellites are worth by how good the receiver's clock is, and how much of it is known.

Run as ``python -m tests.benchmarks.receiver_clock [--seeds N]``. Flights of 170 s with a
consumer's inertial unit under GPS and Galileo at 5 Hz, tightly coupled; from 110 s on for 40 s all
satellites but a few are withheld. Those that stay are drawn by the seed among those in view
throughout. The clock's drift is a random walk:
0.15 m/s/√s as of a cheap quartz, 0.01 of one with temperature compensation, 0.001 of an oven. Its
noise is known to the filter as configured by default, or learned from that on line.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from companion.types import I64, NS, VehicleRecording
from replay.simulator.raw_gnss import RawFlight, with_raw_gnss
from tests.consistency import runs
from tests.tight import flights
from tests.tight.faults import CLOCKS, usable_satellites

WALKS = (0.15, 0.01, 0.001)
KNOWN = ("default", "learned")
LEFT = (3, 2, 1, 0)
START_S, END_S = 110.0, 150.0
SCENARIO = runs.honest("multirotor-mission", 170.0)
NOISE: dict[str, object] = {
    "coupling": "tight", "sd_range_m": 0.7, "sd_multipath_m": 0.0, "iono_residual": 0.0,
}  # fmt: skip
HEADING: dict[str, object] = {"heading": "fixed", "fixed_heading_deg": 30.0}


def kept(flight: RawFlight, seed: int) -> I64:
    """Satellites in view throughout the window, in an order that the seed draws."""
    t = flights.seconds(flight.recording)
    inside = np.flatnonzero((t >= START_S) & (t < END_S))
    seen = usable_satellites(flight)
    throughout = set.intersection(*(seen[i] for i in inside))
    return np.random.default_rng(seed).permutation(sorted(throughout))


def withheld(vehicle: VehicleRecording, keep: I64) -> VehicleRecording:
    """Only ``keep`` in the window."""
    raw, t = vehicle.raw[0], flights.seconds(vehicle)
    inside = ((t >= START_S) & (t < END_S))[:, None]
    gone = inside & ~np.isin(raw.sat, keep)
    return flights.with_raw(vehicle, replace(raw, sat=np.where(gone, 0, raw.sat)))


def largest(flight: RawFlight, seed: int, keep: I64, known: str) -> float:
    """Largest horizontal error in the window [m]."""
    sections = {"raw_gnss": NOISE | CLOCKS[known], "alignment": HEADING}
    config = runs.changed(runs.matching_config(SCENARIO), **sections)
    flown = runs.fly(withheld(flight.recording, keep), config)
    simulation = runs.run(SCENARIO, seed)
    t = (flown.solution.t_ns - simulation.t0_ns) / NS
    inside = (t >= START_S) & (t < END_S)
    error = runs.errors(simulation, flown.solution)[inside, 0, :2]
    return float(np.linalg.norm(error, axis=1).max())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    print(f"Largest horizontal error in {END_S - START_S:.0f} s with so many satellites left [m],")
    print("mean over the flights; in brackets: in how many it is smaller than with none")
    print(f"{'clock m/s/√s':>14}{'known':>10}" + "".join(f"{left:>16}" for left in LEFT))
    for walk in WALKS:
        found: dict[tuple[str, int], list[float]] = {}
        for seed in range(seeds):
            flight = with_raw_gnss(
                runs.run(SCENARIO, seed), seed, lever_arm_b_m=flights.LEVER, systems=(0, 1),
                clock_drift_walk_mps_rts=walk,
            )  # fmt: skip
            order = kept(flight, seed)
            for known in KNOWN:
                for left in LEFT:
                    one = largest(flight, seed, order[:left], known)
                    found.setdefault((known, left), []).append(one)
        for known in KNOWN:
            none = np.array(found[known, 0])
            cells = ""
            for left in LEFT:
                e = np.array(found[known, left])
                better = f" ({int((e < none).sum())})" if left else ""
                cells += f"{f'{e.mean():.2f}{better}':>16}"
            print(f"{walk:14g}{known:>10}{cells}")
        sys.stdout.flush()
    print(f"Flights: {seeds}")


if __name__ == "__main__":
    main()
