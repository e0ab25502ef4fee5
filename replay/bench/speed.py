"""CPU time of the filter: our engine, the bare floor, and a peer on the same samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np

from companion.config import Config
from companion.engine import Engine
from companion.types import F64, NS, Mode, Outputs, Solution, VehicleRecording
from replay.bench import floor, peer
from replay.bench.flight import cut, flight
from replay.bench.measuring import Progress, cpu_s, interleaved
from replay.evaluation import errors_against
from replay.player import blocks, play

LATE_MS = 100.0
"""Of the fixes in the second flight: a receiver's own time, inside the delay ring."""
PEER_FROM_S, PEER_S = 600.0, 300.0
"""The slice that the slow peer is run on; the vehicle is in flight there."""
_SETTLING_S = 60.0
"""From the heading's being found to where errors are compared: both have forgotten the start."""
TARGET_RATIO = 60.0
LIVE_FROM_S, LIVE_S = 60.0, 30.0
"""The slice that is flown one inertial sample a call."""
LIVE_TARGET_US = 60.0
"""Of a call, for an IMU at 1 kHz to leave most of a core to everything else."""


def solve(vehicle: VehicleRecording, config: Config) -> Solution:
    """The settled solution."""
    parts: list[Solution] = []

    def keep(_: object, out: Outputs) -> None:
        parts.append(out.settled)

    play(vehicle, config, keep)
    return Solution.concatenate(parts)


def _same_measurements(config: Config) -> Config:
    """``config`` without what the engine knows beside them: that a vehicle may stand still, and
    that a sensor may not be what is said of it."""
    replace = msgspec.structs.replace
    return replace(
        config,
        constraints=replace(config.constraints, zero_velocity=False),
        adaptation=replace(config.adaptation, method="none"),
    )


def _start_of_floor(solution: Solution) -> int:
    found = np.flatnonzero(solution.mode >= Mode.NAVIGATING)
    if not len(found):
        raise RuntimeError("the engine never found its heading on the benchmark's flight")
    return int(np.searchsorted(solution.t_ns, solution.t_ns[found[0]] + round(_SETTLING_S * NS)))


def _rmse(vehicle: VehicleRecording, solution: Solution, after_ns: int) -> float:
    """Position RMSE in space [m] from ``after_ns`` on, against truth."""
    assert vehicle.truth is not None
    errors = errors_against(solution, vehicle.truth).position_n[solution.t_ns > after_ns]
    return _rms(errors[np.isfinite(errors).all(axis=1)])


def _rms(errors: F64) -> float:
    return math.sqrt(float(np.mean(np.sum(errors**2, axis=1))))


def _live_call(vehicle: VehicleRecording, config: Config) -> Callable[[], float]:
    """CPU time [s] of one call of the engine with one inertial sample, as live, in flight."""
    before, after = cut(vehicle, 0.0, LIVE_FROM_S), cut(vehicle, LIVE_FROM_S, LIVE_FROM_S + LIVE_S)
    imu = after.imu[0]
    samples = [imu.take(slice(m, m + 1)) for m in range(len(imu))]

    def run() -> float:
        engine = Engine(config)
        for block, aids in blocks(before, config):
            engine.step_block(block, aids)

        def fly() -> None:
            for sample in samples:
                engine.step(sample)

        return cpu_s(fly) / len(samples)

    return run


def filter_figures(duration_s: float, repeats: int, progress: Progress) -> dict[str, Any]:
    """Time of each per IMU epoch, ratios of medians, and position errors.

    Turn by turn: engine with fixes in order, with fixes 100 ms late, with one sample a call, floor,
    peer.
    """
    vehicle, config = flight(duration_s)
    late, late_config = flight(duration_s, gnss_latency_ms=LATE_MS)
    epochs = len(vehicle.imu[0])
    plain = _same_measurements(config)
    ours = solve(vehicle, plain)
    start = _start_of_floor(ours)
    given = floor.prepare(vehicle, plain, ours, start)
    bare = floor.run(given)
    begin_ns = int(ours.t_ns[start])
    figures: dict[str, Any] = {
        "duration_s": duration_s,
        "imu_epochs": epochs,
        "repeats": repeats,
        "position_rmse_m": _rmse(vehicle, ours, begin_ns),
        "floor_position_rmse_m": _rmse(vehicle, bare, begin_ns),
    }
    runs = {
        "engine": lambda: cpu_s(lambda: play(vehicle, config)) / epochs,
        "engine_late": lambda: cpu_s(lambda: play(late, late_config)) / epochs,
        "live": _live_call(vehicle, config),
        "floor": lambda: cpu_s(lambda: floor.run(given)) / len(given.t_ns),
    }
    if peer.available():
        begin_s = min(PEER_FROM_S, 0.5 * duration_s)
        part = cut(vehicle, begin_s, begin_s + PEER_S)
        walk, peer_errors = peer.make(part, config)
        figures["peer_epochs"] = len(part.imu[0])
        figures["peer_position_rmse_m"] = _rms(peer_errors()[300:])
        runs["peer"] = lambda: cpu_s(walk) / len(part.imu[0])
    medians = interleaved(runs, repeats, progress)
    figures |= {f"{name}_us_per_epoch": value * 1e6 for name, value in medians.items()}
    figures["above_floor"] = medians["engine"] / medians["floor"]
    figures["late_above_floor"] = medians["engine_late"] / medians["floor"]
    figures["times_real_time"] = duration_s / (medians["engine"] * epochs)
    if "peer" in medians:
        figures["peer_over_engine"] = medians["peer"] / medians["engine"]
        figures["peer_over_engine_late"] = medians["peer"] / medians["engine_late"]
        figures["peer_over_floor"] = medians["peer"] / medians["floor"]
    return figures


def filter_lines(f: dict[str, Any]) -> list[str]:
    """The figures in words."""
    excess = f["position_rmse_m"] / f["floor_position_rmse_m"] - 1.0
    lines = [
        f"Filter, {f['duration_s']:.0f} s of 200 Hz IMU and 5 Hz GNSS in memory, all gates and "
        f"reports on, median of {f['repeats']}, CPU time an IMU epoch",
        f"  engine, fixes in order       {f['engine_us_per_epoch']:8.2f} µs "
        f"({f['times_real_time']:.0f} times real time)",
        f"  engine, fixes {LATE_MS:.0f} ms late    {f['engine_late_us_per_epoch']:8.2f} µs",
        f"  engine, one sample a call    {f['live_us_per_epoch']:8.2f} µs as live "
        f"(target {LIVE_TARGET_US:.0f})",
        f"  floor: bare jitted loop      {f['floor_us_per_epoch']:8.2f} µs; the engine is "
        f"{f['above_floor']:.1f} times that, {f['late_above_floor']:.1f} with late fixes",
    ]
    if "peer_us_per_epoch" in f:
        lines += [
            f"  smsfusion AidedINS           {f['peer_us_per_epoch']:8.2f} µs "
            f"(on {f['peer_epochs']} of these epochs)",
            f"  ratio to the engine          {f['peer_over_engine']:8.1f} in order, "
            f"{f['peer_over_engine_late']:.1f} late (target {TARGET_RATIO:.0f}); "
            f"to the floor {f['peer_over_floor']:.0f}",
        ]
    else:
        lines.append("  smsfusion is not installed (extra 'bench'): no ratio")
    lines.append(
        f"  position RMSE                {f['position_rmse_m']:8.3f} m; floor on the same "
        f"measurements {f['floor_position_rmse_m']:.3f} m ({excess:+.2%}, target within 1 %)"
    )
    return lines
