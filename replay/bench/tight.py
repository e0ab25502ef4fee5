"""CPU time of ranges: the same flight on a receiver's fixes, and on its raw measurements."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from companion.config import Config, RawGnss
from companion.types import Outputs, VehicleRecording
from replay.bench.flight import hour
from replay.bench.measuring import Progress, cpu_s, interleaved
from replay.player import play
from replay.simulator import run
from replay.simulator.raw_gnss import with_raw_gnss

SATELLITES_IN_VIEW = 20
FLIGHT_S = 600.0
TARGET_ADDED = 1.0
"""What ranges may add, in the time of the filter without them."""


def _flights() -> tuple[VehicleRecording, VehicleRecording, Config]:
    """With fixes, with raw measurements of twenty satellites; how both are navigated."""
    scenario, config = hour(FLIGHT_S)
    simulation = run(scenario, seed=0)
    lever = scenario.gnss[0].lever_arm_b_m
    raw = with_raw_gnss(simulation, 0, lever_arm_b_m=lever, latency_ms=0.0).recording
    epochs = raw.raw[0]
    # Satellites stand in the first columns of an epoch.
    sat = np.where(np.arange(epochs.sat.shape[1]) < SATELLITES_IN_VIEW, epochs.sat, 0)
    return simulation.recording, replace(raw, raw=(replace(epochs, sat=sat),)), config


def _used(vehicle: VehicleRecording, config: Config) -> float:
    """Satellites in use, mean over the epochs."""
    used: list[int] = []

    def keep(_: object, out: Outputs) -> None:
        used.extend(out.satellites.used.tolist())

    play(vehicle, config, keep)
    return float(np.mean(used))


def tight_figures(repeats: int, progress: Progress) -> dict[str, Any]:
    """Time of each per IMU epoch, turn by turn, and what ranges add to the time of fixes."""
    fixes, raw, config = _flights()
    mask = RawGnss(elevation_mask_deg=5.0)
    coupled = {
        coupling: msgspec.structs.replace(
            config, raw_gnss=msgspec.structs.replace(mask, coupling=coupling)
        )
        for coupling in ("loose", "tight")
    }
    epochs = len(fixes.imu[0])
    figures: dict[str, Any] = {
        "duration_s": FLIGHT_S,
        "imu_epochs": epochs,
        "repeats": repeats,
        "satellites": _used(raw, coupled["tight"]),
    }
    runs = {
        "fixes": lambda: cpu_s(lambda: play(fixes, config)) / epochs,
        "loose": lambda: cpu_s(lambda: play(raw, coupled["loose"])) / epochs,
        "tight": lambda: cpu_s(lambda: play(raw, coupled["tight"])) / epochs,
    }
    medians = interleaved(runs, repeats, progress)
    figures |= {f"{name}_us_per_epoch": value * 1e6 for name, value in medians.items()}
    figures["added"] = medians["tight"] / medians["fixes"] - 1.0
    return figures


def tight_lines(f: dict[str, Any]) -> list[str]:
    """The figures in words."""
    return [
        f"Raw GNSS, {f['duration_s']:.0f} s of 200 Hz IMU, {f['satellites']:.1f} satellites at "
        f"5 Hz, range and rate, median of {f['repeats']}, CPU time an IMU epoch",
        f"  on the receiver's fixes      {f['fixes_us_per_epoch']:8.2f} µs",
        f"  on fixes made of the ranges  {f['loose_us_per_epoch']:8.2f} µs",
        f"  tight, range by range        {f['tight_us_per_epoch']:8.2f} µs: adds "
        f"{f['added']:.2f} of the time on fixes (target {TARGET_ADDED:.0f})",
    ]
