"""Off-line smoothing of a recorded run: tapes in, a smoothed solution out.

A chunk at a time from the end: the tape is read backwards, then the smoothed error forwards. A
stretch between two declared breaks is smoothed by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.recording import Chunk, Tape
from companion.estimation.tape import F32, I8, STEP
from companion.navigation import layout as lo
from companion.smoothing import bryson_frazier, rts
from companion.smoothing.composite import scratch
from companion.smoothing.correction import correct, from_rows, published_blocks
from companion.smoothing.covariances import count_runs, covariances
from companion.smoothing.phi import K_SIZE
from companion.types import F64, I64, CompanionError, Solution

Method = Literal["bryson-frazier", "rts"]
NO_RUNS: F64 = np.zeros((0, 0, 0))


class SmoothingError(CompanionError):
    """A tape that cannot be smoothed; the forward solution stands."""


def smooth(tapes: Sequence[Tape], config: Config, method: Method = "bryson-frazier") -> Solution:
    """The smoothed solution at the output rows of ``tapes``, in order of time.

    Covariances are NaN for tapes recorded without them, but for ``rts``, which has them anyway.
    Raises :class:`SmoothingError` where a covariance on the tape cannot be inverted (``rts``).
    """
    one = _Smoother(config)
    parts = [
        part
        for tape in tapes
        for part in (one.rts(tape) if method == "rts" else one.bryson_frazier(tape))
    ]
    return Solution.concatenate([p for p in parts if len(p)])


class _Smoother:
    """Layout, parameters and scratch shared by all tapes of a run."""

    def __init__(self, config: Config) -> None:
        layout = par.layout(config)
        self.n = layout.n
        self.lay = layout.vector()
        self.par = par.parameter_vector(config)
        self._scratch = scratch()
        self._room = np.zeros((0, self.n + K_SIZE))
        self._rows = np.zeros((0, self.n, self.n))

    def _steps(self, count: int) -> F64:
        """Room for a chunk's steps, the same for every chunk: fresh memory is what costs most."""
        if count > len(self._room):
            self._room = np.zeros((count, self._room.shape[1]))
        return self._room

    def bryson_frazier(self, tape: Tape) -> list[Solution]:
        n = self.n
        lam, Lam = np.zeros(n), np.zeros((n, n))
        parts: list[Solution] = []
        for chunk in reversed(tape.chunks):
            columns = self._columns(chunk)
            steps = self._steps(int(np.count_nonzero(chunk.kinds == STEP)))
            rows = np.empty((len(chunk.t_ns), n))
            cov = np.full((len(rows), 30), np.nan)
            bryson_frazier.backward(*columns, self._scratch, chunk.s.copy(), lam, steps)
            P = chunk.s[lo.P :].reshape(n, n)
            dx = -(P * lam).sum(axis=1)
            bryson_frazier.forward(*columns, self._scratch, dx, steps, rows)
            if tape.covariance:
                before = self._before(chunk)
                bryson_frazier.backward_covariance(*columns, self._scratch, steps, before, Lam, cov)
            parts.append(self._corrected(chunk, rows, cov.reshape(-1, 5, 6)))
        return parts[::-1]

    def rts(self, tape: Tape) -> list[Solution]:
        n = self.n
        dx = np.zeros(n)
        Ps: F64 | None = None
        after: Chunk | None = None
        parts: list[Solution] = []
        for chunk in reversed(tape.chunks):
            count = count_runs(chunk.kinds)
            before, foreseen = (np.empty((count, n, n)) for _ in range(2))
            columns = self._columns(chunk)
            P = chunk.s[lo.P :].reshape(n, n).copy()
            s = chunk.s.copy()
            covariances(*columns, s, P, before, foreseen, NO_RUNS)
            if Ps is None or after is None:
                Ps = P
            elif after.widened:
                wide = after.s[lo.P :].reshape(n, n)
                C = np.linalg.solve(wide, P).T
                dx, Ps = C @ dx, P + C @ (Ps - wide) @ C.T
            rows, cov = np.empty((len(chunk.t_ns), n)), np.empty((len(chunk.t_ns), n, n))
            if not rts.backward(*columns, s, before, foreseen, dx, Ps, rows, cov):
                raise SmoothingError("a covariance on the tape is not positive definite")
            parts.append(self._corrected(chunk, rows, published_blocks(cov)))
            after = chunk
        return parts[::-1]

    def _columns(self, chunk: Chunk) -> tuple[I8, F32, F64, I64, F64]:
        """What every kernel takes of a chunk first."""
        return chunk.kinds, chunk.coarse, chunk.fine, self.lay, self.par

    def _before(self, chunk: Chunk) -> F64:
        """(rows, n, n) P of the forward run at the rows of a chunk, good until the next call."""
        rows = len(chunk.t_ns)
        if rows > len(self._rows):
            self._rows = np.zeros((rows, self.n, self.n))
        at_rows = self._rows[:rows]
        P = chunk.s[lo.P :].reshape(self.n, self.n).copy()
        covariances(*self._columns(chunk), chunk.s.copy(), P, NO_RUNS, NO_RUNS, at_rows)
        return at_rows

    def _corrected(self, chunk: Chunk, dx: F64, cov: F64) -> Solution:
        """Forward solution ⊞ smoothed error at the rows of a chunk."""
        out = chunk.nominal.copy()
        correct(out, dx, self.lay)
        return from_rows(out, chunk.t_ns, cov, chunk.mode, chunk.resets)
