"""The start: levelled on a window before a fix, with whatever is known of heading and biases."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from companion.config import DEG, Config
from companion.estimation import parameters as par
from companion.estimation.aid_table import A_AZIMUTH, KIND_GNSS, KIND_MAG
from companion.estimation.buffers import SampleBuffer
from companion.estimation.phases import Check, Filter, Phase, Setup
from companion.navigation import layout as lo
from companion.navigation.alignment import (
    Level,
    attitude_covariance,
    heading_from_field,
    level,
)
from companion.navigation.earth import RATE, earth_rate_n, gravity
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64, NS, Event, Mode

MAG_AGE_NS = NS
LAST_HEADING_SD = math.radians(15.0)
"""Beyond it one filter would not do for a heading: each of the bank's twelve is as sure."""
FADE_DPS = 1.0
"""How fast the heading fades in which a vehicle was left standing [deg/s]."""


@dataclass(frozen=True, slots=True)
class _Site:
    """Where a start is made: fix ``j`` of the aids, samples ``a`` to ``b`` to level on."""

    j: int
    a: int
    b: int


@dataclass(frozen=True, slots=True)
class _Heading:
    """A heading to start with [rad], how sure it is, its slope with tilt, and where it is from."""

    yaw: float
    sd: float
    slope: tuple[float, float]
    origin: str


@dataclass(frozen=True, slots=True)
class _Biases:
    """What is known of the biases before levelling, and the variances of all slow states."""

    accel_b: F64
    gyro_b: F64
    var: F64
    """(n,) as :func:`companion.estimation.parameters.initial_variances`."""


def align(
    setup: Setup, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, j: int
) -> tuple[Phase, Event] | None:
    """Start at the first fix from ``j`` on that can be; None, and the phase moved on, otherwise."""
    last = int(imu.t[imu.end - 1])
    window_ns = round(setup.config.alignment.window_s * NS)
    while j < aids.end and aids.t[j] <= last:
        t = int(aids.t[j])
        if aids.key[j, 0] == KIND_GNSS and np.all(np.isfinite(aids.rows[j, :3])):
            begin = max(t - window_ns, phase.start_ns)
            a, b = imu.after(begin - 1), imu.after(t)
            full = b > a and imu.t[a] <= t - int(0.9 * window_ns)
            if full and b - a >= 8 and t - int(imu.t[b - 1]) <= int(setup.ipar[par.GAP_NS]):
                return _begin(setup, phase, imu, aids, _Site(j, a, b))
        j += 1
    phase.reached = last
    return None


def _begin(
    setup: Setup, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, site: _Site
) -> tuple[Phase, Event]:
    """The filter, or the bank over headings, and what there is to say about it."""
    cfg, t, fix = setup.config, int(aids.t[site.j]), aids.rows[site.j]
    known = _known_biases(setup, phase)
    speed = math.hypot(fix[3], fix[4]) if np.isfinite(fix[3]) else math.nan
    slow = not speed > cfg.constraints.standstill_speed_mps + 2 * math.sqrt(fix[9])
    lev = level(
        imu.t[site.a : site.b],
        imu.rows[site.a : site.b],
        spread_gyro=setup.par[par.STILL_GYRO],
        spread_accel=setup.par[par.STILL_ACCEL],
        may_be_static=slow,
        gyro_psd=setup.par[par.GYRO_PSD],
        accel_psd=setup.par[par.ACCEL_PSD],
        prior_bias=known.gyro_b,
        prior_var=known.var[lo.GYRO_BIAS : lo.GYRO_BIAS + 3],
        accel_bias=known.accel_b,
    )
    heading = _heading(setup, lev, aids, site.j, speed)
    unknown = heading.origin == "unknown"
    headings = [heading]
    if unknown:
        count = cfg.alignment.hypotheses
        headings = [
            replace(heading, yaw=2 * math.pi * m / count - math.pi, sd=math.pi / count)
            for m in range(count)
        ]
    filters = [_initial(setup, phase, imu, aids, site, lev, known, h) for h in headings]
    mode = Mode.HEADING_UNKNOWN if unknown else Mode.NAVIGATING
    new = Phase(t, mode, filters, resets=phase.resets)
    new.checks = [Check(t, 0, math.pi, (1.0 / len(filters),) * len(filters))]
    state = "at rest" if lev.static else "in motion"
    said = (
        "heading unknown, to be found from motion"
        if unknown
        else f"heading {math.degrees(heading.yaw) % 360:.0f}° ± {math.degrees(heading.sd):.0f}° "
        f"from {heading.origin}"
    )
    text = (
        f"levelled {state}: roll {math.degrees(lev.roll):.1f}°, pitch "
        f"{math.degrees(lev.pitch):.1f}°; {said}"
    )
    return new, Event(t, "aligned", text)


