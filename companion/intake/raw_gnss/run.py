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
from companion.gnss.clock_noise import Q_SIZE, SCALE, interrupt, learn_clock
from companion.gnss.clock_steps import C_JUMPS, C_OFFSET, offset_at
from companion.gnss.corrected import (
    ROW_SIZE,
    S_RANGE,
    S_RANGE_VAR,
    S_RATE_VAR,
    S_SAT,
    S_SYSTEM,
)
from companion.gnss.correction import O_RANGE, correct
from companion.gnss.geometry import NO_DOP, best_set, dilution
from companion.gnss.scatter import scatter
from companion.gnss.sight import FRAME_SIZE, G_RANGE, SIGHT_SIZE, look, stand
from companion.gnss.single_point import (
    FAULTY,
    P_CLOCK,
    P_POS,
    P_RATE,
    P_VEL,
    SOLVED,
    TOO_FEW,
    solve,
)
from companion.gnss.systems import SYSTEMS
from companion.intake.raw_gnss.state import (
    K_CLOCK,
    K_SATS,
    K_SET,
    K_SIGN,
    K_UNSOLVED,
    T_KNOWN,
    T_POS,
    T_TIME,
    T_VEL,
    W_ADAPT,
    W_BEST,
    W_EXCLUDE,
    W_LEARN,
    W_MARGIN,
    W_OURS,
    W_SLOW,
    W_TAU,
    Z_CODE,
    Z_EXCLUDED,
    Z_LET_GO,
    Z_NEWS,
    Z_USED,
)
from companion.types import F64, I64

GUESS_S = 600.0
"""A place this old no longer tells elevations or clock steps."""
AHEAD_S, AHEAD_M = 10.0, 1_000.0
"""A place is carried on with its velocity for so long and so far: rates are not tested for faults,
and a wrong velocity must not take satellites below the horizon."""
FASTEST_MPS = 100.0
_SIGN = 1_000_003


@njit("b1(f8[::1], f8, f8[::1])", cache=True, counted=False)
def _where(place: F64, now: float, start: F64) -> bool:
    """About where the receiver is at GPS time ``now`` [s], into ``start`` (3,); false: unknown."""
    if abs(now - place[T_TIME]) > GUESS_S:
        place[T_KNOWN] = 0.0
    start[:] = 0.0
    if place[T_KNOWN] == 0.0:
        return False
    ahead, square = now - place[T_TIME], 0.0
    for i in range(3):
        start[i] = place[T_POS + i]
        square += place[T_VEL + i] * place[T_VEL + i]
    # Written so that NaN, for no velocity, stays where it was.
    if 0.0 < ahead <= AHEAD_S and square * ahead * ahead < AHEAD_M * AHEAD_M:
        for i in range(3):
            start[i] += place[T_VEL + i] * ahead
    return True


@njit("void(f8[::1], f8, f8[::1])", cache=True, counted=False)
def _settle(place: F64, now: float, point: F64) -> None:
    """Remember a solution."""
    for i in range(3):
        place[T_POS + i], place[T_VEL + i] = point[P_POS + i], point[P_VEL + i]
    place[T_TIME], place[T_KNOWN] = now, 1.0


@njit("i8(i8, f8[::1])", cache=True, counted=False)
def _system(sat: int, settings: F64) -> int:
    """System of a satellite that is used; −1 else."""
    system = sat // 100 - 1
    if 0 <= system < SYSTEMS and settings[W_OURS + system] == 1.0:
        return system
    return -1


