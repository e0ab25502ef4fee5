"""Inertial sensors as their datasheets give them: grades by name, errors, simulated output."""

from __future__ import annotations

import math
from typing import Literal

import msgspec
import numpy as np

from companion.config import DEG
from companion.types import F64
from replay.simulator.disturbances import BiasStep, Failure, Shaking, failed, shaken, stepped
from replay.simulator.noise import gauss_markov, narrow_band, random_walk


class ImuSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One inertial unit: what it measures when, and how wrong. Units as in ``companion.config``.

    output = quantise(saturate((I + misalignment + scale) truth + bias + white + vibration)), with
    bias = turn-on constant + Gauss-Markov instability + random walk, independent on each axis.
    Zero switches an error off.
    """

    grade: str = "custom"
    """A name of ``IMU_GRADES``: in TOML the other keys then replace values of that grade."""
    source: str = "HIGHRES_IMU"
    rate_hz: float = 100.0
    output: Literal["instantaneous", "integral"] = "instantaneous"
    """``integral``: means over the interval that ends at the stamp, no motion lost between."""
    latency_ms: float = 0.0
    """Stamp − validity, as of a unit that filters."""
    arrival_ms: float = 2.0
    """Arrival − stamp."""
    gyro_noise_dps_rthz: float = 0.0
    gyro_bias_sd_dps: float = 0.0
    """Turn-on bias, 1σ."""
    gyro_instability_dps: float = 0.0
    """Bias instability: 1σ of a Gauss-Markov process."""
    gyro_instability_tau_s: float = 300.0
    gyro_bias_walk_dps_rts: float = 0.0
    gyro_scale_ppm: float = 0.0
    gyro_misalignment_mrad: float = 0.0
    """1σ of each off-diagonal element."""
    gyro_step_dps: float = 0.0
    """Quantisation."""
    gyro_range_dps: float = math.inf
    accel_noise_mps2_rthz: float = 0.0
    accel_bias_sd_mps2: float = 0.0
    accel_instability_mps2: float = 0.0
    accel_instability_tau_s: float = 300.0
    accel_bias_walk_mps2_rts: float = 0.0
    accel_scale_ppm: float = 0.0
    accel_misalignment_mrad: float = 0.0
    accel_step_mps2: float = 0.0
    accel_range_mps2: float = math.inf
    vibration_mps2: float = 0.0
    """RMS of rotor or engine vibration on each accelerometer axis, moving the sensor to and fro
    by micrometres: not part of the truth. From just before the first motion to the last one."""
    vibration_hz: float = 80.0
    bias_steps: tuple[BiasStep, ...] = ()
    shaking: tuple[Shaking, ...] = ()
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the vehicle's reference point, where the first unit should be, body FRD [m]."""
    failures: tuple[Failure, ...] = ()

    def modelled_only(self) -> ImuSpec:
        """The same unit with just what the 15-state filter models, for consistency tests.

        White noise, turn-on bias and random walk stay; instability becomes random walk of the same
        driving density (σ √(2/τ)); scale, misalignment, steps, ranges and vibration go.
        """
        return msgspec.structs.replace(
            self,
            gyro_bias_walk_dps_rts=self.gyro_walk_dps_rts,
            gyro_instability_dps=0.0,
            gyro_scale_ppm=0.0,
            gyro_misalignment_mrad=0.0,
            gyro_step_dps=0.0,
            gyro_range_dps=math.inf,
            accel_bias_walk_mps2_rts=self.accel_walk_mps2_rts,
            accel_instability_mps2=0.0,
            accel_scale_ppm=0.0,
            accel_misalignment_mrad=0.0,
            accel_step_mps2=0.0,
            accel_range_mps2=math.inf,
            vibration_mps2=0.0,
            bias_steps=(),
            shaking=(),
            failures=(),
        )

    @property
    def gyro_walk_dps_rts(self) -> float:
        """Driving density of the whole moving gyro bias [deg/s/√s]."""
        return math.hypot(
            self.gyro_bias_walk_dps_rts,
            self.gyro_instability_dps * math.sqrt(2.0 / self.gyro_instability_tau_s),
        )

    @property
    def accel_walk_mps2_rts(self) -> float:
        """Driving density of the whole moving accelerometer bias [m/s²/√s]."""
        return math.hypot(
            self.accel_bias_walk_mps2_rts,
            self.accel_instability_mps2 * math.sqrt(2.0 / self.accel_instability_tau_s),
        )


