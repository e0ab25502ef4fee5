"""Starts a simulated vehicle as a child process and steers it; for the demo and for tests."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import IO, Any, Self

from companion.types import CompanionError
from replay.simulator.live.faults import FaultName

_READY_S = 60.0
"""Imports and the simulation take 3 s on an idle machine."""
_ANSWER_S = 20.0


class VehicleProcess:
    """A running ``python -m replay.simulator.live``; a context manager that ends it."""

    def __init__(self, arguments: Sequence[str]) -> None:
        """``arguments`` as on the command line; :class:`CompanionError` if it does not start."""
        self._child = subprocess.Popen(
            [sys.executable, "-m", "replay.simulator.live", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Ctrl-C is for the parent, which then ends its children in order.
            start_new_session=True,
        )
        self._lines: queue.Queue[dict[str, Any]] = queue.Queue()
        self._reader = threading.Thread(target=self._read, args=(self._child.stdout,), daemon=True)
        self._reader.start()
        self.ready = self._wait("ready", _READY_S)
        """Endpoints and clock: ``mavlink``, ``can``, ``start_unix_ns``, ``start_monotonic_ns``."""

    def fault(
        self,
        name: FaultName,
        *,
        on: bool = True,
        for_s: float | None = None,
        share: float | None = None,
    ) -> int:
        """Break (or mend) something; the time [ns, UTC] at which it was done."""
        order: dict[str, Any] = {"fault": name, "on": on}
        if for_s is not None:
            order["for_s"] = for_s
        if share is not None:
            order["share"] = share
        self._send(order)
        return int(self._wait("done", _ANSWER_S)["t_ns"])

    def counts(self) -> dict[str, Any]:
        """What it has sent and received so far."""
        self._send({"ask": "counts"})
        counts: dict[str, Any] = self._wait("counts", _ANSWER_S)["counts"]
        return counts

    def end(self) -> dict[str, Any]:
        """Land it: the final counts."""
        if self._child.stdin is not None and not self._child.stdin.closed:
            with contextlib.suppress(BrokenPipeError):
                self._child.stdin.close()
        counts: dict[str, Any] = self._wait("ended", _ANSWER_S)["counts"]
        self._child.wait(_ANSWER_S)
        return counts

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._child.kill()
        self._child.wait()
        self._reader.join()
        for pipe in (self._child.stdin, self._child.stdout, self._child.stderr):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()

    def _send(self, order: dict[str, Any]) -> None:
        assert self._child.stdin is not None
        try:
            self._child.stdin.write(json.dumps(order).encode() + b"\n")
            self._child.stdin.flush()
        except BrokenPipeError:
            raise self._gone() from None

    def _read(self, stream: IO[bytes]) -> None:
        for line in stream:
            self._lines.put(json.loads(line))
        self._lines.put({"gone": True})

    def _wait(self, key: str, seconds: float) -> dict[str, Any]:
        try:
            answer = self._lines.get(timeout=seconds)
        except queue.Empty:
            raise CompanionError(f"the simulated vehicle said nothing for {seconds:g} s") from None
        if "error" in answer:
            raise CompanionError(f"simulated vehicle: {answer['error']}")
        if key not in answer:
            raise self._gone()
        return answer

    def _gone(self) -> CompanionError:
        self._child.wait(_ANSWER_S)
        said = b"" if self._child.stderr is None else self._child.stderr.read()
        last = said.decode(errors="replace").strip().splitlines()[-1:] or ["it said nothing"]
        return CompanionError(f"the simulated vehicle ended: {last[0]}")
