"""Filter parameters as the kernels take them: one float64 vector made from a configuration.

Everything here is SI and radians; the configuration's units end in :func:`parameter_vector`.
"""

from __future__ import annotations

import numpy as np

from companion.config import DEG, Config
from companion.estimation.adaptation.parameters import SIZE as ADAPTATION_SIZE
from companion.estimation.adaptation.parameters import adaptation_vector, method_code
from companion.estimation.chi_square import exceeded_with
from companion.navigation.layout import BIAS, DRIFT, RAMP, SYSTEM, Layout
from companion.types import F64, I64, NS

(
    ACCEL_PSD,  # [(m/s²)²/Hz]
    GYRO_PSD,  # [(rad/s)²/Hz]
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_TAU,  # [s]; 0 a random walk
    GYRO_BIAS_PSD,
    GYRO_BIAS_TAU,
    BARO_PSD,
    GNSS_PSD,  # slow GNSS error, horizontal
    GNSS_PSD_DOWN,
    GNSS_TAU,
    GATE,  # three thresholds, for 1, 2 and 3 degrees of freedom
    GATE_2,
    GATE_3,
    ZUPT_VAR,
    ZARU_VAR,
    STILL_GYRO,  # largest spread of sub-block means [rad/s]
    STILL_ACCEL,
    STILL_SPEED,
    NHC_VAR,
    NHC_LEVER,  # three
    NHC_LEVER_2,
    NHC_LEVER_3,
    COURSE_VAR,
    COURSE_SPEED,
    BRIDGED_DT,  # an IMU interval longer than this is a bridged gap
    VIBRATION_GAIN,  # accelerometer noise density per vibration, squared [1/Hz]
    LATENCY_VAR,  # of a fix's time of validity [s²]
    GYRO_VIBRATION_GAIN,  # gyro noise density per vibration of its axis, squared [1/Hz]
    GYRO_RANGE,  # full scale [rad/s]; 0: not known
    ACCEL_RANGE,  # [m/s²]
    DIVERGED_VAR,  # horizontal position variance beyond use [m²]
    CLOCK_PSD,  # receiver clock: bias [m²/s], drift [(m/s)²/s]
    CLOCK_DRIFT_PSD,
    SYSTEM_BIAS_PSD,
    CLOCK_RAMP_VAR,  # of its drift's change in a temperature that changes [(m/s²)²]
    CLOCK_RAMP_TAU,  # [s]
    GNSS_VAR,  # (4) configured, of position and velocity, horizontal and vertical
    ADAPTATION_AT,  # from here on: adaptation/parameters.py
) = (*range(37), 40)
SIZE = ADAPTATION_AT + ADAPTATION_SIZE

# --- integer parameters
(
    FEEDFORWARD,
    BANK,  # 1: gates open, likelihood accumulated
    OUTPUT_NS,
    COVARIANCE_NS,
    SNAPSHOT_NS,
    STILL_NS,
    CONSTRAINT_NS,  # 0: no non-holonomic constraint
    ZERO_VELOCITY,
    COURSE,
    GAP_NS,
    COASTING_NS,
    BASE_MODE,  # Mode to report while aided
    RELOCK_NS,
    ADAPTATION,  # code of the method, see adaptation/layout.py
    SOURCE_FAULTS,
    PATIENCE_NS,
    TIGHT,  # 1: ranges are fused, fixes only start and relock
    INT_SIZE,
) = range(18)


CLOCK_SD_M, CLOCK_DRIFT_SD_MPS = 1e5, 1e3
"""A receiver's clock before the first range: its first offset is taken off, then it may have run
away at 3 ppm for half a minute. A far larger number would cost digits of P."""


def parameter_vector(config: Config) -> F64:
    """The float parameters of ``config``, by the names of this module."""
    p = np.zeros(SIZE)
    imu, aid = config.imu, config.constraints
    p[ACCEL_PSD] = imu.accel_noise_mps2_rthz**2
    p[GYRO_PSD] = (imu.gyro_noise_dps_rthz * DEG) ** 2
    p[ACCEL_BIAS_PSD] = imu.accel_bias_walk_mps2_rts**2
    p[ACCEL_BIAS_TAU] = imu.accel_bias_tau_s
    p[GYRO_BIAS_PSD] = (imu.gyro_bias_walk_dps_rts * DEG) ** 2
    p[GYRO_BIAS_TAU] = imu.gyro_bias_tau_s
    p[BARO_PSD] = config.baro.bias_walk_m_rts**2
    tau = config.gnss.slow_error_tau_s
    p[GNSS_TAU] = tau
    p[GNSS_PSD] = 2.0 * config.gnss.slow_error_sd_m**2 / tau
    p[GNSS_PSD_DOWN] = 2.0 * config.gnss.slow_error_height_sd_m**2 / tau
    for dof in (1, 2, 3):
        p[GATE + dof - 1] = exceeded_with(1.0 - config.engine.gate_probability, dof)
    p[ZUPT_VAR] = aid.zero_velocity_sd_mps**2
    p[ZARU_VAR] = (aid.zero_rate_sd_dps * DEG) ** 2
    p[STILL_GYRO] = aid.standstill_gyro_dps * DEG
    p[STILL_ACCEL] = aid.standstill_accel_mps2
    p[STILL_SPEED] = aid.standstill_speed_mps
    p[NHC_VAR] = aid.non_holonomic_sd_mps**2
    p[NHC_LEVER : NHC_LEVER + 3] = aid.non_holonomic_lever_b_m
    p[COURSE_VAR] = (aid.course_sd_deg * DEG) ** 2
    p[COURSE_SPEED] = aid.course_min_speed_mps
    p[BRIDGED_DT] = 0.06
    p[LATENCY_VAR] = (config.gnss.latency_sd_ms * 1e-3) ** 2
    p[DIVERGED_VAR] = config.engine.diverged_position_sd_m**2
    p[VIBRATION_GAIN] = imu.vibration_gain_rthz**2
    p[GYRO_VIBRATION_GAIN] = imu.gyro_vibration_gain_rthz**2
    p[GYRO_RANGE] = imu.gyro_range_dps * DEG
    p[ACCEL_RANGE] = imu.accel_range_mps2
    p[CLOCK_PSD] = config.raw_gnss.clock_walk_m_rts**2
    p[CLOCK_DRIFT_PSD] = config.raw_gnss.clock_drift_walk_mps_rts**2
    p[SYSTEM_BIAS_PSD] = config.raw_gnss.system_bias_walk_m_rts**2
    p[CLOCK_RAMP_VAR] = config.raw_gnss.clock_ramp_mps2**2
    p[CLOCK_RAMP_TAU] = config.raw_gnss.clock_ramp_tau_s
    p[GNSS_VAR : GNSS_VAR + 4] = np.square(config.gnss.configured_sd)
    p[ADAPTATION_AT:] = adaptation_vector(config.adaptation)
    return p


