"""The start of the direct filter: at a fix, levelled on the last specific forces."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.config import DEG, Config
from companion.estimation import parameters as common
from companion.estimation.aid_table import A_AZIMUTH, KIND_ATTITUDE, KIND_GNSS, KIND_MAG
from companion.estimation.buffers import SampleBuffer
from companion.estimation.direct import layout as lo
from companion.estimation.direct import parameters as par
from companion.estimation.phases import Check, Filter, Phase
from companion.estimation.start import MAG_AGE_NS
from companion.navigation.alignment import MOVING_TILT_SD, heading_from_field
from companion.navigation.layout import CLOCK_STATES
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy
from companion.types import F64, I64, NS, Event, Mode

FEW_SAMPLES = 4
"""Fewer in the alignment's window, and the last ones before it count too: a slow IMU."""
START_ACCELERATION_SD = 2.0
START_RATE_SD = 20.0 * DEG


class Setup:
    """A configuration as kernels and phases of the direct filter take it."""

    def __init__(self, config: Config) -> None:
        self.config = config
        self.layout = par.layout(config)
        self.lay = self.layout.vector()
        self.par = par.parameter_vector(config)
        self.units = par.units(config)
        self.slow = par.slow_errors(config, self.layout)
        self.ipar = par.integer_vector(config)
        self.ipar_bank = self.ipar.copy()
        self.ipar[common.BASE_MODE] = Mode.NAVIGATING
        self.ipar_bank[common.BANK] = 1
        self.ipar_bank[common.BASE_MODE] = Mode.HEADING_UNKNOWN
        ring_ns = round(config.engine.delay_ring_s * NS)
        self.slots = ring_ns // int(self.ipar[common.SNAPSHOT_NS]) + 3

    def covariance(self, s: F64) -> F64:
        """P (n, n) inside a float state, as a view."""
        n = self.layout.n
        return s[self.layout.covariance :].reshape(n, n)

    def yaw_variance(self, s: F64) -> float:
        """Variance of the heading error, φ_D = (C ψ)_D [rad²]."""
        down = matrix_from_quat(s[:4])[2]
        block = self.covariance(s)[lo.ATT : lo.ATT + 3, lo.ATT : lo.ATT + 3]
        return float((down[:, None] * block * down[None, :]).sum())

    def new_filter(self, s: F64, k: I64) -> Filter:
        """A filter that begins at a state."""
        return Filter.start(s, k, self.slots)


@dataclass(frozen=True, slots=True)
class _Attitude:
    """An attitude to start with [rad], its deviations about the vertical and of level."""

    roll: float
    pitch: float
    yaw: float
    tilt_sd: float
    yaw_sd: float
    origin: str


def align(
    setup: Setup, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, j: int
) -> tuple[Phase, Event] | None:
    """Start at the first fix from ``j`` on that can be; None, and the phase moved on, otherwise."""
    last = int(imu.t[imu.end - 1])
    longest = int(setup.ipar[common.GAP_NS])
    while j < aids.end and aids.t[j] <= last:
        t = int(aids.t[j])
        if aids.key[j, 0] == KIND_GNSS and np.all(np.isfinite(aids.rows[j, :3])):
            b = imu.after(t)
            a = imu.after(max(t - round(setup.config.alignment.window_s * NS), phase.start_ns))
            first = imu.after(max(t - longest, phase.start_ns - 1))
            a = max(min(a, b - FEW_SAMPLES), first)
            if b > a:
                return _begin(setup, phase, imu, aids, j, a, b)
        j += 1
    phase.reached = last
    return None


def _begin(
    setup: Setup, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, j: int, a: int, b: int
) -> tuple[Phase, Event]:
    attitude = _attitude(setup.config, imu.rows[a:b], aids, j)
    unknown = attitude.origin == "unknown"
    count = setup.config.alignment.hypotheses
    yaws = [attitude.yaw]
    if unknown:
        yaws = [2 * math.pi * m / count - math.pi for m in range(count)]
    filters = [_initial(setup, phase, imu, aids, j, b, attitude, yaw) for yaw in yaws]
    t = int(aids.t[j])
    mode = Mode.HEADING_UNKNOWN if unknown else Mode.NAVIGATING
    new = Phase(t, mode, filters, resets=phase.resets)
    new.checks = [Check(t, 0, math.pi)]
    said = (
        "heading unknown, to be found from motion"
        if unknown
        else f"heading {math.degrees(attitude.yaw) % 360:.0f}° ± "
        f"{math.degrees(attitude.yaw_sd):.0f}° from {attitude.origin}"
    )
    text = (
        f"direct filter begins: roll {math.degrees(attitude.roll):.1f}°, pitch "
        f"{math.degrees(attitude.pitch):.1f}° ± {math.degrees(attitude.tilt_sd):.0f}°; {said}"
    )
    return new, Event(t, "aligned", text)


