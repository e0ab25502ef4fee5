"""CAN buses: open, poll, read and send, without ever blocking.

``slcan`` adapters are read here, a block at a time: python-can reads them byte by byte, which at
1 kHz costs a core. All other interfaces are python-can's; one without a file descriptor gets a
thread that waits for it and a socket pair that says so.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import termios
import threading
import tty
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

from companion.types import ConfigError, LinkLost
from drivers.can_imu.slcan import BITRATES, SlcanParser, opening, slcan_lines

if TYPE_CHECKING:
    import can

Option = str | int | float | bool
_READ = 65_536
_QUEUE = 20_000
"""Frames that wait for a reader that does not come: more than a second of the fastest bus."""


class ReceivedFrame(NamedTuple):
    """A data frame as it came."""

    can_id: int
    extended: bool
    data: bytes
    stamp_ns: int | None
    """Kernel's time of arrival, wall clock [ns]; None where the interface has none."""


class CanTransport(ABC):
    """An open bus. Every method raises :class:`LinkLost` once the adapter is gone."""

    def __init__(self, name: str) -> None:
        self.name = name
        """``interface:channel``, for people."""
        self.malformed = 0
        """Messages of the adapter that were no frame, error frames of the bus included."""
        self.dropped = 0
        """Frames that found the queue full: received and not read, or not sent."""

    @abstractmethod
    def fileno(self) -> int:
        """Becomes readable when there may be something to :meth:`receive`."""

    @abstractmethod
    def receive(self) -> list[ReceivedFrame]:
        """All data frames that are there; never waits."""

    @abstractmethod
    def send(self, frames: Iterable[tuple[int, bool, bytes]]) -> None:
        """Send data frames; those that do not fit at once are dropped and counted."""

    @abstractmethod
    def close(self) -> None:
        """Give the adapter back; never raises, may be called twice."""


def open_can(
    interface: str,
    channel: str,
    bitrate: int = 1_000_000,
    options: Mapping[str, Option] | None = None,
) -> CanTransport:
    """Open a bus. ``options``: further keyword arguments of python-can's bus.

    For ``slcan``: ``tty_baudrate`` (115200) and ``listen_only``. Raises :class:`ConfigError` for an
    interface or option that does not exist and :class:`LinkLost` where the adapter is not there.
    """
    if interface == "slcan":
        return SlcanTransport(channel, bitrate, options or {})
    return PythonCanTransport(interface, channel, bitrate, options or {})


