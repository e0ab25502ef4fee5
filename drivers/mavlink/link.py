"""An endpoint that is opened again whenever it is lost, without anybody having to wait for it."""

from __future__ import annotations

from collections.abc import Callable

from companion.types import LinkLost, LinkState
from drivers.backoff import Backoff
from drivers.mavlink.endpoint import Endpoint, open_endpoint


class ReopeningLink:
    """The owner polls about ten times a second, waits on :meth:`fileno`, reads and writes.

    Nothing here raises or blocks once the text has been found to name an endpoint. What changed
    comes out of :meth:`changes`.
    """

    def __init__(
        self, text: str, baud: int, opener: Callable[[str, int], Endpoint] = open_endpoint
    ) -> None:
        self.name = text
        self.reopened = 0
        """Times it was opened after the first."""
        self._baud, self._opener = baud, opener
        self._backoff = Backoff()
        self._endpoint: Endpoint | None = None
        self._opened = 0
        self._state: LinkState | None = None
        self._changes: list[tuple[LinkState, str]] = []

    def poll(self, now_ns: int) -> bool:
        """Open it if it is closed and an attempt is due; True if it was opened just now.

        Raises :class:`~companion.types.ConfigError` for a text that names no endpoint.
        """
        if self._endpoint is not None:
            self._look(self._endpoint, now_ns)
            return False
        if not self._backoff.due(now_ns):
            return False
        try:
            self._endpoint = self._opener(self.name, self._baud)
        except LinkLost as error:
            self._backoff.failed(now_ns)
            self._change("retrying", str(error))
            return False
        self._opened += 1
        self.reopened = self._opened - 1
        self._look(self._endpoint, now_ns)
        return self._endpoint is not None

    def _look(self, endpoint: Endpoint, now_ns: int) -> None:
        """A connection that was begun is up once it is made."""
        try:
            if self._state != "up" and endpoint.connected():
                self._change("up", "")
        except LinkLost as error:
            self._lose(error, now_ns)

    def _lose(self, error: LinkLost, now_ns: int) -> None:
        self.close()
        self._backoff.failed(now_ns)
        self._change("lost" if self._state == "up" else "retrying", str(error))

    def fileno(self) -> int | None:
        """Descriptor to wait on; None while it is closed. A new one after each opening."""
        return self._endpoint.fileno() if self._endpoint is not None else None

    @property
    def datagrams(self) -> bool:
        """Whether pieces are whole datagrams; False while it is closed."""
        return self._endpoint is not None and self._endpoint.datagrams

    def read(self, now_ns: int) -> list[bytes]:
        """What is there now; empty also when the link was just lost."""
        if self._endpoint is None:
            return []
        try:
            found = self._endpoint.read()
        except LinkLost as error:
            self._lose(error, now_ns)
            return []
        if found:
            self._backoff.worked()
            self._change("up", "")
        return found

    def write(self, data: bytes) -> bool:
        """Send one frame; False where it was dropped."""
        return self._endpoint is not None and self._endpoint.write(data)

    def close(self) -> None:
        """Close it for now; the next poll that is due opens it again."""
        if self._endpoint is not None:
            self._endpoint.close()
            self._endpoint = None

    def changes(self) -> list[tuple[LinkState, str]]:
        """State and reason, each time the state changed since the last call."""
        out, self._changes = self._changes, []
        return out

    def _change(self, state: LinkState, note: str) -> None:
        if state != self._state:
            self._state = state
            self._changes.append((state, note))