def _attitude(config: Config, samples: F64, aids: SampleBuffer, j: int) -> _Attitude:
    """Attitude at fix ``j``: another estimator's, or level from ``samples`` and a heading."""
    fix, d = aids.rows[j], config.direct
    recent = _recent(aids, j, KIND_ATTITUDE)
    if recent is not None:
        return _Attitude(
            float(recent[0]),
            float(recent[1]),
            float(recent[2]),
            2.0 * math.hypot(d.attitude_sd_deg, d.attitude_slow_sd_deg) * DEG,
            2.0 * math.hypot(d.attitude_yaw_sd_deg, d.attitude_slow_yaw_sd_deg) * DEG,
            "the attitude in the log",
        )
    fx, fy, fz = samples[:, 3:6].mean(axis=0) - np.array(config.imu.accel_bias_mps2)
    roll, pitch = math.atan2(-fy, -fz), math.atan2(fx, math.hypot(fy, fz))
    wish = config.alignment.heading
    if wish == "fixed":
        yaw, sd = config.alignment.fixed_heading_deg * DEG, config.mag.sd_deg * DEG
        return _Attitude(roll, pitch, yaw, MOVING_TILT_SD, sd, "configuration")
    if wish == "magnetometer" or (wish == "auto" and config.mag.use):
        row = _recent(aids, j, KIND_MAG)
        if row is not None:
            yaw, _ = heading_from_field(roll, pitch, row[:3], float(row[A_AZIMUTH]))
            # A tilt of 6° turns a steep field by twice that.
            sd = math.hypot(config.mag.sd_deg * DEG, 2.0 * MOVING_TILT_SD)
            return _Attitude(roll, pitch, yaw, MOVING_TILT_SD, sd, "magnetometer")
    speed = math.hypot(fix[3], fix[4]) if np.isfinite(fix[3:5]).all() else 0.0
    if (wish == "course" or (wish == "auto" and config.constraints.course)) and (
        speed > config.constraints.course_min_speed_mps
    ):
        sd = 2.0 * math.hypot(config.constraints.course_sd_deg * DEG, math.sqrt(fix[9]) / speed)
        return _Attitude(roll, pitch, math.atan2(fix[4], fix[3]), MOVING_TILT_SD, sd, "course")
    return _Attitude(roll, pitch, 0.0, MOVING_TILT_SD, math.pi / 12, "unknown")


def _recent(aids: SampleBuffer, j: int, kind: int) -> F64 | None:
    """The last row of a kind of aid within a second before aid ``j``."""
    for m in range(j, aids.start - 1, -1):
        if int(aids.t[j]) - int(aids.t[m]) > MAG_AGE_NS:
            return None
        if aids.key[m, 0] == kind:
            row: F64 = aids.rows[m]
            return row
    return None


def _initial(
    setup: Setup,
    phase: Phase,
    imu: SampleBuffer,
    aids: SampleBuffer,
    j: int,
    b: int,
    attitude: _Attitude,
    yaw: float,
) -> Filter:
    """A filter at the time of fix ``j``, levelled and headed as told."""
    cfg, lay = setup.config, setup.layout
    t, fix = int(aids.t[j]), aids.rows[j]
    s, k = lay.blank()
    s[:4] = quat_from_rpy(attitude.roll, attitude.pitch, yaw)
    s[lo.LAT : lo.LAT + 3] = fix[:3]
    s[lo.VEL_N : lo.VEL_N + 3] = np.where(np.isfinite(fix[3:6]), fix[3:6], 0.0)
    var = par.initial_variances(cfg, lay)
    first = lo.UNITS
    s[first : first + 3] = np.multiply(cfg.imu.gyro_bias_dps, DEG)
    s[first + 3 : first + 6] = cfg.imu.accel_bias_mps2
    s[lo.RATE_B : lo.RATE_B + 3] = imu.rows[b - 1, :3] - s[first : first + 3]
    old = phase.prior
    if old is not None:
        # Biases, offsets and vibration outlive a reset; what it may hide doubles their deviation.
        units = slice(lo.UNITS, lay.covariance)
        s[units], s[lo.BARO_BIAS] = old.s[units], old.s[lo.BARO_BIAS]
        clock = slice(lo.CLOCK, lo.CLOCK + CLOCK_STATES)
        s[clock] = old.s[clock]
        kept = slice(lo.UNIT, lo.UNIT + lo.UNIT_SIZE * lay.units)
        var[kept] = np.minimum(var[kept], 4.0 * np.diag(setup.covariance(old.s))[kept])
    P = setup.covariance(s)
    P[np.diag_indices(lay.n)] = var
    three = np.arange(3)
    P[three, three] = fix[6:9]
    if lay.gnss >= 0:
        # The first fix is off by the receiver's slow error, which is the same unknown.
        slow = lay.gnss + three
        P[three, three] += var[slow]
        P[three, slow] = P[slow, three] = -var[slow]
    P[lo.VEL + three, lo.VEL + three] = np.where(
        np.isfinite(fix[3:6]), fix[9:12], [100.0, 100.0, 9.0]
    )
    P[lo.ACC + three, lo.ACC + three] = START_ACCELERATION_SD**2
    P[lo.RATE + three, lo.RATE + three] = START_RATE_SD**2 + var[lo.UNIT : lo.UNIT + 3]
    # Level and heading are about the vertical: turned into body axes.
    C = matrix_from_quat(s[:4])
    n = np.diag([attitude.tilt_sd**2, attitude.tilt_sd**2, attitude.yaw_sd**2])
    if attitude.origin == "unknown":
        n[2, 2] = (math.pi / cfg.alignment.hypotheses) ** 2
    P[lo.ATT : lo.ATT + 3, lo.ATT : lo.ATT + 3] = C.T @ n @ C
    k[lo.T_NOW], k[lo.T_IMU] = t, int(imu.t[b - 1])
    k[lo.T_POSITION_AID] = k[lo.T_VELOCITY_AID] = t
    k[lo.RESETS] = phase.resets
    k[lo.T_OUTPUT] = t // int(setup.ipar[common.OUTPUT_NS])
    k[lo.SNAP_CELL] = t // int(setup.ipar[common.SNAPSHOT_NS])
    return setup.new_filter(s, k)
