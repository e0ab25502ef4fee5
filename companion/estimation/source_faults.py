"""Faults of a position source, seen against what coasts without it.

Beside the filter runs a *shadow*: the same velocity, integrated without any correction of position
by GNSS. The filter's position less the shadow's is the pull, the sum of those corrections, and

    u = y + b + pull        fix − shadow, y the innovation, b the slow error in force

is what a fix says about the shadow. For a good receiver u wanders within its slow error and the
drift of dead reckoning; a step or ramp of position alone, with the velocities of the same receiver
unmoved, shows in it in full, however far the filter has followed. Three means are kept of it, fed
with every fix, fused or not, each no further off than :data:`WINSOR` deviations (a spike of 500 m
counts as little as one of 5 m, and nobody is locked out for good):

- fast (1 s) less base (60 s), against the variance that slow error, noise and dead reckoning leave
  it: beyond :data:`LIMIT` the position *drifts* from its own velocity. The base is an exponential
  mean, so a ramp r ends up r · 60 s away from it: the slowest one that is seen is limit / 60 s;
- the *steady* mean begins anew wherever fixes leave it: it says since when they have told one
  place, wrong or right. A gate that has refused fixes of one place for 2 s refuses a *step*.

Either way the source is a fault and none of its positions is fused, until five fixes in a row agree
with the base again, or until it has told one place for as long as the filter had gone along with it
(at least ``engine.gate_relock_s``, at most ``source_faults.patience_s``): then the filter takes its
word by a declared reset (recovery.py). All this holds only where velocity vouches for the shadow:
fused within 2 s, and fitting. Without that witness filter and receiver disagree and nobody knows
who errs: refused for 2 s the source is *latched* off, and ``gate_relock_s`` decides.

After a gap that left position worth less than a fix, three fixes must agree among themselves before
one is fused: the first would be believed to the metre. A receiver whose fixes always come seconds
apart cannot do that; there the gate alone judges.

Horizontal and vertical are two parts with the same state, side by side in the filter's; time going
back restores it with the rest. Cumulative-sum tests of a drift: Basseville & Nikiforov 1993, ch. 2.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.parameters import (
    FEEDFORWARD,
    GNSS_PSD,
    GNSS_TAU,
    PATIENCE_NS,
    RELOCK_NS,
    SOURCE_FAULTS,
)
from companion.estimation.update import (
    ACCEPTED,
    R_CHANNEL,
    R_DOF,
    R_GATE,
    R_INNOVATION,
    R_NIS,
    R_SCALE_USED,
    R_SD,
    R_SOURCE,
    R_VERDICT,
)
from companion.navigation.layout import (
    DX,
    GNSS_BIAS,
    L_GNSS,
    L_N,
    SOURCE,
    SOURCE_INTS,
    SOURCE_K,
    SOURCE_SIZE,
    T_VELOCITY_AID,
    VELOCITY_FIT,
)
from companion.navigation.layout import P as P_OFFSET
from companion.types import F64, I64

# --- entries of a part's floats; two axes where there are two
FAST, BASE, STEADY, PULL, LAST = 0, 2, 4, 6, 8
DRIFT_VAR = 10  # what dead reckoning may have added to u since the base was laid [m²]
AFTER_VAR = 11  # position variance after the last fix, fused or not [m²]
FUSED_VAR = 12  # and after the last one that was fused
AGREEING = 13  # fixes in a row that agree with the base, or after a gap with each other
MISFIT = 14  # |fast − base|² [m²]
MISFIT_VAR = 15  # its variance an axis without a fault [m²]
REFUSED = 16  # fixes in a row that were not fused
PULLED = 17  # (2) mean of the pull, as the base is of u: what the filter follows in good times
STEP = 19  # between the last two fixes [s]; 0 before there were two

# --- and of its integers; times in ns, 0 none
T_LAST, T_BASE, T_STEADY, T_REFUSED, T_FAULT, STATE, NEWS, RELOCK, AFRESH, REPORTED = range(10)

# AFRESH: the next fix that is fused lays a new base: after a gap, and where nothing vouched for the
# shadow since the last one

# --- STATE
TRUSTED, DRIFTS, STEPPED, LATCHED = 0, 1, 2, 3
# --- NEWS: what the decisions above the kernel have not been told yet
DECLARED, RETURNED = 1, 2
# --- RELOCK: the source has told one place for long; or only its own velocities could say so
ONE_PLACE, ASK_VELOCITY = 1, 2

REJECTED_SOURCE, REJECTED_UNCONFIRMED = 7.0, 8.0  # as types.Verdict
SOURCE_H = 16  # as types.Channel; the vertical part is the next

FAST_S, BASE_S, STEADY_S = 1.0, 60.0, 30.0
LIMIT = 5.5
"""Deviations of the misfit that are a drift: exp(−5.5²/2) = 3e-7 of independent looks, of which
means over a minute give some hundred an hour."""
AGREES = 9.21
"""χ² of a fix against the base, 99 %."""
MOVES = 16.0
"""χ² of a fix that tells another place than the steady mean."""
WINSOR, WINSOR_VAR = 3.0, 0.25
AGREEING_FIXES, CONFIRMING_FIXES, REFUSED_FIXES = 5.0, 2.0, 5.0
ARMED_NS = 10_000_000_000
"""A receiver that has just started is still finding its place."""
REFUSED_NS = 2_000_000_000
WITNESS_NS = 3_000_000_000
WITNESS_FIT = 4.0
"""Mean NIS per component of velocity up to which it is a witness: 1 is honest."""
DRIFT_MPS, DRIFT_CORRELATION_S = 0.05, 5.0
"""Error of dead reckoning on aided velocity that no covariance knows (lever arm, latency, Doppler
multipath): 0.05 m/s, the same for 5 s; over a minute 1.2 m."""
GAP_VAR = 4.0
"""Growth of position variance since a fused fix [m²], beside four times a fix's, that is a gap."""
LONGEST_STEP_S = 5.0


