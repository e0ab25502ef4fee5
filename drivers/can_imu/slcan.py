"""The serial-line CAN protocol (LAWICEL "slcan") of USB adapters: lines to frames and back.

A frame is a line of ASCII that ends in a carriage return: ``t`` or ``T`` (11 or 29 bit), the
identifier in 3 or 8 hexadecimal digits, the number of bytes, the bytes. ``r`` and ``R`` are remote
frames. A bell is an error answer. Some adapters append a time stamp, which is ignored.
LAWICEL CANUSB manual, section 2.
"""

from __future__ import annotations

from collections.abc import Iterable

from drivers.can_imu.decoder import CanFrame

_LONGEST_LINE = 64
_BITRATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
BITRATES = {rate: f"S{i}" for i, rate in enumerate(_BITRATES)}
"""Command that sets each bit rate [bit/s]."""


class SlcanParser:
    """Bytes as they arrive to frames; bad lines are counted and dropped."""

    def __init__(self) -> None:
        self.malformed = 0
        self._rest = b""

    def feed(self, data: bytes) -> list[CanFrame]:
        """The data frames completed by ``data``."""
        lines = (self._rest + data).replace(b"\a", b"\r").split(b"\r")
        self._rest = lines.pop()
        if len(self._rest) > _LONGEST_LINE:
            self.malformed += 1
            self._rest = b""
        frames = []
        for line in lines:
            frame = self._frame(line) if line else None
            if frame is not None:
                frames.append(frame)
        return frames

    def _frame(self, line: bytes) -> CanFrame | None:
        """The frame of a line; None for an answer to a command, and for what is malformed."""
        kind = line[:1]
        if kind == b"T":
            extended, begin, largest = True, 10, 0x1FFFFFFF
        elif kind == b"t":
            extended, begin, largest = False, 5, 0x7FF
        else:
            # Answers to commands and remote frames carry no samples.
            if kind not in (b"r", b"R", b"z", b"Z", b"V", b"N", b"F", b"v"):
                self.malformed += 1
            return None
        try:
            can_id = int(line[1 : begin - 1], 16)
            length = int(line[begin - 1 : begin])
            data = bytes.fromhex(line[begin : begin + 2 * length].decode("ascii"))
        except ValueError:
            self.malformed += 1
            return None
        if len(data) != length or length > 8 or can_id > largest or len(line) > begin + 20:
            self.malformed += 1
            return None
        return CanFrame(can_id, extended, data)


def slcan_line(can_id: int, extended: bool, data: bytes) -> bytes:
    """A data frame as a line."""
    head = f"T{can_id:08X}" if extended else f"t{can_id:03X}"
    return f"{head}{len(data):d}{data.hex().upper()}\r".encode("ascii")


def slcan_lines(frames: Iterable[tuple[int, bool, bytes]]) -> bytes:
    """Several frames in one piece."""
    return b"".join(slcan_line(*frame) for frame in frames)


def opening(bitrate: int, *, listen_only: bool = False) -> bytes:
    """Commands that close the channel, set the bit rate and open it; ``KeyError`` for the rate."""
    return f"C\r{BITRATES[bitrate]}\r{'L' if listen_only else 'O'}\r".encode("ascii")
