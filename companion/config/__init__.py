"""Configuration: TOML in, typed and checked values out.

Keys carry their unit in their name and are converted to SI and radians by the consumer's
``*_si`` properties here, nowhere else. Unknown keys fail, with the nearest known one named.
"""

from __future__ import annotations

import difflib
import math
import tomllib
from pathlib import Path
from typing import Any, get_args

import msgspec

from companion.config.adaptation import Adaptation, check_adaptation, with_all_rules
from companion.config.can_ranges import further_with_ranges, imu_with_range
from companion.config.direct_checks import check_direct
from companion.config.estimator import (
    Alignment,
    Bank,
    Baro,
    Constraints,
    Direct,
    EngineConfig,
    FurtherImu,
    Gnss,
    Imu,
    ImuFusion,
    LastHeading,
    Mag,
    Smoothing,
    SourceFaults,
    Vehicle,
)
from companion.config.imu_checks import check_units
from companion.config.live import (
    CanBus,
    CanImu,
    DbcMapping,
    Ground,
    Live,
    Log,
    Mavlink,
    ToAutopilot,
    Zenoh,
)
from companion.config.live_checks import check_live
from companion.config.ranges import positive, rotation, within
from companion.config.raw_gnss import RawGnss, check_raw_gnss
from companion.config.section import Section
from companion.config.settings import changed, smoothable
from companion.config.spelled import to_toml
from companion.types import ConfigError

__all__ = [
    "DEG",
    "G0",
    "Adaptation",
    "Alignment",
    "Bank",
    "Baro",
    "CanBus",
    "CanImu",
    "Config",
    "Constraints",
    "DbcMapping",
    "Direct",
    "EngineConfig",
    "FurtherImu",
    "Gnss",
    "Ground",
    "Imu",
    "ImuFusion",
    "LastHeading",
    "Live",
    "Log",
    "Mag",
    "Mavlink",
    "RawGnss",
    "Smoothing",
    "SourceFaults",
    "ToAutopilot",
    "Vehicle",
    "Zenoh",
    "from_table",
    "load",
    "parse",
    "to_toml",
]

DEG = math.pi / 180.0
G0 = 9.80665
MAX_WINDOW = 100
"""Longest smoothing window: beyond it nothing is gained, and every fix costs as many passes."""


class Config(Section):
    """One TOML file: every section may be left out, and every key but those without a default."""

    vehicle: Vehicle = Vehicle()
    imu: Imu = Imu()
    further_imu: tuple[FurtherImu, ...] = ()
    imu_fusion: ImuFusion = ImuFusion()
    gnss: Gnss = Gnss()
    raw_gnss: RawGnss = RawGnss()
    baro: Baro = Baro()
    mag: Mag = Mag()
    constraints: Constraints = Constraints()
    alignment: Alignment = Alignment()
    engine: EngineConfig = EngineConfig()
    bank: Bank = Bank()
    adaptation: Adaptation = Adaptation()
    smoothing: Smoothing = Smoothing()
    source_faults: SourceFaults = SourceFaults()
    direct: Direct = Direct()
    can: tuple[CanBus, ...] = ()
    mavlink: Mavlink = Mavlink()
    zenoh: Zenoh = Zenoh()
    ground: Ground = Ground()
    to_autopilot: ToAutopilot = ToAutopilot()
    log: Log = Log()
    live: Live = Live()


