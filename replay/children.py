"""Child processes that speak lines of JSON: started, listened to, and always ended."""

from __future__ import annotations

import contextlib
import json
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

from companion.types import CompanionError

END_S = 20.0
"""A child that is told to end has this long, on a busy machine."""
_GONE: dict[str, Any] = {}


def free_port() -> int:
    """A TCP port on loopback that nobody has at this moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _temporary() -> IO[bytes]:
    return tempfile.TemporaryFile()


class Child:
    """A Python module run as a child; a context manager that ends it.

    Its standard output is read as lines of JSON; standard error goes to a file.
    """

    def __init__(self, name: str, arguments: Sequence[str], log: Path | None = None) -> None:
        """``arguments`` follow ``python -m``; ``log`` gets standard error and is kept."""
        self.name = name
        self._said: queue.Queue[dict[str, Any]] = queue.Queue()
        self._errors = _temporary() if log is None else log.open("w+b")  # closed by __exit__
        self._child = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            # Ctrl-C is for the parent, which ends its children in order.
            start_new_session=True,
        )
        assert self._child.stdout is not None
        self._reader = threading.Thread(target=self._read, args=(self._child.stdout,), daemon=True)
        self._reader.start()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._child.pid

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self._child.poll() is None

    @property
    def ended(self) -> str:
        """How it ended, in words; empty while it runs."""
        status = self._child.poll()
        if status is None:
            return ""
        if status >= 0:
            return f"status {status}"
        try:
            return f"killed by {signal.Signals(-status).name}"
        except ValueError:
            return f"killed by signal {-status}"

    def said(self) -> list[dict[str, Any]]:
        """What it said since the last call."""
        out = []
        while not self._said.empty():
            out.append(self._said.get())
        return [line for line in out if line]

    def answer(self, seconds: float) -> dict[str, Any]:
        """The next thing it says. Raises :class:`CompanionError` if it ends or says nothing."""
        try:
            line = self._said.get(timeout=seconds)
        except queue.Empty:
            raise CompanionError(f"{self.name} said nothing for {seconds:g} s") from None
        if line is _GONE:
            self._child.wait(END_S)
            raise CompanionError(f"{self.name} ended: {self.last_words()}")
        return line

    def tell(self, line: bytes) -> None:
        """Write a line to its standard input."""
        assert self._child.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # its end shows in the missing answer
            self._child.stdin.write(line + b"\n")
            self._child.stdin.flush()

    def close_input(self) -> None:
        """End its standard input, which these children take for the end."""
        if self._child.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._child.stdin.close()

    def wait(self, seconds: float) -> bool:
        """Wait for its end; whether it came."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.wait(seconds)
        return not self.running

    def send_signal(self, number: signal.Signals) -> None:
        """Send a signal, if it still runs."""
        if self.running:
            self._child.send_signal(number)

    def finish(self) -> None:
        """Wait for its end. Raises :class:`CompanionError` with its last words if it failed."""
        if not self.wait(END_S):
            raise CompanionError(f"{self.name} did not end within {END_S:g} s")
        if self._child.returncode != 0:
            status = self._child.returncode
            raise CompanionError(f"{self.name} ended with status {status}: {self.last_words()}")

    def last_words(self) -> str:
        """The last line on its standard error."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1].removeprefix("error: ") if lines else "it said nothing"

    def _read(self, stream: IO[bytes]) -> None:
        for line in stream:
            with contextlib.suppress(ValueError):
                said = json.loads(line)
                if isinstance(said, dict) and said:
                    self._said.put(said)
        self._said.put(_GONE)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close_input()
        if self.running:
            self._child.terminate()
            if not self.wait(2.0):
                self._child.kill()
                self._child.wait()
        self._reader.join()
        self._errors.close()
        if self._child.stdout is not None:
            self._child.stdout.close()
