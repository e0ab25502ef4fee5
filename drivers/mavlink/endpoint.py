"""Transports of MAVLink bytes: UDP, TCP and serial devices, none of which ever blocks.

An endpoint is opened, read, written and closed by one owner, which also waits for its descriptor
and opens it again after :class:`~companion.types.LinkLost`. Bytes are neither parsed nor changed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
from abc import ABC, abstractmethod
from typing import Any, Protocol

from companion.types import ConfigError, LinkLost
from drivers.mavlink.serial_port import close_serial, open_serial

READ_BYTES = 65_536
"""More than the largest datagram."""
_READS = 64
"""Datagrams taken by one call: a flood on one link must not starve the others."""
_BUFFER_BYTES = 1 << 20
"""Kernel buffer of received datagrams: a second of a fast link."""
_PEERS = 4
"""Senders that a listening socket answers: a stranger cannot push out the autopilot."""
_NOTHING_NOW = (errno.EAGAIN, errno.EWOULDBLOCK, errno.EINTR)
_NOBODY_THERE = (*_NOTHING_NOW, errno.ECONNREFUSED, errno.ENETUNREACH, errno.EHOSTUNREACH)
"""What a datagram socket says of a peer that is not there now: no reason to close it."""

_FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or a serial device such as /dev/ttyACM0"


class Endpoint(Protocol):
    """An open link."""

    name: str
    datagrams: bool
    """Pieces are whole datagrams, not parts of a stream."""

    def connected(self) -> bool:
        """False only while a connection is being made; raises :class:`LinkLost` if refused."""

    def fileno(self) -> int:
        """Descriptor to wait on for reading."""

    def read(self) -> list[bytes]:
        """Datagrams, or pieces of a stream, that are there now; empty if there are none.

        Raises :class:`LinkLost` when the device or connection is gone.
        """

    def write(self, data: bytes) -> bool:
        """Send one frame; False where it had to be dropped. Never blocks, never raises."""

    def close(self) -> None:
        """Give the descriptor back; safe to repeat."""


class _UdpIn:
    """Listens; answers those it heard from, the last few of them."""

    datagrams = True

    def __init__(self, name: str, address: tuple[str, int]) -> None:
        self.name = name
        self._socket = _bound(name, address)
        self._peers: dict[tuple[Any, ...], None] = {}

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens: with port 0 asked for, the one that was given."""
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        found: list[bytes] = []
        for _ in range(_READS):
            try:
                data, peer = self._socket.recvfrom(READ_BYTES)
            except OSError as error:
                if error.errno in _NOBODY_THERE:
                    break
                raise LinkLost(f"{self.name}: {error.strerror}") from None
            if data:
                self._hear(peer)
                found.append(data)
        return found

    def connected(self) -> bool:
        return True

    def _hear(self, peer: tuple[Any, ...]) -> None:
        self._peers.pop(peer, None)
        self._peers[peer] = None
        if len(self._peers) > _PEERS:
            del self._peers[next(iter(self._peers))]

    def write(self, data: bytes) -> bool:
        sent = False
        for peer in self._peers:
            with contextlib.suppress(OSError):
                self._socket.sendto(data, peer)
                sent = True
        return sent

    def close(self) -> None:
        self._socket.close()


