"""The little of HTTP/1.1 that a page on loopback needs: one request head, one answer. Pure.

A page of another site that is open in the same browser must not read a vehicle's position. It can
send requests here, so ``Origin``, where it is given, must be our own; and by DNS rebinding it can
make its own name point here, so ``Host`` must be an address or ``localhost``, never another name.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

HEAD_LIMIT = 8192
"""Bytes of a request's head; browsers send one."""
_REASONS = {200: "OK", 400: "Bad Request", 403: "Forbidden", 404: "Not Found",
            405: "Method Not Allowed", 503: "Service Unavailable"}  # fmt: skip
_SAME = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""The page may load and reach nothing but us."""


class HttpError(Exception):
    """A request that is answered with a status and one line."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status, self.text = status, text


@dataclass(frozen=True, slots=True)
class Request:
    """What of a request matters here."""

    method: str
    path: str
    """Without the query."""


def parse_request(head: bytes) -> Request:
    """The request of a head that ends with an empty line.

    Raises :class:`HttpError` for what is no request, for methods that would change something, and
    for a page of another site.
    """
    try:
        first, *lines = head.decode("ascii").rstrip("\r\n").split("\r\n")
        method, target, version = first.split(" ")
        pairs = [line.split(":", 1) for line in lines]
        fields = {name.lower(): value.strip() for name, value in pairs}
    except (UnicodeDecodeError, ValueError):
        raise HttpError(400, "not an HTTP request") from None
    if not version.startswith("HTTP/1.") or not target.startswith("/"):
        raise HttpError(400, "not an HTTP/1.1 request for a path")
    if method not in ("GET", "HEAD"):
        raise HttpError(405, "only GET and HEAD")
    _own(fields)
    return Request(method, target.split("?", 1)[0])


def _own(fields: Mapping[str, str]) -> None:
    host = fields.get("host", "")
    if not _is_address(host):
        raise HttpError(403, "the Host must be an address or localhost")
    origin = fields.get("origin")
    if origin is not None and origin != f"http://{host}":
        raise HttpError(403, "the Origin is another site")


def _is_address(host: str) -> bool:
    """Whether ``host[:port]`` names a machine without asking a name server."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    if name == "localhost":
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def answer(status: int, kind: str, body: bytes, *, with_body: bool = True) -> bytes:
    """A whole answer, after which the connection is closed."""
    head = _head(status, kind) + f"Content-Length: {len(body)}\r\n\r\n"
    return head.encode("ascii") + (body if with_body else b"")


def stream_head() -> bytes:
    """The beginning of a stream of events; a reader that loses it comes again after 0.5 s."""
    return (_head(200, "text/event-stream") + "\r\nretry: 500\n\n").encode("ascii")


def stream_event(data: bytes) -> bytes:
    """One event; ``data`` in one line, as JSON is."""
    return b"data: " + data + b"\n\n"


def _head(status: int, kind: str) -> str:
    return (
        f"HTTP/1.1 {status} {_REASONS[status]}\r\nContent-Type: {kind}\r\n"
        "Connection: close\r\nCache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n"
        f"Cross-Origin-Resource-Policy: same-origin\r\nContent-Security-Policy: {_SAME}\r\n"
    )
