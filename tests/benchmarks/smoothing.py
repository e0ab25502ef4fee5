"""Smoothing against the forward filter: errors inside outages on a real drive, and its cost.

``python -m tests.benchmarks.smoothing [drive] [cost]``; about two minutes. GNSS is withheld in one
place of the drive ``car-rtk`` at a time, the ten places of ``tests.benchmarks.car``; the error is
the largest horizontal one inside the window. Cost is CPU time of one hour of 200 Hz IMU and 5 Hz
GNSS, alternating, medians of three, as ratios to the forward run without a tape.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import msgspec
import numpy as np

from companion.config import Config, load
from companion.smoothing.offline import Method, smooth
from companion.types import NS, Solution, VehicleRecording
from replay.bench.flight import flight
from replay.on_line import on_line_config, smooth_on_line
from replay.preparation import withhold_gnss
from replay.reader import read_log
from replay.recorded import RecordedRun, record
from replay.smoothing import record_for, smoothed
from replay.window import Window
from tests.benchmarks.car import ANTENNA_B, LENGTHS_S, places, variant
from tests.benchmarks.common import ROOT, errors_against, need_data, start_ns, table

ROUNDS = 3
RATE_HZ = 10.0
WINDOWS = (1, 3, 7)
ON_LINE = (1, 7)
"""Windows of the drive: update intervals."""


def worst(vehicle: VehicleRecording, solution: Solution, window: Window) -> float:
    """Largest horizontal error inside a window [m]."""
    truth = vehicle.truth
    assert truth is not None
    errors = errors_against(solution, truth, ANTENNA_B)
    since = (errors.t_ns - start_ns(vehicle)) / NS - window.start_s
    inside = (since >= 0) & (since <= window.seconds)
    return float(np.nanmax(np.hypot(*errors.position_n[inside, :2].T)))


def drive(vehicle: VehicleRecording, config: Config) -> list[list[str]]:
    """Mean and largest over the places of the worst error, by length and kind of solution."""
    rows = []
    smoothing = msgspec.structs.replace(config.smoothing, longest_interval_s=2.0 * max(LENGTHS_S))
    patient = msgspec.structs.replace(config, smoothing=smoothing)
    for length in LENGTHS_S:
        found = []
        for window in places(vehicle, length):
            cut = withhold_gnss(vehicle, [window])
            run = record(cut, config, rate_hz=RATE_HZ)
            late = [
                smooth_on_line(cut, on_line_config(patient, w, RATE_HZ)).smoothed.solution
                for w in ON_LINE
            ]
            solutions = (run.solution, *late, smooth(run.tapes, run.config))
            found.append([worst(vehicle, s, window) for s in solutions])
        mean, largest = np.mean(found, axis=0), np.max(found, axis=0)
        pairs = zip(mean, largest, strict=True)
        rows.append([f"{length} s", *(f"{x:.2f}" for pair in pairs for x in pair)])
    return rows


def _cpu(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def cost() -> str:
    """CPU ratios and the memory of the smoother's history."""
    vehicle, config = flight(3600.0)
    replace = msgspec.structs.replace
    config = replace(config, engine=replace(config.engine, output_rate_hz=RATE_HZ))
    runs: dict[str, RecordedRun] = {}

    def forward(covariance: bool | None) -> Callable[[], None]:
        def go() -> None:
            if covariance is None:
                record(vehicle, config, tape=False)
            else:
                runs[str(covariance)] = record(vehicle, config, covariance=covariance)

        return go

    def back(covariance: bool, method: Method) -> Callable[[], Solution]:
        return lambda: smooth(runs[str(covariance)].tapes, config, method)

    def two_filters() -> Solution:
        run = record_for("two-filter", vehicle, config)
        return smoothed(run, "two-filter")

    def on_line(window: int | None) -> Callable[[], object]:
        played = config if window is None else on_line_config(config, window, RATE_HZ)
        return lambda: smooth_on_line(vehicle, played)

    parts: dict[str, Callable[[], object]] = {
        "forward": forward(None),
        "forward, tape": forward(False),
        "forward, tape with P": forward(True),
        "Bryson-Frazier, states": back(False, "bryson-frazier"),
        "Bryson-Frazier, covariance": back(True, "bryson-frazier"),
        "RTS": back(False, "rts"),
        "two-filter": two_filters,
        "as played": on_line(None),
        **{f"on line, window {w}": on_line(w) for w in WINDOWS},
    }
    times: dict[str, list[float]] = {name: [] for name in parts}
    for _ in range(ROUNDS):
        for name, work in parts.items():
            times[name].append(_cpu(work))
    cpu = {name: statistics.median(t) for name, t in times.items()}
    one = cpu["forward"]
    rows = []
    for name, tape, back_name in (
        ("states", "forward, tape", "Bryson-Frazier, states"),
        ("with covariance", "forward, tape with P", "Bryson-Frazier, covariance"),
        ("RTS, the reference", "forward, tape", "RTS"),
    ):
        extra = cpu[tape] + cpu[back_name] - one
        history = runs[str(name == "with covariance")].tape_bytes / 1e6
        rows.append([name, f"{100 * extra / one:+.0f} %", f"{history:.0f} MB"])
    extra = cpu["two-filter"] - one
    rows.append(["two-filter", f"{100 * extra / one:+.0f} %", ""])
    for window in WINDOWS:
        extra = cpu[f"on line, window {window}"] - cpu["as played"]
        name = f"on line with covariance, window {window}"
        rows.append([name, f"{100 * extra / cpu['as played']:+.0f} %", ""])
    head = [f"one hour, output {RATE_HZ:g} Hz", "CPU over forward", "history"]
    each_us = 1e6 * one / len(vehicle.imu[0])
    return f"forward filter {one:.2f} s of CPU, {each_us:.2f} µs an epoch\n" + table(head, rows)


def main(parts: list[str]) -> None:
    """Print the tables that are asked for, or all."""
    if not parts or "drive" in parts:
        vehicle = read_log([need_data("car-rtk")]).vehicles[0]
        config = load(ROOT / "configs" / "car.toml")
        names = ["forward", *(f"on line {w}" for w in ON_LINE), "off line"]
        head = ["error inside [m]", *(x for n in names for x in (f"{n}: mean", "worst"))]
        for name, constraint in (("inertial only", False), ("non-holonomic", True)):
            print(f"{name}\n{table(head, drive(vehicle, variant(config, constraint, True)))}\n")
    if not parts or "cost" in parts:
        print(cost())


if __name__ == "__main__":
    main(sys.argv[1:])
