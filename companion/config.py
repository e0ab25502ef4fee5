"""Configuration: TOML in, typed and checked values out.

Keys carry their unit in their name and are converted to SI and radians by the consumer's
``*_si`` properties here, nowhere else. Unknown keys fail, with the nearest known one named.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from companion.types import ConfigError

DEG = math.pi / 180.0
G0 = 9.80665


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of all sections: immutable, keyword-only, closed to unknown keys."""


class Vehicle(_Section):
    name: str = "vehicle"
    kind: Literal["multirotor", "fixed-wing", "ground", "handheld", "unknown"] = "unknown"


class Imu(_Section):
    """Inertial sensor: as its datasheet gives it. Defaults: a consumer MEMS on a vibrating body."""

    source: str = "auto"
    """Stream name, or ``auto`` for the best one in the log."""
    latency_ms: float = 0.0
    """Stamp − validity: a filtered IMU is late by the delay of its filter."""
    axes: tuple[tuple[float, float, float], ...] = ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    """Rotation from the sensor's axes to body FRD, row by row."""
    gyro_noise_dps_rthz: float = 0.02
    """Angle random walk as noise density [deg/s/√Hz]; deg/√h ÷ 60."""
    gyro_bias_sd_dps: float = 0.5
    """Turn-on bias, 1σ [deg/s]."""
    gyro_bias_walk_dps_rts: float = 0.001
    """Rate random walk [deg/s/√s]."""
    gyro_bias_tau_s: float = 0.0
    """Correlation time of the bias [s]; 0: a random walk."""
    accel_noise_mps2_rthz: float = 0.01
    """Velocity random walk as noise density [m/s²/√Hz]; m/s/√h ÷ 60."""
    accel_bias_sd_mps2: float = 0.2
    accel_bias_walk_mps2_rts: float = 0.0005
    accel_bias_tau_s: float = 0.0
    vibration_gain_rthz: float = 0.05
    """Further accelerometer noise density per m/s² of vibration (1σ over a quarter of the
    standstill window) [1/√Hz]; rectification and aliasing grow with what shakes the sensor."""
    scale_factor_states: bool = False
    gyro_scale_sd_ppm: float = 5000.0
    accel_scale_sd_ppm: float = 5000.0


class Gnss(_Section):
    source: str = "auto"
    latency_ms: float = 0.0
    """Stamp (or arrival) − validity of a fix."""
    latency_sd_ms: float = 10.0
    """Scatter of that latency, 1σ: counts as velocity error in proportion to acceleration and as
    position error in proportion to speed."""
    lever_arm_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the IMU to the antenna, body FRD [m]."""
    position: bool = True
    velocity: bool = True
    sd_position_m: float = 1.5
    """Used where the source reports none, and as the floor of a reported one: horizontal, 1σ."""
    sd_height_m: float = 3.0
    sd_velocity_mps: float = 0.2
    sd_velocity_down_mps: float = 0.3
    sd_reported: Literal["use", "floor", "ignore"] = "floor"
    """``use``: as reported; ``floor``: the larger of reported and configured; ``ignore``."""
    max_sd_position_m: float = 50.0
    """A fix that reports worse is refused."""
    min_fix_type: int = 3
    lever_arm_sd_m: float = 0.0
    """Uncertainty of the lever arm; above 0 it becomes three states of the filter."""
    slow_error_sd_m: float = 0.0
    """Slow (first-order Gauss-Markov) error of the receiver's horizontal position, 1σ. Where this
    or the next is above 0 it is three states, and the deviations above are the white part."""
    slow_error_height_sd_m: float = 0.0
    """The same for its height."""
    slow_error_tau_s: float = 120.0


class Baro(_Section):
    use: bool = True
    latency_ms: float = 0.0
    sd_m: float = 1.0
    bias_walk_m_rts: float = 0.03
    """Random walk of the offset between pressure height and the GNSS datum [m/√s]."""


class Mag(_Section):
    use: bool = False
    latency_ms: float = 0.0
    sd_deg: float = 5.0
    """Heading, 1σ."""
    max_rate_hz: float = 10.0
    """Faster streams are thinned: neighbouring magnetometer errors are not independent."""
    declination_deg: float | None = None
    """Absent: World Magnetic Model at the place and date."""
    hard_iron_t: tuple[float, float, float] = (0.0, 0.0, 0.0)


class Constraints(_Section):
    """Pseudo-measurements that follow from what the vehicle is."""

    zero_velocity: bool = True
    zero_velocity_sd_mps: float = 0.03
    zero_rate_sd_dps: float = 0.05
    standstill_window_s: float = 1.0
    standstill_gyro_dps: float = 0.5
    """Largest spread of the gyro's means over the window's quarters that counts as standing."""
    standstill_accel_mps2: float = 0.12
    """The same for the accelerometer."""
    standstill_speed_mps: float = 0.3
    """A standstill is never declared while a recent GNSS velocity exceeds this (plus 2σ)."""
    non_holonomic: bool = False
    non_holonomic_sd_mps: float = 0.1
    non_holonomic_rate_hz: float = 10.0
    non_holonomic_lever_b_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the IMU to the point that does not slip sideways (the rear axle)."""
    course: bool = False
    """Heading from GNSS course, for vehicles that point where they go."""
    course_min_speed_mps: float = 3.0
    course_sd_deg: float = 3.0