IMU_GRADES: dict[str, ImuSpec] = {
    "perfect": ImuSpec(grade="perfect", arrival_ms=0.0),
    # Six-axis phone and autopilot chips (InvenSense MPU-6000, ICM-20602 class) after the usual
    # static calibration; ±2000 °/s and ±16 g in 16 bits.
    "mems-consumer": ImuSpec(
        grade="mems-consumer",
        gyro_noise_dps_rthz=0.008,
        gyro_bias_sd_dps=0.3,
        gyro_instability_dps=0.004,
        gyro_bias_walk_dps_rts=2e-4,
        gyro_scale_ppm=2000.0,
        gyro_misalignment_mrad=2.0,
        gyro_step_dps=4000.0 / 65536.0,
        gyro_range_dps=2000.0,
        accel_noise_mps2_rthz=0.004,
        accel_bias_sd_mps2=0.1,
        accel_instability_mps2=0.002,
        accel_bias_walk_mps2_rts=1e-4,
        accel_scale_ppm=2000.0,
        accel_misalignment_mrad=2.0,
        accel_step_mps2=32.0 * 9.80665 / 65536.0,
        accel_range_mps2=16.0 * 9.80665,
    ),
    # Factory-calibrated industrial modules (ADIS1647x, MTi-600 class).
    "mems-industrial": ImuSpec(
        grade="mems-industrial",
        gyro_noise_dps_rthz=0.003,
        gyro_bias_sd_dps=0.1,
        gyro_instability_dps=8.0 / 3600.0,
        gyro_scale_ppm=1000.0,
        gyro_misalignment_mrad=0.5,
        gyro_range_dps=2000.0,
        accel_noise_mps2_rthz=6e-4,
        accel_bias_sd_mps2=0.02,
        accel_instability_mps2=2e-4,
        accel_scale_ppm=500.0,
        accel_misalignment_mrad=0.5,
        accel_range_mps2=8.0 * 9.80665,
    ),
    # Small tactical units (HG4930, STIM300 class): 0.04-0.15 °/√h, below 1 °/h in run.
    "tactical": ImuSpec(
        grade="tactical",
        gyro_noise_dps_rthz=0.06 / 60.0,
        gyro_bias_sd_dps=7.0 / 3600.0,
        gyro_instability_dps=0.3 / 3600.0,
        gyro_scale_ppm=200.0,
        gyro_misalignment_mrad=0.1,
        gyro_range_dps=400.0,
        accel_noise_mps2_rthz=0.03 / 60.0,
        accel_bias_sd_mps2=1.7e-3 * 9.80665,
        accel_instability_mps2=3e-5 * 9.80665,
        accel_scale_ppm=200.0,
        accel_misalignment_mrad=0.1,
        accel_range_mps2=20.0 * 9.80665,
    ),
    # Section V of Yu et al. 2018: 10 °/h and 4.5 °/√h, 0.1 mg and 1 m/s/√h.
    "yu-2018": ImuSpec(
        grade="yu-2018",
        gyro_noise_dps_rthz=4.5 / 60.0,
        gyro_bias_sd_dps=10.0 / 3600.0,
        gyro_instability_dps=10.0 / 3600.0,
        accel_noise_mps2_rthz=1.0 / 60.0,
        accel_bias_sd_mps2=1e-4 * 9.80665,
        accel_instability_mps2=1e-4 * 9.80665,
    ),
}
"""Rounded from datasheets of each class; "bias" is what is left after the usual calibration."""


