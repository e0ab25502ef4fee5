"""Recovery: position, level or heading taken anew, and what is told of a source on the way.

Sources are judged in source_faults.py, fix by fix; here its verdicts become events, a drift that
had been followed is taken back, and a source that has told one place for long is believed.
"""

from __future__ import annotations

import math

import numpy as np

from companion.estimation import parameters as par
from companion.estimation import source_faults as sf
from companion.estimation import walk as w
from companion.estimation.aid_table import KIND_GNSS
from companion.estimation.bank import spread_headings
from companion.estimation.buffers import SampleBuffer
from companion.estimation.phases import Check, Filter, Phase, Setup
from companion.estimation.source_words import (
    begun_anew,
    declared,
    rejoined,
    relocked,
    returned,
    taken_back,
)
from companion.estimation.start import place_at
from companion.navigation import layout as lo
from companion.navigation.earth import ned_difference
from companion.navigation.error_model import box_plus
from companion.types import F64, I64, NS, Event, Mode

RELOCK_FIXES = 4
LOST_TILT_SD = math.radians(3.0)
FAR_SD = 2.5
"""Deviations of the misfit from which on the filter is at the wrong place, not at a noisy one."""
FOLLOWED_SD = math.sqrt(2.0)
"""The same where a drift has been declared, so that something is known to have been followed:
taking back an estimate w of it with variance σ² is a gain on average once w² − σ² > σ²."""

Decision = tuple[Phase | None, list[Event]]


def decide(setup: Setup, phase: Phase, t: int, aids: SampleBuffer) -> Decision:
    """What became of the source since the last decision, and whether something is taken anew."""
    f = phase.filters[0]
    refused = int(f.k[lo.REFUSED_SINCE])
    if refused and t - refused > setup.ipar[par.RELOCK_NS] and (fixes := agreeing_fixes(aids, t)):
        return _at_ranges(setup, f, t, aids, fixes)
    if f.s[lo.VELOCITY_FIT] > w.LOST_FIT and (fixes := agreeing_fixes(aids, t)):
        # Position alone can be off for long where a receiver erred; velocity that never fits means
        # that the attitude is wrong: on the move its heading, which nothing else holds; without way
        # over ground its level, by an inertial sensor that began to err (shaken, struck).
        s, k = _restarted(setup, f, t, aids, fixes)
        moving = f.s[lo.GNSS_GROUND_SPEED] > w.LOST_SPEED
        if moving and setup.config.alignment.heading != "fixed":
            found = _relearn_heading(setup, s, k, t)
        else:
            found = _relearn_level(setup, s, k, t)
        return found[0], [found[1]]
    events: list[Event] = []
    for part in range(2):
        q, x = _ints(f.k, part), _floats(f.s, part)
        news, q[sf.NEWS] = int(q[sf.NEWS]), 0
        if news == sf.RETURNED:
            events.append(returned(t, part, q))
            # Fixes that agree with the base, but not with a filter that had followed a drift.
            if _far(_way(x, part, sf.LAST), x, sf.position_variance(f.s, setup.lay, part)):
                events.append(rejoined(t, part))
                return _at_source(setup, f, t, part, aids), events
        elif news == sf.DECLARED:
            events.append(declared(setup, t, part, q, x))
            way = _way(x, part, sf.PULLED)
            if q[sf.STATE] == sf.DRIFTS and _far(way, x, deviations=FOLLOWED_SD):
                events.append(taken_back(t, part, way))
                return _without_pull(setup, f, t, part, way), events
    for part in range(2):
        q = _ints(f.k, part)
        since = int(q[sf.T_FAULT] if q[sf.STATE] != sf.TRUSTED else q[sf.T_REFUSED])
        if since == 0:
            continue  # a fix was fused after one had asked for it
        wish = int(q[sf.RELOCK])
        if wish == sf.ONE_PLACE or (wish == sf.ASK_VELOCITY and agreeing_fixes(aids, t)):
            events.append(relocked(t, part, q))
            return _at_source(setup, f, t, part, aids), events
        if wish == sf.ASK_VELOCITY and part == 0 and _without_velocity(aids, t):
            q = _ints(f.k, part)
            events.append(begun_anew(t, q))
            resets = int(f.k[lo.RESETS]) + 1
            return Phase(t + 1, Mode.ALIGNING, prior=f, resets=resets, reached=t), events
    return None, events


