"""Which unit is trusted: excluded with a name for its fault, and let back after proof.

Far off for two windows: with three units or more it is known which one, and it is excluded; two can
only say that they disagree. A unit that is silent, repeats itself or stays at full scale accuses
itself. Who comes back has to agree for a while, twice as long each time. One is always trusted.
"""

from __future__ import annotations

import numpy as np

from companion._jit import njit
from companion.intake.fusion.combine import middle
from companion.intake.fusion.judge import (
    LEARNING,
    follow,
    hold_against,
    learn_noise,
    noise_of,
    note_pull,
    set_weights,
    undo,
)
from companion.intake.fusion.layout import (
    AGREE_SINCE,
    AGREED,
    BEFORE,
    C_EXCLUDE,
    C_PROOF_S,
    CENTRE,
    CENTRE_BEFORE,
    DISAGREE,
    DISAGREED,
    DRIFTING,
    END,
    EPOCHS,
    EXCLUDED,
    EXCLUSIONS,
    FROZEN,
    GOOD_SINCE,
    HAVE_BEFORE,
    LAST_ONE,
    NOISY,
    NOISY_UNIT,
    ONSET,
    OVER,
    PERIOD,
    PROOF,
    RAILED,
    RATIO,
    RETURNED,
    RING,
    SAME,
    SAMPLES,
    SATURATED,
    SCALED,
    SCATTER,
    SILENT,
    STEPPED,
    SUM_E,
    SUM_EE,
    T_CHANGE,
    TOLD,
    TRUSTED,
    VAR_0,
    WHY,
    WINDOWS,
    WORST,
)
from companion.types import F64, I64

OVER_WINDOWS = 2
MUCH_NOISE = 16.0
"""Variance over the usual one, and over that of the others, that is a fault."""
NOISY_WINDOWS = 4
SILENT_S = 0.2
UNHEARD_WINDOWS = 8
"""After so many, two seconds, a unit that was never heard is silent."""
FROZEN_S, FROZEN_SAMPLES = 0.2, 10
RAILED_SHARE = 0.2
LONGEST_PROOF_S = 600.0
EXPLAINED, LEAST_SCALE = 0.8, 0.03
"""Share of a deviation that is proportional to what was measured, and by how much, for a fault of
scale."""
PLAIN = 3.0
"""Standard deviations from which such a fault would show."""
SUDDEN = 0.1
"""Deviation in the last good window, as a share of what it has become, below which it is a step."""


@njit("i8(i8, i8, i8, f8[:, ::1], i8[:, ::1], i8[:, ::1])", cache=True)
def accuses_itself(u: int, t: int, windows: int, s: F64, k: I64, T: I64) -> int:
    """What is wrong with unit ``u`` at ``t`` by its own samples; ``TRUSTED`` where nothing is."""
    if k[u, END] == 0:
        return SILENT if windows > UNHEARD_WINDOWS else TRUSTED
    newest = T[u, (k[u, END] - 1) % RING]
    if (t - newest) * 1e-9 > SILENT_S + 2.0 * s[u, PERIOD]:
        return SILENT
    still = (newest - k[u, T_CHANGE]) * 1e-9
    if still > FROZEN_S and k[u, SAME] >= FROZEN_SAMPLES:
        return FROZEN
    if k[u, RAILED] > RAILED_SHARE * max(k[u, SAMPLES], 1):
        return SATURATED
    return TRUSTED


@njit("i8(i8, f8[::1], f8[:, ::1], i8[:, ::1], f8[::1])", cache=True)
def _name(u: int, typical: F64, s: F64, k: I64, common: F64) -> int:
    """What kind of fault a deviation looks like.

    Of scale where it began at once, or the least one would have shown: while next to nothing is
    measured, that explains nothing.
    """
    if k[u, RAILED] > 0:
        return SATURATED
    worst = int(s[u, WORST])
    sensor = worst // 3
    o = 3 * sensor
    xy, xx, yy = 0.0, 0.0, 0.0
    for a in range(o, o + 3):
        xy += s[u, SUM_E + a] * common[CENTRE + a]
        xx += common[CENTRE + a] ** 2
        yy += s[u, SUM_E + a] ** 2
    shows = LEAST_SCALE * LEAST_SCALE * xx > PLAIN * PLAIN * typical[sensor]
    sudden = abs(s[u, ONSET + worst]) < SUDDEN * abs(s[u, WORST + 1])
    if (shows or sudden) and abs(xy) > LEAST_SCALE * xx and xy * xy > EXPLAINED * xx * yy:
        return SCALED
    if s[u, SUM_EE + sensor] > MUCH_NOISE * common[SCATTER + sensor]:
        return NOISY_UNIT
    return STEPPED if sudden else DRIFTING


@njit("i8(i8, i8, i8, i8, f8, f8, f8[:, ::1])", cache=True)
def _tell(count: int, what: int, u: int, why: int, axis: float, by: float, news: F64) -> int:
    """Add a piece of news; how many there are then."""
    news[count, 0], news[count, 1], news[count, 2] = what, u, why
    news[count, 3], news[count, 4] = axis, by
    return count + 1


