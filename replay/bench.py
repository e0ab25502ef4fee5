"""Speed and memory of the engine on a simulated hour that is already in memory."""

from __future__ import annotations

import platform
import resource
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import msgspec
import numba
import numpy as np

from companion.types import NS
from replay.player import choose_imu, play
from replay.simulator import load_scenario, matching_config, simulate


class EngineFigures(msgspec.Struct, frozen=True):
    """What the engine took, all gates and reports on; medians over the repeats."""

    scenario: str
    duration_s: float
    imu_epochs: int
    repeats: int
    cpu_s: float
    cpu_us_per_epoch: float
    times_real_time: float
    peak_memory_mb: float
    """Of the whole process, recording included."""


def _peak_memory_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Linux counts kB, macOS bytes.
    return peak / 1e6 if sys.platform == "darwin" else peak / 1e3


def engine_figures(
    scenario_name: str, repeats: int, progress: Callable[[float], None]
) -> EngineFigures:
    """Run the engine over one simulated recording, ``repeats`` times."""
    scenario = load_scenario(scenario_name)
    recording = simulate(scenario, seed=0)
    config = matching_config(scenario)
    imu = choose_imu(recording, config)
    took = []
    for done in range(repeats):
        progress(done / repeats)
        begin = time.process_time()
        play(recording, config)
        took.append(time.process_time() - begin)
    duration_s = float(imu.t_ns[-1] - imu.t_ns[0]) / NS
    cpu_s = statistics.median(took)
    return EngineFigures(
        scenario=scenario_name,
        duration_s=duration_s,
        imu_epochs=len(imu),
        repeats=repeats,
        cpu_s=cpu_s,
        cpu_us_per_epoch=cpu_s / len(imu) * 1e6,
        times_real_time=duration_s / cpu_s,
        peak_memory_mb=_peak_memory_mb(),
    )


def main(
    *, scenario: str = "hour", repeats: int = 5, progress: Callable[[float], None] = lambda _: None
) -> dict[str, Any]:
    """All figures, with what they were measured on; plain types, ready for JSON."""
    return {
        "engine": msgspec.structs.asdict(engine_figures(scenario, repeats, progress)),
        "machine": {
            "processor": platform.processor() or platform.machine(),
            "python": platform.python_version(),
            "numpy": np.__version__,
            "numba": numba.__version__,
        },
    }