def _known_biases(setup: Setup, phase: Phase) -> _Biases:
    """Biases before levelling: configured at the first start, the old filter's after a reset."""
    var = par.initial_variances(setup.config, setup.layout)
    old = phase.prior
    if old is None:
        return _Biases(*par.initial_biases(setup.config), var)
    old_var = np.diag(setup.covariance(old.s))
    # Its deviation doubled, for what a reset may hide; the turn-on one bounds it from above for
    # the accelerometer, whose bias is slow to find, and from below for the gyro.
    var[9:12] = np.minimum(np.maximum(var[9:12], old_var[9:12]), 4.0 * old_var[9:12])
    var[12:15] = np.maximum(var[12:15], 4.0 * old_var[12:15])
    # In feedforward mode the estimate is beside the nominal state.
    bias = old.s[lo.ACCEL_BIAS_B : lo.GYRO_BIAS_B + 3] + old.s[lo.DX + 9 : lo.DX + 15]
    return _Biases(bias[:3], bias[3:], var)


def _heading(setup: Setup, lev: Level, aids: SampleBuffer, j: int, speed: float) -> _Heading:
    """The heading at fix ``j``, as configured or from what there is."""
    cfg = setup.config
    wish = cfg.alignment.heading
    if wish == "fixed":
        fixed = cfg.alignment.fixed_heading_deg * DEG
        return _Heading(fixed, cfg.mag.sd_deg * DEG, (0.0, 0.0), "configuration")
    found = _measured_heading(setup, lev, aids, j, speed)
    before = _last_heading(cfg, lev, int(aids.t[j])) if wish == "auto" else None
    if before is not None and (found is None or before.sd < found.sd):
        return before
    return found or _Heading(0.0, math.pi, (0.0, 0.0), "unknown")


def _last_heading(cfg: Config, lev: Level, t: int) -> _Heading | None:
    """The heading that an earlier run left, where the vehicle stood then and stands now.

    sd² = saved² + (fade · age)². Nobody saw whether it was turned in between, so this is for the
    seconds of a restart; a heading in motion is not worth keeping even for those.
    """
    last = cfg.alignment.last_heading
    # A clock that is behind the file's says nothing about its age.
    if last is None or not lev.static or t < last.t_ns:
        return None
    sd = math.hypot(last.sd_deg, FADE_DPS * (t - last.t_ns) / NS) * DEG
    if sd > LAST_HEADING_SD:
        return None
    return _Heading(last.heading_deg * DEG, sd, (0.0, 0.0), "the last run")


def _measured_heading(
    setup: Setup, lev: Level, aids: SampleBuffer, j: int, speed: float
) -> _Heading | None:
    """The heading at fix ``j`` by magnetometer or course, as configured; None without either."""
    cfg = setup.config
    wish = cfg.alignment.heading
    fix, t = aids.rows[j], int(aids.t[j])
    if wish == "magnetometer" or (wish == "auto" and cfg.mag.use):
        for m in range(j, aids.start - 1, -1):
            if t - int(aids.t[m]) > MAG_AGE_NS:
                break
            if aids.key[m, 0] == KIND_MAG:
                row = aids.rows[m]
                yaw, slope = heading_from_field(lev.roll, lev.pitch, row[:3], row[A_AZIMUTH])
                return _Heading(yaw, 2.0 * cfg.mag.sd_deg * DEG, slope, "magnetometer")
    if (wish == "course" or (wish == "auto" and cfg.constraints.course)) and (
        speed > cfg.constraints.course_min_speed_mps
    ):
        sd = math.hypot(cfg.constraints.course_sd_deg * DEG, math.sqrt(fix[9]) / speed)
        return _Heading(math.atan2(fix[4], fix[3]), 2.0 * sd, (0.0, 0.0), "course")
    return None