def integer_vector(config: Config) -> I64:
    """The integer parameters of ``config``: periods in ns and switches."""
    k = np.zeros(INT_SIZE, dtype=np.int64)
    engine, aid = config.engine, config.constraints
    k[FEEDFORWARD] = engine.correction == "feedforward"
    k[OUTPUT_NS] = round(NS / engine.output_rate_hz)
    k[COVARIANCE_NS] = round(NS / engine.covariance_rate_hz)
    k[SNAPSHOT_NS] = NS // 10
    k[STILL_NS] = round(aid.standstill_window_s * NS / 4)
    k[CONSTRAINT_NS] = round(NS / aid.non_holonomic_rate_hz) if aid.non_holonomic else 0
    k[ZERO_VELOCITY] = aid.zero_velocity
    k[COURSE] = aid.course
    k[GAP_NS] = round(engine.imu_gap_bridge_s * NS)
    k[RELOCK_NS] = round(engine.gate_relock_s * NS)
    k[SOURCE_FAULTS] = config.source_faults.detect
    k[PATIENCE_NS] = round(config.source_faults.patience_s * NS)
    k[COASTING_NS] = round(engine.coasting_after_s * NS)
    k[ADAPTATION] = method_code(config.adaptation)
    k[TIGHT] = config.raw_gnss.coupling == "tight"
    return k


def layout(config: Config) -> Layout:
    """Which optional states ``config`` asks for."""
    return Layout.build(
        scale=config.imu.scale_factor_states,
        lever=config.gnss.lever_arm_sd_m > 0,
        baro=config.baro.use,
        gnss=config.gnss.slow_error_sd_m > 0 or config.gnss.slow_error_height_sd_m > 0,
        clock=config.raw_gnss.coupling == "tight",
    )


def initial_biases(config: Config) -> tuple[F64, F64]:
    """Accelerometer (3,) [m/s²] and gyro bias (3,) [rad/s] to start with, body axes."""
    return np.array(config.imu.accel_bias_mps2), np.array(config.imu.gyro_bias_dps) * DEG


def initial_variances(config: Config, lay: Layout) -> F64:
    """(n,) variances of bias and optional states at start; position, velocity, attitude are 0."""
    v = np.zeros(lay.n)
    imu = config.imu
    v[9:12] = imu.accel_bias_sd_mps2**2
    v[12:15] = (imu.gyro_bias_sd_dps * DEG) ** 2
    if lay.accel_scale >= 0:
        v[lay.accel_scale : lay.accel_scale + 3] = (imu.accel_scale_sd_ppm * 1e-6) ** 2
        v[lay.gyro_scale : lay.gyro_scale + 3] = (imu.gyro_scale_sd_ppm * 1e-6) ** 2
    if lay.lever >= 0:
        v[lay.lever : lay.lever + 3] = config.gnss.lever_arm_sd_m**2
    if lay.baro >= 0:
        v[lay.baro] = 1e4  # any weather, any datum: found from the first fixes
    if lay.gnss >= 0:
        v[lay.gnss : lay.gnss + 2] = config.gnss.slow_error_sd_m**2
        v[lay.gnss + 2] = config.gnss.slow_error_height_sd_m**2
    if lay.clock >= 0:
        clock_variances(config, v[lay.clock :])
    return v


def clock_variances(config: Config, v: F64) -> None:
    """Fill ``v`` (≥ CLOCK_STATES,) with the variances of a receiver's clock at the start."""
    v[BIAS], v[DRIFT] = CLOCK_SD_M**2, CLOCK_DRIFT_SD_MPS**2
    v[SYSTEM : SYSTEM + 2] = config.raw_gnss.system_bias_sd_m**2
    v[RAMP] = config.raw_gnss.clock_ramp_mps2**2