def _without_velocity(aids: SampleBuffer, t: int) -> bool:
    """Whether the receiver tells places alone: then it will never say what velocity is right.

    Refused for so long, with nothing to hold it against, it is the filter that is lost: a velocity
    that ran away comes of a wrong level or heading, which would run away again from any place.
    """
    recent = [
        m
        for m in range(aids.start, aids.after(t))
        if aids.key[m, 0] == KIND_GNSS and aids.t[m] > t - 5 * NS
    ]
    places = [m for m in recent if np.all(np.isfinite(aids.rows[m, :3]))]
    return len(places) >= RELOCK_FIXES and not np.isfinite(aids.rows[recent, 3:5]).any()


def _ints(k: I64, part: int) -> I64:
    """What is known of a part of the source, as a view: integers by the names of source_faults."""
    return k[lo.SOURCE_K + part * lo.SOURCE_INTS :][: lo.SOURCE_INTS]


def _floats(s: F64, part: int) -> F64:
    """The same for its floats."""
    return s[lo.SOURCE + part * lo.SOURCE_SIZE :][: lo.SOURCE_SIZE]


def _way(x: F64, part: int, mean: int) -> F64:
    """The way (3,) NED [m] from the filter's position to what a mean says of the shadow."""
    way = np.zeros(3)
    for i, axis in enumerate((0, 1) if part == 0 else (2,)):
        way[axis] = x[mean + i] - x[sf.PULL + i]
    return way


def _far(way: F64, x: F64, further: float = 0.0, deviations: float = FAR_SD) -> bool:
    """Whether a way is longer than slow error and dead reckoning, and ``further`` [m²], explain."""
    return float(way @ way) > deviations**2 * (float(x[sf.MISFIT_VAR]) + further)


def _whole(setup: Setup, f: Filter) -> tuple[F64, I64]:
    """State and integers as copies; in feedforward mode the error carried is applied."""
    s, k = f.s.copy(), f.k.copy()
    carried = s[lo.DX : lo.DX + setup.layout.n]
    if carried.any():
        box_plus(s, setup.lay, carried.copy())
        carried[:] = 0.0
    return s, k


def _navigating(setup: Setup, s: F64, k: I64, t: int) -> Phase:
    """The phase that goes on from ``s``, ``k``, one declared reset later."""
    k[lo.RESETS] += 1
    new = Phase(t + 1, Mode.NAVIGATING, [setup.new_filter(s, k)])
    new.checks = [Check(t)]
    return new


def _without_pull(setup: Setup, f: Filter, t: int, part: int, way: F64) -> Phase:
    """The filter without what it followed of a drift: as far off the shadow as in the last minute.

    Not at the base: there is the receiver, which may long have told another height than the rest.
    """
    s, k = _whole(setup, f)
    x = _floats(s, part)
    _move(setup, s, part, way, np.full(3, x[sf.MISFIT_VAR]))
    x[sf.PULL : sf.PULL + 2] = x[sf.PULLED : sf.PULLED + 2]
    return _navigating(setup, s, k, t)


def _at_source(setup: Setup, f: Filter, t: int, part: int, aids: SampleBuffer) -> Phase:
    """The filter at the place that the source has told for long."""
    s, k = _whole(setup, f)
    m = max(m for m in range(aids.start, aids.after(t)) if aids.key[m, 0] == KIND_GNSS)
    last, ahead = aids.rows[m], (t - int(aids.t[m])) / NS
    velocity = np.where(np.isfinite(last[3:6]), last[3:6], s[lo.VEL_N : lo.VEL_N + 3])
    off = ned_difference(*last[:3], *s[lo.LAT : lo.LAT + 3])
    moved = (1.0 + float(velocity @ velocity)) * ahead**2
    _move(setup, s, part, off + velocity * ahead, 4.0 * last[6:9] + moved)
    if not sf.witness(f.s, f.k, t):
        _take_velocity(setup, s, part, last, velocity, ahead)
    sf.forget(s, k)
    return _navigating(setup, s, k, t)