class _UdpOut:
    """Sends to one address and takes what comes from there."""

    datagrams = True

    def __init__(self, name: str, address: tuple[str, int]) -> None:
        self.name = name
        family, to = _resolved(name, address, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
            self._socket.connect(to)
        except OSError as error:
            self._socket.close()
            raise LinkLost(f"{name}: {error.strerror}") from None

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        found: list[bytes] = []
        for _ in range(_READS):
            try:
                data = self._socket.recv(READ_BYTES)
            except OSError as error:
                if error.errno in _NOBODY_THERE:
                    break
                raise LinkLost(f"{self.name}: {error.strerror}") from None
            if data:
                found.append(data)
        return found

    def connected(self) -> bool:
        return True

    def write(self, data: bytes) -> bool:
        try:
            return self._socket.send(data) == len(data)
        except OSError:
            return False

    def close(self) -> None:
        self._socket.close()


class _Stream(ABC):
    """A byte stream on a non-blocking descriptor. What a write leaves over goes out first."""

    datagrams = False

    def __init__(self, name: str) -> None:
        self.name = name
        self._rest = b""

    @abstractmethod
    def fileno(self) -> int: ...

    def connected(self) -> bool:
        return True

    @abstractmethod
    def _receive(self) -> bytes: ...

    @abstractmethod
    def _send(self, data: bytes) -> int: ...

    def read(self) -> list[bytes]:
        try:
            data = self._receive()
        except OSError as error:
            if error.errno in _NOTHING_NOW:
                return []
            raise LinkLost(f"{self.name}: {error.strerror}") from None
        if not data:
            raise LinkLost(f"{self.name}: closed by the other side")
        return [data]

    def write(self, data: bytes) -> bool:
        # A frame that is begun is finished before the next: the other side stays in step.
        try:
            if self._rest:
                self._rest = self._rest[self._send(self._rest) :]
                if self._rest:
                    return False
            sent = self._send(data)
        except OSError:
            return False
        self._rest = data[sent:] if sent else b""
        return sent > 0


class _Tcp(_Stream):
    """A client. Opening returns at once; a refused connection shows at the first read."""

    def __init__(self, name: str, address: tuple[str, int]) -> None:
        super().__init__(name)
        family, to = _resolved(name, address, socket.SOCK_STREAM)
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        code = self._socket.connect_ex(to)
        if code not in (0, errno.EINPROGRESS):
            self._socket.close()
            raise LinkLost(f"{name}: {os.strerror(code)}")

    def fileno(self) -> int:
        return self._socket.fileno()

    def _receive(self) -> bytes:
        return self._socket.recv(READ_BYTES)

    def _send(self, data: bytes) -> int:
        return self._socket.send(data)

    def read(self) -> list[bytes]:
        if not self.connected():
            return []
        return super().read()

    def connected(self) -> bool:
        try:
            self._socket.getpeername()
        except OSError:
            code = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
            if code:
                raise LinkLost(f"{self.name}: {os.strerror(code)}") from None
            return False
        return True

    def close(self) -> None:
        self._socket.close()


class _Serial(_Stream):
    """A serial device, or anything that behaves as a terminal."""

    def __init__(self, name: str, device: str, baud: int) -> None:
        super().__init__(name)
        self._fd = open_serial(device, baud)

    def fileno(self) -> int:
        return self._fd

    def _receive(self) -> bytes:
        return os.read(self._fd, READ_BYTES)

    def _send(self, data: bytes) -> int:
        return os.write(self._fd, data)

    def close(self) -> None:
        if self._fd >= 0:
            close_serial(self._fd)
            self._fd = -1


def _resolved(name: str, address: tuple[str, int], kind: int) -> tuple[int, tuple[str, int]]:
    """(family, address) of a host. Names are looked up, which may take time: prefer numbers."""
    try:
        found = socket.getaddrinfo(*address, type=kind)
    except OSError as error:
        raise LinkLost(f"{name}: {error.strerror}") from None
    family, _, _, _, to = found[0]
    return family, (str(to[0]), int(to[1]))


def _bound(name: str, address: tuple[str, int]) -> socket.socket:
    family, at = _resolved(name, address, socket.SOCK_DGRAM)
    listener = socket.socket(family, socket.SOCK_DGRAM)
    try:
        listener.setblocking(False)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        listener.bind(at)
    except OSError as error:
        listener.close()
        raise LinkLost(f"{name}: {error.strerror}") from None
    return listener


def _host_port(text: str, rest: str) -> tuple[str, int]:
    host, _, port = rest.rpartition(":")
    if not host or not port.isdigit() or int(port) > 65_535:
        raise ConfigError(f"endpoint '{text}': a host and a port are needed, as in {_FORMS}")
    return host.strip("[]"), int(port)


def open_endpoint(text: str, baud: int = 921_600) -> Endpoint:
    """Open ``udpin:``, ``udpout:``, ``tcp:`` with host and port, or a serial device at ``baud``.

    ``udp:`` is ``udpin:``, as in pymavlink; a device may be followed by its own ``,BAUD``. Raises
    :class:`ConfigError` for text that names no endpoint and :class:`LinkLost` for one that cannot
    be opened now.
    """
    kind, colon, rest = text.partition(":")
    if colon and kind in ("udpin", "udp"):
        return _UdpIn(text, _host_port(text, rest))
    if colon and kind == "udpout":
        return _UdpOut(text, _host_port(text, rest))
    if colon and kind == "tcp":
        return _Tcp(text, _host_port(text, rest))
    device, comma, own = text.partition(",")
    if not device.startswith("/") or (comma and not own.isdigit()):
        raise ConfigError(f"endpoint '{text}': not one of {_FORMS}")
    return _Serial(text, device, int(own) if comma else baud)
