"""Frames out of bytes as they come: halves wait, what is no frame is counted and dropped.

For protocols whose frame begins with a mark, says its length in its head and ends with a check:
UBX, RTCM 3. Half a mark at the end of what came is kept, too.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar, Generic, TypeVar

FrameT = TypeVar("FrameT")


class Framer(ABC, Generic[FrameT]):
    """Keeps the beginning of a frame until the rest comes."""

    MARK: ClassVar[bytes]
    HEAD: ClassVar[int]
    """Bytes, with the mark, that tell how long the frame is."""

    def __init__(self) -> None:
        self.frames = 0
        self.bad = 0
        """Frames with a wrong check."""
        self.skipped = 0
        """Bytes of no frame: other protocols, noise, what is left of bad frames."""
        self._held = bytearray()

    @abstractmethod
    def length(self, head: bytes) -> int | None:
        """Length of the whole frame with this head, check and all; None: no frame begins so."""

    @abstractmethod
    def frame(self, whole: bytes) -> FrameT | None:
        """What a whole frame carries; None where its check is wrong."""

    def feed(self, data: bytes) -> Iterator[FrameT]:
        """Every frame that ``data`` completes."""
        held = self._held
        held += data
        while self._to_mark():
            length = self.length(bytes(held[: self.HEAD]))
            if length is not None and len(held) < length:
                return
            found = None if length is None else self.frame(bytes(held[:length]))
            if found is None:
                # Perhaps the mark stood in something else: look again behind it.
                self.bad += length is not None
                self._drop(len(self.MARK))
                continue
            self.frames += 1
            del held[:length]
            yield found

    def _to_mark(self) -> bool:
        """Drop what is in front of the next mark; whether a whole head is there."""
        held, mark = self._held, self.MARK
        at = held.find(mark)
        if at < 0:
            half = next((k for k in range(len(mark) - 1, 0, -1) if held.endswith(mark[:k])), 0)
            self._drop(len(held) - half)
            return False
        self._drop(at)
        return len(held) >= self.HEAD

    def _drop(self, count: int) -> None:
        self.skipped += count
        del self._held[:count]