@njit(
    "i8(i8, i8, i8, i8, f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[::1], f8[::1], i8, f8[:, ::1])",
    cache=True,
)
def _exclude(
    u: int,
    why: int,
    t: int,
    trusted: int,
    s: F64,
    k: I64,
    terms: F64,
    common: F64,
    config: F64,
    count: int,
    news: F64,
) -> int:
    """Exclude unit ``u``, unless it is the last one; that is news either way."""
    if trusted < 2:
        if k[u, TOLD] == 0:
            count = _tell(count, LAST_ONE, u, why, s[u, WORST], s[u, WORST + 1], news)
        k[u, TOLD] = 1
        return count
    k[u, WHY] = why
    k[u, EXCLUSIONS] += 1
    k[u, GOOD_SINCE] = t
    k[u, OVER] = k[u, NOISY] = 0
    undo(u, s, terms, common)
    s[u, PROOF] = min(max(2.0 * s[u, PROOF], config[C_PROOF_S]), LONGEST_PROOF_S)
    return _tell(count, EXCLUDED, u, why, s[u, WORST], s[u, WORST + 1], news)


@njit("void(i8[::1], i8[::1], f8[:, ::1], i8[:, ::1], f8[:, :, :, ::1], i8)", cache=True)
def _note_noise(present: I64, trusted: I64, unit: F64, k: I64, pairs: F64, windows: int) -> None:
    """Count the windows in which a unit has been much noisier than usual and than the others."""
    units = present.shape[0]
    usual, now, near = np.empty(units), np.empty(units), np.empty(units)
    noisy = np.zeros(units, np.int64)
    for sensor in range(2):
        noise_of(present, unit, sensor, 0, pairs, usual)
        noise_of(present, unit, sensor, 1, pairs, now)
        for u in range(units):
            m = 0
            for i in range(units):
                if i != u and trusted[i] == 1 and present[i] == 1:
                    near[m] = now[i]
                    m += 1
            # Of two, none can say whose the noise is.
            if present[u] == 1 and m > 1:
                limit = max(usual[u], unit[u, VAR_0 + sensor])
                loud = now[u] > MUCH_NOISE * limit and now[u] > MUCH_NOISE * middle(near, m)
                noisy[u] = 1 if loud else noisy[u]
    for u in range(units):
        k[u, NOISY] = k[u, NOISY] + 1 if noisy[u] == 1 and windows > LEARNING else 0


@njit("void(i8[::1], f8[:, ::1], i8[:, ::1], f8[::1], i8[::1])", cache=True)
def _average(present: I64, s: F64, k: I64, common: F64, clock: I64) -> None:
    """Sums of the window into means and scatter about them; the usual scatter of all."""
    units = s.shape[0]
    near = np.empty(units)
    for a in range(6):
        common[CENTRE + a] /= max(clock[EPOCHS], 1)
    for u in range(units):
        # Half a window, or it is no mean over it.
        present[u] = 1 if 2 * k[u, SAMPLES] >= clock[EPOCHS] and k[u, SAMPLES] > 1 else 0
        for a in range(6):
            s[u, SUM_E + a] /= max(k[u, SAMPLES], 1)
        for sensor in range(2):
            s[u, SUM_EE + sensor] /= max(k[u, SAMPLES], 1)
            for a in range(3 * sensor, 3 * sensor + 3):
                s[u, SUM_EE + sensor] -= s[u, SUM_E + a] ** 2 / 3.0
    for sensor in range(2):
        m = 0
        for u in range(units):
            if present[u] == 1 and k[u, WHY] == TRUSTED:
                near[m] = s[u, SUM_EE + sensor]
                m += 1
        if m > 2:
            share = max(0.05, 1.0 / (1.0 + clock[WINDOWS]))
            # The mean of three about their median is a third smaller than it should be.
            step = 1.5 * middle(near, m) - common[SCATTER + sensor]
            common[SCATTER + sensor] += share * step


@njit("void(f8[:, ::1], i8[:, ::1], i8[::1], f8[::1], i8[::1])", cache=True)
def _begin(s: F64, k: I64, present: I64, common: F64, clock: I64) -> None:
    """Begin the next window."""
    for u in range(s.shape[0]):
        for a in range(6):
            s[u, BEFORE + a] = s[u, SUM_E + a]
            s[u, SUM_E + a] = 0.0
        s[u, SUM_EE] = s[u, SUM_EE + 1] = 0.0
        k[u, HAVE_BEFORE] = present[u]
        k[u, SAMPLES] = k[u, RAILED] = 0
    for a in range(6):
        common[CENTRE_BEFORE + a] = common[CENTRE + a]
        common[CENTRE + a] = 0.0
    clock[WINDOWS] += 1
    clock[EPOCHS] = 0