def section_of(annotation: Any) -> type[Section] | None:
    """The section behind ``Section``, ``Section | None`` or ``tuple[Section, ...]``."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, Section):
            return kind
    return None


def _section_at(path: str) -> type[Section] | None:
    """The section that ``path`` (``can[0].imu[1]``) leads to; none for a free table of options."""
    section: type[Section] = Config
    for part in [p.split("[")[0] for p in path.split(".") if p]:
        found = section_of({f.name: f.type for f in msgspec.structs.fields(section)}.get(part))
        if found is None:
            return None
        section = found
    return section


def _known(path: str) -> dict[str, Any]:
    """Keys of the section at ``path`` and their types."""
    section = _section_at(path)
    return {} if section is None else {f.name: f.type for f in msgspec.structs.fields(section)}


def _explain(error: msgspec.ValidationError) -> str:
    text = str(error)
    path = ""
    if " - at `$." in text:
        path = text.split(" - at `$.")[1].rstrip("`")
    if "unknown field" in text:
        bad = text.split("unknown field `")[1].split("`")[0]
        near = difflib.get_close_matches(bad, _known(path), n=1)
        where = f"{path}.{bad}" if path else bad
        return f"unknown key '{where}'" + (f"; did you mean '{near[0]}'?" if near else "")
    if not path:
        return text
    what = text.split(" - at")[0]
    section, _, name = path.rpartition(".")
    kind = _known(section).get(name)
    if "Invalid enum value" in text:
        what += f"; one of {', '.join(repr(choice) for choice in get_args(kind))}"
    elif section_of(kind) is not None and "got `object`" in text:
        what = f"is a list of tables; write [[{path}]]"
    return f"key '{path}': {what}"


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
    "gnss.max_sd_position_m",
    "baro.sd_m",
    "mag.sd_deg",
    "mag.max_rate_hz",
    "constraints.zero_velocity_sd_mps",
    "constraints.zero_rate_sd_dps",
    "constraints.standstill_window_s",
    "constraints.standstill_gyro_dps",
    "constraints.standstill_accel_mps2",
    "constraints.non_holonomic_sd_mps",
    "constraints.non_holonomic_rate_hz",
    "constraints.course_sd_deg",
    "alignment.window_s",
    "alignment.heading_found_sd_deg",
    "engine.covariance_rate_hz",
    "engine.output_rate_hz",
    "engine.delay_ring_s",
    "engine.imu_gap_bridge_s",
    "engine.coasting_after_s",
    "engine.diverged_position_sd_m",
    "engine.gate_relock_s",
    "source_faults.patience_s",
    "smoothing.rate_hz",
    "smoothing.longest_interval_s",
)

_NOT_NEGATIVE = (
    "imu.gyro_bias_walk_dps_rts",
    "imu.gyro_bias_tau_s",
    "imu.accel_bias_walk_mps2_rts",
    "imu.accel_bias_tau_s",
    "imu.vibration_gain_rthz",
    "imu.gyro_vibration_gain_rthz",
    "imu.gyro_range_dps",
    "imu.accel_range_mps2",
    "imu.gyro_scale_sd_ppm",
    "imu.accel_scale_sd_ppm",
    "gnss.latency_sd_ms",
    "gnss.lever_arm_sd_m",
    "gnss.slow_error_sd_m",
    "gnss.slow_error_height_sd_m",
    "baro.bias_walk_m_rts",
    "constraints.standstill_speed_mps",
    "constraints.course_min_speed_mps",
)


def _check(config: Config) -> None:
    for key in _POSITIVE:
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        if not (math.isfinite(value) and value > 0):
            raise ConfigError(f"key '{key}': must be positive, got {value}")
    for key in _NOT_NEGATIVE:
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        if not (math.isfinite(value) and value >= 0):
            raise ConfigError(f"key '{key}': zero (none) or positive, got {value}")
    for key, biases, limit, unit in (
        ("imu.gyro_bias_dps", config.imu.gyro_bias_dps, 100.0, "deg/s"),
        ("imu.accel_bias_mps2", config.imu.accel_bias_mps2, 10.0, "m/s²"),
    ):
        if not all(abs(value) <= limit for value in biases):
            raise ConfigError(f"key '{key}': three numbers within ±{limit:g} {unit}, got {biases}")
    rotation("imu.axes", config.imu.axes)
    for key, limit in (
        ("imu.latency_ms", 500.0), ("gnss.latency_ms", 2000.0),
        ("baro.latency_ms", 2000.0), ("mag.latency_ms", 2000.0),
    ):  # fmt: skip
        section, name = key.split(".")
        value = getattr(getattr(config, section), name)
        if not 0 <= value <= limit:
            raise ConfigError(f"key '{key}': milliseconds between 0 and {limit:g}, got {value}")
    if not 0.5 < config.engine.gate_probability < 1:
        raise ConfigError("key 'engine.gate_probability': between 0.5 and 1, such as 0.9999")
    if not 4 <= config.alignment.hypotheses <= 72:
        raise ConfigError("key 'alignment.hypotheses': between 4 and 72")
    check_adaptation(config.adaptation)
    check_raw_gnss(config.raw_gnss)
    if not 1 <= config.smoothing.window <= MAX_WINDOW:
        raise ConfigError(f"key 'smoothing.window': update intervals, 1 to {MAX_WINDOW}")
    if not 0 < config.smoothing.load_limit <= 1:
        raise ConfigError("key 'smoothing.load_limit': share of a core, above 0 and up to 1")
    last = config.alignment.last_heading
    if last is not None:
        within("alignment.last_heading.heading_deg", last.heading_deg, -360.0, 360.0, "degrees")
        positive("alignment.last_heading.sd_deg", last.sd_deg, "degrees")
    check_direct(config.direct)
    check_units(config.imu, config.further_imu, config.imu_fusion)
    if config.engine.estimator == "direct" and config.smoothing.enabled:
        raise ConfigError("key 'smoothing.enabled': only with engine.estimator = 'error-state'")
    _check_bank(config)
    check_live(config)


def _check_bank(config: Config) -> None:
    names = config.bank.estimators
    for name in names:
        try:
            changed(config, name)
        except ConfigError as error:
            raise ConfigError(f"key 'bank.estimators': {error}") from None
    if len(names) == 1 or len(set(names)) < len(names):
        raise ConfigError("key 'bank.estimators': two or more, each once; or none")
    if names and config.smoothing.enabled and smoothable(config) is None:
        raise ConfigError("key 'smoothing.enabled': only with an error-state estimator in the bank")


def parse(text: str, origin: str = "configuration") -> Config:
    """Typed configuration from TOML text.

    Raises :class:`ConfigError` with ``origin`` and the offending key.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from None
    return from_table(table, origin)