@njit("void(f8[::1], i8[::1])", cache=True, entry=True, counted=False)
def forget(s: F64, k: I64) -> None:
    """Know nothing of the source: position has been taken from it anew."""
    for i in range(2 * SOURCE_SIZE):
        s[SOURCE + i] = 0.0
    for i in range(2 * SOURCE_INTS):
        k[SOURCE_K + i] = 0


@njit("f8(i8[::1], f8[::1], i8, f8)", cache=True, counted=False)
def slow_variance(lay: I64, par: F64, part: int, r: float) -> float:
    """Variance of a receiver's slow error: as configured, else all of a fix's ``r`` [m²]."""
    if lay[L_GNSS] < 0:
        return r
    return float(par[GNSS_PSD + part] * par[GNSS_TAU] * 0.5)


@njit("f8(f8[::1], i8[::1], i8)", cache=True, entry=True, counted=False)
def position_variance(s: F64, lay: I64, part: int) -> float:
    """Variance of position an axis, of the horizontal or the vertical part [m²]."""
    n = lay[L_N]
    if part == 1:
        return float(s[P_OFFSET + 2 * n + 2])
    return float(0.5 * (s[P_OFFSET] + s[P_OFFSET + n + 1]))


@njit("b1(f8[::1], i8[::1], i8)", cache=True, entry=True, counted=False)
def witness(s: F64, k: I64, t: int) -> bool:
    """Whether aided velocity vouches for the shadow."""
    return bool(t - k[T_VELOCITY_AID] <= WITNESS_NS and s[VELOCITY_FIT] < WITNESS_FIT)


@njit("f8(f8[::1], i8, f8[::1], i8)", cache=True, counted=False)
def _square(f: F64, at: int, u: F64, m: int) -> float:
    """Square of the distance of ``u`` (m,) from the mean at ``at`` [m²]."""
    total = 0.0
    for i in range(m):
        total += (u[i] - f[at + i]) * (u[i] - f[at + i])
    return total


