"""Scenarios: what is flown with which sensors; built-in ones by name, any by TOML.

A scenario file has the sections below; every key has a default, unknown keys fail::

    name = "windy-mission"

    [trajectory]
    kind = "multirotor-mission"   # static, hover, multirotor-mission, multirotor-sport,
    duration_s = 300.0            # fixed-wing, car-with-stops, yu-table1
    rest_s = 10.0                 # at rest before the first motion
    heading_deg = 40.0

    [imu]                         # [[imu]] several times for several units
    grade = "mems-consumer"       # keys below replace values of the grade
    rate_hz = 200.0
    gyro_noise_dps_rthz = 0.01

    [gnss]
    rate_hz = 5.0
    lever_arm_b_m = [0.1, 0.0, -0.05]
    outages = [{ start_s = 60.0, length_s = 20.0 }]

    [baro]                        # absent, as [mag]: no such sensor
"""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any, Literal

import msgspec

from companion.types import ConfigError
from replay.simulator.aids import BaroSpec, Fault, GnssSpec, MagSpec, Outage
from replay.simulator.imu import IMU_GRADES, ImuSpec


class TrajectorySpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is flown or driven, where and for how long."""

    kind: Literal[
        "static",
        "hover",
        "multirotor-mission",
        "multirotor-sport",
        "fixed-wing",
        "car-with-stops",
        "yu-table1",
    ] = "multirotor-mission"
    duration_s: float = 180.0
    rest_s: float = 10.0
    """At rest before the first motion; part of the duration."""
    heading_deg: float = 30.0
    """At the start."""
    lat_deg: float = 47.3977
    lon_deg: float = 8.5456
    height_hae_m: float = 488.0
    seed: int | None = None
    """Fixes what is flown while the simulation's seed varies the errors; absent: that seed."""