def _corrupt(
    rng: np.random.Generator,
    ideal: F64,
    step_s: float,
    *,
    bias: F64,
    noise: float,
    vibration: F64,
    scale: float,
    misalignment: float,
    quantum: float,
    limit: float,
) -> F64:
    """Sensor output (N, 3) from ``ideal`` (N, 3), all in the same SI unit; see :class:`ImuSpec`."""
    gain = np.eye(3) + rng.standard_normal((3, 3)) * misalignment
    gain[np.diag_indices(3)] = 1.0 + rng.standard_normal(3) * scale
    out = ideal @ gain.T + bias + vibration
    out += rng.standard_normal(ideal.shape) * (noise / math.sqrt(step_s))
    if math.isfinite(limit):
        np.clip(out, -limit, limit, out=out)
    if quantum > 0:
        out = np.rint(out / quantum) * quantum
    return np.asarray(out)


def _bias(
    rng: np.random.Generator,
    count: int,
    step_s: float,
    turn_on: float,
    instability: float,
    tau_s: float,
    walk: float,
) -> F64:
    """Bias history (count, 3) in the unit of its arguments."""
    bias = np.tile(rng.standard_normal(3) * turn_on, (count, 1))
    bias += gauss_markov(rng, count, step_s, np.full(3, instability), tau_s)
    bias += random_walk(rng, count, step_s, np.full(3, walk))
    return bias


def measure(
    spec: ImuSpec,
    rng: np.random.Generator,
    gyro_ideal: F64,
    accel_ideal: F64,
    t: F64,
    running: F64 | float = 1.0,
) -> tuple[F64, F64, F64, F64]:
    """Gyro, accelerometer, gyro bias, accelerometer bias, each (N, 3) in SI, of a simulated unit.

    ``t`` (N,) [s] since the start places what happens for a while; ``running`` (N, 1) scales the
    vibration: 1 with motors on, 0 with motors off.
    A zero-valued error still draws its random numbers, so that switching one off leaves the
    others as they were.
    """
    count, step_s = len(gyro_ideal), 1.0 / spec.rate_hz
    # A child's numbers are its own: the draws below stay as they are without disturbances.
    shaken_gyro, shaken_accel = shaken(spec.shaking, rng.spawn(1)[0], t, step_s)
    gyro_step, accel_step = stepped(spec.bias_steps, t)
    gyro_bias = DEG * _bias(
        rng,
        count,
        step_s,
        spec.gyro_bias_sd_dps,
        spec.gyro_instability_dps,
        spec.gyro_instability_tau_s,
        spec.gyro_bias_walk_dps_rts,
    )
    gyro_bias += gyro_step
    accel_bias = _bias(
        rng,
        count,
        step_s,
        spec.accel_bias_sd_mps2,
        spec.accel_instability_mps2,
        spec.accel_instability_tau_s,
        spec.accel_bias_walk_mps2_rts,
    )
    accel_bias += accel_step
    gyro = _corrupt(
        rng,
        gyro_ideal,
        step_s,
        bias=gyro_bias,
        noise=spec.gyro_noise_dps_rthz * DEG,
        vibration=shaken_gyro,
        scale=spec.gyro_scale_ppm * 1e-6,
        misalignment=spec.gyro_misalignment_mrad * 1e-3,
        quantum=spec.gyro_step_dps * DEG,
        limit=spec.gyro_range_dps * DEG,
    )
    accel = _corrupt(
        rng,
        accel_ideal,
        step_s,
        bias=accel_bias,
        noise=spec.accel_noise_mps2_rthz,
        vibration=running
        * narrow_band(rng, count, step_s, spec.vibration_mps2, spec.vibration_hz, 3)
        + shaken_accel,
        scale=spec.accel_scale_ppm * 1e-6,
        misalignment=spec.accel_misalignment_mrad * 1e-3,
        quantum=spec.accel_step_mps2,
        limit=spec.accel_range_mps2,
    )
    rate = 1.0 / math.sqrt(step_s)
    white = (spec.gyro_noise_dps_rthz * DEG * rate, spec.accel_noise_mps2_rthz * rate)
    limits = (spec.gyro_range_dps * DEG, spec.accel_range_mps2)
    failed(spec.failures, rng.spawn(1)[0], t, gyro, accel, white=white, limits=limits)
    return gyro, accel, gyro_bias, accel_bias
