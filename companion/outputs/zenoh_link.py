"""A zenoh session that is opened, and opened again, behind the back of who uses it."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Generic, TypeVar

import zenoh

from companion.outputs.publisher import Notice
from companion.outputs.zenoh_settings import complaint

RETRY_S = 2.0
CLOSE_S = 1.0
"""A session that takes longer to say goodbye is waited for at the end of the process."""

T = TypeVar("T")


class ZenohLink(Generic[T]):
    """Keeps one session with its declarations, ``T``, alive.

    Opening can take as long as a connection's time-out and fails while a port is taken: a thread
    does it, and :attr:`live` is None until it is done. Publishing goes on the caller's thread.
    """

    def __init__(
        self,
        settings: Callable[[], zenoh.Config],
        declare: Callable[[zenoh.Session], T],
        *,
        retry_s: float = RETRY_S,
    ) -> None:
        """``settings`` are made anew for each attempt; ``declare`` runs in the thread."""
        self._settings = settings
        self._declare = declare
        self._retry_s = retry_s
        self._session: zenoh.Session | None = None
        self._notices: deque[Notice] = deque(maxlen=16)
        self._stop = threading.Event()
        self._opened = threading.Event()
        self._troubled = False
        self.live: T | None = None
        """The declarations of an open session; None while there is none."""
        self._thread = self._start()

    def wait_open(self, timeout_s: float) -> bool:
        """Wait for the session to be open; for start-up and tests, not for a loop."""
        return self._opened.wait(timeout_s)

    def lost(self, error: zenoh.ZError) -> None:
        """The session broke in the caller's hands: open another one."""
        if self.live is None:
            return
        self.live = None
        self._opened.clear()
        self._say("zenoh-down", f"zenoh session lost: {complaint(error)}", trouble=True)
        self._thread = self._start()

    def notices(self) -> list[Notice]:
        """What happened since the last call."""
        out = []
        while self._notices:
            out.append(self._notices.popleft())
        return out

    def close(self) -> None:
        """Close the session, waiting at most :data:`CLOSE_S` for each of two steps."""
        self._stop.set()
        self.live = None
        # Not daemons: the interpreter must not end in the middle of one's call into zenoh.
        self._thread.join(CLOSE_S)
        closer = threading.Thread(target=self._close_session, name="zenoh-close")
        closer.start()
        closer.join(CLOSE_S)

    # ------------------------------------------------------------------ the thread

    def _start(self) -> threading.Thread:
        thread = threading.Thread(target=self._open, name="zenoh-open")
        thread.start()
        return thread

    def _open(self) -> None:
        self._close_session()
        while not self._stop.is_set():
            try:
                self._session = zenoh.open(self._settings())
                self.live = self._declare(self._session)
            except zenoh.ZError as error:
                self._close_session()
                if not self._troubled:
                    text = f"zenoh does not open, tried again: {complaint(error)}"
                    self._say("zenoh-down", text, trouble=True)
                self._stop.wait(self._retry_s)
                continue
            if self._troubled:
                self._say("zenoh-up", "zenoh session open", trouble=False)
            self._opened.set()
            break
        if self._stop.is_set():
            self.live = None
            self._close_session()

    def _close_session(self) -> None:
        session, self._session = self._session, None
        if session is not None:
            with suppress(zenoh.ZError):
                session.close()  # type: ignore[no-untyped-call]  # zenoh leaves it unannotated

    def _say(self, kind: str, text: str, *, trouble: bool) -> None:
        self._troubled = trouble
        self._notices.append(Notice(kind, text, "warning" if trouble else "info"))
