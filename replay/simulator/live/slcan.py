"""The adapter's side of slcan, the serial line CAN protocol of Lawicel and its descendants.

Commands end with a carriage return and are answered with one (done) or with a bell (refused):
``Sn`` bit rate, ``O``/``L`` open, ``C`` close, ``V``/``N`` version and serial number, ``F`` flags,
``tIIILDD…``/``TIIIIIIIILDD…`` transmit with an 11- or 29-bit id. Received frames come as the same
lines. Pure: bytes in, bytes out.

Lawicel CANUSB manual, version 1.0D, 2011.
"""

from __future__ import annotations

CR, BELL = b"\r", b"\a"
_BITRATES = dict(
    enumerate((10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000))
)
_LONGEST = 64
"""No command is longer; what is has lost its end."""

Frame = tuple[int, bool, bytes]
"""Identifier, whether it has 29 bits, data."""


def line(frame: Frame) -> bytes:
    """The line that hands a received frame to the computer."""
    can_id, extended, data = frame
    head = f"T{can_id:08X}" if extended else f"t{can_id:03X}"
    return f"{head}{len(data)}{data.hex().upper()}\r".encode()


class SlcanAdapter:
    """An adapter on a bus of ``bitrate``: closed until opened; at another rate it hears nothing."""

    def __init__(self, bitrate: int = 1_000_000) -> None:
        self.bus_bitrate = bitrate
        self.bitrate = 0
        self.is_open = False
        self.closings = 0
        """Times that the channel was closed; a real adapter then drops what it had not sent."""
        self.sent: list[Frame] = []
        """Frames that the computer transmitted; whoever reads them clears them."""
        self.refused = 0
        self._rest = b""

    @property
    def hears(self) -> bool:
        """Whether frames on the bus reach the computer."""
        return self.is_open and self.bitrate == self.bus_bitrate

    def feed(self, data: bytes) -> bytes:
        """Answers to the commands completed by ``data``."""
        *commands, self._rest = (self._rest + data).split(CR)
        self._rest = self._rest[-_LONGEST:]
        return b"".join(self._answer(command) for command in commands)

    def _answer(self, command: bytes) -> bytes:
        answer = self._act(command[:1], command[1:])
        self.refused += answer == BELL
        return answer

    def _act(self, kind: bytes, rest: bytes) -> bytes:
        if kind == b"":
            return CR
        if kind == b"S":
            rate = _BITRATES.get(int(rest)) if rest.isdigit() else None
            if rate is None or self.is_open:
                return BELL
            self.bitrate = rate
            return CR
        if kind in b"OL":
            if self.is_open or not self.bitrate:
                return BELL
            self.is_open = True
            return CR
        if kind == b"C":
            self.is_open = False
            self.closings += 1
            return CR
        if kind in b"VNF":
            return {b"V": b"V1013", b"N": b"NSIM1", b"F": b"F00"}[kind] + CR
        if kind in b"tT" and self.is_open:
            frame = _frame(kind == b"T", rest)
            if frame is not None:
                self.sent.append(frame)
                return (b"Z" if kind == b"T" else b"z") + CR
        return BELL


def _frame(extended: bool, text: bytes) -> Frame | None:
    """A frame from what follows ``t`` or ``T``; None if it is malformed."""
    digits = 8 if extended else 3
    try:
        can_id, length = int(text[:digits], 16), int(text[digits : digits + 1])
        data = bytes.fromhex(text[digits + 1 :].decode("ascii"))
    except ValueError:
        return None
    if length != len(data) or length > 8 or can_id >= 1 << (29 if extended else 11):
        return None
    return can_id, extended, data
