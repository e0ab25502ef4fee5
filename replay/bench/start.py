"""Start-up: with warm kernels to the first output, and the one time they are compiled."""

from __future__ import annotations

import statistics
import tempfile
from pathlib import Path
from typing import Any

import replay
from companion.types import CompanionError
from replay.bench.measuring import ChildRun, Progress, python, run_child

WARM_TARGET_S, COLD_TARGET_CPU_S = 2.0, 40.0
_FIRST_SOLUTION = """
import sys, time
from pathlib import Path
from replay.reader import read_log
from replay.configuration import choose_config
from replay.preparation import navigable
recording = read_log([Path(sys.argv[1])])
chosen = choose_config(recording)
fit, _ = navigable(recording, chosen.config)
from replay.player import play
def first(_, out):
    if len(out.published):
        print("first solution")
        sys.exit(0)
play(fit[0], chosen.config, first)
"""
"""What ``companion replay`` does up to the first navigation state, then leaves."""


def _sample() -> Path:
    found = sorted((Path(replay.__file__).parent / "data").glob("*.tlog"))
    if not found:
        raise CompanionError("the sample flight is missing from the installation")
    return found[0]


def _checked(run: ChildRun, what: str) -> ChildRun:
    if run.status:
        raise CompanionError(f"{what} failed: {' '.join(run.text.split())[-300:]}")
    return run


def start_figures(repeats: int, progress: Progress) -> dict[str, Any]:
    """Wall time of a warm start, CPU time of a cold one, and what the cold one says."""
    sample = str(_sample())
    with tempfile.TemporaryDirectory() as directory:
        out = str(Path(directory) / "run.mcap")
        replay_command = python("-m", "companion", "replay", sample, "--out", out)
        _checked(run_child(replay_command), "replay of the sample flight")
        first, whole = [], []
        for k in range(repeats):
            progress(0.3 * k / repeats)
            run = _checked(run_child(python("-c", _FIRST_SOLUTION, sample)), "first solution")
            first.append(next(t for t, line in run.lines if line == "first solution"))
            whole.append(_checked(run_child(replay_command), "replay of the sample flight").wall_s)
        progress(0.4)
        cold = {"NUMBA_CACHE_DIR": str(Path(directory) / "compiled")}
        load = _checked(
            run_child(python("-m", "replay.kernels", "filter"), cold), "loading of kernels"
        )
        progress(0.7)
        again = {"NUMBA_CACHE_DIR": str(Path(directory) / "again")}
        start = _checked(run_child(replay_command, again), "first replay on a new machine")
    return {
        "repeats": repeats,
        "warm_first_output_s": statistics.median(first),
        "warm_sample_replay_s": statistics.median(whole),
        "cold_kernels_cpu_s": load.cpu_s,
        "cold_replay_cpu_s": start.cpu_s,
        "cold_replay_wall_s": start.wall_s,
        "cold_replay_says": [
            {"after_s": round(t, 1), "line": line}
            for t, line in start.lines
            if "compil" in line.lower() or "kernel" in line.lower()
        ],
    }


def start_lines(f: dict[str, Any]) -> list[str]:
    """The figures in words."""
    lines = [
        f"Start, median of {f['repeats']}",
        f"  warm, process start to first navigation state {f['warm_first_output_s']:.2f} s "
        f"(target {WARM_TARGET_S:g}); whole replay of the sample flight "
        f"{f['warm_sample_replay_s']:.2f} s",
        f"  cold, compiling the kernels of a replay {f['cold_kernels_cpu_s']:.1f} s of CPU "
        f"(target {COLD_TARGET_CPU_S:g}); first `companion replay` {f['cold_replay_cpu_s']:.1f} s "
        f"of CPU, {f['cold_replay_wall_s']:.1f} s of wall clock; it says",
    ]
    said = f["cold_replay_says"] or [{"after_s": 0.0, "line": "nothing"}]
    return lines + [f"    {one['after_s']:5.1f} s  {one['line']}" for one in said[:6]]
