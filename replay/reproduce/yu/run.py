"""One run of the direct filter along the track, with or without the mechanisms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.config import (
    DEG,
    Adaptation,
    Alignment,
    Baro,
    Config,
    Direct,
    EngineConfig,
    FurtherImu,
    Gnss,
    Imu,
)
from companion.estimation import parameters as common
from companion.estimation.aid_table import AID_SIZE, KIND_GNSS, KIND_IMU
from companion.estimation.direct import layout as lo
from companion.estimation.direct import parameters as par
from companion.estimation.direct.start import Setup
from companion.estimation.direct.update import box_plus
from companion.estimation.direct.walk import walk
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.update import REPORT_SIZE
from companion.navigation.earth import ned_difference
from companion.navigation.rotation import quat_from_rpy, rpy_from_quat
from companion.types import F64, I64, NS
from replay.reproduce.yu import track as tr

EVERY = 10
"""IMU samples between two looks at the state: 0.1 s."""
START_SD = 0.1, 0.1, 0.3 * DEG, 0.1 * DEG
"""Velocity, acceleration, attitude and rate at the start, 1σ: at rest and aligned, of which the
paper says nothing. The position is that of a first fix, with its deviation."""


@dataclass(frozen=True)
class Errors:
    """Estimate − truth every 0.1 s."""

    t: F64
    position: F64
    """(M, 3) NED [m]."""
    velocity: F64
    acceleration: F64
    attitude_deg: F64
    """(M, 3) roll, pitch, yaw."""
    sd_position: F64
    """(M,) three-dimensional, as claimed."""
    switches: int


def configuration(jerk: float, transitions: bool) -> Config:
    """51 states: three units, acceleration and turn rate that stay, GPS position alone."""
    white, slow = np.array(tr.GPS_WHITE), np.array(tr.GPS_SLOW)
    horizontal, _, vertical = np.hypot(white, slow).tolist()
    return Config(
        imu=Imu(
            gyro_noise_dps_rthz=tr.GYRO_NOISE / DEG,
            gyro_bias_sd_dps=tr.GYRO_BIAS / DEG,
            gyro_bias_walk_dps_rts=1e-6,
            accel_noise_mps2_rthz=tr.ACCEL_NOISE,
            accel_bias_sd_mps2=tr.ACCEL_BIAS,
            accel_bias_walk_mps2_rts=1e-6,
            gyro_scale_sd_ppm=tr.SCALE * 1e6,
            accel_scale_sd_ppm=tr.SCALE * 1e6,
        ),
        further_imu=tuple(
            FurtherImu(source=f"imu{i + 2}", lever_arm_b_m=lever)
            for i, lever in enumerate(tr.LEVERS_B[1:])
        ),
        gnss=Gnss(sd_position_m=horizontal, sd_height_m=vertical),
        baro=Baro(use=False),
        alignment=Alignment(heading="fixed"),
        engine=EngineConfig(estimator="direct", output_rate_hz=10.0),
        adaptation=Adaptation(method="none"),  # the paper's filter has none
        direct=Direct(
            jerk_mps3_rthz=(jerk, jerk, jerk),
            acceleration_tau_s=0.0,
            angular_acceleration_dps2_rthz=(30.0, 30.0, 30.0),
            rate_tau_s=0.0,
            transitions=transitions,
        ),
    )


def fly(track: tr.Track, sensors: tr.Sensors, start: F64, jerk: float, transitions: bool) -> Errors:
    """Filter one run; ``start`` (12,) are the standard normal errors of the first state
    behind its position."""
    setup = Setup(configuration(jerk, transitions))
    s, k = _begin(setup, sensors.first_fix, start)
    count = len(track.t)
    t: I64 = NS + np.arange(1, count + 1, dtype=np.int64) * (NS // tr.RATE_HZ)
    aid_t, kinds, rows = _aids(setup, sensors, t)
    found = []
    at = np.array([0, 0, 0, len(aid_t), 0, 0, 0])
    reports_t, reports = np.zeros(9 * count, np.int64), np.zeros((9 * count, REPORT_SIZE))
    switches = np.zeros((count, 2), np.int64)
    for stop in range(EVERY, count + 1, EVERY):
        at[1], at[4], at[5] = stop, 0, 0
        walk(
            s, k, setup.lay, setup.par, setup.ipar, setup.units, setup.slow,
            t, sensors.imu[0], aid_t, kinds, rows,
            np.zeros(2 * EVERY, np.int64), np.zeros((2 * EVERY, ROW_SIZE)), reports_t, reports,
            np.zeros((2, len(s))), np.zeros((2, len(k)), np.int64), switches, at,
        )  # fmt: skip
        P = np.diag(setup.covariance(s))[:3].sum()
        found.append((*s[4:13], *rpy_from_quat(s[:4]), math.sqrt(P)))
    table = np.array(found)
    rows_at = np.arange(EVERY - 1, count, EVERY)
    lat, lon, height = (np.full(len(table), x) for x in tr.PLACE)
    place = ned_difference(table[:, 0], table[:, 1], table[:, 2], lat, lon, height)
    rpy = table[:, 9:12]
    rpy[:, 2] -= track.yaw[rows_at]
    return Errors(
        track.t[rows_at],
        place - track.position_n[rows_at],
        table[:, 3:6] - track.vel_n[rows_at],
        table[:, 6:9] - track.acc_n[rows_at],
        np.degrees(np.remainder(rpy + np.pi, 2 * np.pi) - np.pi),
        table[:, 12],
        int(at[6]),
    )


def _begin(setup: Setup, first_fix: F64, start: F64) -> tuple[F64, I64]:
    """State and clock at rest on the first fix, off by what the deviations allow."""
    lay = setup.layout
    s, k = lay.blank()
    s[:4] = quat_from_rpy(0.0, 0.0, 0.0)
    s[lo.LAT : lo.LAT + 3] = tr.PLACE
    s[lo.ACC_N] = tr.STEPS[0][1]
    var = par.initial_variances(setup.config, lay)
    gnss = setup.config.gnss
    var[:3] = np.square([gnss.sd_position_m, gnss.sd_position_m, gnss.sd_height_m])
    for block, sd in zip((lo.VEL, lo.ACC, lo.ATT, lo.RATE), START_SD, strict=True):
        var[block : block + 3] = sd**2
    P = setup.covariance(s)
    P[np.diag_indices(lay.n)] = var
    off = np.zeros(lay.n)
    off[:3] = first_fix
    off[3:15] = start * np.sqrt(var[3:15])
    box_plus(s, setup.lay, off)
    k[lo.T_NOW] = k[lo.T_IMU] = NS
    k[lo.T_POSITION_AID] = NS
    k[lo.T_OUTPUT] = NS // int(setup.ipar[common.OUTPUT_NS])
    return s, k


def _aids(setup: Setup, sensors: tr.Sensors, t: I64) -> tuple[I64, I64, F64]:
    """The two further units and the fixes as rows of the aid table, in order of time."""
    count = len(t)
    rows = np.full((2 * count + len(sensors.fixes), AID_SIZE), np.nan)
    rows[:count, :7], rows[count : 2 * count, :7] = sensors.imu[1], sensors.imu[2]
    kinds = np.zeros((len(rows), 2), np.int64)
    kinds[: 2 * count, 0] = KIND_IMU
    kinds[count : 2 * count, 1] = 1
    kinds[2 * count :, 0] = KIND_GNSS
    full = t[tr.RATE_HZ - 1 :: tr.RATE_HZ]
    gnss = setup.config.gnss
    for row, fix in zip(rows[2 * count :], sensors.fixes, strict=True):
        there = np.zeros(setup.layout.size)
        there[0] = 1.0
        there[lo.LAT : lo.LAT + 3] = tr.PLACE
        box_plus(there, setup.lay, np.concatenate([fix, np.zeros(setup.layout.n - 3)]))
        row[:3] = there[lo.LAT : lo.LAT + 3]
        row[6:9] = np.square([gnss.sd_position_m, gnss.sd_position_m, gnss.sd_height_m])
    times = np.concatenate([t, t, full])
    order = np.argsort(times, kind="stable")
    return times[order], kinds[order], rows[order]
