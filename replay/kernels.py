"""Loading the jitted kernels, which is what compiles them on a machine that never ran them.

Kernels carry explicit signatures, so importing their module is enough: numba reads the machine
code from its on-disk cache, or compiles it and fills the cache (ADR 0004). Run as
``python -m replay.kernels`` before tests or in an image build, so that nothing later has to wait.
"""

from __future__ import annotations

import importlib
import pkgutil
import time

import companion
import drivers
import replay


def kernel_modules() -> list[str]:
    """Dotted names of every module of the project that holds kernels, or may come to hold some.

    Entry points and written protobuf code are left out: importing them does nothing useful here.
    """
    skipped = ("cli", "present", "proto", "__main__", "kernels")
    return [
        module.name
        for package in (companion, drivers, replay)
        for module in pkgutil.walk_packages(package.__path__, package.__name__ + ".")
        if not any(part in skipped for part in module.name.split("."))
    ]


def load_all() -> float:
    """Import every module of :func:`kernel_modules`; returns the CPU time it took [s]."""
    begin = time.process_time()
    for name in kernel_modules():
        importlib.import_module(name)
    return time.process_time() - begin


if __name__ == "__main__":
    print(f"kernels ready, {load_all():.1f} CPU s")
