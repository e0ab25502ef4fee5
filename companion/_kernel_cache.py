"""Where compiled kernels are kept: a folder named after the sources of all of them.

Numba's cache looks at the file of a kernel, not at the files of what it calls or of the constants
it compiles in. A changed offset in one file would leave stale machine code in its callers, silently
wrong. So the cache's folder carries a hash of every source that takes part: any change is a new
folder. Nothing here imports numba: the command line asks :func:`compiled` before it does.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import sys
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

CONSTANTS = ("layout.py", "parameters.py")
"""Sources without kernels whose values are compiled into kernels."""
_KERNEL = re.compile(rb"^@njit\(", re.MULTILINE)
_MARK = "complete"
"""File in the cache's folder that says for which sources and versions everything is there."""
_PROCESSOR = ("model name", "flags", "CPU implementer", "CPU part", "Features")


def root() -> Path:
    """The folder that holds the packages."""
    return Path(__file__).parent.parent


@cache
def kernel_sources() -> tuple[Path, ...]:
    """Every source that takes part in a kernel, in a fixed order."""
    found: list[Path] = []
    for package in ("companion", "drivers", "replay"):
        found.extend(
            path
            for path in sorted((root() / package).rglob("*.py"))
            if path.name in CONSTANTS or _KERNEL.search(path.read_bytes())
        )
    return tuple(found)


def use_cache() -> None:
    """Point numba to the folder of these sources, unless ``NUMBA_CACHE_DIR`` says otherwise.

    Must run before numba is first imported. Folders of other sources are removed.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    digest = hashlib.sha256()
    for path in kernel_sources():
        digest.update(path.name.encode() + path.read_bytes())
    base = Path(__file__).parent / "__pycache__"
    if not os.access(base if base.exists() else base.parent, os.W_OK):
        home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        base = Path(home) / "companion-nav"
    folder = base / f"kernels-{digest.hexdigest()[:16]}"
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    for old in base.glob("kernels-*"):
        if old != folder:
            shutil.rmtree(old, ignore_errors=True)


def _state() -> str:
    """What numba will ask before it takes an entry: versions, the processor, each source's stamp
    and size."""
    lines = [f"python {sys.version}", f"numba {_numba()}", f"processor {_processor()}"]
    for path in kernel_sources():
        stat = path.stat()
        lines.append(f"{path.relative_to(root())} {stat.st_mtime_ns} {stat.st_size}")
    return "\n".join(lines)


def _numba() -> str:
    """Which numba there is; its metadata would cost ten times as much to read."""
    spec = find_spec("numba")
    if spec is None or spec.origin is None:
        return "none"
    said = Path(spec.origin).with_name("_version.py")
    return f"{said} {hashlib.sha256(said.read_bytes()).hexdigest()[:16]}"


def _processor() -> str:
    """Kind of processor and what it can, as Linux has it: code for one is not taken on another."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.machine()
    first = text.partition("\n\n")[0].splitlines()
    kind = [line for line in first if line.startswith(_PROCESSOR)]
    return hashlib.sha256("\n".join(kind).encode()).hexdigest()[:16]


def compiled() -> bool:
    """Whether every kernel of these sources was compiled here before; decided without numba."""
    try:
        said = (Path(os.environ["NUMBA_CACHE_DIR"]) / _MARK).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return False
    return said == _state()


def note_compiled() -> None:
    """Remember that every kernel is compiled; a folder that cannot be written forgets it."""
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / _MARK).write_text(_state(), encoding="utf-8")