@njit("void(f8[::1], i8[::1], f8[::1], i8, i8)", cache=True, counted=False)
def _begin(f: F64, q: I64, u: F64, m: int, t: int) -> None:
    """Lay the base at this fix; the shadow begins at the filter's position."""
    for i in range(m):
        v = u[i] - f[PULL + i]
        f[FAST + i] = f[BASE + i] = f[STEADY + i] = f[LAST + i] = v
        f[PULL + i] = f[PULLED + i] = 0.0
    f[DRIFT_VAR] = f[MISFIT] = f[AGREEING] = f[REFUSED] = 0.0
    f[MISFIT_VAR] = 1.0
    q[T_LAST] = q[T_BASE] = q[T_STEADY] = t
    q[T_REFUSED] = q[STATE] = q[RELOCK] = q[AFRESH] = 0


@njit("void(f8[::1], i8[::1], f8[::1], i8, i8, f8, f8, f8, f8)", cache=True, counted=False)
def _means(
    f: F64, q: I64, u: F64, m: int, t: int, r: float, slow: float, tau: float, grown: float
) -> None:
    """Take ``u`` (m,) into the means, and work out the misfit and its variance.

    ``r`` variance of a fix, ``slow`` of its slow error of ``tau``, ``grown`` what position has
    become less certain by since the last fix [m²].
    """
    dt = min((t - q[T_LAST]) * 1e-9, LONGEST_STEP_S)
    if dt <= 0.0:
        return  # a fix that comes twice says nothing more
    gain = dt / (FAST_S + dt)
    off = math.sqrt(_square(f, FAST, u, m))
    most = WINSOR * math.sqrt(r + WINSOR_VAR)
    gain_in = gain * (most / off if off > most else 1.0)
    age = min((t - q[T_BASE]) * 1e-9, BASE_S)
    base_gain = dt / (age + dt)
    trusted = q[STATE] == TRUSTED
    if trusted:
        f[DRIFT_VAR] *= max(0.0, 1.0 - 2.0 * base_gain)
    f[DRIFT_VAR] += grown + 2.0 * DRIFT_MPS * DRIFT_MPS * DRIFT_CORRELATION_S * dt
    f[MISFIT] = 0.0
    for i in range(m):
        f[FAST + i] += gain_in * (u[i] - f[FAST + i])
        if trusted:
            f[BASE + i] += base_gain * (f[FAST + i] - f[BASE + i])
            f[PULLED + i] += base_gain * (f[PULL + i] - f[PULLED + i])
        f[MISFIT] += (f[FAST + i] - f[BASE + i]) * (f[FAST + i] - f[BASE + i])
    f[MISFIT_VAR] = r * gain / (2.0 - gain) + slow * age / (age + tau) + f[DRIFT_VAR]
    drifted = 2.0 * DRIFT_MPS * DRIFT_MPS * DRIFT_CORRELATION_S * STEADY_S
    spread = r + slow * STEADY_S / (STEADY_S + tau) + drifted
    if _square(f, STEADY, u, m) > MOVES * spread:
        q[T_STEADY] = t
        for i in range(m):
            f[STEADY + i] = u[i]
    else:
        steady_gain = dt / (min((t - q[T_STEADY]) * 1e-9, STEADY_S) + dt)
        for i in range(m):
            f[STEADY + i] += steady_gain * (u[i] - f[STEADY + i])


@njit("void(f8[::1], i8[::1], i8, b1)", cache=True, counted=False)
def _declare(f: F64, q: I64, t: int, vouched: bool) -> None:
    """Whether a trusted source is a fault from this fix on."""
    drifts = f[MISFIT] > LIMIT * LIMIT * f[MISFIT_VAR] and t - q[T_BASE] >= ARMED_NS
    one_place = t - q[T_STEADY] >= REFUSED_NS and f[REFUSED] >= REFUSED_FIXES
    refused = q[T_REFUSED] > 0 and t - q[T_REFUSED] >= REFUSED_NS and one_place
    if drifts and vouched:
        q[STATE] = DRIFTS
    elif refused and vouched and t - q[T_BASE] >= ARMED_NS:
        q[STATE] = STEPPED
    elif refused:
        q[STATE] = LATCHED
    else:
        return
    q[T_FAULT], q[NEWS] = t, DECLARED
    f[AGREEING] = 0.0


