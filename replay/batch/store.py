"""What has been done, kept from run to run: one small file a log, named after what decided it.

The name is a digest of the log's bytes and name, the configuration's, the settings of the batch
and the program's sources. A file is there only when the work was finished, page and all.
"""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

import msgspec

from companion import __version__
from companion.config import load
from replay.batch.outcome import Outcome

_DONE = "done"


@cache
def program() -> str:
    """Version and sources of what works on a log: other code may give other bits."""
    digest = hashlib.sha256(__version__.encode())
    root = Path(__file__).parents[2]
    for package in ("companion", "drivers", "replay"):
        for path in sorted((root / package).rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + path.read_bytes())
    return f"{__version__}-{digest.hexdigest()[:12]}"


def settings_key(config: Path | None, rate_hz: float) -> str:
    """Of all that a batch says about its logs: program, configuration with the files that it
    names, and rate of the smoothed epochs.

    Raises :class:`~companion.types.ConfigError` for a configuration that cannot be used.
    """
    digest = hashlib.sha256(f"{program()} {rate_hz!r}".encode())
    if config is not None:
        files = [config]
        files += [Path(i.dbc.file) for bus in load(config).can for i in bus.imu if i.dbc]
        for path in files:
            _add(digest, path)
    return digest.hexdigest()


def log_key(log: Path, settings: str) -> str:
    """Of one log under these settings; a folder counts with every file in it."""
    digest = hashlib.sha256(f"{settings} {log.name}".encode())
    if log.is_dir():
        for path in sorted(p for p in log.rglob("*") if p.is_file()):
            digest.update(str(path.relative_to(log)).encode())
            _add(digest, path)
    else:
        _add(digest, log)
    return digest.hexdigest()[:32]


def _add(digest: hashlib._Hash, path: Path) -> None:
    with path.open("rb") as file:
        digest.update(hashlib.file_digest(file, "sha256").digest())


def find(out: Path, key: str) -> Outcome | None:
    """The finished work of this name, if its pages are still there."""
    try:
        outcome = msgspec.json.decode((out / _DONE / f"{key}.json").read_bytes(), type=Outcome)
    except (OSError, msgspec.DecodeError):
        return None
    return outcome if all((out / row.report).is_file() for row in outcome.rows) else None


def keep(out: Path, outcome: Outcome) -> None:
    """Write it so that it is there whole or not at all."""
    folder = out / _DONE
    folder.mkdir(exist_ok=True)
    part = folder / f"{outcome.key}.{os.getpid()}.part"
    part.write_bytes(msgspec.json.encode(outcome))
    part.replace(folder / f"{outcome.key}.json")
