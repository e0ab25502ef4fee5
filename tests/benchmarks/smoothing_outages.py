"""Every smoother inside outages: a real drive against RTK, and ArduPilot SITL flights.

``python -m tests.benchmarks.smoothing_outages [drive] [flights] [SECONDS…]``; about six minutes.
GNSS is withheld in one place at a time: in the drive ``car-rtk`` at the ten places of
``tests.benchmarks.car``, for 10, 20, 30 and 60 s or those that are named; in the flights for 60 s
about each outage that they were flown with. What counts is the largest horizontal error inside the
window, as mean and worst over the places, and the error in the window's middle.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence

import msgspec
import numpy as np

from companion.config import Config, load
from companion.types import F64, NS, Outputs, Smoothed, Solution, VehicleRecording
from replay.player import play
from replay.preparation import withhold_gnss
from replay.reader import read_log
from replay.smoothing import Method, record_for, smoothed
from replay.window import Window
from tests.benchmarks.car import ANTENNA_B, LENGTHS_S, places, variant
from tests.benchmarks.common import ROOT, errors_against, need_data, start_ns, table

RATE_HZ = 10.0
WINDOWS = (1, 3, 5, 7)
METHODS: dict[Method, str] = {
    "two-filter-straight": "two-filter, straight",
    "two-filter": "two-filter",
    "two-filter-weighted": "two-filter, covariances",
    "bryson-frazier": "optimal",
}
FLIGHTS = ("c3_outage", "p1_plane_outage")
EXTENDED_S = 60.0
_NO_LEVER = (0.0, 0.0, 0.0)


def on_line(vehicle: VehicleRecording, config: Config, window: int) -> Solution:
    """What smoothing on line gives out with a window of so many update intervals."""
    replace = msgspec.structs.replace
    smoothing = replace(
        config.smoothing,
        enabled=True,
        window=window,
        rate_hz=RATE_HZ,
        longest_interval_s=2.0 * EXTENDED_S,
    )
    parts: list[Smoothed] = []

    def sink(_: object, out: Outputs) -> None:
        parts.append(out.smoothed)

    play(vehicle, replace(config, smoothing=smoothing), sink)
    return Smoothed.concatenate([p for p in parts if len(p)]).solution


def solutions(vehicle: VehicleRecording, config: Config) -> dict[str, Solution]:
    """All solutions of a recording that GNSS was withheld from."""
    run = record_for("two-filter-weighted", vehicle, config, rate_hz=RATE_HZ)
    found = {"forward": run.solution}
    found.update({f"on-line, {n}": on_line(vehicle, config, n) for n in WINDOWS})
    found.update({name: smoothed(run, method) for method, name in METHODS.items()})
    return found


def inside(
    vehicle: VehicleRecording, config: Config, window: Window, lever_b: Sequence[float]
) -> dict[str, tuple[float, float]]:
    """Largest horizontal error in a withheld window, and that in its middle [m], by solution."""
    truth = vehicle.truth
    assert truth is not None
    found = {}
    for name, solution in solutions(withhold_gnss(vehicle, [window]), config).items():
        errors = errors_against(solution, truth, tuple(lever_b))
        since = (errors.t_ns - start_ns(vehicle)) / NS - window.start_s
        horizontal = np.hypot(*errors.position_n[:, :2].T)
        within = (since >= 0) & (since <= window.seconds)
        middle = horizontal[int(np.argmin(np.abs(since - 0.5 * window.seconds)))]
        found[name] = float(np.nanmax(horizontal[within])), float(middle)
    return found


def rows(title: str, found: list[dict[str, tuple[float, float]]]) -> list[list[str]]:
    """A row a solution: mean and worst of the largest errors, RMS in the middle and its ratio."""
    made = []
    best = _rms(np.array([f["optimal"][1] for f in found]))
    for name in found[0]:
        largest, middle = np.array([f[name] for f in found]).T
        made.append(
            [title, name, f"{largest.mean():.2f}", f"{largest.max():.2f}", f"{_rms(middle):.2f}",
             f"{_rms(middle) / best:.2f}"]
        )  # fmt: skip
        title = ""
    return made


def _rms(x: F64) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


HEAD = ["outage", "solution", "largest m: mean", "worst", "middle m: RMS", "over optimal"]


def drive(lengths: Sequence[int]) -> None:
    """Print the tables of the drive."""
    vehicle = read_log([need_data("car-rtk")]).vehicles[0]
    config = load(ROOT / "configs" / "car.toml")
    for name, constraint in (("inertial only", False), ("non-holonomic", True)):
        chosen = variant(config, constraint, True)
        made = []
        for length in lengths:
            windows = places(vehicle, length)
            found = [inside(vehicle, chosen, window, ANTENNA_B) for window in windows]
            made += rows(f"{length} s at {len(windows)} places", found)
        print(f"car-rtk, {name}\n{table(HEAD, made)}\n", flush=True)


def flights() -> None:
    """Print the tables of the SITL flights."""
    for flight in FLIGHTS:
        noted = json.loads(need_data("sitl", f"{flight}.ekf3.json").read_text(encoding="utf-8"))
        recording = read_log([need_data("sitl", f"{flight}.tlog")])
        vehicle = recording.vehicles[0]
        offset_ns = int(recording.metadata[f"{vehicle.name}.boot_offset_ns"])
        config = load(ROOT / "configs" / ("sitl-plane.toml" if "plane" in flight else "sitl.toml"))
        late_s = (offset_ns - start_ns(vehicle)) / NS
        made = []
        own = [Window(e["t"] + late_s, e["dur"]) for e in noted["events"]]
        for window in own:
            made += rows(
                f"{window.seconds:.0f} s, its own", [inside(vehicle, config, window, _NO_LEVER)]
            )
        wide = [Window(w.start_s + 0.5 * (w.seconds - EXTENDED_S), EXTENDED_S) for w in own]
        found = [inside(vehicle, config, window, _NO_LEVER) for window in wide]
        made += rows(f"{EXTENDED_S:.0f} s about each", found)
        print(f"{flight}\n{table(HEAD, made)}\n", flush=True)


def main(parts: list[str]) -> None:
    """Print the tables that are asked for, or all."""
    lengths = [int(part) for part in parts if part.isdigit()]
    if not parts or "drive" in parts:
        drive(lengths or LENGTHS_S)
    if not parts or "flights" in parts:
        flights()


if __name__ == "__main__":
    main(sys.argv[1:])
