"""How everything here is measured: one core, CPU time, turn by turn, medians."""

from __future__ import annotations

import contextlib
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

Progress = Callable[[float], None]
"""Told how much is done, 0 to 1."""


@contextlib.contextmanager
def pinned() -> Iterator[None]:
    """This process and its children on one core, where the system can do that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def interleaved(
    runs: Mapping[str, Callable[[], float]], repeats: int, progress: Progress
) -> dict[str, float]:
    """Median of what each run returns over ``repeats`` rounds A B C, A B C, …

    Turn by turn, so that a machine that slows down or is shared slows all of them alike.
    """
    took: dict[str, list[float]] = {name: [] for name in runs}
    for turn in range(repeats):
        for k, (name, run) in enumerate(runs.items()):
            progress((turn + k / len(runs)) / repeats)
            took[name].append(run())
    return {name: statistics.median(values) for name, values in took.items()}


def cpu_s(work: Callable[[], object]) -> float:
    """CPU time of this process for one call [s]."""
    begin = time.process_time()
    work()
    return time.process_time() - begin


@dataclass(frozen=True, slots=True)
class ChildRun:
    """A command that was run to its end."""

    status: int
    wall_s: float
    cpu_s: float
    """User and system time of the child."""
    lines: tuple[tuple[float, str], ...]
    """What it printed on either stream: seconds since its start, and the line."""

    @property
    def text(self) -> str:
        """Everything printed."""
        return "\n".join(line for _, line in self.lines)


def run_child(command: Sequence[str], environment: Mapping[str, str] | None = None) -> ChildRun:
    """Run ``command`` and time its output; children must not overlap, CPU time is by difference."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.monotonic()
    lines: list[tuple[float, str]] = []
    with subprocess.Popen(
        list(command),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1", **(environment or {})},
    ) as child:
        assert child.stdout is not None
        lines.extend((time.monotonic() - begin, line.rstrip()) for line in child.stdout)
        status = child.wait()
    wall_s = time.monotonic() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return ChildRun(status, wall_s, cpu, tuple(lines))


def python(*arguments: str) -> list[str]:
    """A command line for this same interpreter."""
    return [sys.executable, *arguments]


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    packages = {}
    for name in ("numpy", "numba", "smsfusion", "pymavlink", "INSLIB"):
        with contextlib.suppress(metadata.PackageNotFoundError):
            packages[name] = metadata.version(name)
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "memory_gb": _memory_gb(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        **packages,
    }


def _processor() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _memory_gb() -> float | None:
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    except (ValueError, OSError):
        return None
