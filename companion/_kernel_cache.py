"""Where compiled kernels are kept: a folder named after the sources of all of them.

Numba's cache looks at the file of a kernel, not at the files of what it calls or of the constants it
compiles in. A changed offset in one file would leave stale machine code in its callers, silently
wrong. So the cache's folder carries a hash of every source that takes part: any change is a new folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from pathlib import Path

CONSTANTS = ("layout.py", "parameters.py")
"""Sources without kernels whose values are compiled into kernels."""


def _sources() -> list[Path]:
    root = Path(__file__).parent
    found = []
    for package in (root, root.parent / "drivers", root.parent / "replay"):
        for path in sorted(package.rglob("*.py")):
            if path.name in CONSTANTS or b"njit(" in path.read_bytes():
                found.append(path)
    return found


def use_cache() -> None:
    """Point numba to the folder of these sources, unless ``NUMBA_CACHE_DIR`` says otherwise.

    Must run before numba is first imported. Folders of other sources are removed.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    digest = hashlib.sha256()
    for path in _sources():
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