def _take_velocity(setup: Setup, s: F64, part: int, last: F64, velocity: F64, ahead: float) -> None:
    """Velocity of a part from a fix, ``ahead`` seconds old: nothing vouched for the filter's."""
    P = setup.covariance(s)
    for m in (0, 1) if part == 0 else (2,):
        s[lo.VEL_N + m] = velocity[m]
        P[3 + m, :], P[:, 3 + m] = 0.0, 0.0
        var = last[9 + m] if np.isfinite(last[3 + m]) else 9.0
        P[3 + m, 3 + m] = 4.0 * var + ahead**2


def _move(setup: Setup, s: F64, part: int, way: F64, variance: F64) -> None:
    """Move a part of the position by ``way`` (3,) NED [m], known then to ``variance`` (3,) [m²].

    What the receiver's slow error is stays open, as at a start (``start.place_at``).
    """
    axes = (0, 1) if part == 0 else (2,)
    dx = np.zeros(setup.layout.n)
    dx[list(axes)] = way[list(axes)]
    box_plus(s, setup.lay, dx)
    P, slow = setup.covariance(s), setup.layout.gnss
    prior = par.initial_variances(setup.config, setup.layout)
    for m in axes:
        P[m, :], P[:, m] = 0.0, 0.0
        P[m, m] = variance[m]
        if slow >= 0:
            s[lo.GNSS_BIAS + m] = 0.0
            P[slow + m, :], P[:, slow + m] = 0.0, 0.0
            P[slow + m, slow + m] = prior[slow + m]
            P[m, m] += prior[slow + m]
            P[m, slow + m] = P[slow + m, m] = -prior[slow + m]
    if part == 1 and setup.layout.baro >= 0:
        _tie_barometer(setup, s, float(way[2]))


def _tie_barometer(setup: Setup, s: F64, down: float) -> None:
    """The barometer's offset follows a height that was moved ``down`` [m]: it said z = h + b."""
    P, at = setup.covariance(s), setup.layout.baro
    s[lo.BARO_BIAS] += down
    P[at, :], P[:, at] = P[2, :].copy(), P[:, 2].copy()
    P[at, at] = P[2, 2] + setup.config.baro.sd_m**2


def agreeing_fixes(aids: SampleBuffer, t: int) -> list[int]:
    """The last few fixes where each foresees the next by its velocity; else none."""
    fixes = [
        m
        for m in range(aids.start, aids.after(t))
        if aids.key[m, 0] == KIND_GNSS
        and np.all(np.isfinite(aids.rows[m, :5]))
        and aids.t[m] > t - 5 * NS
    ][-RELOCK_FIXES:]
    if len(fixes) < RELOCK_FIXES:
        return []
    rows, times = aids.rows[fixes], aids.t[fixes]
    step = ned_difference(
        rows[1:, 0], rows[1:, 1], rows[1:, 2], rows[:-1, 0], rows[:-1, 1], rows[:-1, 2]
    )
    dt = np.diff(times)[:, None] / NS
    expected = 0.5 * (rows[1:, 3:5] + rows[:-1, 3:5]) * dt
    allowed = 3.0 * np.sqrt(rows[1:, 6:8] + rows[:-1, 6:8] + rows[1:, 9:11] * dt**2)
    return fixes if np.all(np.abs(step[:, :2] - expected) < allowed) else []


