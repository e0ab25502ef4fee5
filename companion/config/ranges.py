"""What a value may be: checks that name the key, its unit and what would be right."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from companion.types import ConfigError

SCHEMES = ("udpin", "udpout", "tcp")
"""Of MAVLink endpoints over a network, written ``scheme:HOST:PORT``."""
TRANSPORTS = ("tcp", "udp", "tls", "quic", "ws", "serial", "unixsock-stream", "unixpipe", "vsock")
"""Of zenoh endpoints, written ``transport/ADDRESS``."""


def within(key: str, value: float, low: float, high: float, unit: str, why: str = "") -> None:
    """Raise unless ``low`` ≤ ``value`` ≤ ``high``; NaN is outside. ``why`` follows the range."""
    if not low <= value <= high:
        raise ConfigError(f"key '{key}': {unit} between {low:g} and {high:g}{why}, got {value}")


def positive(key: str, value: float, unit: str) -> None:
    """Raise unless ``value`` is finite and above zero."""
    if not 0 < value < math.inf:
        raise ConfigError(f"key '{key}': {unit} above 0, got {value}")


def not_empty(key: str, text: str, what: str) -> None:
    """Raise where ``text`` says nothing."""
    if not text.strip():
        raise ConfigError(f"key '{key}': {what}, got ''")


def rotation(key: str, rows: Sequence[Sequence[float]]) -> None:
    """Raise unless ``rows`` (3, 3) is a rotation: orthonormal to 1e-6, determinant +1."""
    if len(rows) != 3:
        raise ConfigError(f"key '{key}': must have three rows of three numbers")
    for i in range(3):
        for j in range(3):
            dot = sum(a * b for a, b in zip(rows[i], rows[j], strict=True))
            if not abs(dot - (i == j)) <= 1e-6:
                raise ConfigError(f"key '{key}': rows must be orthonormal (a rotation)")
    (a, b, c), (d, e, f), (g, h, i_) = rows
    if a * (e * i_ - f * h) - b * (d * i_ - f * g) + c * (d * h - e * g) < 0:
        raise ConfigError(f"key '{key}': determinant is −1; a rotation has +1 (swap a sign)")


def mavlink_endpoint(key: str, text: str) -> None:
    """Raise unless ``text`` is ``udpin:``, ``udpout:`` or ``tcp:HOST:PORT``, or a serial device."""
    scheme, colon, rest = text.partition(":")
    # A device's path may hold colons of its own: /dev/serial/by-path/pci-0000:00:14.0-usb-0:1
    if text.startswith(("/", "./", "../")) or re.fullmatch(r"COM\d+", text):
        return
    right = "'udpin:HOST:PORT', 'udpout:HOST:PORT', 'tcp:HOST:PORT' or a device such as /dev/ttyS0"
    if not colon or scheme not in SCHEMES:
        raise ConfigError(f"key '{key}': {right}, got '{text}'")
    host, colon, port = rest.rpartition(":")
    whole = bool(colon and host) and (":" not in host or bool(re.fullmatch(r"\[[^\[\]]+\]", host)))
    if not whole or any(c.isspace() for c in host):
        raise ConfigError(
            f"key '{key}': '{scheme}:HOST:PORT' (an IPv6 host in brackets), got '{text}'"
        )
    # Port 0 lets the system choose, which only a listener can use.
    lowest = 0 if scheme == "udpin" else 1
    if not (re.fullmatch(r"[0-9]{1,5}", port) and lowest <= int(port) <= 65535):
        raise ConfigError(f"key '{key}': port between {lowest} and 65535, got '{port}'")


def zenoh_endpoint(key: str, text: str) -> None:
    """Raise unless ``text`` is ``transport/ADDRESS`` with a transport that zenoh has."""
    transport, slash, address = text.partition("/")
    if not (slash and address and transport in TRANSPORTS):
        raise ConfigError(
            f"key '{key}': 'TRANSPORT/ADDRESS' such as 'tcp/127.0.0.1:7447', TRANSPORT one of "
            f"{', '.join(TRANSPORTS)}; got '{text}'"
        )