def _initial(
    setup: Setup,
    phase: Phase,
    imu: SampleBuffer,
    aids: SampleBuffer,
    site: _Site,
    lev: Level,
    known: _Biases,
    heading: _Heading,
) -> Filter:
    """A filter at the fix's time, levelled and headed as told."""
    t, fix = int(aids.t[site.j]), aids.rows[site.j]
    s, k = np.zeros(setup.layout.size), np.zeros(lo.INT_SIZE, np.int64)
    s[lo.Q : lo.Q + 4] = quat_from_rpy(lev.roll, lev.pitch, heading.yaw)
    s[lo.VEL_N : lo.VEL_N + 3] = np.where(np.isfinite(fix[3:6]), fix[3:6], 0.0)
    s[lo.LEVER_B : lo.LEVER_B + 3] = setup.config.gnss.lever_arm_b_m
    s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = known.accel_b
    s[lo.R_SCALE : lo.RECEPTION] = s[lo.R_LEAST : lo.WINDOWS] = 1.0
    s[lo.EARTH_RATE] = RATE
    if phase.prior is not None:
        for source, size in ((lo.BARO_BIAS, 1), (lo.STILL_LEARNED, 7)):
            s[source : source + size] = phase.prior.s[source : source + size]
    _fill_covariance(setup, s, fix, lev, known, heading)
    bias, bias_var = _gyro_bias(s, lev, known, heading)
    s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] = bias
    P = setup.covariance(s)
    P[range(12, 15), range(12, 15)] = bias_var
    # rate and force at the fix, between the samples around it
    b = site.b
    t0 = int(imu.t[b - 1])
    s[lo.LAST_GYRO : lo.LAST_GYRO + 6] = imu.rows[b - 1, :6]
    if b < imu.end and imu.rows[b, 6] == 0.0:
        part = (t - t0) / max(int(imu.t[b]) - t0, 1)
        s[lo.LAST_GYRO : lo.LAST_GYRO + 6] += part * (imu.rows[b, :6] - imu.rows[b - 1, :6])
    k[lo.T_NOW], k[lo.T_IMU], k[lo.HAVE_IMU] = t, t0, 1
    k[lo.T_POSITION_AID] = k[lo.T_VELOCITY_AID] = t
    if np.isfinite(fix[3]):
        s[lo.GNSS_SPEED] = math.hypot(fix[3], fix[4])
        s[lo.GNSS_SPEED_SD] = math.sqrt(fix[9])
        s[lo.GNSS_GROUND_SPEED] = s[lo.GNSS_SPEED]
        k[lo.T_GNSS_SPEED] = t
    k[lo.RESETS] = phase.resets
    for cell, period in (
        (lo.T_OUTPUT, par.OUTPUT_NS),
        (lo.T_COVARIANCE, par.COVARIANCE_NS),
        (lo.T_SNAPSHOT, par.SNAPSHOT_NS),
        (lo.STILL_CELL, par.STILL_NS),
    ):
        k[cell] = t // int(setup.ipar[period])
    return setup.new_filter(s, k, alone=heading.origin != "unknown")


def _gyro_bias(s: F64, lev: Level, known: _Biases, heading: _Heading) -> tuple[F64, F64]:
    """Gyro bias (3,) [rad/s] and its variance: what standing still says beside what was known."""
    if not lev.static:
        return lev.gyro_bias_b, lev.gyro_bias_var
    # Each heading says what of the mean rate is Earth's, as far as it is right itself.
    earth = earth_rate_n(float(s[lo.LAT]))
    bias = lev.gyro_bias_b - (matrix_from_quat(s[:4]) * earth[:, None]).sum(axis=0)
    var = lev.gyro_bias_var + (RATE * min(heading.sd, 1.0)) ** 2
    prior_var = known.var[lo.GYRO_BIAS : lo.GYRO_BIAS + 3]
    bias = bias + var / (var + prior_var) * (known.gyro_b - bias)
    return bias, var * prior_var / (var + prior_var)


def _fill_covariance(
    setup: Setup, s: F64, fix: F64, lev: Level, known: _Biases, heading: _Heading
) -> None:
    """Position and P of a start from a fix, in ``s``: all but the gyro bias."""
    P = setup.covariance(s)
    P[np.diag_indices(setup.layout.n)] = known.var
    still = lev.static and not np.isfinite(fix[3])
    unknown = (0.3 if still else 10.0, 0.3 if still else 10.0, 3.0)
    velocity_var = np.where(np.isfinite(fix[3:6]), fix[9:12], np.square(unknown))
    lever = s[lo.LEVER_B : lo.LEVER_B + 3]
    place_at(setup, s, fix[:3], fix[6:9] + float(lever @ lever))
    P[range(3, 6), range(3, 6)] = velocity_var
    attitude, cross = attitude_covariance(
        s[:4],
        known.var[lo.ACCEL_BIAS : lo.ACCEL_BIAS + 3],
        lev.tilt_var,
        heading.sd * heading.sd,
        gravity(float(fix[0]), float(fix[2])),
        heading.slope,
    )
    P[6:9, 6:9] = attitude
    P[6:9, 9:12] = cross
    P[9:12, 6:9] = cross.T


def place_at(setup: Setup, s: F64, place: F64, variance: F64) -> None:
    """Take position from a fix: ``place`` lat, lon [rad], height [m], white ``variance`` (3,) [m²].

    The receiver's slow error b is unknown then, and in the place: what is wrong with that is −b
    beside the white part, so P_pp = R + P_bb and P_pb = −P_bb. Taken for independent, the first fix
    would be believed to its white part for the whole run.
    """
    P = setup.covariance(s)
    s[lo.LAT : lo.LAT + 3] = place
    P[:3, :], P[:, :3] = 0.0, 0.0
    P[range(3), range(3)] = variance
    at = setup.layout.gnss
    if at < 0:
        return
    slow = range(at, at + 3)
    prior = par.initial_variances(setup.config, setup.layout)[at : at + 3]
    s[lo.GNSS_BIAS : lo.GNSS_BIAS + 3] = 0.0
    P[slow, :], P[:, slow] = 0.0, 0.0
    P[slow, slow] = prior
    P[range(3), range(3)] += prior
    P[range(3), slow] = P[slow, range(3)] = -prior