@njit(
    "i8(f8, f8, i8[::1], f8[:, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], b1, f8[::1], f8[::1], "
    "f8[::1], f8[::1], f8[:, ::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def _correct_all(
    week: float, tow: float, sat: I64, observed: F64, row_of: I64, ephemerides: F64, knots: F64,
    known: bool, start: F64, frame: F64, ionosphere: F64, settings: F64, rows: F64, lines: F64,
    sight: F64,
) -> int:  # fmt: skip
    """Fill a row for each satellite of an epoch that can be used; returns how many there are."""
    m = 0
    for k in range(sat.shape[0]):
        if _system(sat[k], settings) < 0 or not np.isfinite(observed[k, O_RANGE]):
            continue
        which = row_of[sat[k]]
        if which >= 0 and correct(
            ephemerides[which], knots[which], week, tow, observed[k], known, start, frame,
            ionosphere, settings, rows[m], lines[m], sight[m],
        ):  # fmt: skip
            m += 1
    return m


@njit("void(f8[:, ::1], i8, f8[:, ::1], f8[:, ::1])", cache=True, counted=False)
def _scale(rows: F64, m: int, factors: F64, before: F64) -> None:
    """Variances times their systems' ``factors`` (2, SYSTEMS) over those of ``before``."""
    for s in range(m):
        c = int(rows[s, S_SYSTEM])
        rows[s, S_RANGE_VAR] *= factors[0, c] / before[0, c]
        rows[s, S_RATE_VAR] *= factors[1, c] / before[1, c]


