"""Loading the jitted kernels beforehand, which compiles those that this machine never compiled.

A kernel is read from the cache or compiled when it is first called (ADR 0004). A command that must
not wait in flight, or that wants to say why it waits, loads the parts that it uses here. Run as
``python -m replay.kernels [PART …]`` before tests or in an image build: all parts, two processes
side by side.
"""

from __future__ import annotations

import importlib
import re
import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from companion import _jit
from companion.config import Config
from companion.config.settings import uses_direct

PARTS: dict[str, tuple[str, ...]] = {
    "filter": (
        "companion.navigation", "companion.measurements", "companion.estimation", "drivers",
    ),
    "smoothing": ("companion.smoothing",),
    "direct": ("companion.estimation.direct",),
    "gnss": (
        "companion.gnss", "companion.measurements.pseudorange",
        "companion.estimation.receiver_clock", "companion.estimation.adaptation.constellations",
        "companion.intake.raw_gnss",
    ),
    "several imus": ("companion.intake.fusion",),
    "files": ("replay.candump", "replay.dataflash_codec"),
    "simulator": ("replay.simulator",),
}  # fmt: skip
"""Kernels by what needs them: modules that begin with one of the names, the longest one counts."""

# The floor that `bench` compares with is no part of the program; `bench` compiles it.
_NOT_OURS = "replay.bench"
_KERNEL = re.compile(rb"^@njit\(", re.MULTILINE)


def part_of(module: str) -> str:
    """The part that a module of kernels belongs to."""
    fits = {name: part for part, names in PARTS.items() for name in names if begins(module, name)}
    return fits[max(fits, key=len)]


def begins(module: str, package: str) -> bool:
    """Whether a module is a package or in it."""
    return f"{module}.".startswith(f"{package}.")


@cache
def kernel_modules() -> tuple[str, ...]:
    """Dotted names of the program's modules that hold kernels."""
    root = Path(__file__).parent.parent
    found = (
        path.relative_to(root).with_suffix("")
        for package in ("companion", "drivers", "replay")
        for path in sorted((root / package).rglob("*.py"))
        if _KERNEL.search(path.read_bytes())
    )
    names = (".".join(path.parts) for path in found)
    return tuple(name for name in names if not begins(name, _NOT_OURS))


def kernels_of(parts: Iterable[str]) -> list[_jit.Kernel[Any, Any]]:
    """The kernels of ``parts``, called ones before their callers; numba is not imported."""
    wanted = {module for module in kernel_modules() if part_of(module) in set(parts)}
    for module in sorted(wanted):
        importlib.import_module(module)
    return [kernel for kernel in _jit.made if kernel.__module__ in wanted]


def parts_of(config: Config) -> tuple[str, ...]:
    """What a run with this configuration may call."""
    asked = {
        "filter": True,
        "smoothing": config.smoothing.enabled,
        "direct": uses_direct(config),
        "gnss": config.raw_gnss.coupling != "off",
        "several imus": bool(config.further_imu),
    }
    return tuple(part for part, used in asked.items() if used)


def compiled(*parts: str) -> bool:
    """Whether what Python calls of these parts is all there."""
    return all(kernel.ready for kernel in kernels_of(parts) if kernel.entry)


def load(parts: Iterable[str] = PARTS, progress: Callable[[float], None] | None = None) -> float:
    """Compile what is missing of ``parts``; returns the CPU time it took [s].

    ``progress`` is told the fraction done before each kernel that has to be compiled.
    """
    begin = time.process_time()
    missing = [kernel for kernel in kernels_of(parts) if kernel.entry and not kernel.ready]
    called = _called_by(missing)
    steps = [*(kernel.part for kernel in called), *(kernel.load for kernel in missing)]
    for done, step in enumerate(steps):
        if progress is not None:
            progress(done / len(steps))
        step()
    return time.process_time() - begin


def _called_by(kernels: Iterable[_jit.Kernel[Any, Any]]) -> list[_jit.Kernel[Any, Any]]:
    """The kernels that these call, directly or not; called ones before their callers."""
    found: set[str] = set()
    ahead = [called for kernel in kernels for called in kernel.calls]
    while ahead:
        kernel = ahead.pop()
        if kernel.stored_name not in found:
            found.add(kernel.stored_name)
            ahead += kernel.calls
    return [kernel for kernel in _jit.made if kernel.stored_name in found]


def _load_side_by_side(parts: tuple[str, ...]) -> float:
    """The filter first, which most others call; then each further part in one of two processes."""
    spent = load(["filter"]) if "filter" in parts else 0.0
    rest = [[part] for part in parts if part != "filter"]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        return spent + sum(pool.map(load, rest))


if __name__ == "__main__":
    asked = tuple(sys.argv[1:]) or tuple(PARTS)
    if unknown := set(asked) - set(PARTS):
        sys.exit(f"no part {min(unknown)}; there are {', '.join(PARTS)}")
    print(f"kernels ready, {_load_side_by_side(asked):.1f} CPU s")
