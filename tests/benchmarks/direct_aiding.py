"""The direct filter on raw ranges and with adaptation, beside the error-state filter.

    python -m tests.benchmarks.direct_aiding [--seeds 5]

*Ranges*: a simulated multirotor under GPS and Galileo; between 60 and 80 s only so many satellites
are left, with loose coupling none of use. *Receiver five times noisier than it says* from 30 s of
120 on: a fixed wing, every method of adaptation. IMU at 100 Hz. Horizontal errors, means over the
seeds.
"""

from __future__ import annotations

import argparse

import msgspec
import numpy as np

from companion.config import Config
from companion.types import F64, NS, Outputs, Samples, Solution, VehicleRecording
from replay.evaluation import errors_against
from replay.player import play
from tests.benchmarks.common import table
from tests.estimation.direct.receivers import NOISY_S, noisy
from tests.tight import flights

BEGIN_S, END_S = 60.0, 80.0
METHODS = ("none", "fuzzy", "flac", "innovation", "variational", "huber", "igg3")


def solved(recording: VehicleRecording, config: Config, estimator: str) -> Solution:
    """What is published, at 10 Hz."""
    engine = msgspec.structs.replace(config.engine, estimator=estimator, output_rate_hz=10.0)
    parts: list[Solution] = []

    def sink(_: Samples, out: Outputs) -> None:
        parts.append(out.published)

    play(recording, msgspec.structs.replace(config, engine=engine), sink)
    return Solution.concatenate(parts)


def _ranges(seeds: int) -> None:
    rows = []
    for left in (12, 3, 2, 1, 0):
        found: list[list[float]] = []
        for seed in range(seeds):
            vehicle = flights.withheld(flights.flight(seed).recording, BEGIN_S, END_S, left)
            one = []
            for coupling in ("tight", "loose"):
                config = flights.config(raw_gnss={"coupling": coupling, "sd_range_m": 0.7,
                                        "sd_multipath_m": 0.0, "iono_residual": 0.0})  # fmt: skip
                for estimator in ("direct", "error-state"):
                    t, e = flights.errors(solved(vehicle, config, estimator), seed)
                    off = np.hypot(e[:, 0], e[:, 1])
                    one.append(float(off[(t > BEGIN_S) & (t < END_S + 0.5)].max()))
            found.append(one)
        rows.append([str(left), *(f"{x:.2f}" for x in np.mean(found, axis=0))])
    print(f"Satellites left for {END_S - BEGIN_S:g} s: largest horizontal error inside, m, mean of "
          f"{seeds} seeds")  # fmt: skip
    print(table(["left", "direct tight", "error-state tight", "direct loose", "error-state loose"],
                rows))  # fmt: skip


def _rms(recording: VehicleRecording, solution: Solution, t0: int) -> tuple[float, float]:
    """RMS horizontal error [m] before the noise and 5 s behind its beginning to the end."""
    assert recording.truth is not None
    e = errors_against(solution, recording.truth)
    off: F64 = np.hypot(e.position_n[:, 0], e.position_n[:, 1])
    t = (e.t_ns - t0) / NS
    early, late = (t > 10.0) & (t < NOISY_S), t > NOISY_S + 5.0
    return tuple(float(np.sqrt(np.nanmean(off[x] ** 2))) for x in (early, late))  # type: ignore[return-value]


def _adaptation(seeds: int) -> None:
    rows = []
    made = [noisy(seed, 120.0) for seed in range(seeds)]
    for method in METHODS:
        cells = [method]
        for estimator in ("direct", "error-state"):
            found = []
            for recording, t0, base in made:
                adaptation = msgspec.structs.replace(base.adaptation, method=method)
                config = msgspec.structs.replace(base, adaptation=adaptation)
                found.append(_rms(recording, solved(recording, config, estimator), t0))
            cells += [f"{x:.2f}" for x in np.sqrt(np.mean(np.square(found), axis=0))]
        rows.append(cells)
    print(f"\nReceiver five times noisier than it says: horizontal RMS m, {seeds} seeds")
    print(table(["method", "direct: before", "with the noise", "error-state: before",
                 "with the noise"], rows))  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=5)
    asked = parser.parse_args()
    _ranges(asked.seeds)
    _adaptation(asked.seeds)
