"""The kernel of raw measurements: epochs of one receiver, each from observations to rows.

Correction, solution with its test of faults, trust in the systems, steps of the receiver's clock,
choice of satellites, DOP. A run has one set of ephemerides; how a stream is cut into runs changes
nothing.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.constellations import judge, news
from companion.estimation.adaptation.parameters import LENGTH
from companion.gnss.clock_noise import Q_SIZE, SCALE
from companion.gnss.clock_steps import C_JUMPS
from companion.gnss.corrected import S_RANGE
from companion.gnss.geometry import dilution
from companion.gnss.scatter import scatter
from companion.gnss.sight import FRAME_SIZE, SIGHT_SIZE
from companion.gnss.single_point import FAULTY, SOLVED, TOO_FEW
from companion.gnss.systems import SYSTEMS
from companion.intake.raw_gnss.clock import clock_offset, learn_clock_noise
from companion.intake.raw_gnss.solution import scale, solve_epoch
from companion.intake.raw_gnss.state import (
    E_CLOCK,
    E_DOP,
    E_TRUST,
    W_ADAPT,
    W_EXCLUDE,
    W_LEARN,
    W_SLOW,
    W_TAU,
    Z_CODE,
    Z_EXCLUDED,
    Z_LET_GO,
)
from companion.intake.raw_gnss.usage import choose, leave_out, remember
from companion.types import F64, I64


@njit(
    "void(i8, f8[::1], f8[:, :, ::1], f8[::1], f8[:, ::1], f8[:, :, ::1], i8[:, ::1], i8[::1], "
    "f8[:, ::1])",
    cache=True,
)
def _trust(
    t_ns: int, settings: F64, found: F64, a: F64, factors: F64, rings: F64, at: I64, learned: I64,
    traces: F64,
) -> None:  # fmt: skip
    """Learn from what was ``found`` of an epoch's systems; ``factors`` are those it leads to."""
    fresh = np.empty(2)
    news(t_ns, settings[W_SLOW], settings[W_TAU], int(a[LENGTH]), learned, fresh)
    judge(found, rings, at, fresh, a, factors, traces)


@njit(
    "i8(i8[::1], f8[::1], f8[::1], i8[:, ::1], f8[:, :, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], "
    "f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], i8[::1], f8[:, ::1], "
    "f8[:, :, ::1], i8[:, ::1], i8[::1], i8, f8[:, ::1], f8[:, ::1], i8[::1], i8[:, ::1], "
    "f8[:, ::1], f8[:, ::1], f8[:, :, :, ::1], f8[:, :, ::1])",
    cache=True,
    entry=True,
)
def run(
    t_ns: I64,
    week: F64,
    tow: F64,
    sat: I64,
    observed: F64,
    row_of: I64,
    ephemerides: F64,
    knots: F64,
    ionosphere: F64,
    settings: F64,
    gates: F64,
    expected: F64,
    a: F64,
    place: F64,
    clock: F64,
    learner: F64,
    memory: I64,
    factors: F64,
    rings: F64,
    ring_at: I64,
    learned: I64,
    filled: int,
    rows: F64,
    lines: F64,
    excluded: I64,
    epochs: I64,
    points: F64,
    figures: F64,
    found: F64,
    traces: F64,
) -> int:
    """Take N epochs at ``t_ns``, GPS time ``week``, ``tow`` (N,); returns how many rows are full.

    In: ``sat`` (N, K), ``observed`` (N, K, ·) as ``O_`` of :mod:`companion.gnss.correction`;
    ``row_of``, ``ephemerides``, ``knots`` of a :class:`companion.gnss.broadcast.Table`,
    ``ionosphere`` (8,); ``settings``: ``V_`` and ``W_``; ``gates`` of :func:`solve`, ``expected``
    of :func:`companion.gnss.scatter.trimmed_mean`, ``a`` of the adaptation's parameters.
    Moved on: ``place`` (``T_``), ``clock`` (``C_``), ``learner`` of its noise, ``memory`` (``K_``);
    ``factors``, ``rings``, ``ring_at``, ``learned`` of :class:`Constellations`.
    Out: ``rows``, ``lines`` (M, ·) of satellites in use from ``filled`` on, ``excluded`` (N K), an
    epoch's first; and by epoch ``epochs`` (``Z_``), ``points`` (``P_``), ``figures`` (``E_``),
    ``found`` of :func:`companion.gnss.scatter.scatter`, ``traces`` of :func:`judge`.
    """
    K = sat.shape[1]
    frame, sight, start = np.empty(FRAME_SIZE), np.empty((K, SIGHT_SIZE)), np.empty(3)
    work, column, used = np.empty((3, 8, 8)), np.empty(SYSTEMS, np.int64), np.empty(K, np.int64)
    systems, before = np.empty(K, np.int64), np.ones((2, 2, SYSTEMS))
    for i in range(t_ns.shape[0]):
        own, line, epoch, point = rows[filled:], lines[filled:], epochs[i], points[i]
        before[0] = factors
        code, m, known = solve_epoch(
            week[i], tow[i], sat[i], observed[i], row_of, ephemerides, knots, ionosphere, settings,
            gates, before, place, start, frame, own, line, sight, work, column, point, used,
        )  # fmt: skip
        if settings[W_ADAPT] == 1.0 and known and code in (SOLVED, FAULTY):
            scatter(own, m, used, column, sight, factors, work, expected, found[i])
            _trust(t_ns[i], settings, found[i], a, factors, rings, ring_at, learned, traces[i])
            scale(own, m, factors, before[0])
        now, jumps = week[i] * 604_800.0 + tow[i], clock[C_JUMPS]
        offset = clock_offset(now, code, own, m, point, place, clock, frame, sight)
        jumped = clock[C_JUMPS] > jumps
        epoch[Z_CODE], epoch[Z_EXCLUDED], epoch[Z_LET_GO] = code, 0, 1 if jumped else 0
        if settings[W_LEARN] == 1.0:
            learn_clock_noise(now, code == SOLVED, jumped, point, offset, memory, learner)
        gone = excluded[i * K :]
        if settings[W_EXCLUDE] == 1.0 and code != TOO_FEW:
            m = leave_out(own, m, line, used, code, column, gone, epoch)
        m = choose(own, m, line, systems, settings, memory)
        for s in range(m):
            own[s, S_RANGE] -= offset
        dilution(line, systems, m, work[2], figures[i, E_DOP:E_TRUST])
        remember(own, m, gone, sat[i], row_of, settings, memory, epoch)
        figures[i, E_TRUST:E_CLOCK] = factors[0]
        figures[i, E_CLOCK:] = learner[SCALE : SCALE + Q_SIZE]
        filled += m
    return filled