@njit("f8(f8[:, ::1], i8, f8[:, ::1])", cache=True, counted=False)
def _median_residual(rows: F64, m: int, sight: F64) -> float:
    """Median of range less what is expected of ``m`` > 0 satellites; orders ``sight`` by it."""
    for s in range(m):
        value, at = rows[s, S_RANGE] - sight[s, G_RANGE], s
        while at > 0 and sight[at - 1, 0] > value:
            sight[at, 0] = sight[at - 1, 0]
            at -= 1
        sight[at, 0] = value
    return float(0.5 * (sight[m // 2, 0] + sight[(m - 1) // 2, 0]))


@njit("i8(f8[::1])", cache=True, counted=False)
def _first_clock(point: F64) -> int:
    """The first system whose clock is solved: one clock in all but the systems' biases."""
    c = 0
    while c < SYSTEMS - 1 and np.isnan(point[P_CLOCK + c]):
        c += 1
    return c


@njit(
    "f8(f8, i8, f8[:, ::1], i8, f8[::1], f8[::1], f8[::1], f8[::1], f8[:, ::1])",
    cache=True,
    counted=False,
)
def _offset(
    now: float, code: int, rows: F64, m: int, point: F64, place: F64, clock: F64, frame: F64,
    sight: F64,
) -> float:  # fmt: skip
    """Clock offset to take off; without a solution, steps are looked for at the last place."""
    if code == SOLVED:
        bias = point[P_CLOCK + _first_clock(point)]
        return offset_at(clock, now, bias, point[P_RATE], 0.0)
    if np.isnan(clock[C_OFFSET]):
        return 0.0
    if place[T_KNOWN] == 0.0 or m == 0:
        return float(clock[C_OFFSET])
    stand(place[T_POS], place[T_POS + 1], place[T_POS + 2], frame)
    look(rows, m, place[T_POS : T_POS + 3], frame, sight)
    # The vehicle has gone on since it was last known where it is.
    doubt = FASTEST_MPS * (now - place[T_TIME])
    return offset_at(clock, now, _median_residual(rows, m, sight), np.nan, doubt)


@njit("void(f8, b1, b1, f8[::1], f8, i8[::1], f8[::1])", cache=True)
def _learn_clock(
    now: float, solved: bool, jumped: bool, point: F64, offset: float, memory: I64, learner: F64
) -> None:
    """Let the noise of the clock be learned from an epoch's own solution, if it has one."""
    if jumped:
        interrupt(learner)
    if solved:
        system = _first_clock(point)
        if system != memory[K_CLOCK]:
            interrupt(learner)
            memory[K_CLOCK] = system
        learn_clock(learner, now, point[P_CLOCK + system] - offset, point[P_RATE])


@njit("void(f8[:, ::1], i8, f8[:, ::1], i8)", cache=True, counted=False)
def _move(rows: F64, to: int, lines: F64, s: int) -> None:
    """Row and line of satellite ``s`` to a place further up."""
    if to != s:
        for i in range(ROW_SIZE):
            rows[to, i] = rows[s, i]
        for i in range(3):
            lines[to, i] = lines[s, i]


@njit(
    "i8(f8[:, ::1], i8, f8[:, ::1], i8[::1], i8, i8[::1], i8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def _leave_out(
    rows: F64, m: int, lines: F64, used: I64, code: int, count: I64, excluded: I64, epoch: I64
) -> int:
    """Keep the satellites that may be used after the test of faults; returns how many.

    Where the epoch is solved, those left out are ``excluded``; else all go. ``count`` (SYSTEMS,)
    is scratch.
    """
    if code != SOLVED:
        return 0
    count[:] = 0
    for s in range(m):
        count[int(rows[s, S_SYSTEM])] += 1
    kept, gone = 0, 0
    for s in range(m):
        # Judged by the residuals; the only one of its system was left out unjudged.
        if used[s] == 1 or count[int(rows[s, S_SYSTEM])] == 1:
            _move(rows, kept, lines, s)
            kept += 1
        else:
            excluded[gone] = int(rows[s, S_SAT])
            gone += 1
    epoch[Z_EXCLUDED] = gone
    return kept


@njit("i8(f8[:, ::1], i8, f8[:, ::1], i8[::1], f8[::1], i8[::1])", cache=True)
def _choose(rows: F64, m: int, lines: F64, systems: I64, settings: F64, memory: I64) -> int:
    """Keep the best set of the configured size; returns how many are kept.

    The set of the epoch before stays until another is better by the margin.
    """
    count = int(settings[W_BEST])
    if count == 0 or m <= count:
        return m
    best = np.empty(count, np.int64)
    found = best_set(lines, systems, m, count, best)
    if found >= NO_DOP:
        return m
    old, same = np.empty(m, np.int64), 0
    for s in range(m):
        for k in range(memory[K_SET]):
            if memory[K_SATS + k] == int(rows[s, S_SAT]):
                old[same] = s
                same += 1
                break
    if same == count:
        sub, kinds, dop = np.empty((count, 3)), np.empty(count, np.int64), np.empty(5)
        for k in range(count):
            kinds[k] = systems[old[k]]
            for i in range(3):
                sub[k, i] = lines[old[k], i]
        dilution(sub, kinds, count, np.empty((8, 8)), dop)
        if dop[0] <= found * (1.0 + settings[W_MARGIN]):
            best = old[:count]
    for k in range(count):
        _move(rows, k, lines, best[k])
    return count


@njit(
    "void(f8[:, ::1], i8, i8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8[::1])",
    cache=True,
    counted=False,
)
def _remember(
    rows: F64, m: int, excluded: I64, sat: I64, row_of: I64, settings: F64, memory: I64, epoch: I64
) -> None:
    """Whether others are used, at fault or without an ephemeris than in the epoch before."""
    sign, bad = 0, epoch[Z_CODE] != SOLVED and epoch[Z_CODE] != TOO_FEW
    for s in range(m):
        memory[K_SATS + s] = int(rows[s, S_SAT])
        sign = sign * _SIGN + memory[K_SATS + s]
    for s in range(epoch[Z_EXCLUDED]):
        sign = sign * _SIGN + 1_000 + excluded[s]
    for k in range(sat.shape[0]):
        # Below −1: an ephemeris that may not be used; one that is missing is no news.
        if _system(sat[k], settings) >= 0 and row_of[sat[k]] < -1:
            sign = sign * _SIGN - 1_000 * row_of[sat[k]] + sat[k]
    epoch[Z_USED] = memory[K_SET] = m
    epoch[Z_NEWS] = 1 if sign != memory[K_SIGN] else 0
    memory[K_SIGN] = sign
    memory[K_UNSOLVED] += 1 if bad else 0


@njit(
    "i8(i8[::1], f8[::1], f8[::1], i8[:, ::1], f8[:, :, ::1], i8[::1], f8[:, ::1], f8[:, :, ::1], "
    "f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], f8[::1], i8[::1], f8[:, ::1], "
    "f8[:, :, ::1], i8[:, ::1], i8[::1], i8, f8[:, ::1], f8[:, ::1], i8[::1], i8[:, ::1], "
    "f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, :, :, ::1], f8[:, :, ::1])",
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
    dops: F64,
    trusted: F64,
    clock_scales: F64,
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
    epoch's first; and by epoch ``epochs`` (``Z_``), ``points`` (``P_``), ``dops``,
    ``trusted`` (SYSTEMS): factors on ranges' variances, ``found`` of :func:`scatter`, ``traces``.
    """
    K = sat.shape[1]
    frame, sight, start = np.empty(FRAME_SIZE), np.empty((K, SIGHT_SIZE)), np.empty(3)
    work, column, used = np.empty((3, 8, 8)), np.empty(SYSTEMS, np.int64), np.empty(K, np.int64)
    systems, fresh, before = np.empty(K, np.int64), np.empty(2), np.empty((2, SYSTEMS))
    adapt, ones = settings[W_ADAPT] == 1.0, np.ones((2, SYSTEMS))
    for i in range(t_ns.shape[0]):
        own, line, epoch, point = rows[filled:], lines[filled:], epochs[i], points[i]
        now = week[i] * 604_800.0 + tow[i]
        begun = known = _where(place, now, start)
        code, m = TOO_FEW, 0
        # From nowhere, the first solution only tells what is low and where the ionosphere is.
        for _ in range(2):
            if known:
                stand(start[0], start[1], start[2], frame)
            m = _correct_all(
                week[i], tow[i], sat[i], observed[i], row_of, ephemerides, knots, known, start,
                frame, ionosphere, settings, own, line, sight,
            )  # fmt: skip
            if adapt:
                _scale(own, m, factors, ones)
            code = solve(
                own, m, start, known, gates, frame, sight, work, column, point, used
            )  # fmt: skip
            if code == SOLVED:
                _settle(place, now, point)
            if known or code != SOLVED:
                break
            known = _where(place, now, start)
        if adapt and known and code in (SOLVED, FAULTY):
            before[:, :] = factors
            scatter(own, m, used, column, sight, work, expected, found[i])
            news(t_ns[i], settings[W_SLOW], settings[W_TAU], int(a[LENGTH]), learned, fresh)
            judge(found[i], rings, ring_at, fresh, a, factors, traces[i])
            _scale(own, m, factors, before)
        if not begun and code != SOLVED:
            place[T_KNOWN] = 0.0  # a beginning that led nowhere is none
        jumps = clock[C_JUMPS]
        offset = _offset(now, code, own, m, point, place, clock, frame, sight)
        epoch[Z_CODE], epoch[Z_EXCLUDED] = code, 0
        jumped = clock[C_JUMPS] > jumps
        epoch[Z_LET_GO] = 1 if jumped else 0
        if settings[W_LEARN] == 1.0:
            _learn_clock(now, code == SOLVED, jumped, point, offset, memory, learner)
        gone = excluded[i * K :]
        if settings[W_EXCLUDE] == 1.0 and code != TOO_FEW:
            m = _leave_out(own, m, line, used, code, column, gone, epoch)
        for s in range(m):
            systems[s] = int(own[s, S_SYSTEM])
        m = _choose(own, m, line, systems, settings, memory)
        for s in range(m):
            systems[s] = int(own[s, S_SYSTEM])
            own[s, S_RANGE] -= offset
        dilution(line, systems, m, work[2], dops[i])
        _remember(own, m, gone, sat[i], row_of, settings, memory, epoch)
        for c in range(SYSTEMS):
            trusted[i, c] = factors[0, c]
        for c in range(Q_SIZE):
            clock_scales[i, c] = learner[SCALE + c]
        filled += m
    return filled