class Alignment(_Section):
    heading: Literal["auto", "magnetometer", "course", "unknown", "fixed"] = "auto"
    """``auto``: magnetometer with ``mag.use``, course with ``constraints.course``, else unknown."""
    fixed_heading_deg: float = 0.0
    window_s: float = 1.0
    """Length of the accelerometer and gyro means for levelling [s]."""
    hypotheses: int = 12
    """Filters in the bank over an unknown heading."""
    heading_found_sd_deg: float = 8.0


class EngineConfig(_Section):
    estimator: Literal["error-state"] = "error-state"
    correction: Literal["feedback", "feedforward"] = "feedback"
    covariance_rate_hz: float = 50.0
    """Covariance propagation; the state itself runs at the IMU's rate."""
    output_rate_hz: float = 50.0
    delay_ring_s: float = 0.5
    """Aiding may arrive this late; older is refused and reported."""
    gate_probability: float = 0.9999
    """Two-sided: a good measurement passes with this probability."""
    imu_gap_bridge_s: float = 0.5
    """A longer silence of the IMU is a declared reset."""
    coasting_after_s: float = 2.0
    diverged_position_sd_m: float = 5000.0
    """Beyond it the solution is worthless: declared reset at the next fix."""
    gate_relock_s: float = 10.0
    """Position aiding rejected by the gate for this long: declared reset of position and
    velocity to several mutually consistent fixes."""


class Config(_Section):
    vehicle: Vehicle = Vehicle()
    imu: Imu = Imu()
    gnss: Gnss = Gnss()
    baro: Baro = Baro()
    mag: Mag = Mag()
    constraints: Constraints = Constraints()
    alignment: Alignment = Alignment()
    engine: EngineConfig = EngineConfig()


def _known_keys(path: str) -> list[str]:
    section: Any = Config
    for part in [p for p in path.split(".") if p]:
        found = {f.name: f.type for f in msgspec.structs.fields(section)}.get(part)
        if found is None or not isinstance(found, type) or not issubclass(found, _Section):
            return []
        section = found
    return [f.name for f in msgspec.structs.fields(section)]


def _explain(error: msgspec.ValidationError) -> str:
    text = str(error)
    path = ""
    if " - at `$." in text:
        path = text.split(" - at `$.")[1].rstrip("`")
    if "unknown field" in text:
        bad = text.split("unknown field `")[1].split("`")[0]
        near = difflib.get_close_matches(bad, _known_keys(path), n=1)
        where = f"{path}.{bad}" if path else bad
        return f"unknown key '{where}'" + (f"; did you mean '{near[0]}'?" if near else "")
    return f"key '{path}': {text.split(' - at')[0]}" if path else text


_POSITIVE = (
    "imu.gyro_noise_dps_rthz",
    "imu.accel_noise_mps2_rthz",
    "imu.gyro_bias_sd_dps",
    "imu.accel_bias_sd_mps2",
    "gnss.sd_position_m",
    "gnss.sd_height_m",
    "gnss.sd_velocity_mps",
    "gnss.sd_velocity_down_mps",
    "gnss.slow_error_tau_s",
    "baro.sd_m",
    "mag.sd_deg",
    "mag.max_rate_hz",
    "constraints.zero_velocity_sd_mps",
    "constraints.zero_rate_sd_dps",
    "constraints.standstill_window_s",
    "constraints.non_holonomic_sd_mps",
    "constraints.non_holonomic_rate_hz",
    "constraints.course_sd_deg",
    "alignment.window_s",
    "engine.covariance_rate_hz",
    "engine.output_rate_hz",
    "engine.delay_ring_s",
    "engine.imu_gap_bridge_s",
)


def _check(config: Config) -> None:
    for key in _POSITIVE:
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"key '{key}': must be positive, got {value}")
    axes = config.imu.axes
    if len(axes) != 3:
        raise ConfigError("key 'imu.axes': must have three rows of three numbers")
    for i in range(3):
        for j in range(3):
            dot = sum(a * b for a, b in zip(axes[i], axes[j], strict=True))
            if not abs(dot - (i == j)) <= 1e-6:
                raise ConfigError("key 'imu.axes': rows must be orthonormal (a rotation)")
    (a, b, c), (d, e, f), (g, h, i_) = axes
    if a * (e * i_ - f * h) - b * (d * i_ - f * g) + c * (d * h - e * g) < 0:
        raise ConfigError("key 'imu.axes': determinant is −1; a rotation has +1 (swap a sign)")
    for key, limit in (("imu.latency_ms", 500.0), ("gnss.latency_ms", 2000.0)):
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        if not 0 <= value <= limit:
            raise ConfigError(f"key '{key}': milliseconds between 0 and {limit:g}, got {value}")
    if not 0.5 < config.engine.gate_probability < 1:
        raise ConfigError("key 'engine.gate_probability': between 0.5 and 1, such as 0.9999")
    if not 4 <= config.alignment.hypotheses <= 72:
        raise ConfigError("key 'alignment.hypotheses': between 4 and 72")


def parse(text: str, origin: str = "configuration") -> Config:
    """Typed configuration from TOML text.

    Raises :class:`ConfigError` with ``origin`` and the offending key.
    """
    try:
        config = msgspec.convert(tomllib.loads(text), Config)
        _check(config)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from None
    except msgspec.ValidationError as error:
        raise ConfigError(f"{origin}: {_explain(error)}") from None
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from None
    return config


def load(path: Path) -> Config:
    """Typed configuration from a TOML file."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    return parse(text, str(path))