@njit(
    "i8(i8, i8, f8[::1], f8[::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[::1], i8[::1], i8,"
    "f8[:, ::1])",
    cache=True,
)
def _accuse(
    t: int,
    trusted: int,
    config: F64,
    typical: F64,
    s: F64,
    k: I64,
    terms: F64,
    common: F64,
    clock: I64,
    count: int,
    news: F64,
) -> int:
    """Of the trusted units that lie far off, exclude the worst, or say that two disagree."""
    worst = -1
    for u in range(s.shape[0]):
        guilty = k[u, OVER] >= OVER_WINDOWS or k[u, NOISY] >= NOISY_WINDOWS
        if k[u, WHY] == TRUSTED and guilty and (worst < 0 or s[u, RATIO] > s[worst, RATIO]):
            worst = u
    if trusted == 2:
        if worst >= 0:
            clock[AGREE_SINCE] = t
            if clock[DISAGREE] == 0:
                clock[DISAGREE] = t
                count = _tell(
                    count, DISAGREED, worst, 0, s[worst, WORST], 2.0 * s[worst, WORST + 1], news
                )
    elif worst >= 0:
        why = _name(worst, typical, s, k, common)
        count = _exclude(worst, why, t, trusted, s, k, terms, common, config, count, news)
    if clock[DISAGREE] > 0:
        agreed = (t - clock[AGREE_SINCE]) * 1e-9 >= config[C_PROOF_S]
        if agreed or trusted > 2 or trusted < 2:
            clock[DISAGREE] = 0
            count = _tell(count, AGREED, 0, 0, 0.0, 0.0, news)
    return count


@njit("i8(i8, i8, i8, f8[:, ::1], i8[:, ::1], i8, f8[:, ::1])", cache=True)
def _admit(u: int, t: int, present: int, s: F64, k: I64, count: int, news: F64) -> int:
    """Let an excluded unit back that has agreed for long enough."""
    if k[u, WHY] == TRUSTED:
        return count
    if present == 0 or k[u, OVER] > 0 or k[u, NOISY] > 0:
        k[u, GOOD_SINCE] = t
    if (t - k[u, GOOD_SINCE]) * 1e-9 < s[u, PROOF]:
        return count
    why = k[u, WHY]
    k[u, WHY] = TRUSTED
    return _tell(count, RETURNED, u, why, 0.0, s[u, PROOF], news)


@njit(
    "i8(i8, f8[::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[:, :, :, ::1],"
    "f8[:, :, :, ::1], f8[::1], i8[::1], i8[:, ::1], f8[:, ::1])",
    cache=True,
)
def close_window(
    t: int,
    config: F64,
    unit: F64,
    s: F64,
    k: I64,
    terms: F64,
    P: F64,
    pairs: F64,
    common: F64,
    clock: I64,
    T: I64,
    news: F64,
) -> int:
    """Judge every unit at the end of a window; how many rows of ``news`` there are."""
    units = s.shape[0]
    present, trusted = np.zeros(units, np.int64), np.zeros(units, np.int64)
    follows, own = np.zeros(units, np.int64), np.zeros(units, np.int64)
    typical = np.array([unit[0, VAR_0], unit[0, VAR_0 + 1]])
    least = np.empty(2)
    _average(present, s, k, common, clock)
    many, count = 0, 0
    for u in range(units):
        many += k[u, WHY] == TRUSTED
    for u in range(units):
        own[u] = accuses_itself(u, t, clock[WINDOWS], s, k, T)
        if own[u] == TRUSTED:
            k[u, TOLD] = 0
        elif k[u, WHY] != TRUSTED:
            k[u, GOOD_SINCE] = t
        elif config[C_EXCLUDE] > 0.0:
            count = _exclude(u, own[u], t, many, s, k, terms, common, config, count, news)
            many -= k[u, WHY] != TRUSTED
    for u in range(units):
        trusted[u] = 1 if k[u, WHY] == TRUSTED and present[u] == 1 else 0
    learn_noise(present, s, k, pairs, clock[WINDOWS], least)
    set_weights(trusted, unit, s, pairs, least, typical)
    note_pull(clock[EPOCHS], s)
    _note_noise(present, trusted, unit, k, pairs, clock[WINDOWS])
    for u in range(units):
        if present[u] == 1 and many > 0:
            hold_against(u, many, config, typical, unit, s, k, terms, P, common)
    if config[C_EXCLUDE] > 0.0:
        count = _accuse(t, many, config, typical, s, k, terms, common, clock, count, news)
    for u in range(units):
        count = _admit(u, t, present[u], s, k, count, news)
        calm = k[u, OVER] == 0 and clock[DISAGREE] == 0 and many > 1
        # What a unit makes up says nothing of how it differs.
        learns = own[u] == TRUSTED and (calm or k[u, WHY] != TRUSTED)
        follows[u] = present[u] if learns else 0
    follow(follows, typical, unit, s, k, terms, P, common)
    _begin(s, k, present, common, clock)
    return count
