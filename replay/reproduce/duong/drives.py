"""The paper's two drives on simulated sensors of its grade, and the filter that it describes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import msgspec
import numpy as np

from companion.config import Config
from companion.types import F64, Solution, VehicleRecording
from replay.evaluation import errors_against
from replay.preparation import start_ns, withhold_gnss
from replay.simulator.aids import GnssSpec
from replay.simulator.imu import ImuSpec
from replay.simulator.matching import matching_config
from replay.simulator.scenarios import Scenario, TrajectorySpec
from replay.simulator.simulation import run
from replay.window import Window

FIRST_S, SECOND_S = 3600.0, 2040.0
"""An hour (Table 5), and 34 minutes (section 5)."""
OUTAGE_S, _EVERY_S, _FROM_S = 60.0, 300.0, 240.0
SPARSE_S = 20.0
"""Between fixes of the second drive."""
_HEADING_SD_DEG = 5.0
_PLACE_DEG = (22.6163, 120.3133)
"""Kaohsiung."""

MIDG_II = ImuSpec(
    grade="midg-ii",
    rate_hz=50.0,
    # Table 2.
    gyro_instability_dps=4.7 / 3600.0,
    gyro_scale_ppm=5000.0,
    accel_bias_sd_mps2=0.006 * 9.80665,
    accel_scale_ppm=19_700.0,
    # Not in the paper: what is usual for such a unit.
    gyro_noise_dps_rthz=0.05,
    gyro_bias_sd_dps=0.1,
    accel_noise_mps2_rthz=0.0015,
    accel_instability_mps2=0.002,
)
RECEIVER = GnssSpec(
    rate_hz=1.0,
    # Together 2.1 m and 0.2 m/s (Table 2: 2-3 m, 0.2 m/s), height 4 m (3-5 m). How much of it is
    # slow, Table 3 bounds: no smoother takes slow error away, and what its off-line solution is
    # left with over the whole hour, outages included, is 0.69 m north and 0.95 m up. All of that is
    # taken for slow error; the rest is noise from fix to fix.
    sd_position_m=2.0,
    sd_height_m=3.9,
    correlated_sd_position_m=0.69,
    correlated_sd_height_m=0.95,
    sd_velocity_mps=0.2,
    sd_velocity_down_mps=0.3,
    latency_ms=0.0,
)


@dataclass(frozen=True, slots=True)
class Drive:
    """A drive with the fixes that the filter gets."""

    vehicle: VehicleRecording
    config: Config
    outages: tuple[Window, ...]

    def errors(self, solution: Solution) -> tuple[F64, F64]:
        """Seconds since the start (N,), and position errors (N, 3) [m, NED]."""
        truth = self.vehicle.truth
        assert truth is not None
        found = errors_against(solution, truth)
        return (found.t_ns - start_ns(self.vehicle)) / 1e9, found.position_n


def with_outages(seed: int) -> Drive:
    """An hour of town traffic, fixes at 1 Hz, without any for a minute in every five."""
    windows = tuple(
        Window(start, OUTAGE_S) for start in np.arange(_FROM_S, FIRST_S - OUTAGE_S, _EVERY_S)
    )
    vehicle, config = _drive(FIRST_S, RECEIVER, seed)
    return Drive(withhold_gnss(vehicle, windows), config, windows)


def with_few_fixes(seed: int) -> Drive:
    """34 minutes with a fix every 20 s, after two minutes at 1 Hz in which the filter settles."""
    vehicle, config = _drive(SECOND_S, RECEIVER, seed)
    fixes = vehicle.gnss[0]
    since_s = (fixes.t_ns - start_ns(vehicle)) / 1e9
    kept = (since_s < 120.0) | (np.round(since_s) % SPARSE_S == 0)
    return Drive(replace(vehicle, gnss=(fixes.take(kept),)), config, ())


def _drive(seconds: float, receiver: GnssSpec, seed: int) -> tuple[VehicleRecording, Config]:
    place = TrajectorySpec(
        kind="car-with-stops",
        duration_s=seconds,
        lat_deg=_PLACE_DEG[0],
        lon_deg=_PLACE_DEG[1],
        height_hae_m=30.0,
    )
    scenario = Scenario(
        name="duong", trajectory=place, imu=(MIDG_II,), gnss=(receiver,), truth_rate_hz=10.0
    )
    simulation = run(scenario, seed)
    start_deg = place.heading_deg + np.random.default_rng([12, seed]).normal(0.0, _HEADING_SD_DEG)
    return simulation.recording, _as_the_paper(matching_config(scenario), start_deg)


def _as_the_paper(config: Config, heading_deg: float) -> Config:
    """Inertial unit and GPS alone, with the scale factors that Table 2 gives as states."""
    change = msgspec.structs.replace
    return change(
        config,
        imu=change(
            config.imu,
            scale_factor_states=True,
            gyro_scale_sd_ppm=MIDG_II.gyro_scale_ppm,
            accel_scale_sd_ppm=MIDG_II.accel_scale_ppm,
        ),
        gnss=change(
            config.gnss,
            sd_position_m=RECEIVER.sd_position_m,
            sd_height_m=RECEIVER.sd_height_m,
            slow_error_sd_m=RECEIVER.correlated_sd_position_m,
            slow_error_height_sd_m=RECEIVER.correlated_sd_height_m,
            slow_error_tau_s=RECEIVER.correlated_tau_s,
            sd_reported="ignore",
        ),
        constraints=change(
            config.constraints, non_holonomic=False, course=False, zero_velocity=False
        ),
        # The paper's filter takes every fix; ours would wait for a second one behind an outage.
        source_faults=change(config.source_faults, detect=False),
        alignment=change(config.alignment, heading="fixed", fixed_heading_deg=heading_deg),
        mag=change(config.mag, sd_deg=_HEADING_SD_DEG),
        # Coasting for a minute, and fixes 20 s apart, are what this is about.
        engine=change(config.engine, coasting_after_s=2.0, output_rate_hz=50.0),
        smoothing=change(config.smoothing, longest_interval_s=2.0 * OUTAGE_S),
    )
