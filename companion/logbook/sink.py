"""Where the bytes of a log go: the seam between building records and writing them.

A replay writes at once and ends with an error when the disk does not take it. The live process
must not wait for a disk: its sink queues (``companion.runtime.background``), and may have to leave
pieces out, which the file's index then has to know.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple, Protocol

from companion.types import CompanionError


class LogWriteError(CompanionError):
    """The log cannot be written (disk full, no permission); what was written before stays."""


class Hole(NamedTuple):
    """A piece that was appended and is not in the file."""

    start: int
    """Where it would be if everything before it had been written [bytes]."""
    length: int


class Sink(Protocol):
    """Takes a file's pieces in order; each is one or more whole records."""

    def append(self, data: bytes, *, whole: int = 0, needed: bool = False) -> None:
        """Add a piece.

        ``whole``: a prefix that makes sense by itself, if the rest cannot be written.
        ``needed``: what comes later cannot be read without it. May raise :class:`LogWriteError`;
        every later call then does too.
        """
        ...

    def settle(self) -> list[Hole]:
        """Wait until all pieces are written or given up; those left out, in order."""
        ...

    def close(self) -> None:
        """Finish; a second call does nothing."""
        ...


class DirectFile:
    """Writes each piece at once; any failure ends the file at its last whole record."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offset = 0
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise LogWriteError(f"{path}: cannot be opened: {error.strerror or error}") from None

    def append(self, data: bytes, *, whole: int = 0, needed: bool = False) -> None:  # noqa: ARG002 - nothing is ever left out here
        """Write all of ``data``, or cut back to what is whole, close and raise."""
        if self._file.closed:
            raise LogWriteError(f"{self._path}: the log is closed")
        view, done = memoryview(data), 0
        try:
            while done < len(data):
                done += self._file.write(view[done:]) or 0
        except OSError as error:
            self._abandon(self._offset + (whole if whole and done >= whole else 0))
            raise LogWriteError(
                f"{self._path}: writing stopped after {self._offset} bytes: "
                f"{error.strerror or error}"
            ) from None
        self._offset += done

    def settle(self) -> list[Hole]:
        """Nothing is pending and nothing is left out."""
        return []

    def close(self) -> None:
        self._file.close()

    def _abandon(self, whole: int) -> None:
        """Best effort: a half-written record at the end is legal, only untidy."""
        try:
            os.ftruncate(self._file.fileno(), whole)
        except (OSError, ValueError):
            pass
        finally:
            self._file.close()
