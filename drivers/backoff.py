"""When to try again to open what could not be opened."""

from __future__ import annotations

from companion.types import NS

FIRST_NS = NS // 4
MOST_NS = 4 * NS


class Backoff:
    """Waits twice as long after each failure; starts over once the link has worked. Pure."""

    def __init__(self, first_ns: int = FIRST_NS, most_ns: int = MOST_NS) -> None:
        self._first_ns, self._most_ns = first_ns, most_ns
        self._wait_ns = first_ns
        self._due_ns: int | None = None

    def due(self, now_ns: int) -> bool:
        """Whether it is time to try."""
        return self._due_ns is None or now_ns >= self._due_ns

    def failed(self, now_ns: int) -> None:
        """It could not be opened, or was lost."""
        self._due_ns = now_ns + self._wait_ns
        self._wait_ns = min(2 * self._wait_ns, self._most_ns)

    def worked(self) -> None:
        """Something came through: the next loss is a new one."""
        self._wait_ns = self._first_ns
