"""A CAN bus that is opened again whenever its adapter is lost, without the loop having to wait."""

from __future__ import annotations

import threading
from collections.abc import Callable

from companion.config import CanBus
from companion.runtime.clock import Reading, arrival_ns
from companion.runtime.core import CanArrival
from companion.types import CompanionError, LinkLost, LinkState
from drivers.backoff import Backoff
from drivers.can_imu import CanTransport, open_can

Opener = Callable[[CanBus], CanTransport]


def _open(bus: CanBus) -> CanTransport:
    return open_can(bus.interface, bus.channel, bus.bitrate, bus.options)


class CanLink:
    """The owner polls about ten times a second, waits on :meth:`fileno` and reads.

    Opening an adapter may take seconds (and python-can does it on the caller's time), so each
    attempt after the first is a thread's.
    """

    def __init__(self, bus: CanBus, opener: Opener = _open) -> None:
        self.name = bus.channel
        self._bus, self._opener = bus, opener
        self._backoff = Backoff()
        self._transport: CanTransport | None = None
        self._attempt: _Attempt | None = None
        self._state: LinkState | None = None
        self._changes: list[tuple[LinkState, str]] = []

    def open_first(self, now_ns: int) -> None:
        """Open at once, before there is anything to keep waiting.

        Raises :class:`~companion.types.ConfigError` for a bus that can never be opened.
        """
        try:
            self._opened(self._opener(self._bus))
        except LinkLost as error:
            self._failed(str(error), now_ns)

    def poll(self, now_ns: int) -> bool:
        """Open it if it is closed and an attempt is due; True if it was opened just now."""
        if self._transport is not None:
            return False
        if self._attempt is None:
            if self._backoff.due(now_ns):
                self._attempt = _Attempt(self._opener, self._bus)
            return False
        if not self._attempt.done():
            return False
        attempt, self._attempt = self._attempt, None
        if attempt.transport is None:
            self._failed(attempt.error, now_ns)
            return False
        self._opened(attempt.transport)
        return True

    def fileno(self) -> int | None:
        """Descriptor to wait on; None while it is closed. A new one after each opening."""
        return self._transport.fileno() if self._transport is not None else None

    def read(self, now: Reading) -> list[CanArrival]:
        """Frames that are there now; empty also when the bus was just lost."""
        if self._transport is None:
            return []
        try:
            frames = self._transport.receive()
        except LinkLost as error:
            self.close()
            self._backoff.failed(now.run)
            self._change("lost", str(error))
            return []
        if frames:
            self._backoff.worked()
        return [
            CanArrival(arrival_ns(f.stamp_ns, now), f.can_id, f.extended, f.data) for f in frames
        ]

    def malformed(self) -> int:
        """What the adapter sent that was no frame, since it was opened."""
        return self._transport.malformed if self._transport is not None else 0

    def close(self) -> None:
        """Give the adapter back for now."""
        if self._transport is not None:
            self._transport.close()
            self._transport = None

    def changes(self) -> list[tuple[LinkState, str]]:
        """State and reason, each time the state changed since the last call."""
        out, self._changes = self._changes, []
        return out

    def _opened(self, transport: CanTransport) -> None:
        self._transport = transport
        self._change("up", "")

    def _failed(self, reason: str, now_ns: int) -> None:
        self._backoff.failed(now_ns)
        self._change("retrying", reason)

    def _change(self, state: LinkState, note: str) -> None:
        if state != self._state:
            self._state = state
            self._changes.append((state, note))


class _Attempt:
    """One try to open a bus, in a thread of its own."""

    def __init__(self, opener: Opener, bus: CanBus) -> None:
        self.transport: CanTransport | None = None
        self.error = ""
        self._opener, self._bus = opener, bus
        self._thread = threading.Thread(target=self._run, name="can-open", daemon=True)
        self._thread.start()

    def done(self) -> bool:
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            self.transport = self._opener(self._bus)
        except CompanionError as error:
            self.error = str(error)
