"""Loading the jitted kernels, which is what compiles them on a machine that never ran them.

Kernels carry explicit signatures, so importing their module is enough: numba reads the machine
code from its on-disk cache, or compiles it and fills the cache (ADR 0004). Run as
``python -m replay.kernels`` before tests or in an image build, so that nothing later has to wait.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

from companion._kernel_cache import compiled, kernel_sources, note_compiled, root

# Called before callers: importing a caller first would compile everything behind one name.
_ORDER = (
    "companion.navigation", "companion.gnss", "companion.measurements", "companion.estimation",
    "drivers",
)  # fmt: skip
# The floor that `bench` compares with is no part of the program; `bench` compiles it.
_NOT_OURS = "replay.bench"

__all__ = ["compiled", "kernel_modules", "load_all"]


def kernel_modules() -> list[str]:
    """Dotted names of the program's modules that hold kernels, called ones before their callers."""
    names = [".".join(path.relative_to(root()).with_suffix("").parts) for path in kernel_sources()]

    def rank(name: str) -> int:
        return next((at for at, part in enumerate(_ORDER) if name.startswith(part)), len(_ORDER))

    return sorted((n for n in names if not n.startswith(_NOT_OURS)), key=rank)


def load_all(progress: Callable[[float], None] | None = None) -> float:
    """Import every module of :func:`kernel_modules`; returns the CPU time it took [s].

    ``progress`` is told the fraction of modules done before each of them.
    """
    begin = time.process_time()
    names = kernel_modules()
    for done, name in enumerate(names):
        if progress is not None:
            progress(done / len(names))
        importlib.import_module(name)
    note_compiled()
    return time.process_time() - begin


if __name__ == "__main__":
    print(f"kernels ready, {load_all():.1f} CPU s")