def _restarted(
    setup: Setup, f: Filter, t: int, aids: SampleBuffer, fixes: list[int]
) -> tuple[F64, I64]:
    """The state with position and velocity taken anew from the last agreeing fix."""
    s, k = _whole(setup, f)
    last = aids.rows[fixes[-1]]
    ahead = (t - int(aids.t[fixes[-1]])) / NS
    velocity = np.where(np.isfinite(last[3:6]), last[3:6], s[lo.VEL_N : lo.VEL_N + 3])
    moved = (1.0 + float(velocity @ velocity)) * ahead**2
    place_at(setup, s, last[:3], 4.0 * last[6:9] + moved)
    for part in range(2):
        _take_velocity(setup, s, part, last, velocity, ahead)
    # Innovations of what is given up say nothing of the sensors.
    s[lo.WINDOWS : lo.WINDOWS + lo.ADAPTED * lo.WINDOW_SIZE] = 0.0
    s[lo.VELOCITY_FIT] = s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = 0.0
    sf.forget(s, k)
    k[lo.RESETS] += 1
    return s, k


def _at_ranges(setup: Setup, f: Filter, t: int, aids: SampleBuffer, fixes: list[int]) -> Decision:
    """The filter at the place that the ranges tell among themselves, its clock found anew."""
    since = int(f.k[lo.REFUSED_SINCE])
    s, k = _restarted(setup, f, t, aids, fixes)
    P, clock = setup.covariance(s), setup.layout.clock
    for m in range(clock, clock + lo.CLOCK_STATES):
        P[m, :], P[:, m] = 0.0, 0.0
        P[m, m] = par.initial_variances(setup.config, setup.layout)[m]
    k[lo.REFUSED_SINCE] = 0
    new = Phase(t + 1, Mode.NAVIGATING, [setup.new_filter(s, k)])
    new.checks = [Check(t)]
    text = f"position reset to the ranges, most refused for {(t - since) / NS:.0f} s"
    return new, [Event(t, "relocked", text, "warning")]


def _relearn_level(setup: Setup, s: F64, k: I64, t: int) -> tuple[Phase, Event]:
    """Velocity never fits, without way over ground: level and biases are known roughly again."""
    P = setup.covariance(s)
    var = par.initial_variances(setup.config, setup.layout)
    yaw_var = P[8, 8]
    for m in range(6, 15):
        P[m, :], P[:, m] = 0.0, 0.0
        P[m, m] = var[m]
    P[6, 6] = P[7, 7] = LOST_TILT_SD**2
    P[8, 8] = yaw_var + LOST_TILT_SD**2
    new = Phase(t + 1, Mode.NAVIGATING, [setup.new_filter(s, k)])
    new.checks = [Check(t)]
    text = "velocity does not fit GNSS at rest: level and biases are learned again"
    return new, Event(t, "level-lost", text, "warning")


def _relearn_heading(setup: Setup, s: F64, k: I64, t: int) -> tuple[Phase, Event]:
    """Velocity never fits: back to the bank over headings, level and gyro bias kept roughly."""
    P = setup.covariance(s)
    var = par.initial_variances(setup.config, setup.layout)
    # What a wrong heading taught the accelerometer bias is worth nothing; the gyro's was in part
    # learned at rest and stays, no surer than it was.
    var[12:15] = np.maximum(var[12:15], np.diag(P)[12:15])
    # Position stays tied to the receiver's slow error, on which nothing else depends.
    slow = range(setup.layout.gnss, setup.layout.gnss + 3) if setup.layout.gnss >= 0 else range(0)
    for m in set(range(6, setup.layout.n)) - set(slow):
        P[m, :], P[:, m] = 0.0, 0.0
        P[m, m] = var[m]
    P[6, 6] = P[7, 7] = LOST_TILT_SD**2
    P[8, 8] = (math.pi / setup.config.alignment.hypotheses) ** 2
    s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = par.initial_biases(setup.config)[0]
    new = Phase(t + 1, Mode.HEADING_UNKNOWN, spread_headings(setup, s, k))
    new.checks = [Check(t, 0, math.pi, (1.0 / len(new.filters),) * len(new.filters))]
    text = "velocity does not fit GNSS for seconds: heading is searched for again"
    return new, Event(t, "heading-lost", text, "warning")
