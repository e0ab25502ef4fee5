"""A log file written by a thread, so that no disk can make the estimator wait.

Pieces go into a bounded queue. While the disk refuses them (full, gone) they wait there and are
tried again; when the queue is full, the oldest piece that nothing later needs is left out. So a
short refusal costs nothing, and a long one costs a span of the log, never the process.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from companion.logbook.sink import Hole, LogWriteError
from companion.types import LogHealth

QUEUE_BYTES = 32 * 1024 * 1024
"""About ten minutes of a 1 kHz IMU with raw frames."""
RETRY_S = 1.0
SYNC_S = 5.0
"""Power loss takes at most this much of what was written, and what waits in memory."""
SETTLE_S = 5.0
"""A disk that takes nothing for this long at the end is given up."""


class _Piece(NamedTuple):
    start: int
    data: bytes
    needed: bool


class BackgroundFile:
    """A :class:`~companion.logbook.sink.Sink` that never blocks and never fails after opening."""

    def __init__(
        self, path: Path, *, queue_bytes: int = QUEUE_BYTES, retry_s: float = RETRY_S
    ) -> None:
        """Open ``path``.

        A full disk is tried again like any other refusal; :class:`LogWriteError` for the rest.
        """
        self._path = path
        self._limit = queue_bytes
        self._retry_s = retry_s
        self._fd, self._refused = -1, ""
        try:
            self._open()
        except OSError as error:
            self._refused = error.strerror or str(error)
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise LogWriteError(f"{path}: cannot be opened: {self._refused}") from None
        self._change = threading.Condition()
        self._queue: deque[_Piece] = deque()
        self._queued = self._end = self._written = self._left_out = 0
        self._busy = False
        self._holes: list[Hole] = []
        self._closing = False
        self._thread = threading.Thread(target=self._work, name="log", daemon=True)
        self._thread.start()

    # ------------------------------------------------------------------ for the loop

    def append(self, data: bytes, *, whole: int = 0, needed: bool = False) -> None:  # noqa: ARG002 - pieces are written whole or not at all
        """Queue a piece; returns at once."""
        with self._change:
            if self._closing:
                raise LogWriteError(f"{self._path}: the log is closed")
            self._queue.append(_Piece(self._end, data, needed))
            self._end += len(data)
            self._queued += len(data)
            while self._queued > self._limit and self._leave_out_oldest():
                pass
            self._change.notify_all()

    def settle(self) -> list[Hole]:
        """Wait until all is written or, after :data:`SETTLE_S` without progress, given up."""
        with self._change:
            self._await_empty()
            while self._leave_out_oldest(even_needed=True):
                pass
            return sorted(self._holes)

    def close(self) -> None:
        """Write what is left and close; waits no longer than :meth:`settle` does."""
        with self._change:
            if self._closing:
                return
            self._await_empty()
            self._closing = True
            self._change.notify_all()
        self._thread.join(SETTLE_S)

    def health(self) -> LogHealth:
        """How the file is doing."""
        with self._change:
            return LogHealth(
                state="stopped" if self._refused else "writing",
                path=str(self._path),
                written_bytes=self._written,
                queued_bytes=self._queued,
                dropped_bytes=self._left_out,
            )

    @property
    def refused(self) -> str:
        """Why the disk takes nothing; empty while it does."""
        return self._refused

    def _await_empty(self) -> None:
        """Wait, with the lock held, for the queue to empty while it gets shorter."""
        left = self._queued
        while left and self._thread.is_alive():
            self._change.wait_for(lambda: not self._queued, SETTLE_S)
            if self._queued >= left:
                return
            left = self._queued

    def _leave_out_oldest(self, even_needed: bool = False) -> bool:
        """Take one piece out of the queue; whether there was one to take."""
        # The first may be on its way to the disk just now.
        for at in range(1 if self._busy else 0, len(self._queue)):
            piece = self._queue[at]
            if even_needed or not piece.needed:
                del self._queue[at]
                self._queued -= len(piece.data)
                self._left_out += len(piece.data)
                self._holes.append(Hole(piece.start, len(piece.data)))
                return True
        return False

    # ------------------------------------------------------------------ the thread

    def _work(self) -> None:
        synced, dirty = time.monotonic(), False
        while True:
            with self._change:
                idle = None if not dirty else max(0.0, synced + SYNC_S - time.monotonic())
                self._change.wait_for(lambda: self._queue or self._closing, idle)
                if self._closing and (self._refused or not self._queue):
                    break
                piece = self._queue[0] if self._queue else None
                self._busy = piece is not None
            if piece is not None:
                dirty = self._write(piece) or dirty
            if dirty and time.monotonic() - synced >= SYNC_S:
                with suppress(OSError):
                    os.fdatasync(self._fd)
                synced, dirty = time.monotonic(), False
        if self._fd >= 0:
            with suppress(OSError):
                os.fdatasync(self._fd)
            os.close(self._fd)

    def _open(self) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC
        self._fd = os.open(self._path, flags, 0o644)

    def _write(self, piece: _Piece) -> bool:
        """Write the first piece of the queue, or cut back and wait before the next try."""
        view, done, refused = memoryview(piece.data), 0, ""
        try:
            if self._fd < 0:
                self._open()
            while done < len(piece.data):
                done += os.write(self._fd, view[done:])
        except OSError as error:
            refused = error.strerror or str(error)
            self._cut_back()
        with self._change:
            self._refused, self._busy = refused, False
            if not refused:
                self._queue.popleft()
                self._queued -= len(piece.data)
                self._written += len(piece.data)
            self._change.notify_all()
            if refused:
                self._change.wait_for(lambda: self._closing, self._retry_s)
        return not refused

    def _cut_back(self) -> None:
        """Leave the file at the end of its last whole piece."""
        if self._fd < 0:
            return
        with suppress(OSError):
            os.ftruncate(self._fd, self._written)
            os.lseek(self._fd, self._written, os.SEEK_SET)
