"""What a filter leaves for a smoother: its tape in chunks, each with the state it began from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np

from companion.estimation import tape as tp
from companion.estimation.output_row import O_COV, O_MODE, O_RESETS
from companion.navigation import layout as lo
from companion.types import F64, I64

STEPS_OF_CHUNK = 3000
"""Covariance steps of a chunk at least: a minute at 50 Hz. The smoother starts anew from P at each
chunk, so that rounding does not travel far; P is small against that much tape."""
NOMINAL = O_COV
"""Columns of an output row that a smoother corrects: all before the covariance."""
_KEPT = [*range(NOMINAL), O_MODE, O_RESETS]

Recording = Literal["no", "states", "covariance", "inputs", "all"]
"""What a filter leaves for a smoother: a tape, for the states alone or covariances with them; the
inputs beside rows with P; the inputs beside a whole tape."""

Column = TypeVar("Column", tp.I8, tp.F32, F64)


@dataclass(frozen=True, slots=True)
class Chunk:
    """A stretch of tape."""

    s: F64
    """The filter's float state at the start, with P."""
    kinds: tp.I8
    coarse: tp.F32
    fine: F64
    t_ns: I64
    """(rows,) of the output rows marked on the tape."""
    nominal: F64
    """(rows, NOMINAL) the forward solution there, by the first ``O_`` columns of walk.py."""
    mode: I64
    """(rows,)."""
    resets: I64
    """(rows,)."""
    widened: bool
    """P at the start was made larger than at the end of the chunk before."""


@dataclass(slots=True)
class Tape:
    """The tape of one filter: closed chunks and the running one."""

    n: int
    """States."""
    covariance: bool
    """Whether the smoothed solution is to have its own."""
    rows_only: bool = False
    """Whether the rows, with P, are all there is: nothing to smooth back over."""
    chunks: list[Chunk] = field(default_factory=list)
    _s: F64 = field(default_factory=lambda: np.zeros(0))
    _kinds: tp.I8 = field(default_factory=lambda: np.zeros(0, np.int8))
    _coarse: tp.F32 = field(default_factory=lambda: np.zeros(0, np.float32))
    _fine: F64 = field(default_factory=lambda: np.zeros(0))
    _rows: list[tuple[I64, F64]] = field(default_factory=list)
    _widened: bool = False

    def begin(self, s: F64, k: I64) -> None:
        """Start a chunk from the filter's state."""
        self._s = s.copy()
        k[lo.TAPE_AT : lo.TAPE_AT + tp.POSITION] = 0
        k[lo.TAPE_AT + tp.ROWS] = tp.ROWS_ONLY if self.rows_only else tp.MARKED

    def recorder(self, k: I64, steps: int, updates: int, rows: int) -> tp.Recorder:
        """The tape for a kernel, with room for so many more records."""
        at = position(k)
        if self.rows_only:
            steps = updates = 0
        triangle = self.n * (self.n + 1) // 2 if self.rows_only else 0
        self._kinds = grown(self._kinds, int(at[tp.KIND]) + steps + 3 * updates + rows)
        self._coarse = grown(self._coarse, int(at[tp.COARSE]) + tp.C_STEP * steps + triangle * rows)
        numbers = (
            tp.F_STEP_WITH_SCALE * steps
            + (tp.F_GAIN + 2 * self.n + tp.F_TURN + tp.F_FADE) * updates
        )
        self._fine = grown(self._fine, int(at[tp.FINE]) + numbers)
        return self._kinds, self._coarse, self._fine, at

    def wrote(self, t_ns: I64, rows: F64, s: F64, k: I64) -> None:
        """Take the output rows of a walk, and close the chunk when it is long enough."""
        if len(t_ns):
            self._rows.append((t_ns.copy(), rows[:, _KEPT]))
        if k[lo.TAPE_AT + tp.KIND] > 2 * STEPS_OF_CHUNK:
            self.cut(s, k)

    def cut(self, s: F64, k: I64, widened: bool = False) -> None:
        """Close the running chunk and begin the next from ``s``, where P may have been widened."""
        rows = np.concatenate([r for _, r in self._rows] or [np.zeros((0, NOMINAL + 2))])
        kinds, coarse, fine = (int(x) for x in k[lo.TAPE_AT : lo.TAPE_AT + 3])
        self.chunks.append(
            Chunk(
                self._s,
                self._kinds[:kinds].copy(),
                self._coarse[:coarse].copy(),
                self._fine[:fine].copy(),
                np.concatenate([t for t, _ in self._rows] or [np.zeros(0, np.int64)]),
                rows[:, :NOMINAL].copy(),
                rows[:, NOMINAL].astype(np.int64),
                rows[:, NOMINAL + 1].astype(np.int64),
                self._widened,
            )
        )
        self._rows, self._widened = [], widened
        self.begin(s, k)


def grown(column: Column, size: int) -> Column:
    """``column`` itself where ``size`` fits, else a copy of at least twice the length."""
    if size <= len(column):
        return column
    out = np.zeros(max(size, 2 * len(column)), column.dtype)
    out[: len(column)] = column
    return out


def nothing(k: I64) -> tp.Recorder:
    """The tape of a filter that nobody smooths."""
    return *_EMPTY, position(k)


def position(k: I64) -> I64:
    """Where the tape of a filter stands, as a view of its integer state."""
    return k[lo.TAPE_AT : lo.TAPE_AT + tp.POSITION]


_EMPTY = (np.zeros(0, np.int8), np.zeros(0, np.float32), np.zeros(0))
