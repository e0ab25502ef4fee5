"""Which machine code a kernel needs, and where it is kept: found by content, without numba.

Numba's cache asks the time stamp of a kernel's own file: not the kernels it calls, nor constants
from elsewhere that are compiled in. A changed offset in one file would leave stale code in its
callers, silently wrong. Here a kernel's key is a hash of all that its machine code is made of: its
byte code, signature and constants, the values of the globals it reads, and the keys of the kernels
it calls. A comment or another file costs nothing, and two checkouts can share one folder.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from types import BuiltinFunctionType, ModuleType
from typing import Any

import numpy as np

_PACKAGES = ("companion", "drivers", "replay", "tests")
_FORM = "parts"
"""How kernels are compiled: to be changed with :mod:`companion._machine_code`."""
_PLAIN = (bool, int, float, complex, str, bytes, type(None))
_PROCESSOR = ("model name", "flags", "CPU implementer", "CPU part", "Features")


def key(function: Callable[..., Any], signature: str) -> str:
    """Hash of what ``function`` compiles to.

    Raises :class:`TypeError` for a global whose value cannot be told apart by content.
    """
    code = function.__code__
    said = hashlib.sha256(code.co_code)
    constants = [c for c in code.co_consts if c != function.__doc__]
    for part in (signature, constants, code.co_varnames, code.co_names, function.__defaults__):
        said.update(repr(part).encode())
    for name, value in read_globals(function):
        said.update(f"{name}={_content(value)};".encode())
    return said.hexdigest()[:20]


def read_globals(function: Callable[..., Any]) -> Iterator[tuple[str, Any]]:
    """Name and value of each global that the code may read, those within our modules too."""
    names = function.__code__.co_names
    for name in names:
        if name not in function.__globals__:
            continue
        value = function.__globals__[name]
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] in _PACKAGES:
            for inner in names:
                if hasattr(value, inner):
                    yield f"{name}.{inner}", getattr(value, inner)
        else:
            yield name, value


def _content(value: Any) -> str:
    """What stands for a global's value."""
    if isinstance(value, _PLAIN):
        return repr(value)
    if isinstance(value, tuple):
        return f"({','.join(_content(v) for v in value)})"
    if isinstance(value, np.ndarray | np.generic):
        return f"{value.dtype}{value.shape}{hashlib.sha256(value.tobytes()).hexdigest()}"
    if hasattr(value, "kernel_key"):
        return str(value.kernel_key)
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, type | BuiltinFunctionType | np.ufunc):
        return repr(value)
    raise TypeError(f"a kernel reads a global {type(value).__name__}, whose content has no name")


@cache
def folder() -> Path:
    """Where kernels of this Python, numba and processor are kept.

    Under ``NUMBA_CACHE_DIR`` where it is set, else in ``__pycache__`` beside this file where that
    can be written (a virtual environment, a checkout), else in the user's cache directory.
    """
    machine = hashlib.sha256(
        f"{sys.version} {_numba()} {_processor()} {_FORM}".encode()
    ).hexdigest()[:16]
    return _base() / f"kernels-{machine}"


def _base() -> Path:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given)
    base = Path(__file__).parent / "__pycache__"
    if os.access(base if base.exists() else base.parent, os.W_OK):
        return base
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(home) / "companion-nav"


def _numba() -> str:
    """Which numba there is; its metadata would cost ten times as much to read."""
    spec = find_spec("numba")
    if spec is None or spec.origin is None:
        return "none"
    said = Path(spec.origin).with_name("_version.py")
    return hashlib.sha256(said.read_bytes()).hexdigest()[:16]


def _processor() -> str:
    """Kind of processor and what it can, as Linux has it: code for one is not taken on another."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.machine()
    first = text.partition("\n\n")[0].splitlines()
    kind = [line for line in first if line.startswith(_PROCESSOR)]
    return hashlib.sha256("\n".join(kind).encode()).hexdigest()[:16]


def home(name: str, kernel_key: str) -> Path:
    """The folder of one kernel's machine code."""
    return folder() / f"{name}-{kernel_key}"


def stored(place: Path) -> bool:
    """Whether machine code is in that folder."""
    try:
        return any(one.suffix == ".nbc" for one in place.iterdir())
    except OSError:
        return False


def forget_others(place: Path) -> None:
    """Remove what the kernel of that folder was before; not from one that may be shared."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    name = place.name.rpartition("-")[0]
    for old in place.parent.glob(f"{name}-*"):
        if old != place:
            with suppress(OSError):
                shutil.rmtree(old)
