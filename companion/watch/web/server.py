"""Serves the page and its stream of events on one port, with nothing but asyncio.

A browser that does not read as fast as we write is passed over until it has: its next frame is then
the latest, with what it lacks. One that takes nothing for :data:`STUCK_S` is let go.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import resources

from companion.outputs.subscriber import Subscriber
from companion.types import NS, CompanionError
from companion.watch.web import http
from companion.watch.web.model import TICK_S, Cursor, PageModel

READERS = 16
"""Pages at a time."""
NOBODY = "nobody listens there; tried again and again"
STUCK_S = 20.0
HEAD_S = 5.0
"""Within which a request's head must be here."""
_HTML, _SCRIPT, _STYLE = "text/html; charset=utf-8", "text/javascript", "text/css"
_PAGE = {
    "/": ("companion.watch.web", "live.html", _HTML),
    "/live.js": ("companion.watch.web", "live.js", _SCRIPT),
    "/parts.js": ("companion.watch.web", "parts.js", _SCRIPT),
    "/live.css": ("companion.watch.web", "live.css", _STYLE),
    "/plotting.js": ("replay.report", "plotting.js", _SCRIPT),
    "/report.css": ("replay.report", "report.css", _STYLE),
    "/uPlot.js": ("replay.report", "uPlot.iife.min.js", _SCRIPT),
    "/uPlot.css": ("replay.report", "uPlot.min.css", _STYLE),
}


@dataclass(eq=False, slots=True)
class _Reader:
    writer: asyncio.StreamWriter
    gone: asyncio.Event = field(default_factory=asyncio.Event)
    cursor: Cursor = field(default_factory=Cursor)
    free_at: float = 0.0
    """When it last had taken everything."""


class LiveServer:
    """The page of everything that a model knows."""

    def __init__(self, model: PageModel) -> None:
        self._model = model
        self._readers: set[_Reader] = set()
        self._server: asyncio.Server | None = None
        self._files = {
            path: (kind, (resources.files(package) / "assets" / name).read_bytes())
            for path, (package, name, kind) in _PAGE.items()
        }

    async def open(self, host: str, port: int) -> int:
        """Listen; the port, which for 0 is a free one. :class:`CompanionError` when it is taken."""
        try:
            self._server = await asyncio.start_server(
                self._serve, host, port, limit=http.HEAD_LIMIT
            )
        except OSError as error:
            raise CompanionError(
                f"{host}:{port}: {error.strerror or error}; choose another --port or --bind"
            ) from None
        bound: int = self._server.sockets[0].getsockname()[1]
        return bound

    async def close(self) -> None:
        """Let every reader go."""
        if self._server is not None:
            self._server.close()
        for reader in self._readers:
            reader.gone.set()
            reader.writer.transport.abort()

    def send(self, now_s: float) -> None:
        """Give every reader that has taken its last frame the next one."""
        made: dict[Cursor, tuple[bytes, Cursor]] = {}
        for reader in self._readers:
            if reader.writer.transport.get_write_buffer_size():
                if now_s - reader.free_at > STUCK_S:
                    reader.gone.set()
                continue
            reader.free_at = now_s
            before = reader.cursor
            if before not in made:
                frame, after = self._model.frame(before)
                made[before] = http.stream_event(frame), after
            event, reader.cursor = made[before]
            reader.writer.write(event)

    # ------------------------------------------------------------------ one connection

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ConnectionError, TimeoutError, asyncio.IncompleteReadError):
            await self._answer(reader, writer)
        # Not closed: a reader that is stuck would never take the rest.
        writer.transport.abort()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            async with asyncio.timeout(HEAD_S):
                head = await reader.readuntil(b"\r\n\r\n")
            request = http.parse_request(head)
            if request.path == "/stream" and request.method == "GET":
                await self._stream(reader, writer)
                return
            kind, body = self._file(request.path)
            reply = http.answer(200, kind, body, with_body=request.method == "GET")
        except asyncio.LimitOverrunError:
            reply = http.answer(400, "text/plain", b"the request's head is too long\n")
        except http.HttpError as error:
            reply = http.answer(error.status, "text/plain", f"{error.text}\n".encode())
        writer.write(reply)
        async with asyncio.timeout(STUCK_S):
            await writer.drain()
            writer.close()
            await writer.wait_closed()

    def _file(self, path: str) -> tuple[str, bytes]:
        if path not in self._files:
            raise http.HttpError(404, "there is no such page")
        return self._files[path]

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Until the reader goes away; frames are written by :meth:`send`."""
        if len(self._readers) >= READERS:
            raise http.HttpError(503, f"{READERS} pages are open already")
        mine = _Reader(writer, free_at=time.monotonic())
        writer.write(http.stream_head())
        self._readers.add(mine)
        try:
            gone = asyncio.create_task(mine.gone.wait())
            closed = asyncio.create_task(_until_closed(reader))
            await asyncio.wait({gone, closed}, return_when=asyncio.FIRST_COMPLETED)
            gone.cancel()
            closed.cancel()
        finally:
            self._readers.discard(mine)


async def _until_closed(reader: asyncio.StreamReader) -> None:
    """What a reader still says is thrown away."""
    with suppress(ConnectionError):
        while await reader.read(4096):
            pass


async def serve_page(
    server: LiveServer, model: PageModel, subscriber: Subscriber, stop: asyncio.Event
) -> None:
    """Feed the model and send frames until ``stop``; ``server`` is open, and is closed here.

    Messages wait in the subscriber's queue, with their times, until the next frame is made.
    """
    due = time.monotonic()
    try:
        while not stop.is_set():
            for heard in subscriber.take(0.0):
                model.update(heard)
            model.tick(time.monotonic_ns(), "" if subscriber.link.live is not None else NOBODY)
            server.send(time.monotonic())
            due = max(due + TICK_S, time.monotonic())
            with suppress(TimeoutError):
                await asyncio.wait_for(stop.wait(), due - time.monotonic())
    finally:
        await server.close()


def new_model() -> PageModel:
    """An empty model of this moment."""
    now_ns = time.monotonic_ns()
    return PageModel(f"{now_ns / NS:.6f}", now_ns)
