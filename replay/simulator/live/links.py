"""The simulated vehicle's transports: a UDP socket, and a pseudo-terminal that is unplugged."""

from __future__ import annotations

import os
import pty
import socket
import tty
from contextlib import suppress
from pathlib import Path

from companion.types import CompanionError

_MOST = 65_536
_ADAPTER_BYTES = 65_536
"""A USB adapter and its driver hold about this much; a pseudo-terminal only 4 kB."""


def parse_endpoint(text: str) -> tuple[bool, tuple[str, int]]:
    """Whether ``text`` listens (``udpin:``), and its address; :class:`CompanionError` otherwise."""
    kind, _, address = text.partition(":")
    host, _, port = address.rpartition(":")
    if kind not in ("udpin", "udpout") or not host or not port.isdigit() or int(port) > 65535:
        raise CompanionError(f"'{text}': udpin:HOST:PORT or udpout:HOST:PORT")
    return kind == "udpin", (host, int(port))


class UdpLink:
    """One UDP endpoint: answers whoever spoke last, or sends to the address it was given."""

    def __init__(self, endpoint: str) -> None:
        self._listens, self._address = parse_endpoint(endpoint)
        self._peer: tuple[str, int] | None = None if self._listens else self._address
        self._socket: socket.socket | None = None
        self.dropped = 0
        self.open()

    @property
    def endpoint(self) -> str:
        """What the other side has to use; the port is known once it was open."""
        kind = "udpout" if self._listens else "udpin"
        return f"{kind}:{self._address[0]}:{self._address[1]}"

    def open(self) -> None:
        """Open the socket if it is closed; a listening one keeps its port."""
        if self._socket is not None:
            return
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        if self._listens:
            try:
                self._socket.bind(self._address)
            except OSError as error:
                host, port = self._address
                raise CompanionError(f"udpin:{host}:{port}: {error.strerror}") from None
            self._address = self._socket.getsockname()[:2]

    def close(self) -> None:
        """Close the socket; a listening one forgets who spoke."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            self._peer = None if self._listens else self._address

    def fileno(self) -> int | None:
        """The socket's descriptor; None while it is closed."""
        return None if self._socket is None else self._socket.fileno()

    def read(self) -> list[bytes]:
        """All datagrams that are there."""
        out: list[bytes] = []
        while self._socket is not None:
            try:
                data, peer = self._socket.recvfrom(_MOST)
            except BlockingIOError:
                break
            except ConnectionError:
                continue  # nobody listened to what was sent before
            self._peer = peer
            out.append(data)
        return out

    def write(self, datagrams: list[bytes]) -> None:
        """Send; what cannot go at once is dropped and counted."""
        if self._socket is None or self._peer is None:
            return
        for data in datagrams:
            try:
                self._socket.sendto(data, self._peer)
            except OSError:
                self.dropped += 1


class Plug:
    """A serial device at a path: a link to a pseudo-terminal that can be pulled and put back.

    The device's own name changes from plug to plug, as a real adapter's does; the path does not.
    """

    def __init__(self, path: Path, holds: int = _ADAPTER_BYTES) -> None:
        """``holds``: bytes that wait for a computer that does not take them."""
        self.path = path
        self._holds = holds
        self.dropped_bytes = 0
        self._waiting = b""
        self._master: int | None = None
        self._slave = -1
        self.put_in()

    def put_in(self) -> None:
        """Make the terminal and the link to it, unless it is there."""
        if self._master is not None:
            return
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        spare = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            spare.unlink(missing_ok=True)
            spare.symlink_to(os.ttyname(self._slave))
            spare.replace(self.path)
        except OSError as error:
            raise CompanionError(f"{self.path}: cannot be made: {error.strerror}") from None

    def pull(self) -> None:
        """Hang up on whoever has it open, and take the path away."""
        if self._master is None:
            return
        os.close(self._master)
        os.close(self._slave)
        self._master = None
        self._waiting = b""
        with suppress(OSError):
            self.path.unlink(missing_ok=True)

    def fileno(self) -> int | None:
        """The adapter's end; None while it is unplugged."""
        return self._master

    def read(self) -> bytes:
        """What the computer wrote, possibly nothing."""
        if self._master is None:
            return b""
        with suppress(BlockingIOError):
            return os.read(self._master, _MOST)
        return b""

    def drop_waiting(self) -> None:
        """Forget what the computer has not taken yet."""
        self._waiting = b""

    def write(self, data: bytes) -> None:
        """Hand bytes to the computer; what it does not take yet waits in the adapter.

        A full adapter drops the new, and counts.
        """
        if self._master is None:
            return
        if len(self._waiting) + len(data) <= self._holds:
            self._waiting += data
        else:
            self.dropped_bytes += len(data)
        if self._waiting:
            with suppress(BlockingIOError):
                self._waiting = self._waiting[os.write(self._master, self._waiting) :]