class SlcanTransport(CanTransport):
    """An slcan adapter on a serial device."""

    def __init__(self, channel: str, bitrate: int, options: Mapping[str, Option]) -> None:
        super().__init__(f"slcan:{channel}")
        unknown = set(options) - {"tty_baudrate", "listen_only"}
        if unknown:
            raise ConfigError(f"{self.name}: no option '{min(unknown)}'; tty_baudrate, listen_only")
        if bitrate not in BITRATES:
            raise ConfigError(f"{self.name}: bitrate {bitrate} is none of {sorted(BITRATES)}")
        speed = getattr(termios, f"B{options.get('tty_baudrate', 115_200)}", None)
        if speed is None:
            raise ConfigError(f"{self.name}: tty_baudrate {options['tty_baudrate']} does not exist")
        self._parser = SlcanParser()
        self._unsent = b""
        self._fd = -1
        try:
            self._fd = os.open(channel, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
            tty.setraw(self._fd, termios.TCSANOW)
            settings = termios.tcgetattr(self._fd)
            settings[2] |= termios.CLOCAL | termios.CREAD
            settings[4] = settings[5] = speed
            termios.tcsetattr(self._fd, termios.TCSANOW, settings)
            # What came when nobody read is older than it would seem, and has a gap behind it.
            termios.tcflush(self._fd, termios.TCIFLUSH)
            os.write(self._fd, opening(bitrate, listen_only=bool(options.get("listen_only"))))
        except (OSError, termios.error) as error:
            self.close()
            raise LinkLost(f"{self.name}: {_reason(error)}") from None

    def fileno(self) -> int:
        """Descriptor of the serial device."""
        return self._fd

    def receive(self) -> list[ReceivedFrame]:
        """All frames that the adapter has sent so far; without stamps."""
        frames: list[ReceivedFrame] = []
        while True:
            try:
                data = os.read(self._fd, _READ)
            except BlockingIOError:
                break
            except OSError as error:
                raise LinkLost(f"{self.name}: {_reason(error)}") from None
            if not data:
                raise LinkLost(f"{self.name}: the adapter is gone")
            frames += [ReceivedFrame(*frame, None) for frame in self._parser.feed(data)]
            if len(data) < _READ:
                break
        self.malformed = self._parser.malformed
        return frames

    def send(self, frames: Iterable[tuple[int, bool, bytes]]) -> None:
        """Frames as lines, in one write; of a line that was cut, the rest goes first next time."""
        lines = self._unsent + slcan_lines(frames)
        try:
            sent = os.write(self._fd, lines)
        except BlockingIOError:
            sent = 0
        except OSError as error:
            raise LinkLost(f"{self.name}: {_reason(error)}") from None
        cut = lines[sent - 1 : sent] != b"\r" if sent else bool(self._unsent)
        end = lines.index(b"\r", sent) + 1 if cut else sent
        self._unsent = lines[sent:end]
        self.dropped += lines[end:].count(b"\r")

    def close(self) -> None:
        """Close the channel on the bus and the device."""
        if self._fd >= 0:
            with contextlib.suppress(OSError):
                os.write(self._fd, b"C\r")
            with contextlib.suppress(OSError):
                os.close(self._fd)
            self._fd = -1


class PythonCanTransport(CanTransport):
    """Any interface of python-can."""

    def __init__(
        self, interface: str, channel: str, bitrate: int, options: Mapping[str, Option]
    ) -> None:
        super().__init__(f"{interface}:{channel}")
        self._bus = _python_can_bus(self.name, interface, channel, bitrate, options)
        self._stamped = interface == "socketcan"
        self._reader: _Reader | None = None
        try:
            # -1 is what an interface answers whose descriptor is none.
            self._fd = int(self._bus.fileno())
        except Exception:
            # Back ends are many, plug-ins among them, and refuse each in its own way; whatever it
            # was, a thread reads instead, and a bus that is really gone says so at the first read.
            self._fd = -1
        if self._fd < 0:
            self._reader = _Reader(self._bus)
            self._fd = self._reader.fileno()

    def fileno(self) -> int:
        """Descriptor of the bus, or of the thread's end of the pair."""
        return self._fd

    def receive(self) -> list[ReceivedFrame]:
        """All data frames; ``socketcan`` stamps them with the kernel's wall clock."""
        import can

        frames: list[ReceivedFrame] = []
        while True:
            try:
                message = self._reader.next() if self._reader else self._bus.recv(timeout=0)
            except ValueError:
                self.malformed += 1
                continue
            except (can.CanError, OSError) as error:
                raise LinkLost(f"{self.name}: {_reason(error)}") from None
            if message is None:
                break
            if message.is_error_frame:
                self.malformed += 1
            elif not message.is_remote_frame:
                stamp = round(message.timestamp * 1e9) if self._stamped else None
                data = bytes(message.data)
                extended = bool(message.is_extended_id)
                frames.append(ReceivedFrame(message.arbitration_id, extended, data, stamp))
        if self._reader:
            self.dropped = self._reader.dropped
        return frames

    def send(self, frames: Iterable[tuple[int, bool, bytes]]) -> None:
        """Frame by frame; a full queue of the interface drops."""
        import can

        for can_id, extended, data in frames:
            message = can.Message(
                arbitration_id=can_id, is_extended_id=extended, data=data, is_fd=len(data) > 8
            )
            try:
                self._bus.send(message, timeout=0)
            except can.CanTimeoutError:
                self.dropped += 1
            except (can.CanError, OSError) as error:
                if getattr(error, "error_code", None) == errno.ENOBUFS:
                    self.dropped += 1
                    continue
                raise LinkLost(f"{self.name}: {_reason(error)}") from None

    def close(self) -> None:
        """Stop the thread, if any, and shut the bus down."""
        if self._reader:
            self._reader.close()
        with contextlib.suppress(Exception):
            self._bus.shutdown()


def _python_can_bus(
    name: str, interface: str, channel: str, bitrate: int, options: Mapping[str, Option]
) -> can.BusABC:
    import can

    arguments: dict[str, Any] = {"bitrate": bitrate, **options}
    try:
        return can.Bus(channel, interface, ignore_config=True, **arguments)
    except NotImplementedError as error:
        raise ConfigError(f"{name}: {_reason(error)}") from None
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name}: options do not fit the interface: {_reason(error)}") from None
    except (can.CanError, OSError) as error:
        raise LinkLost(f"{name}: {_reason(error)}") from None


class _Reader:
    """Waits for a bus that cannot be polled."""

    def __init__(self, bus: can.BusABC) -> None:
        self.dropped = 0
        self._bus = bus
        self._waiting: deque[can.Message] = deque()
        self._failed: Exception | None = None
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._theirs.setblocking(False)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="can-reader", daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        return self._ours.fileno()

    def next(self) -> can.Message | None:
        """The oldest message that waits; raises what the bus raised, once all were read."""
        if not self._waiting:
            # Emptied before the queue is looked at again, so that no message waits without a sign.
            with contextlib.suppress(BlockingIOError):
                while self._ours.recv(4096):
                    pass
        if self._waiting:
            return self._waiting.popleft()
        if self._failed is not None:
            raise self._failed
        return None

    def close(self) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0)
        self._ours.close()
        self._theirs.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                message = self._bus.recv(timeout=0.1)
            except ValueError:
                continue
            except Exception as error:
                self._failed = error if isinstance(error, OSError) else OSError(str(error))
                self._sign()
                return
            if message is None:
                continue
            if len(self._waiting) >= _QUEUE:
                self.dropped += 1
                continue
            self._waiting.append(message)
            self._sign()

    def _sign(self) -> None:
        # A full pair says that there is something, too.
        with contextlib.suppress(OSError):
            self._theirs.send(b"\0")


def _reason(error: BaseException) -> str:
    """What went wrong, on one line."""
    text = getattr(error, "strerror", None) or str(error) or type(error).__name__
    return " ".join(str(text).split())
