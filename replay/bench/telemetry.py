"""``companion replay`` of a telemetry log against merely iterating it with pymavlink's mavutil."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion.types import CompanionError
from replay.bench.measuring import Progress, interleaved, python, run_child

TARGET_SHARE = 0.25
_ITERATE = """
import sys
from pymavlink import mavutil
log = mavutil.mavlink_connection(sys.argv[1])
count = 0
while log.recv_match() is not None:
    count += 1
print(count)
"""


def telemetry_figures(
    path: Path, config: Path | None, repeats: int, progress: Progress
) -> dict[str, Any]:
    """Whole processes, imports included, turn by turn; medians of wall and CPU time [s]."""
    if not path.is_file():
        raise CompanionError(f"{path}: no such file")
    cpu: dict[str, list[float]] = {"replay": [], "mavutil": []}
    with tempfile.TemporaryDirectory() as directory:
        out = Path(directory) / "run.mcap"
        chosen = [] if config is None else ["--config", str(config)]
        commands = {
            "replay": python("-m", "companion", "replay", str(path), "--out", str(out), *chosen),
            "mavutil": python("-c", _ITERATE, str(path)),
        }
        messages = 0

        def timed(name: str) -> Callable[[], float]:
            def run() -> float:
                nonlocal messages
                child = run_child(commands[name])
                if child.status:
                    raise CompanionError(f"{name}: {' '.join(child.text.split())[-300:]}")
                if name == "mavutil":
                    messages = int(child.lines[-1][1])
                cpu[name].append(child.cpu_s)
                return child.wall_s

            return run

        wall = interleaved({name: timed(name) for name in commands}, repeats, progress)
        log_mb = os.path.getsize(out) / 1e6
    median_cpu = {name: sorted(values)[len(values) // 2] for name, values in cpu.items()}
    return {
        "file": path.name,
        "file_mb": path.stat().st_size / 1e6,
        "messages": messages,
        "repeats": repeats,
        "run_log_mb": log_mb,
        "replay_wall_s": wall["replay"],
        "mavutil_wall_s": wall["mavutil"],
        "wall_share": wall["replay"] / wall["mavutil"],
        "replay_cpu_s": median_cpu["replay"],
        "mavutil_cpu_s": median_cpu["mavutil"],
        "cpu_share": median_cpu["replay"] / median_cpu["mavutil"],
    }


def telemetry_lines(f: dict[str, Any]) -> list[str]:
    """The figures in words."""
    return [
        f"Telemetry log {f['file']}, {f['file_mb']:.1f} MB, {f['messages']} messages, whole "
        f"processes, median of {f['repeats']}",
        f"  companion replay, run log of {f['run_log_mb']:.1f} MB written "
        f"{f['replay_wall_s']:6.2f} s wall {f['replay_cpu_s']:6.2f} s CPU",
        f"  mavutil, messages iterated and dropped      {f['mavutil_wall_s']:6.2f} s wall "
        f"{f['mavutil_cpu_s']:6.2f} s CPU",
        f"  share {f['wall_share']:.2f} of the wall time, {f['cpu_share']:.2f} of the CPU time "
        f"(target {TARGET_SHARE:g})",
    ]
