"""A span of a recording; on its own, so that a command line is parsed without the kernels."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Window:
    """From ``start_s`` after the recording's start, for ``seconds``; the end is not included."""

    start_s: float
    seconds: float
