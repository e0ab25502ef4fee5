"""The live page's server over loopback, without a browser."""

from __future__ import annotations

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest

from companion.types import NS, CompanionError
from companion.watch.web import http
from companion.watch.web.model import PageModel
from companion.watch.web.server import READERS, LiveServer
from tests.outputs.zenoh_help import PATIENCE_S, free_port
from tests.watch.test_watch_command import publishing
from tests.watch.test_web_model import at, flown, state


def head(*fields: str, first: str = "GET / HTTP/1.1") -> bytes:
    return "\r\n".join([first, *fields, "", ""]).encode()


@pytest.mark.parametrize(
    "host", ["127.0.0.1:8470", "localhost:1", "[::1]:8470", "192.168.1.9", "10.0.0.1:80"]
)
def test_addresses_and_localhost_are_answered(host: str) -> None:
    request = http.parse_request(head(f"Host: {host}", f"Origin: http://{host}"))
    assert (request.method, request.path) == ("GET", "/")


@pytest.mark.parametrize(
    ("status", "raw"),
    [
        (403, head("Host: evil.example:8470")),
        (403, head("Host: 127.0.0.1.evil.example")),
        (403, head("Host: localhost@evil.example/")),
        (403, head()),
        (403, head("Host: [::1")),
        (403, head("Host: 127.0.0.1:1", "Origin: http://evil.example")),
        (403, head("Host: 127.0.0.1:1", "Origin: http://127.0.0.1:2")),
        (403, head("Host: 127.0.0.1:1", "Origin: null")),
        (405, head("Host: localhost", first="POST / HTTP/1.1")),
        (400, head("Host: localhost", first="GET http://x/ HTTP/1.1")),
        (400, head("Host: localhost", first="GET /")),
        (400, head("no colon")),
        (400, b"\x16\x03\x01\x02\x00\r\n\r\n"),
    ],
)
def test_others_are_refused(status: int, raw: bytes) -> None:
    with pytest.raises(http.HttpError) as refused:
        http.parse_request(raw)
    assert refused.value.status == status


@asynccontextmanager
async def serving(model: PageModel) -> AsyncIterator[tuple[LiveServer, int]]:
    server = LiveServer(model)
    port = await server.open("127.0.0.1", 0)
    try:
        yield server, port
    finally:
        await server.close()


