"""The tape of a filter that flies: written while it is read, taken back and forgotten.

Where it stands is part of the filter's integer state, so that a snapshot restores it: what was put
down after the moment that the filter goes back to is written over.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.estimation import tape as tp
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.recording import Column, grown, position
from companion.navigation import layout as lo
from companion.types import F64, I64

KEPT = 1 << 14
"""Numbers in front of what is still wanted, before the rest is moved up to the start."""


@dataclass(slots=True)
class RunningTape:
    """Columns of a tape."""

    n: int
    """States."""
    every_ns: int
    """Grid of the epochs to be smoothed."""
    plain_rows: bool
    """Keep the output rows between them as well."""
    kinds: tp.I8 = field(default_factory=lambda: np.zeros(0, np.int8))
    coarse: tp.F32 = field(default_factory=lambda: np.zeros(0, np.float32))
    fine: F64 = field(default_factory=lambda: np.zeros(0))
    read: bool = False
    """The smoother is through with it."""

    def begin(self, _s: F64, k: I64) -> None:
        """Start with the filter."""
        at = position(k)
        at[:] = 0
        at[tp.ROWS] = tp.ALL if self.plain_rows else tp.TO_SMOOTH
        at[tp.EVERY_NS] = self.every_ns
        at[tp.CELL] = -1

    def recorder(self, k: I64, steps: int, updates: int, rows: int) -> tp.Recorder:
        """The tape for a kernel, with room for so many more records."""
        at = position(k)
        triangle = self.n * (self.n + 1) // 2
        # An update may be a fix: its mark comes on top.
        self.kinds = grown(self.kinds, int(at[tp.KIND]) + steps + 4 * updates + rows)
        self.coarse = grown(self.coarse, int(at[tp.COARSE]) + tp.C_STEP * steps)
        numbers = tp.F_STEP_WITH_SCALE * steps + (tp.F_TIME + ROW_SIZE + triangle) * rows
        numbers += (tp.F_GAIN + 2 * self.n + tp.F_TURN + tp.F_FADE + tp.F_TIME) * updates
        self.fine = grown(self.fine, int(at[tp.FINE]) + numbers)
        return self.kinds, self.coarse, self.fine, at

    def wrote(self, t_ns: I64, rows: F64, s: F64, k: I64) -> None:
        """Output rows are on the tape already."""

    def forget(self, before: I64, k: I64, snaps_k: I64, settled_ns: int) -> I64:
        """Drop what lies in front of ``before`` (kind, coarse, fine); returns by how much (3,).

        Not what a snapshot may go back to: the newest one of ``settled_ns`` or earlier. Positions
        in ``k`` and ``snaps_k`` (slots, …) move along.
        """
        none = np.zeros(3, np.int64)
        if before[tp.FINE] < KEPT:
            return none
        times = snaps_k[:, lo.T_NOW]
        taken = times > np.iinfo(np.int64).min
        usable = np.flatnonzero(taken & (times <= settled_ns))
        if len(usable) == 0:
            return none
        newest = snaps_k[usable[np.argmax(times[usable])]]
        cut: I64 = np.minimum(before[:3], position(newest)[:3])
        a, b = cut.tolist(), position(k)[:3].tolist()
        _move_up(self.kinds, a[tp.KIND], b[tp.KIND])
        _move_up(self.coarse, a[tp.COARSE], b[tp.COARSE])
        _move_up(self.fine, a[tp.FINE], b[tp.FINE])
        # Snapshots older than that one end up in front of the tape: nobody goes back to them.
        position(k)[:3] -= cut
        for slot in np.flatnonzero(taken):
            position(snaps_k[slot])[:3] -= cut
        return cut


def _move_up(column: Column, first: int, end: int) -> None:
    column[: end - first] = column[first:end].copy()
