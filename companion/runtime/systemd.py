"""Telling systemd how the process is: ready, alive, stopping. Silent where there is no systemd.

sd_notify(3): datagrams of ``KEY=value`` lines to the socket that ``NOTIFY_SOCKET`` names.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping
from contextlib import suppress


class Notifier:
    """Sends the service's state; never blocks, never raises."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket: socket.socket | None = None
        # A leading @ stands for Linux's abstract namespace.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self.watchdog_ns = _watchdog_ns(environment)
        """Feed the watchdog at least this often; 0: there is none."""

    def ready(self) -> None:
        """The first start is over: units that wait for this one may start."""
        self._send("READY=1")

    def alive(self) -> None:
        """Feed the watchdog."""
        if self.watchdog_ns:
            self._send("WATCHDOG=1")

    def status(self, text: str) -> None:
        """One line for ``systemctl status``."""
        self._send("STATUS=" + " ".join(text.split()))

    def stopping(self) -> None:
        """A clean end has begun."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.sendto(text.encode(), self._address)


def _watchdog_ns(environment: Mapping[str, str]) -> int:
    """Half of the watchdog's time, if it is meant for this process."""
    try:
        microseconds = int(environment.get("WATCHDOG_USEC", "0"))
        owner = int(environment.get("WATCHDOG_PID", str(os.getpid())))
    except ValueError:
        return 0
    return microseconds * 1000 // 2 if microseconds > 0 and owner == os.getpid() else 0
