"""Parameters of the direct filter as its kernels take them; SI and radians from here on."""

from __future__ import annotations

import numpy as np

from companion.config import DEG, Config
from companion.estimation import parameters as common
from companion.estimation.direct import layout as lo
from companion.types import F64, I64, NS

# What both filters have stands where the common vectors have it; this filter's own comes behind.
(
    JERK_PSD,  # three, body axes [(m/s³)²/Hz]
    JERK_PSD_2,
    JERK_PSD_3,
    RATE_PSD,  # three: angular acceleration, body axes [(rad/s²)²/Hz]
    RATE_PSD_2,
    RATE_PSD_3,
    ACC_TAU,  # fading time of the acceleration [s]; 0 never
    RATE_TAU,
    LEVER,  # three: first IMU to antenna, body axes [m]
    LEVER_2,
    LEVER_3,
    ATTITUDE_VAR,  # roll and pitch of another estimator [rad²]
    ATTITUDE_YAW_VAR,
    SWITCH_SIGMAS,  # Yu's σ₁ and σ₂ in deviations of a difference of two samples; infinite: off
    SWITCH_VAR,  # what a switch adds to the variance of the acceleration on its axis [(m/s²)²]
    CIRCLE_VAR,  # of the lateral acceleration from turn rate times speed [(m/s²)²]
    SIZE,
) = range(common.SIZE, common.SIZE + 17)
REPORT_NS = common.INT_SIZE
"""Of the integers: inertial updates are reported once in this time; refusals always."""

# --- columns of the table of units, one row an IMU
U_LEVER, U_GYRO_PSD, U_ACCEL_PSD, U_GYRO_VAR, U_ACCEL_VAR = 0, 3, 4, 5, 6
UNIT_COLUMNS = 7

SHORTEST_S, LONGEST_S = 0.0005, 0.02
"""Interval that a sample's noise density is spread over [s]. A sample of a slow stream is not the
mean over its period: autopilots filter at about 20 Hz and pick."""
RELOCK_S = 3.0
"""Refused that long, fixes that agree among themselves are believed: a prediction by the model,
unlike an inertial one, is worth little by then."""
REPORT_NS_INERTIAL = NS // 20


def parameter_vector(config: Config) -> F64:
    """The float parameters of ``config``: the common ones, then those named in this module."""
    p = np.zeros(SIZE)
    p[: common.SIZE] = common.parameter_vector(config)
    d = config.direct
    p[JERK_PSD : JERK_PSD + 3] = np.square(d.jerk_mps3_rthz)
    p[RATE_PSD : RATE_PSD + 3] = np.square(np.multiply(d.angular_acceleration_dps2_rthz, DEG))
    p[ACC_TAU], p[RATE_TAU] = d.acceleration_tau_s, d.rate_tau_s
    p[LEVER : LEVER + 3] = config.gnss.lever_arm_b_m
    p[ATTITUDE_VAR] = (d.attitude_sd_deg * DEG) ** 2
    p[ATTITUDE_YAW_VAR] = (d.attitude_yaw_sd_deg * DEG) ** 2
    p[SWITCH_SIGMAS] = d.transition_sigmas if d.transitions else np.inf
    p[SWITCH_VAR] = d.transition_sd_mps2**2
    p[CIRCLE_VAR] = d.circular_sd_mps2**2
    return p


def integer_vector(config: Config) -> I64:
    """The integer parameters of ``config``, the common ones first; some are this filter's own."""
    k = np.append(common.integer_vector(config), REPORT_NS_INERTIAL)
    k[common.GAP_NS] = round(config.direct.max_gap_s * NS)
    k[common.RELOCK_NS] = round(min(config.engine.gate_relock_s, RELOCK_S) * NS)
    return k


