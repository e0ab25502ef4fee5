"""Which logs a batch is of: those that are named, and what is readable below folders."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.types import CompanionError
from replay.reader import looks_readable


def find_logs(given: Sequence[Path], out: Path) -> dict[str, Path]:
    """Absolute paths by name: below a single folder its part from there, else as it was given.

    A file is taken as it is, refused later if need be; of a folder that is no sensor folder, every
    file that begins like a log, at any depth, but nothing inside ``out``. Raises
    :class:`CompanionError` for a path that is not there, and where no log is found.
    """
    found: dict[Path, str] = {}
    for path in given:
        for one in _logs(path, out.resolve()):
            named = one.relative_to(path) if len(given) == 1 and one != path else one
            found.setdefault(one.absolute(), str(named))
    if not found:
        raise CompanionError(f"no log in {', '.join(map(str, given))}")
    return {name: path for path, name in found.items()}


def _logs(path: Path, out: Path) -> Iterator[Path]:
    if path.is_dir():
        yield from _below(path, out)
    elif path.is_file():
        yield path
    else:
        raise CompanionError(f"{path}: {'is no file' if path.exists() else 'is not there'}")


def _below(folder: Path, out: Path) -> Iterator[Path]:
    if folder.resolve() == out:
        return
    if (folder / "imu.csv").exists():
        yield folder
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink():
            yield from _below(path, out)
        elif path.is_file() and looks_readable(path):
            yield path
