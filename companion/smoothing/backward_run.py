"""The forward filter once more, backwards over what it took: its estimates at the output epochs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from companion.config import DEG, Config
from companion.estimation import parameters as par
from companion.estimation.recording import Chunk, nothing
from companion.estimation.stretch import Block, Mark, Stretch
from companion.estimation.tape import F32, RECORDER, Recorder
from companion.estimation.update import REPORT_SIZE
from companion.estimation.walk import DONE, walk
from companion.navigation import layout as lo
from companion.smoothing.time_reversal import (
    Mirror,
    reversed_block,
    reversed_parameters,
    reversed_state,
    signs,
    turn_around,
)
from companion.types import F64, I64

NOMINAL = lo.GNSS_BIAS + 3
"""Entries of a filter's state that are estimates."""
WIDER = 10.0
"""Standard deviations of the start over those of the forward run's end: what the backward run then
has of it counts a hundredth."""
WIDEST_ATTITUDE = 10.0 * DEG
"""But not beyond what the error model is linear for."""


@dataclass(frozen=True, slots=True)
class Backward:
    """Estimates of the run backwards, in forward terms, from what was valid after each epoch."""

    known: NDArray[np.bool_]
    """(N,) whether there is one: not where the run was lost."""
    nominal: F64
    """(N, NOMINAL) by the offsets of a filter's state."""
    triangle: F32
    """(N, n (n + 1) / 2) upper triangles of P."""

    def by_chunk(self, chunks: Sequence[Chunk]) -> Iterator[tuple[Chunk, Backward]]:
        """The chunks whose rows the N epochs are, each with its part."""
        at = 0
        for chunk in chunks:
            rows = slice(at, at + len(chunk.t_ns))
            yield chunk, Backward(self.known[rows], self.nominal[rows], self.triangle[rows])
            at = rows.stop


@njit(
    "i8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1], f8[:, ::1], i8[::1], i8[:, ::1],"
    "f8[:, ::1], i8[::1], i8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], f8[:, ::1],"
    f"f4[:, ::1], {RECORDER})",
    cache=True,
    entry=True,
)
def walk_to_stops(
    s: F64,
    k: I64,
    lay: I64,
    par: F64,
    ipar: I64,
    imu_t: I64,
    imu: F64,
    aid_t: I64,
    aid_kind: I64,
    aid: F64,
    stops: I64,
    reports_t: I64,
    reports: F64,
    snaps: F64,
    snaps_k: I64,
    at: I64,
    nominal: F64,
    triangle: F32,
    tape: Recorder,
) -> int:
    """Walk all samples, and put down the state after each of ``stops``, indices of samples.

    Arguments as of :func:`companion.estimation.walk.walk`; ``nominal`` (stops, NOMINAL) and
    ``triangle`` (stops, n (n + 1) / 2) are filled, ``at[6]`` says how far. The code is the walk's.
    """
    n = lay[lo.L_N]
    end = at[1]
    for m in range(stops.shape[0] + 1):
        at[1] = stops[m] + 1 if m < stops.shape[0] else end
        code = walk(
            s, k, lay, par, ipar, imu_t, imu, aid_t, aid_kind, aid,
            reports_t, reports, reports_t, reports, snaps, snaps_k, at, tape,
        )  # fmt: skip
        at[5] = 0
        if code != DONE:
            return int(code)
        if m < stops.shape[0]:
            for i in range(NOMINAL):
                nominal[m, i] = s[i]
            c = 0
            for i in range(n):
                for j in range(i, n):
                    triangle[m, c] = s[lo.P + i * n + j]
                    c += 1
            at[6] = m + 1
    return int(DONE)


def run_backwards(stretch: Stretch, config: Config, t_ns: I64) -> Backward:
    """Estimates at ``t_ns`` (N,), times of samples of the stretch in order.

    The filter starts from the last mark's state with a wide P. Where it is lost (locked out,
    diverged, not finite) it starts anew from the mark before.
    """
    run = _Run(stretch, config, t_ns)
    marks = list(stretch.marks)
    while marks:
        mark = marks.pop()
        reached = run.walk_from(mark)
        while marks and marks[-1].block >= reached:
            marks.pop()
    return run.result()


