"""A serial device as a raw, non-blocking descriptor, by the terminal interface of POSIX."""

from __future__ import annotations

import contextlib
import fcntl
import os
import termios

from companion.types import ConfigError, LinkLost

_SPEEDS = {
    int(name[1:]): int(getattr(termios, name))
    for name in dir(termios)
    if name.startswith("B") and name[1:].isdigit() and int(name[1:]) > 0
}


def open_serial(device: str, baud: int) -> int:
    """Descriptor of ``device`` at ``baud``: 8 data bits, no parity, no flow control, no echo.

    The device is taken for this process alone. Raises :class:`ConfigError` for a speed that the
    system does not know and :class:`LinkLost` for a device that cannot be opened.
    """
    if baud not in _SPEEDS:
        near = ", ".join(str(b) for b in sorted(_SPEEDS, key=lambda b: abs(b - baud))[:3])
        raise ConfigError(f"endpoint '{device}': no serial speed of {baud} baud; near: {near}")
    try:
        fd = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        raise LinkLost(f"{device}: {error.strerror}") from None
    try:
        _make_raw(fd, _SPEEDS[baud])
        fcntl.ioctl(fd, termios.TIOCEXCL)
    except (OSError, termios.error) as error:
        close_serial(fd)
        raise LinkLost(f"{device}: {error.args[-1]}") from None
    return fd


def _make_raw(fd: int, speed: int) -> None:
    """Bytes as they are; the line's modem signals are ignored."""
    _, _, cflag, _, _, _, control = termios.tcgetattr(fd)
    cflag &= ~(termios.CSIZE | termios.PARENB | termios.CSTOPB | termios.CRTSCTS)
    cflag |= termios.CS8 | termios.CREAD | termios.CLOCAL
    # With at least one byte asked for, "nothing there" and "gone" read differently.
    control[termios.VMIN], control[termios.VTIME] = 1, 0
    termios.tcsetattr(fd, termios.TCSANOW, [0, 0, cflag, 0, speed, speed, control])
    termios.tcflush(fd, termios.TCIFLUSH)


def close_serial(fd: int) -> None:
    """Give the device back, also to others; never raises."""
    with contextlib.suppress(OSError):
        fcntl.ioctl(fd, termios.TIOCNXCL)
    with contextlib.suppress(OSError):
        os.close(fd)