def from_table(table: dict[str, Any], origin: str = "configuration") -> Config:
    """Typed configuration from what TOML text says, as :func:`parse`."""
    try:
        config = msgspec.convert(table, Config)
        _check(config)
        config = msgspec.structs.replace(
            config,
            adaptation=with_all_rules(config.adaptation),
            imu=imu_with_range(config.imu, config.can),
            further_imu=further_with_ranges(config.further_imu, config.can),
        )
    except msgspec.ValidationError as error:
        raise ConfigError(f"{origin}: {_explain(error)}") from None
    except ConfigError as error:
        raise ConfigError(f"{origin}: {error}") from None
    return config


def load(path: Path) -> Config:
    """Typed configuration from a TOML file; files that it names are looked for beside it."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    # Absolute, so that it does not matter where it is opened from, or resolved once more.
    return _beside(parse(text, str(path)), path.parent.absolute())


def _beside(config: Config, folder: Path) -> Config:
    """The same configuration with paths relative to ``folder`` resolved."""
    replace = msgspec.structs.replace
    buses = []
    for bus in config.can:
        units = [
            replace(imu, dbc=replace(imu.dbc, file=str(folder / imu.dbc.file))) if imu.dbc else imu
            for imu in bus.imu
        ]
        buses.append(replace(bus, imu=tuple(units)))
    zenoh = config.zenoh
    if zenoh.config_file:
        zenoh = replace(zenoh, config_file=str(folder / zenoh.config_file))
    return replace(config, can=tuple(buses), zenoh=zenoh)