class _Run:
    """Parameters, scratch and results of a run backwards."""

    def __init__(self, stretch: Stretch, config: Config, t_ns: I64) -> None:
        self.layout = par.layout(config)
        n = self.layout.n
        self._vectors = self.layout.vector(), par.parameter_vector(config)
        self._ipar = reversed_parameters(par.integer_vector(config))
        self._blocks = stretch.blocks
        self._mirror = Mirror(stretch.end_ns)
        self._t_ns = t_ns
        self._known = np.zeros(len(t_ns), np.bool_)
        self._nominal = np.full((len(t_ns), NOMINAL), np.nan)
        self._triangle = np.full((len(t_ns), n * (n + 1) // 2), np.nan, np.float32)
        self._config = config

    def walk_from(self, mark: Mark) -> int:
        """Run from ``mark`` to the start, or to where it is lost: the block reached."""
        n = self.layout.n
        s, k = reversed_state(mark.s, mark.k, n, self._ipar, self._mirror)
        widen(s, n, self._config)
        waiting: Block | None = None
        following: F64 | None = None
        for index in range(mark.block, -1, -1):
            block = self._blocks[index]
            turned = reversed_block(block, self._mirror, following)
            if waiting is not None:
                turned = _behind(waiting, turned)
            left = self._walk(s, k, block, turned)
            if left is None:
                return index
            waiting = left
            following = block.imu[0] if len(block.imu) else following
        return 0

    def _walk(self, s: F64, k: I64, block: Block, turned: Block) -> Block | None:
        """Walk one block; the aids left for the next one, None where the filter is lost."""
        if len(block.imu_t) == 0:
            return turned
        a, b = np.searchsorted(self._t_ns, [block.imu_t[0], block.imu_t[-1] + 1])
        stops = np.searchsorted(turned.imu_t, self._mirror(self._t_ns[a:b])[::-1])
        samples, aids = len(turned.imu_t), len(turned.aid_t)
        # As many reports as a walk can leave: five an aid, three a sample of constraints.
        room = 5 * aids + 3 * samples
        reports_t, reports = np.empty(room, np.int64), np.empty((room, REPORT_SIZE))
        at = np.array([0, samples, 0, aids, 0, 0, 0], np.int64)
        nominal = np.empty((b - a, NOMINAL))
        triangle = np.empty((b - a, self._triangle.shape[1]), np.float32)
        code = walk_to_stops(
            s, k, *self._vectors, self._ipar,
            turned.imu_t, turned.imu, turned.aid_t, turned.aid_key, turned.aid,
            stops, reports_t, reports, np.zeros((1, len(s))), np.zeros((1, len(k)), np.int64), at,
            nominal, triangle, nothing(k),
        )  # fmt: skip
        done = int(at[6])
        rows = slice(b - done, b)
        self._known[rows] = True
        self._nominal[rows] = nominal[:done][::-1]
        self._triangle[rows] = triangle[:done][::-1]
        if code != DONE:
            return None
        rest = slice(int(at[2]), None)
        return Block(
            turned.imu_t[:0], turned.imu[:0],
            turned.aid_t[rest], turned.aid_key[rest], turned.aid[rest],
        )  # fmt: skip

    def result(self) -> Backward:
        """What was found, turned back into forward terms."""
        turn_around(self._nominal)
        i, j = np.triu_indices(self.layout.n)
        sign = signs(self.layout.n)
        self._triangle *= (sign[i] * sign[j]).astype(np.float32)
        return Backward(self._known, self._nominal, self._triangle)


def _behind(waiting: Block, turned: Block) -> Block:
    """``turned`` with the aids that waited for its samples in front of its own."""
    return Block(
        turned.imu_t,
        turned.imu,
        np.concatenate([waiting.aid_t, turned.aid_t]),
        np.concatenate([waiting.aid_key, turned.aid_key]),
        np.concatenate([waiting.aid, turned.aid]),
    )


def widen(s: F64, n: int, config: Config) -> None:
    """Let go of what the forward run knew, in place: P ← D P D, diagonal D.

    The slow GNSS error goes back to what is known of it beforehand, apart from all else: that is
    then the one thing that both runs share (see two_filter.py).
    """
    P = s[lo.P :].reshape(n, n)
    wider = np.full(n, WIDER)
    attitude = float(np.sqrt(np.diag(P)[lo.ATT : lo.ATT + 3].max()))
    wider[lo.ATT : lo.ATT + 3] = max(1.0, min(WIDER, WIDEST_ATTITUDE / attitude))
    P *= wider[:, None] * wider
    layout = par.layout(config)
    if layout.gnss >= 0:
        slow = slice(layout.gnss, layout.gnss + 3)
        s[lo.GNSS_BIAS : lo.GNSS_BIAS + 3] = 0.0
        P[slow, :], P[:, slow] = 0.0, 0.0
        prior = par.initial_variances(config, layout)[slow]
        P[range(layout.gnss, layout.gnss + 3), range(layout.gnss, layout.gnss + 3)] = prior
