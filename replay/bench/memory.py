"""Peak memory of the engine, and how it grows with the length of a flight.

Each length runs in a process of its own, ``python -m replay.bench.memory FILE``, on a recording
that another process simulated: what the simulator needed must not hide what the engine needs.
"""

from __future__ import annotations

import gc
import json
import pickle
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion.config import Config
from companion.types import CompanionError, VehicleRecording
from replay.bench.flight import cut, flight
from replay.bench.measuring import Progress, python, run_child
from replay.configuration import ChosenConfig
from replay.player import play
from replay.session import run_session

LENGTHS_S = (600.0, 1800.0, 3600.0, 7200.0)


def memory_figures(progress: Progress, lengths_s: Sequence[float] = LENGTHS_S) -> dict[str, Any]:
    """Memory for flights of each length, and the growth per hour from the first to the last."""
    vehicle, config = flight(max(lengths_s))
    rows = []
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "recording"
        for k, length_s in enumerate(lengths_s):
            progress(k / len(lengths_s))
            path.write_bytes(pickle.dumps((cut(vehicle, 0.0, length_s), config), protocol=5))
            child = run_child(python("-m", "replay.bench.memory", str(path)))
            if child.status:
                raise CompanionError(f"memory of {length_s:g} s: {child.text[-200:]}")
            rows.append({"duration_s": length_s, **json.loads(child.lines[-1][1])})
    hours = (rows[-1]["duration_s"] - rows[0]["duration_s"]) / 3600.0
    return {
        "lengths": rows,
        "engine_growth_mb_per_hour": (rows[-1]["engine_mb"] - rows[0]["engine_mb"]) / hours,
        "collected_growth_mb_per_hour": (rows[-1]["collected_mb"] - rows[0]["collected_mb"])
        / hours,
    }


def memory_lines(figures: dict[str, Any]) -> list[str]:
    """The figures in words."""
    lines = [
        "Memory, MB: recording; engine and player on top, outputs handed on; the same with all "
        "outputs kept; peak of the process, outputs handed on"
    ]
    lines += [
        f"  {row['duration_s'] / 60:4.0f} min  recording {row['recording_mb']:6.1f}  engine "
        f"{row['engine_mb']:6.1f}  outputs kept {row['collected_mb']:7.1f}  process "
        f"{row['process_mb']:7.1f}"
        for row in figures["lengths"]
    ]
    lines.append(
        f"  growth per hour of flight: engine {figures['engine_growth_mb_per_hour']:.1f} MB, "
        f"with outputs kept {figures['collected_growth_mb_per_hour']:.1f} MB"
    )
    return lines


def _status_mb(key: str) -> float:
    """A memory figure of this process from the kernel [MB]; Linux only."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith(key + ":"):
            return int(line.split()[1]) * 1024 / 1e6
    raise CompanionError(f"the kernel does not tell {key}")


def _peak_over(work: Any) -> float:
    """Highest resident memory during ``work()`` above that before it [MB]."""
    gc.collect()
    # 5: forget the high-water mark (proc_pid_clear_refs(5)).
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    before = _status_mb("VmRSS")
    kept = work()
    peak = _status_mb("VmHWM") - before
    del kept
    return peak


def _measure(path: Path) -> dict[str, float]:
    vehicle: VehicleRecording
    config: Config
    with path.open("rb") as file:
        gc.collect()
        before = _status_mb("VmRSS")
        vehicle, config = pickle.load(file)
    # Half a minute of flight first: the machine code is then in memory and not counted as growth.
    play(cut(vehicle, 0.0, 30.0), config)
    recording = _status_mb("VmRSS") - before
    loaded = _status_mb("VmRSS")
    engine = _peak_over(lambda: play(vehicle, config))
    chosen = ChosenConfig(config, "benchmark", "")
    collected = _peak_over(lambda: run_session(vehicle, chosen))
    return {
        "recording_mb": recording,
        "engine_mb": engine,
        "collected_mb": collected,
        "process_mb": loaded + engine,
    }


if __name__ == "__main__":
    print(json.dumps(_measure(Path(sys.argv[1]))))
