"""Recovery: position or heading taken anew from fixes that agree among themselves."""

from __future__ import annotations

import math

import numpy as np

from companion.estimation import parameters as par
from companion.estimation import walk as w
from companion.estimation.bank import spread_headings
from companion.estimation.buffers import SampleBuffer
from companion.estimation.phases import Check, Filter, Phase, Setup
from companion.estimation.start import place_at
from companion.navigation import layout as lo
from companion.navigation.earth import ned_difference
from companion.navigation.error_model import box_plus
from companion.types import F64, I64, NS, Event, Mode

RELOCK_FIXES = 4
LOST_TILT_SD = math.radians(3.0)


def recover(setup: Setup, phase: Phase, t: int, aids: SampleBuffer) -> tuple[Phase, Event] | None:
    """Relock to fixes that the gate refused for long, or search again for a lost heading."""
    f = phase.filters[0]
    since = int(f.k[lo.T_REJECT])
    relock = bool(since) and t - since > setup.ipar[par.RELOCK_NS]
    lost = f.s[lo.VELOCITY_FIT] > w.LOST_FIT
    if not (relock or lost):
        return None
    fixes = _agreeing_fixes(aids, t)
    if len(fixes) == 0:
        return None
    # Position alone can be off for long where a receiver erred; velocity that never fits means
    # that the attitude is wrong: on the move its heading, which nothing else holds; without way
    # over ground its level, by an inertial sensor that began to err (shaken, struck, saturated).
    s, k = _restarted(setup, f, t, aids, fixes)
    if lost:
        moving = f.s[lo.GNSS_GROUND_SPEED] > w.LOST_SPEED
        if moving and setup.config.alignment.heading != "fixed":
            return _relearn_heading(setup, s, k, t)
        return _relearn_level(setup, s, k, t)
    new = Phase(t + 1, Mode.NAVIGATING, [setup.new_filter(s, k)])
    new.checks = [Check(t)]
    text = (
        f"position reset to {RELOCK_FIXES} mutually consistent GNSS fixes after "
        f"{setup.config.engine.gate_relock_s:.0f} s of rejections"
    )
    return new, Event(t, "relocked", text, "warning")


def _agreeing_fixes(aids: SampleBuffer, t: int) -> list[int]:
    """The last few fixes where each foresees the next by its velocity; else none."""
    fixes = [
        m
        for m in range(aids.start, aids.after(t))
        if aids.key[m, 0] == w.KIND_GNSS
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
    s, k = f.s.copy(), f.k.copy()
    carried = s[lo.DX : lo.DX + setup.layout.n]
    if carried.any():
        # Feedforward: what follows is about the whole estimate.
        box_plus(s, setup.lay, carried.copy())
        carried[:] = 0.0
    last = aids.rows[fixes[-1]]
    ahead = (t - int(aids.t[fixes[-1]])) / NS
    velocity = np.where(np.isfinite(last[3:6]), last[3:6], s[lo.VEL_N : lo.VEL_N + 3])
    s[lo.VEL_N : lo.VEL_N + 3] = velocity
    P = setup.covariance(s)
    moved = (1.0 + float(velocity @ velocity)) * ahead**2
    place_at(setup, s, last[:3], 4.0 * last[6:9] + moved)
    P[3:6, :], P[:, 3:6] = 0.0, 0.0
    for m in range(3):
        var = last[9 + m] if np.isfinite(last[3 + m]) else 9.0
        P[3 + m, 3 + m] = 4.0 * var + ahead**2
    s[lo.VELOCITY_FIT] = s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = 0.0
    k[lo.T_REJECT], k[lo.RESETS] = 0, k[lo.RESETS] + 1
    return s, k


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
    new.checks = [Check(t, 0, math.pi)]
    text = "velocity does not fit GNSS for seconds: heading is searched for again"
    return new, Event(t, "heading-lost", text, "warning")