def units(config: Config) -> F64:
    """(N, UNIT_COLUMNS) what is known of each IMU: lever arm, noise; the first is the reference."""
    d = config.direct
    table = np.zeros((1 + len(config.further_imu), UNIT_COLUMNS))
    for row, unit in zip(table, (None, *config.further_imu), strict=True):
        row[U_LEVER : U_LEVER + 3] = unit.lever_arm_b_m if unit is not None else 0.0
        gyro, accel = config.imu.gyro_noise_dps_rthz, config.imu.accel_noise_mps2_rthz
        if unit is not None and unit.gyro_noise_dps_rthz is not None:
            gyro = unit.gyro_noise_dps_rthz
        if unit is not None and unit.accel_noise_mps2_rthz is not None:
            accel = unit.accel_noise_mps2_rthz
        row[U_GYRO_PSD], row[U_ACCEL_PSD] = (gyro * DEG) ** 2, accel**2
        row[U_GYRO_VAR] = (d.gyro_sample_sd_dps * DEG) ** 2
        row[U_ACCEL_VAR] = d.accel_sample_sd_mps2**2
    return table


def layout(config: Config) -> lo.Layout:
    """States that ``config`` asks for."""
    d = config.direct
    return lo.Layout.build(
        1 + len(config.further_imu),
        baro=config.baro.use,
        gnss=config.gnss.slow_error_sd_m > 0 or config.gnss.slow_error_height_sd_m > 0,
        attitude=d.attitude and (d.attitude_slow_sd_deg > 0 or d.attitude_slow_yaw_sd_deg > 0),
        clock=config.raw_gnss.coupling == "tight",
    )


def initial_variances(config: Config, lay: lo.Layout) -> F64:
    """(n,) variances at the start behind the fifteen of the trajectory, which are 0 here."""
    v = np.zeros(lay.n)
    imu, d = config.imu, config.direct
    one = np.repeat(
        np.square(
            [
                imu.gyro_bias_sd_dps * DEG,
                imu.accel_bias_sd_mps2,
                imu.gyro_scale_sd_ppm * 1e-6,
                imu.accel_scale_sd_ppm * 1e-6,
            ]
        ),
        3,
    )
    v[lo.UNIT : lo.UNIT + lo.UNIT_SIZE * lay.units] = np.tile(one, lay.units)
    if lay.baro >= 0:
        v[lay.baro] = 1e4  # any weather, any datum: found from the first fixes
    if lay.gnss >= 0:
        v[lay.gnss : lay.gnss + 2] = config.gnss.slow_error_sd_m**2
        v[lay.gnss + 2] = config.gnss.slow_error_height_sd_m**2
    if lay.attitude >= 0:
        v[lay.attitude : lay.attitude + 2] = (d.attitude_slow_sd_deg * DEG) ** 2
        v[lay.attitude + 2] = (d.attitude_slow_yaw_sd_deg * DEG) ** 2
    if lay.clock >= 0:
        common.clock_variances(config, v[lay.clock :])
    return v


def slow_errors(config: Config, lay: lo.Layout) -> F64:
    """(2, n) inverse fading time [1/s] and psd of each state behind the fifteen.

    A fading error keeps its variance: psd = 2 σ²/τ; a random walk has no fading time.
    """
    table = np.zeros((2, lay.n))
    imu, d = config.imu, config.direct
    start = initial_variances(config, lay)
    for unit in range(lay.units):
        at = lo.UNIT + lo.UNIT_SIZE * unit
        for offset, tau, walk in (
            (lo.GYRO_BIAS, imu.gyro_bias_tau_s, imu.gyro_bias_walk_dps_rts * DEG),
            (lo.ACCEL_BIAS, imu.accel_bias_tau_s, imu.accel_bias_walk_mps2_rts),
        ):
            three = slice(at + offset, at + offset + 3)
            table[0, three] = 1.0 / tau if tau > 0 else 0.0
            table[1, three] = walk**2
    if lay.baro >= 0:
        table[1, lay.baro] = config.baro.bias_walk_m_rts**2
    # The receiver's clock has a step of its own.
    for first, tau in ((lay.gnss, config.gnss.slow_error_tau_s), (lay.attitude, d.attitude_tau_s)):
        if first >= 0:
            three = slice(first, first + 3)
            table[0, three] = 1.0 / tau
            table[1, three] = 2.0 * start[three] / tau
    return table