class Scenario(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A flight to simulate: trajectory and sensors."""

    name: str = "scenario"
    start_unix_s: int = 1_748_779_200
    """2025-06-01 12:00 UTC; the World Magnetic Model needs a date."""
    truth_rate_hz: float = 50.0
    """Truth is given at every n-th stamp of the first IMU, n being the nearest to this rate."""
    trajectory: TrajectorySpec = TrajectorySpec()
    imu: tuple[ImuSpec, ...] = (IMU_GRADES["mems-consumer"],)
    gnss: tuple[GnssSpec, ...] = (GnssSpec(),)
    baro: BaroSpec | None = None
    mag: MagSpec | None = None


def graded(grade: str, **changes: Any) -> ImuSpec:
    """The IMU of a named grade with some fields changed.

    Raises :class:`ConfigError` for an unknown grade, naming the known ones.
    """
    if grade not in IMU_GRADES:
        raise ConfigError(
            f"key 'imu.grade': unknown grade '{grade}'; known are {', '.join(sorted(IMU_GRADES))}"
        )
    return msgspec.structs.replace(IMU_GRADES[grade], **changes)


def _builtin(name: str, kind: str, duration_s: float, **more: Any) -> Scenario:
    spec = TrajectorySpec(kind=kind, duration_s=duration_s)  # type: ignore[arg-type]
    return Scenario(**{"name": name, "trajectory": spec, "baro": BaroSpec(), **more})


_CONSUMER_100 = (graded("mems-consumer", rate_hz=100.0),)
_CONSUMER_200 = (graded("mems-consumer", rate_hz=200.0, vibration_mps2=0.5),)

SCENARIOS: dict[str, Scenario] = {
    s.name: s
    for s in (
        _builtin("static", "static", 120.0),
        _builtin("hover", "hover", 120.0, imu=_CONSUMER_200),
        _builtin(
            "multirotor-mission", "multirotor-mission", 300.0, imu=_CONSUMER_200, mag=MagSpec()
        ),
        _builtin(
            "multirotor-outages",
            "multirotor-mission",
            480.0,
            imu=_CONSUMER_200,
            gnss=(
                GnssSpec(
                    outages=(
                        Outage(start_s=90.0, length_s=10.0),
                        Outage(start_s=160.0, length_s=20.0),
                        Outage(start_s=240.0, length_s=30.0),
                        Outage(start_s=340.0, length_s=60.0),
                    )
                ),
            ),
        ),
        _builtin(
            "multirotor-faults",
            "multirotor-mission",
            300.0,
            imu=_CONSUMER_200,
            gnss=(
                GnssSpec(
                    spike_probability=0.01,
                    faults=(
                        Fault(start_s=100.0, length_s=5.0, step_n_m=(25.0, -15.0, 10.0)),
                        Fault(start_s=180.0, length_s=60.0, ramp_n_mps=(0.7, 0.7, 0.0)),
                    ),
                ),
            ),
        ),
        _builtin("fixed-wing", "fixed-wing", 400.0, imu=_CONSUMER_200, mag=MagSpec()),
        _builtin(
            "car-with-stops",
            "car-with-stops",
            400.0,
            imu=_CONSUMER_100,
            baro=None,
            gnss=(GnssSpec(rate_hz=1.0, lever_arm_b_m=(0.3, 0.0, -1.2)),),
        ),
        # Three equal units and GPS at 1 Hz, as in section V of Yu et al. 2018.
        _builtin(
            "yu-table1",
            "yu-table1",
            70.0,
            baro=None,
            imu=tuple(graded("yu-2018", source=f"imu{i}") for i in (1, 2, 3)),
            gnss=(GnssSpec(rate_hz=1.0, correlated_sd_position_m=3.0),),
        ),
        _builtin("hour", "multirotor-mission", 3600.0, imu=_CONSUMER_200),
    )
}
"""Built-in scenarios by name."""


def _with_grade(table: Any) -> Any:
    """An ``imu`` table of TOML, laid over the values of its grade."""
    if not isinstance(table, dict) or "grade" not in table:
        return table
    return {**msgspec.structs.asdict(graded(str(table["grade"]))), **table}


def parse_scenario(text: str, origin: str = "scenario") -> Scenario:
    """A scenario from TOML text; :class:`ConfigError` with ``origin`` and the offending key."""
    try:
        raw = tomllib.loads(text)
        for key in ("imu", "gnss"):
            if isinstance(raw.get(key), dict):
                raw[key] = [raw[key]]
        if isinstance(raw.get("imu"), list):
            raw["imu"] = [_with_grade(table) for table in raw["imu"]]
        scenario = msgspec.convert(raw, Scenario)
        check(scenario)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from None
    except (msgspec.ValidationError, ConfigError) as error:
        raise ConfigError(f"{origin}: {error}") from None
    return scenario


def load_scenario(name_or_path: str) -> Scenario:
    """A built-in scenario by name, or one from a ``.toml`` file.

    Raises :class:`ConfigError` that lists the built-in names if it is neither.
    """
    if name_or_path in SCENARIOS:
        return SCENARIOS[name_or_path]
    if not name_or_path.endswith(".toml"):
        raise ConfigError(
            f"no scenario '{name_or_path}'; built in are {', '.join(SCENARIOS)}; "
            "or give the path of a .toml file"
        )
    try:
        text = Path(name_or_path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{name_or_path}: cannot be read: {error}") from None
    return parse_scenario(text, name_or_path)


_MAX_SAMPLES = 50_000_000
"""Of one sensor: two days at 200 Hz, a few GB of memory."""


def _check_numbers(section: str, spec: msgspec.Struct, duration_s: float) -> None:
    """Every scalar of a sensor is a size: finite (a range may be infinite), none negative."""
    for key in spec.__struct_fields__:
        value = getattr(spec, key)
        if not isinstance(value, float | int):
            continue
        if key == "rate_hz" and not 0.01 <= value <= 5000.0:
            raise ConfigError(f"key '{section}.rate_hz': Hz between 0.01 and 5000, got {value}")
        if key == "rate_hz" and value * duration_s > _MAX_SAMPLES:
            raise ConfigError(f"key '{section}.rate_hz': more than {_MAX_SAMPLES} samples")
        if key.endswith(("_tau_s", "_hz")) and not 0.0 < value < math.inf:
            raise ConfigError(f"key '{section}.{key}': must be positive, got {value}")
        if key.endswith("_ms") and not 0.0 <= value <= 10_000.0:
            raise ConfigError(f"key '{section}.{key}': milliseconds between 0 and 10000")
        if not value >= 0.0 or (math.isinf(value) and "_range_" not in key):
            raise ConfigError(f"key '{section}.{key}': must be zero or more, got {value}")


def check(scenario: Scenario) -> None:
    """Raise :class:`ConfigError` for values that cannot be simulated, naming the key."""
    trajectory = scenario.trajectory
    if not 1.0 <= trajectory.duration_s <= 86400.0:
        raise ConfigError("key 'trajectory.duration_s': seconds between 1 and 86400")
    if not 0.0 <= trajectory.rest_s <= 86400.0:
        raise ConfigError("key 'trajectory.rest_s': seconds between 0 and 86400")
    if not -85.0 <= trajectory.lat_deg <= 85.0:
        raise ConfigError("key 'trajectory.lat_deg': between −85 and 85, away from the poles")
    if not -180.0 <= trajectory.lon_deg <= 180.0:
        raise ConfigError("key 'trajectory.lon_deg': between −180 and 180")
    if not -1000.0 <= trajectory.height_hae_m <= 10_000.0:
        raise ConfigError("key 'trajectory.height_hae_m': metres between −1000 and 10000")
    if not -360.0 <= trajectory.heading_deg <= 360.0:
        raise ConfigError("key 'trajectory.heading_deg': between −360 and 360")
    if trajectory.seed is not None and trajectory.seed < 0:
        raise ConfigError("key 'trajectory.seed': zero or more")
    if not scenario.imu:
        raise ConfigError("section 'imu': at least one unit is needed")
    if not 0.01 <= scenario.truth_rate_hz <= 5000.0:
        raise ConfigError("key 'truth_rate_hz': Hz between 0.01 and 5000")
    for imu in scenario.imu:
        if imu.latency_ms > 500.0:
            raise ConfigError("key 'imu.latency_ms': between 0 and 500")
    sensors: list[tuple[str, msgspec.Struct | None]] = [("imu", spec) for spec in scenario.imu]
    sensors += [("gnss", spec) for spec in scenario.gnss]
    sensors += [("baro", scenario.baro), ("mag", scenario.mag)]
    for section, spec in sensors:
        if spec is not None:
            _check_numbers(section, spec, trajectory.duration_s)
