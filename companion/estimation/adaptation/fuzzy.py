"""Fuzzy covariance scaling: rules over spread and mean, each channel's R and the unit's Q.

    weight of a rule = membership of spread × membership of mean        (nine, they sum to 1)
    ln scale = Σ weight · ln action                                     (Takagi and Sugeno 1985)

Memberships are ramps between quantiles of the inputs' own distributions, so a healthy sensor fires
the usual rules whatever its unit, rate or noise. A mean is attributed before anything is scaled:
the share that the inertial unit may have caused goes to Q, the share that is correlated without
such a cause is a fault of the source and holds what is in force; the rest goes to R.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.estimation.adaptation.evidence import strain
from companion.estimation.adaptation.layout import (
    DRIFT,
    FIRING,
    HOLD,
    IN_CORRELATION,
    IN_MEAN,
    IN_SPREAD,
    MATCH,
    MOTION,
    Q_WISH,
    TO_MODEL,
    TO_SOURCE,
)
from companion.estimation.adaptation.parameters import (
    FALL,
    LENGTH,
    ODD,
    Q_MAX,
    Q_TABLE,
    R_MAX,
    R_MIN,
    R_TABLE,
    RISE,
    UNUSUAL,
    USUAL,
)
from companion.estimation.adaptation.window import push, statistics
from companion.navigation.layout import (
    ADAPTED,
    Q_SCALE,
    R_LEAST,
    R_SCALE,
    RECEPTION,
    WINDOW_SIZE,
    WINDOWS,
)
from companion.types import F64

# channels, as types.Channel
_VEL_H, _VEL_V, _MAG = 2, 3, 5
SMALLEST = 1e-9
"""Ratio of variances that is as good as none."""


@njit("f8(f8, f8, f8)", cache=True)
def ramp(x: float, low: float, high: float) -> float:
    """0 up to ``low``, 1 from ``high`` on, a line between."""
    if x <= low:
        return 0.0
    return 1.0 if x >= high else (x - low) / (high - low)


@njit("void(f8[::1], f8, f8, f8[::1])", cache=True)
def fire(a: F64, mean: float, spread: float, weights: F64) -> None:
    """``weights`` (9,) of the rules, spread by spread, from the deviates of mean and spread."""
    low = ramp(-spread, a[USUAL], a[UNUSUAL])
    high = ramp(spread, a[USUAL], a[UNUSUAL])
    not_zero = ramp(mean, a[USUAL], a[ODD])
    large = ramp(mean, a[ODD], a[UNUSUAL])
    for i in range(3):
        x = low if i == 0 else (high if i == 2 else 1.0 - low - high)
        weights[3 * i] = x * (1.0 - not_zero)
        weights[3 * i + 1] = x * (not_zero - large)
        weights[3 * i + 2] = x * large


@njit("f8(f8[::1], i8, f8[::1], f8[::1], f8, f8, f8)", cache=True)
def conclude(
    a: F64, table: int, weights: F64, shares: F64, now: float, match: float, rest: float
) -> float:
    """Weighted mean of the actions of a table, as factors: of their logarithms.

    ``shares`` (3,) by mean: how much of a rule's weight counts here; ``rest`` is the action of what
    does not.
    """
    total = 0.0
    for i in range(9):
        action = a[table + i]
        value = now if action == HOLD else (match if action == MATCH else 1.0)
        share = shares[i % 3]
        total += weights[i] * (share * math.log(value) + (1.0 - share) * math.log(rest))
    return math.exp(total)


@njit("f8(f8, f8, f8[::1], f8, f8)", cache=True)
def slew(now: float, target: float, a: F64, low: float, high: float) -> float:
    """``now`` on its way to ``target``: fast up, slowly down, within bounds; never NaN."""
    x = max(min(target, now * a[RISE]), now / a[FALL])
    return min(max(x, low), high) if x == x else now


@njit("UniTuple(f8, 2)(f8[::1], f8[::1], i8, f8)", cache=True)
def attribute(s: F64, w: F64, channel: int, correlated: float) -> tuple[float, float]:
    """Shares of a mean that are the inertial unit's and the source's; the rest is noise.

    A Doppler velocity has hardly an error that lasts: a mean there is the inertial unit's, and what
    it did to velocity it did to position. Fewer satellites or less accuracy than usual, or
    interference: the receiver says itself where the mean comes from.
    """
    model = 1.0
    if channel != _VEL_H and channel != _VEL_V:
        witness = WINDOWS + (_VEL_H if channel == 0 else _VEL_V) * WINDOW_SIZE
        # A field is turned by what carries it, most while that moves: no witness of the unit.
        model = 0.0 if channel == _MAG else max(w[MOTION], s[witness + DRIFT])
    received = 1.0 - s[RECEPTION] if channel <= _VEL_V else 1.0
    model *= received
    return model, (received - model) * correlated


@njit("f8(f8[::1], f8[::1], f8[::1], i8, i8, f8[::1], f8, f8, f8, f8, f8[::1])", cache=True)
def fuzzy_scale(
    s: F64,
    par: F64,
    a: F64,
    channel: int,
    m: int,
    u: F64,
    nis: float,
    gate: float,
    foreseen: float,
    said: float,
    trace: F64,
) -> float:
    """Take in one innovation of ``channel``; the factor on R from here on.

    ``u`` (3,) whitened with R as it is said, ``nis`` = |u|²; ``foreseen``, ``said``: means over the
    components of H P Hᵀ and R. ``trace`` is filled.
    """
    w = s[WINDOWS + channel * WINDOW_SIZE : WINDOWS + (channel + 1) * WINDOW_SIZE]
    length = int(a[LENGTH])
    now = float(s[R_SCALE + channel])
    r = foreseen / said
    # Winsorised at the gate in force: what is refused still counts, but for no more than what just
    # passes, so neither lock-out nor poisoning can come of it.
    limit = gate * (r + now) / (r + 1.0)
    shrink = math.sqrt(limit / nis) if nis > limit else 1.0
    push(w, length, u[0] * shrink, u[1] * shrink, u[2] * shrink)
    w[MOTION] = max(strain(s, par), w[MOTION] * (1.0 - 2.0 / length))
    found = np.empty(7)
    weights = trace[FIRING : FIRING + 9]
    if not statistics(w, length, m, found):
        return now
    mean, spread, correlation = found[0], found[1], found[2]
    scatter = found[3]
    if channel < _VEL_H and spread > 0.0:
        # A step or a drift scatters about the mean, but not between neighbours: it is no noise, and
        # a position's faults have detectors of their own.
        scatter, spread = min(scatter, found[5]), max(min(spread, found[6]), 0.0)
    fire(a, mean, spread, weights)
    correlated = ramp(correlation, a[USUAL], a[UNUSUAL])
    w[DRIFT] = correlated * ramp(mean, a[USUAL], a[UNUSUAL])
    model, source = attribute(s, w, channel, correlated)
    shares = np.array([1.0, 1.0 - model - source, 1.0 - model - source])
    # A mean is noise only as far as the receiver itself says that it receives badly.
    lost = s[RECEPTION] if channel <= _VEL_V else 0.0
    match_r = 1.0 + (scatter + lost * max(found[4] - scatter / length, 0.0) - 1.0) * (1.0 + r)
    # What a receiver claims beyond its configuration may be disproved, but not where it claims more
    # than usual, nor by innovations that are alike: an error that lasts does not scatter.
    least = max(a[R_MIN], SMALLEST)
    if channel <= _VEL_V:
        least *= max(s[R_LEAST], SMALLEST) ** ((1.0 - lost) * (1.0 - correlated))
    target = conclude(a, R_TABLE, weights, shares, now, min(max(match_r, least), a[R_MAX]), now)
    now = slew(now, target, a, least, a[R_MAX])
    s[R_SCALE + channel] = now
    shares[0], shares[1], shares[2] = model, model, model
    # What of the mean R does not explain, P has to: H P Hᵀ so many times larger. Of a state that
    # noise drives and aids hold, P goes with the root of Q.
    unexplained = max(found[4] - (r + now) / ((r + 1.0) * length), 0.0)
    match_p = min(1.0 + unexplained * (1.0 + 1.0 / max(r, SMALLEST)), a[Q_MAX])
    wish = 1.0 + w[Q_WISH]
    target = conclude(a, Q_TABLE, weights, shares, wish, min(match_p * match_p, a[Q_MAX]), 1.0)
    w[Q_WISH] = slew(wish, target, a, 1.0, a[Q_MAX]) - 1.0
    trace[IN_MEAN], trace[IN_SPREAD], trace[IN_CORRELATION] = mean, spread, correlation
    trace[TO_MODEL], trace[TO_SOURCE] = model, source
    return now


@njit("void(f8[::1])", cache=True)
def gather_q(s: F64) -> None:
    """The factor on Q in force: the largest that a channel asks for."""
    q = 0.0
    for channel in range(ADAPTED):
        q = max(q, s[WINDOWS + channel * WINDOW_SIZE + Q_WISH])
    s[Q_SCALE] = np.float32(1.0 + q)