async def ask(port: int, raw: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(raw)
    reply = await asyncio.wait_for(reader.read(), PATIENCE_S)
    writer.close()
    return reply


def test_the_page_is_whole_and_closed_to_other_sites() -> None:
    async def scene() -> None:
        async with serving(flown(1)) as (_, port):
            host = f"Host: 127.0.0.1:{port}"
            reply = await ask(port, head(host))
            top, body = reply.split(b"\r\n\r\n", 1)
            assert top.startswith(b"HTTP/1.1 200 OK")
            assert b"default-src 'none'" in top
            for name in ("live.js", "parts.js", "plotting.js", "uPlot.js", "live.css", "uPlot.css"):
                assert f'"/{name}"'.encode() in body
                found = await ask(port, head(host, first=f"GET /{name} HTTP/1.1"))
                assert found.startswith(b"HTTP/1.1 200"), name
            assert (await ask(port, head(host, first="GET /../x HTTP/1.1")))[9:12] == b"404"
            assert (await ask(port, b"x" * (http.HEAD_LIMIT + 10)))[9:12] == b"400"
            only_head = await ask(port, head(host, first="HEAD / HTTP/1.1"))
            assert only_head.endswith(b"\r\n\r\n")

    asyncio.run(scene())


class Page:
    """A reader of the stream."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    @classmethod
    async def open(cls, port: int) -> Page:
        reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 24)
        writer.write(head(f"Host: 127.0.0.1:{port}", first="GET /stream HTTP/1.1"))
        await asyncio.wait_for(reader.readuntil(b"retry: 500\n\n"), PATIENCE_S)
        return cls(reader, writer)

    async def frame(self) -> dict[str, Any]:
        line = await asyncio.wait_for(self.reader.readuntil(b"\n\n"), PATIENCE_S)
        frame: dict[str, Any] = json.loads(line.removeprefix(b"data: "))
        return frame


def test_two_readers_get_frames_and_a_third_everything() -> None:
    async def scene() -> None:
        model = flown(2)
        async with serving(model) as (server, port):
            pages = [await Page.open(port), await Page.open(port)]
            server.send(0.0)
            first = [await page.frame() for page in pages]
            assert first[0] == first[1]
            assert first[0]["vehicles"]["v1"]["anew"]
            model.tick(10 * NS)
            server.send(0.2)
            assert [len((await p.frame())["vehicles"]["v1"]["rows"]) for p in pages] == [1, 1]
            late = await Page.open(port)
            server.send(0.4)
            assert len((await late.frame())["vehicles"]["v1"]["rows"]) == 11

    asyncio.run(scene())


def test_a_reader_that_does_not_read_is_passed_over_then_let_go() -> None:
    """It costs the server one frame of memory, and others nothing."""

    async def scene() -> None:
        model = flown(1)
        async with serving(model) as (server, port):
            stuck, good = await Page.open(port), await Page.open(port)
            sock: socket.socket = stuck.writer.get_extra_info("socket")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            stuck.reader._transport.pause_reading()  # type: ignore[attr-defined]
            largest, got = 0, 0
            for k in range(300):
                for i in range(20):
                    model.update(at(state(40 * k + i), NS * (1000 + k), f"vehicle {i}"))
                model.tick(NS * (1000 + k))
                server.send(0.01 * k)
                got = (await good.frame())["tick"]
                (held,) = [
                    r.writer.transport.get_write_buffer_size()
                    for r in server._readers
                    if r.writer.get_extra_info("peername") == sock.getsockname()
                ]
                largest = max(largest, held)
            assert got == 5 + 300
            assert 0 < largest < 1_000_000  # one frame, however many were made
            for k in range(5):
                server.send(3.0 + 10.0 * k)
                await good.frame()
                await asyncio.sleep(0)
            async with asyncio.timeout(PATIENCE_S):
                while len(server._readers) > 1:
                    await asyncio.sleep(0.01)

    asyncio.run(scene())


def test_too_many_pages_are_refused_and_places_become_free() -> None:
    async def scene() -> None:
        async with serving(flown(1)) as (server, port):
            pages = [await Page.open(port) for _ in range(READERS)]
            request = head(f"Host: 127.0.0.1:{port}", first="GET /stream HTTP/1.1")
            assert (await ask(port, request))[9:12] == b"503"
            pages[0].writer.close()
            async with asyncio.timeout(PATIENCE_S):
                while len(server._readers) == READERS:
                    await asyncio.sleep(0.01)
            await Page.open(port)

    asyncio.run(scene())


def test_a_port_that_is_taken_is_one_line() -> None:
    async def scene() -> None:
        async with serving(flown(1)) as (_, port):
            with pytest.raises(CompanionError, match=f"127.0.0.1:{port}: .*--port"):
                await LiveServer(flown(1)).open("127.0.0.1", port)

    asyncio.run(scene())


def test_the_command_serves_what_is_published_and_ends_with_an_interrupt() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-u", "-m", "companion", "watch", "--web", "--port", "0"]
    with (
        publishing(endpoint, "boat"),
        subprocess.Popen(
            [*command, "--connect", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        ) as run,
    ):  # fmt: skip
        assert run.stdout is not None
        first = run.stdout.readline()
        assert first.startswith("Page      http://127.0.0.1:")
        port = int(first.rstrip("/\n").rpartition(":")[2])

        async def navigating() -> None:
            page = await Page.open(port)
            while True:
                vehicles = (await page.frame())["vehicles"]
                if vehicles.get("boat", {}).get("now", {}).get("is") == "navigating":
                    return

        asyncio.run(asyncio.wait_for(navigating(), PATIENCE_S))
        run.terminate()
        _, err = run.communicate(timeout=PATIENCE_S)
    assert run.returncode == 0
    assert "Traceback" not in err
