"""A span of a recording; on its own, so that a command line is parsed without the kernels."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """From ``start_s`` after the recording's start, for ``seconds``; the end is not included."""

    start_s: float
    seconds: float
    left: int = 0
    """Satellites that are left of raw GNSS where it is withheld, those that stand highest."""

    def __str__(self) -> str:
        """As the command line takes it and a run log keeps it."""
        left = f":{self.left}" if self.left else ""
        return f"{self.start_s!r}+{self.seconds!r}{left}"


def parse_window(text: str) -> Window:
    """A window from ``START+SECONDS[:LEFT]``; :class:`ValueError` for anything else."""
    times, colon, left = text.partition(":")
    start, plus, length = times.partition("+")
    window = Window(float(start), float(length), int(left) if colon else 0)
    if not plus or not (0 <= window.start_s < math.inf and 0 < window.seconds < math.inf):
        raise ValueError(text)
    if window.left < 0:
        raise ValueError(text)
    return window


def read_windows(text: str) -> tuple[Window, ...]:
    """The windows that a run log names, separated by spaces; unreadable ones are left out."""
    windows = []
    for part in text.split():
        with suppress(ValueError):
            windows.append(parse_window(part))
    return tuple(windows)
