"""The filter configuration that says about the sensors what the simulator did to them."""

from __future__ import annotations

import math
from typing import Any

from companion.config import Adaptation, Baro, Config, Constraints, Gnss, Imu, Mag, Vehicle
from replay.simulator.aids import BaroSpec, GnssSpec, MagSpec
from replay.simulator.imu import ImuSpec
from replay.simulator.plans import CAR_IMU_AHEAD_M
from replay.simulator.scenarios import Scenario

_VEHICLE_KINDS: dict[str, Any] = {
    "static": "unknown",
    "hover": "multirotor",
    "multirotor-mission": "multirotor",
    "multirotor-sport": "multirotor",
    "fixed-wing": "fixed-wing",
    "car-with-stops": "ground",
    "yu-table1": "ground",
}
_SMALLEST = 1e-7
"""Stands for zero where the configuration asks for positive values."""


def _with_quantisation(density: float, step: float, rate_hz: float) -> float:
    """Noise density with the rounding noise step²/12 of each sample added."""
    return max(math.hypot(density, step / math.sqrt(12.0 * rate_hz)), _SMALLEST)


def imu_config(spec: ImuSpec) -> Imu:
    """Filter parameters of a simulated IMU.

    Exact for :meth:`ImuSpec.modelled_only`; otherwise instability enters as a random walk of the
    same driving density, and scale factor and misalignment do not enter.
    """
    return Imu(
        latency_ms=spec.latency_ms,
        gyro_noise_dps_rthz=_with_quantisation(
            spec.gyro_noise_dps_rthz, spec.gyro_step_dps, spec.rate_hz
        ),
        gyro_bias_sd_dps=max(math.hypot(spec.gyro_bias_sd_dps, spec.gyro_instability_dps), 1e-6),
        gyro_bias_walk_dps_rts=spec.gyro_walk_dps_rts,
        accel_noise_mps2_rthz=_with_quantisation(
            spec.accel_noise_mps2_rthz, spec.accel_step_mps2, spec.rate_hz
        ),
        accel_bias_sd_mps2=max(
            math.hypot(spec.accel_bias_sd_mps2, spec.accel_instability_mps2), 1e-6
        ),
        accel_bias_walk_mps2_rts=spec.accel_walk_mps2_rts,
        vibration_gain_rthz=0.0,
        gyro_range_dps=spec.gyro_range_dps if math.isfinite(spec.gyro_range_dps) else 0.0,
        accel_range_mps2=spec.accel_range_mps2 if math.isfinite(spec.accel_range_mps2) else 0.0,
    )


def gnss_config(spec: GnssSpec) -> Gnss:
    """Filter parameters of a simulated receiver; its slow error enters as white."""
    horizontal, vertical = spec.total_sd_m
    return Gnss(
        latency_sd_ms=0.0,
        latency_ms=spec.latency_ms if spec.stamped == "arrival" else 0.0,
        lever_arm_b_m=spec.lever_arm_b_m,
        sd_position_m=max(horizontal, 1e-3),
        sd_height_m=max(vertical, 1e-3),
        sd_velocity_mps=max(spec.sd_velocity_mps, 1e-3),
        sd_velocity_down_mps=max(spec.sd_velocity_down_mps, 1e-3),
        # The receiver's own word is not taken where the scenario makes it lie.
        sd_reported="floor" if spec.reported_factor == 1.0 else "ignore",
    )


def _baro_config(spec: BaroSpec | None) -> Baro:
    if spec is None:
        return Baro(use=False)
    return Baro(sd_m=max(spec.sd_m, 1e-3), bias_walk_m_rts=spec.walk_m_rts)


def _mag_config(spec: MagSpec | None) -> Mag:
    if spec is None:
        return Mag()
    # 20 µT of horizontal field, as in Europe: heading noise = sd / horizontal.
    return Mag(
        use=True,
        sd_deg=max(math.degrees(spec.sd_t / 2e-5), 1.0),
        declination_deg=None
        if spec.field_n_t is None
        else math.degrees(math.atan2(spec.field_n_t[1], spec.field_n_t[0])),
        hard_iron_t=spec.hard_iron_t,
    )


def matching_config(scenario: Scenario) -> Config:
    """Configuration whose parameters equal those that ``scenario`` simulates.

    It describes the first IMU and the first receiver. Sensors that are what is said of them leave
    nothing to adapt to, and an adaptive R makes innovations look right by construction: off.
    """
    kind = scenario.trajectory.kind
    wheels = kind in ("car-with-stops", "yu-table1")
    ahead = CAR_IMU_AHEAD_M if kind == "car-with-stops" else 0.0
    return Config(
        vehicle=Vehicle(name=scenario.name, kind=_VEHICLE_KINDS[kind]),
        imu=imu_config(scenario.imu[0]),
        gnss=gnss_config(scenario.gnss[0]) if scenario.gnss else Gnss(),
        baro=_baro_config(scenario.baro),
        mag=_mag_config(scenario.mag),
        constraints=Constraints(
            non_holonomic=wheels,
            non_holonomic_lever_b_m=(-ahead, 0.0, 0.0),
            course=wheels,
        ),
        adaptation=Adaptation(method="none"),
    )
