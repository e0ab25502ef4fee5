"""Arrays by what they hold, and rows of several of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
Flags = NDArray[np.bool_]

NS = 1_000_000_000
"""Nanoseconds in a second."""


@cache
def _names(kind: Any) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind))


class Rows(ABC):
    """Base of the frozen dataclasses whose fields are arrays with one first dimension N."""

    __slots__ = ()
    t_ns: I64

    def __len__(self) -> int:
        return int(self.t_ns.shape[0])

    def take(self, index: slice | Sequence[int] | I64 | Flags) -> Self:
        """The rows of ``index``."""
        # As `object`: mypy takes the __hash__ of a frozen dataclass's instances for its class's.
        kind: object = type(self)
        return type(self)(*[getattr(self, name)[index] for name in _names(kind)])

    @classmethod
    @abstractmethod
    def empty(cls) -> Self:
        """Without a row."""

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """Join in order; empty for an empty list."""
        if not parts:
            return cls.empty()
        if len(parts) == 1:
            return parts[0]
        kind: object = cls
        return cls(*[np.concatenate([getattr(p, n) for p in parts]) for n in _names(kind)])
