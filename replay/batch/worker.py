"""One log on a worker: is it done already? Else in a child process, with a limit of time.

:func:`work` is what Dask runs. It imports nothing numerical and loads no log itself, so that a
worker stays small and alive whatever a log does to the child. A worker keeps as many children as
it has threads, each for log after log: loading the kernels costs as much as a small log.
"""

from __future__ import annotations

import json
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.types import CompanionError
from replay.batch import store
from replay.batch.outcome import Outcome, as_outcome
from replay.children import Child

_READY_S = 1800.0
"""To load the kernels, or on a new machine to compile them, behind others that do the same."""


@dataclass(frozen=True, slots=True)
class Job:
    """One log to work on; paths mean the same on every machine that takes part."""

    log: str
    path: str
    out: str
    config: str | None
    settings: str
    """:func:`~replay.batch.store.settings_key`."""
    program: str
    rate_hz: float
    limit_s: float


class Children:
    """The child processes of this worker: some at work, some idle."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[Child] = []
        self._all: list[Child] = []
        self._closed = False

    def take(self) -> Child:
        """One that is ready. Raises :class:`CompanionError` if it does not get so."""
        with self._lock:
            while self._idle:
                child = self._idle.pop()
                if child.running:
                    return child
            if self._closed:
                raise CompanionError("the batch was ended")
            child = Child("the log's process", ["replay.batch.child"])
            self._all.append(child)
        try:
            child.answer(_READY_S)
        except CompanionError:
            self.drop(child)
            raise
        return child

    def give_back(self, child: Child) -> None:
        """Keep it for the next log."""
        with self._lock:
            self._idle.append(child)

    def drop(self, child: Child) -> None:
        """End it: it hangs, or is gone."""
        child.__exit__(None, None, None)
        with self._lock, suppress(ValueError):
            self._all.remove(child)

    def end_idle(self) -> None:
        """End those that wait for work."""
        with self._lock:
            idle, self._idle = self._idle, []
        for child in idle:
            self.drop(child)

    def end_all(self) -> None:
        """End also those at work, and start no more."""
        with self._lock:
            self._closed = True
            every, self._all, self._idle = self._all, [], []
        for child in every:
            child.__exit__(None, None, None)

    def begin(self) -> None:
        """Children may be started (again)."""
        with self._lock:
            self._closed = False


CHILDREN = Children()


def end_idle_children() -> None:
    """End this worker's children that wait for work; those of another batch come again."""
    CHILDREN.end_idle()


def work(job: Job) -> dict[str, Any]:
    """Work on one log, or take what is there of it; an :class:`Outcome` as plain types."""
    begin = time.monotonic()
    outcome = _found_or_made(job)
    if not outcome.reused:
        outcome = msgspec.structs.replace(outcome, wall_s=time.monotonic() - begin)
        if outcome.ended != "failed":
            store.keep(Path(job.out), outcome)
    plain: dict[str, Any] = msgspec.to_builtins(outcome)
    return plain


def failed(log: str, path: str, reason: str, key: str = "") -> Outcome:
    """A log whose work did not come to an end."""
    return Outcome(log=log, path=path, ended="failed", reason=reason, key=key)


def _found_or_made(job: Job) -> Outcome:
    if store.program() != job.program:
        return failed(
            job.log, job.path, f"a worker runs other code: {store.program()}, not {job.program}"
        )
    try:
        key = store.log_key(Path(job.path), job.settings)
    except OSError as error:
        return failed(job.log, job.path, f"cannot be read: {error.strerror or error}")
    done = store.find(Path(job.out), key)
    if done is not None:
        return msgspec.structs.replace(done, log=job.log, path=job.path, reused=True)
    return _made(job, key)


def _made(job: Job, key: str) -> Outcome:
    try:
        child = CHILDREN.take()
    except CompanionError as error:
        return failed(job.log, job.path, str(error), key)
    child.tell(
        json.dumps(
            {
                "log": job.path, "name": job.log, "config": job.config, "out": job.out,
                "key": key, "rate_hz": job.rate_hz,
            }
        ).encode()
    )  # fmt: skip
    try:
        answer = child.answer(job.limit_s)
    except CompanionError:
        return failed(job.log, job.path, _ended(child, job.limit_s), key)
    CHILDREN.give_back(child)
    ended = next(word for word in ("rows", "refused", "failed") if word in answer)
    table = {
        "log": job.log,
        "path": job.path,
        "key": key,
        "ended": "done" if ended == "rows" else ended,
        "rows": answer.get("rows", []),
        "reason": answer.get("refused", answer.get("failed", "")),
        "peak_mb": answer["peak_mb"],
    }
    return as_outcome(table)


def _ended(child: Child, limit_s: float) -> str:
    """Why a child gave no answer; it is no more when this returns."""
    ended = child.ended
    words = child.last_words() if ended else ""
    CHILDREN.drop(child)
    if not ended:
        return f"not done after {limit_s:g} s: its process was ended"
    return f"its process died ({ended}): {words}"
