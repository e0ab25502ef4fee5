"""One satellite system's ranges and rates five times as noisy for a minute: adaptation or none.

Run as ``python -m tests.benchmarks.constellation_noise [--seeds N]``. Flights of 110 s under GPS
and Galileo at 5 Hz, tightly coupled; RMS errors from 40 to 100 s, while it lasts, root mean square
over the flights, and the factors on R that the adaptation found there, mean over the flights.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass

import numpy as np

from companion.gnss.systems import GALILEO, GPS, SYSTEM_NAMES
from companion.types import NS, AdaptationTrace, Channel, Outputs, Solution
from replay.player import play
from replay.simulator.constellation import SystemNoise
from replay.simulator.raw_gnss import with_raw_gnss
from tests.consistency import runs
from tests.tight import flights

START_S, END_S, FACTOR = 40.0, 100.0, 5.0
METHODS = ("none", "fuzzy")


@dataclass(frozen=True, slots=True)
class Outcome:
    """One flight with one method, while the noise lasts."""

    position_m: float
    """RMS error, 3-D."""
    velocity_mps: float
    r_range: tuple[float, ...]
    """Mean factor on R of the ranges, GPS and Galileo; NaN without."""
    r_rate: tuple[float, ...]


def fly(seed: int, noisy: int | None, method: str, multipath_m: float = 0.5) -> Outcome:
    """One flight; ``noisy`` is the system whose noise grows, if any."""
    simulation = runs.run(flights.SCENARIO, seed)
    noises = () if noisy is None else (SystemNoise(noisy, START_S, END_S, FACTOR),)
    flight = with_raw_gnss(
        simulation, seed, lever_arm_b_m=flights.LEVER, systems=(GPS, GALILEO), noises=noises,
        multipath_m=multipath_m, multipath_tau_s=5.0,
    )  # fmt: skip
    config = flights.config(raw_gnss={"sd_multipath_m": multipath_m}, adaptation={"method": method})
    settled: list[Solution] = []
    traces: list[AdaptationTrace] = []

    def keep(_: object, out: Outputs) -> None:
        settled.append(out.settled)
        traces.append(out.adaptation)

    play(flight.recording, config, keep)
    solution, trace = Solution.concatenate(settled), AdaptationTrace.concatenate(traces)
    t = (solution.t_ns - simulation.t0_ns) / NS
    error = runs.errors(simulation, solution)[(t > START_S) & (t < END_S), :2]
    rms = np.sqrt((error**2).sum(axis=2).mean(axis=0))
    at = (trace.t_ns - simulation.t0_ns) / NS
    during = (at > START_S) & (at < END_S)

    def scales(first: Channel) -> tuple[float, ...]:
        chosen = [trace.r_scale[during & (trace.channel == first + s)] for s in (GPS, GALILEO)]
        return tuple(float(c.mean()) if len(c) else float("nan") for c in chosen)

    return Outcome(
        float(rms[0]), float(rms[1]), scales(Channel.RANGE_GPS), scales(Channel.RATE_GPS)
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    seeds = parser.parse_args().seeds
    print(f"{'noisy':>8}{'method':>8}{'position m':>12}{'velocity m/s':>14}"
          f"{'R of ranges GPS, Galileo':>26}{'R of rates':>14}")  # fmt: skip
    for noisy in (None, GPS, GALILEO):
        for method in METHODS:
            done = [fly(seed, noisy, method) for seed in range(seeds)]
            name = "-" if noisy is None else SYSTEM_NAMES[noisy]
            p, v = (np.sqrt(np.mean(np.square([getattr(d, n) for d in done])))
                    for n in ("position_m", "velocity_mps"))  # fmt: skip
            cells = [" ".join(f"{x:.1f}" for x in np.mean([getattr(d, n) for d in done], axis=0))
                     for n in ("r_range", "r_rate")]  # fmt: skip
            print(f"{name:>8}{method:>8}{p:12.3f}{v:14.4f}{cells[0]:>26}{cells[1]:>14}")


if __name__ == "__main__":
    main()