@njit("void(f8[::1], i8[::1], f8[::1], i8, f8)", cache=True, counted=False)
def _take_back(f: F64, q: I64, u: F64, m: int, near: float) -> None:
    """Whether a faulty source is trusted again: ``near`` is the variance of u about the base."""
    f[AGREEING] = f[AGREEING] + 1.0 if _square(f, BASE, u, m) <= AGREES * near else 0.0
    if f[AGREEING] < AGREEING_FIXES:
        return
    q[STATE], q[NEWS], q[T_REFUSED] = TRUSTED, RETURNED, 0
    f[REFUSED] = f[AGREEING] = 0.0
    q[AFRESH] = 1 if f[DRIFT_VAR] > GAP_VAR else 0
    for i in range(m):
        f[FAST + i] = u[i]


@njit("void(i8[::1], i8[::1], i8, b1)", cache=True, counted=False)
def _may_relock(q: I64, ipar: I64, t: int, vouched: bool) -> None:
    """Whether the filter should take the source's word: it has told one place for long enough."""
    q[RELOCK] = 0
    since = q[T_FAULT] if q[STATE] != TRUSTED else q[T_REFUSED]
    if since == 0:
        return
    patience = ipar[RELOCK_NS]
    if q[STATE] == DRIFTS or q[STATE] == STEPPED:
        agreed = q[T_FAULT] - q[T_BASE]
        patience = max(patience, min(agreed, ipar[PATIENCE_NS]))
    if t - since >= patience:
        if t - q[T_STEADY] >= patience:
            q[RELOCK] = ONE_PLACE
        elif not vouched:
            q[RELOCK] = ASK_VELOCITY


@njit(
    "f8(f8[::1], i8[::1], i8[::1], f8[::1], i8[::1], i8, f8[::1], f8[::1], i8, f8[::1])",
    cache=True,
    counted=False,
)
def weigh(
    s: F64, k: I64, lay: I64, par: F64, ipar: I64, part: int, y: F64, R: F64, t: int, u: F64
) -> float:
    """Hold a fix against the shadow before it is gated: the verdict that bars it, or ACCEPTED.

    ``part`` 0 horizontal, 1 vertical; ``y`` (3,) innovation against the nominal state [m], its
    first one or two entries used, ``R`` (3,) variances [m²]; ``u`` (≥ 2,) is scratch.
    """
    f = s[SOURCE + part * SOURCE_SIZE : SOURCE + (part + 1) * SOURCE_SIZE]
    q = k[SOURCE_K + part * SOURCE_INTS : SOURCE_K + (part + 1) * SOURCE_INTS]
    m, axis = 2 - part, 2 * part
    r = 0.0
    for i in range(m):
        r += R[i] / m
        u[i] = y[i] + s[GNSS_BIAS + axis + i] + f[PULL + i]
        if ipar[FEEDFORWARD] == 1:
            u[i] -= s[DX + axis + i]
    here = position_variance(s, lay, part)
    if q[T_BASE] == 0:
        _begin(f, q, u, m, t)
        f[FUSED_VAR] = here
        return ACCEPTED
    vouched = witness(s, k, t)
    slow, tau = slow_variance(lay, par, part, r), par[GNSS_TAU]
    near = _square(f, LAST, u, m) <= AGREES * (2.0 * r + DRIFT_MPS * DRIFT_MPS)
    grown = max(0.0, here - f[AFTER_VAR]) * max(1.0, s[VELOCITY_FIT])
    _means(f, q, u, m, t, r, slow, tau, grown)
    step, before = (t - q[T_LAST]) * 1e-9, f[STEP]
    f[STEP] = step
    recent = step <= LONGEST_STEP_S
    for i in range(m):
        f[LAST + i] = u[i]
    q[T_LAST] = t
    if ipar[SOURCE_FAULTS] == 1:
        if q[STATE] != TRUSTED:
            _take_back(f, q, u, m, r + slow * BASE_S / (BASE_S + tau) + f[DRIFT_VAR])
        else:
            q[AFRESH] = 0 if vouched else 1
            # A receiver that is slow at all times has no neighbours to confirm a fix by.
            slow_receiver = not recent and (before > LONGEST_STEP_S or before == 0.0)
            if here - f[FUSED_VAR] > 4.0 * r + GAP_VAR and not slow_receiver:
                q[AFRESH] = 1
                f[AGREEING] = f[AGREEING] + 1.0 if near and recent else 0.0
                if f[AGREEING] < CONFIRMING_FIXES:
                    # A filter that runs away makes each fix disagree with the last: not for good.
                    _may_relock(q, ipar, t, vouched)
                    return REJECTED_UNCONFIRMED
            _declare(f, q, t, vouched)
    _may_relock(q, ipar, t, vouched)
    return REJECTED_SOURCE if q[STATE] != TRUSTED else ACCEPTED


@njit("void(f8[::1], i8[::1], i8[::1], i8, f8[::1], i8, f8)", cache=True, counted=False)
def settle(s: F64, k: I64, lay: I64, part: int, dx: F64, t: int, verdict: float) -> None:
    """Note what became of a fix that was weighed; ``dx`` (n,) the correction if it was fused."""
    f = s[SOURCE + part * SOURCE_SIZE : SOURCE + (part + 1) * SOURCE_SIZE]
    q = k[SOURCE_K + part * SOURCE_INTS : SOURCE_K + (part + 1) * SOURCE_INTS]
    m, axis = 2 - part, 2 * part
    f[AFTER_VAR] = position_variance(s, lay, part)
    if verdict == ACCEPTED:
        for i in range(m):
            f[PULL + i] += dx[axis + i]
        f[FUSED_VAR], f[REFUSED] = f[AFTER_VAR], 0.0
        q[T_REFUSED] = 0
        if q[AFRESH] == 1:
            _begin(f, q, f[LAST : LAST + m], m, t)
    elif verdict != REJECTED_UNCONFIRMED:
        f[REFUSED] += 1.0
        if q[T_REFUSED] == 0:
            q[T_REFUSED] = t


@njit("b1(i8[::1])", cache=True, counted=False)
def undecided(k: I64) -> bool:
    """Whether a decision above the kernel is due: something to tell, or a relock."""
    for part in range(2):
        at = SOURCE_K + part * SOURCE_INTS
        if k[at + NEWS] != 0 or k[at + RELOCK] != 0:
            return True
    return False


@njit("b1(f8[::1], i8[::1], i8, i8, i8, f8[::1])", cache=True, counted=False)
def report_source(s: F64, k: I64, part: int, source: int, t: int, report: F64) -> bool:
    """Fill a report row with the misfit, at the first fix of a second and where the state changes.

    Its innovation is fast − base [m], its NIS what is held against :data:`LIMIT` squared; its gate
    is infinite where nothing vouches for the shadow, or the base is too young.
    """
    f = s[SOURCE + part * SOURCE_SIZE : SOURCE + (part + 1) * SOURCE_SIZE]
    q = k[SOURCE_K + part * SOURCE_INTS : SOURCE_K + (part + 1) * SOURCE_INTS]
    cell = 4 * (t // 1_000_000_000) + q[STATE]
    if cell == q[REPORTED]:
        return False
    q[REPORTED] = cell
    m = 2 - part
    sd = math.sqrt(f[MISFIT_VAR])
    report[R_CHANNEL], report[R_SOURCE], report[R_DOF] = SOURCE_H + part, source, m
    for i in range(3):
        report[R_INNOVATION + i] = f[FAST + i] - f[BASE + i] if i < m else np.nan
        report[R_SD + i] = sd if i < m else np.nan
    armed = t - q[T_BASE] >= ARMED_NS and (q[STATE] != TRUSTED or witness(s, k, t))
    report[R_NIS], report[R_GATE] = f[MISFIT] / f[MISFIT_VAR], LIMIT * LIMIT if armed else np.inf
    report[R_SCALE_USED] = 1.0
    report[R_VERDICT] = ACCEPTED if q[STATE] == TRUSTED else REJECTED_SOURCE
    for i in range(R_VERDICT + 1, report.shape[0]):
        report[i] = 0.0
    return True
