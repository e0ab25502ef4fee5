"""Which configuration a recording is replayed with, and the full text that its log keeps."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path

import msgspec

from companion.config import Bank, CanBus, Config, Direct, load, parse, to_toml
from companion.config.settings import alone
from companion.types import Recording
from replay.reader import has_inputs
from replay.streams import SLOW_HZ, GnssClock, rate_hz

_DEFAULT_LATENCY_MS = {
    # ArduPilot streams samples behind its 20 Hz filter, and a fix when it has arrived.
    "tlog": (10.0, 100.0),
    # The same fixes beside an IMU on CAN, whose samples are stamped when they are valid.
    "tlog+can": (0.0, 100.0),
    # On board the stamp of a u-blox fix is its arrival: 210-230 ms late by ArduPilot's measurement.
    "dataflash": (10.0, 200.0),
    "dataflash+can": (0.0, 200.0),
    # PX4 logs integrals before its filters; 110 ms is its own default for EKF2_GPS_DELAY.
    "ulog": (0.0, 110.0),
    "ulog+can": (0.0, 110.0),
}
"""IMU and GNSS latency [ms] by format of the log; other formats stamp validity."""


_UNDERSAMPLED_HZ = 100.0
_UNDERSAMPLED_NOISE = (0.5, 0.2)
"""Noise [deg/s/√Hz, m/s²/√Hz] of an IMU that is logged slower than that: samples of a 1 kHz sensor
on a shaking airframe, picked without a filter. Spread of a flight's gyro, 5 to 30 deg/s, over
√50 Hz is 0.7 to 4; most of it is motion that the trapezoid rule follows."""


_SLOW_ERROR = {"slow_error_sd_m": 1.0, "slow_error_height_sd_m": 1.7, "slow_error_tau_s": 60.0}
"""A single-band receiver wanders: what it repeats for a minute must not be averaged away."""

_WARMING_DPS_RTS = 0.005
"""Gyro bias walk [deg/s/√s] of an autopilot's IMU, which nobody keeps at one temperature: 0.01 to
0.05 deg/s per kelvin and about a kelvin a minute after power-up, 0.04 deg/s in 60 s. At less, the
bias falls behind and the heading with it, ten times further than the filter says."""


_SLOW_OUTPUT_HZ = 10.0
_SLOW = Direct(gyro_sample_sd_dps=3.0, accel_sample_sd_mps2=0.7)
_SLOW_NOISE = (0.1, 0.03)
"""Of an IMU that is logged at a few hertz: what single samples carry of a vibrating airframe."""


def _is_slow(recording: Recording) -> bool:
    """Whether no vehicle that could be navigated has an IMU that a strapdown filter can use."""
    rates = [rate_hz(v.imu[0].t_ns) for v in recording.vehicles if has_inputs(v)]
    return bool(rates) and max(rates) < SLOW_HZ


def _imu_rate_hz(recording: Recording) -> float:
    """Rate of the inertial stream that the engine would use; 0 without one."""
    for vehicle in recording.vehicles:
        for stream in vehicle.streams:
            if vehicle.imu and stream.kind == "imu" and stream.source == vehicle.imu[0].source:
                return stream.rate_hz
    return 0.0


def stated_clock(text: str | None) -> GnssClock | None:
    """On which time a folder's stamps run by ``raw_gnss.clock`` of a TOML; None: it does not say.

    What is wrong with the text otherwise, its reader says.
    """
    try:
        section = tomllib.loads(text or "").get("raw_gnss", {})
    except (tomllib.TOMLDecodeError, RecursionError):
        return None
    clock = section.get("clock") if isinstance(section, dict) else None
    return "gps" if clock == "gps" else "utc" if clock == "utc" else None


def said_of_data(path: Path | None) -> tuple[tuple[CanBus, ...], GnssClock | None]:
    """What a configuration says that reading needs: CAN buses, and the clock of raw GNSS.

    Raises :class:`~companion.types.ConfigError` for a file that cannot be used.
    """
    if path is None:
        return (), None
    return load(path).can, stated_clock(path.read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True)
class ChosenConfig:
    """A configuration, where it came from, and the TOML of all its keys."""

    config: Config
    origin: str
    """For people: a path, ``from the log``, or what the defaults assume."""
    toml: str
    """Every key with its value, so that a later change of a default cannot change a replay."""


def _slow(config: Config, assumed: bool) -> tuple[Config, str]:
    """The same configuration with the direct filter, and a word on it.

    ``assumed``: nobody configured the sensors.
    """
    engine = msgspec.structs.replace(
        config.engine,
        estimator="direct",
        output_rate_hz=min(config.engine.output_rate_hz, _SLOW_OUTPUT_HZ),
    )
    bank, left_out = _slow_bank(msgspec.structs.replace(config, engine=engine))
    # Its smoother is for the error-state filter.
    smoothing = msgspec.structs.replace(config.smoothing, enabled=False)
    direct, imu = config.direct, config.imu
    if assumed:
        gyro, accel = _SLOW_NOISE
        direct = _SLOW
        imu = msgspec.structs.replace(imu, gyro_noise_dps_rthz=gyro, accel_noise_mps2_rthz=accel)
    return (
        msgspec.structs.replace(
            config, engine=engine, direct=direct, imu=imu, smoothing=smoothing, bank=bank
        ),
        f"; direct filter, as the IMU is slower than {SLOW_HZ:g} Hz{left_out}",
    )


def _slow_bank(config: Config) -> tuple[Bank, str]:
    """The bank without estimators that such an IMU is too slow for, and a word on those.

    Of fewer than two there is nothing to choose: the direct filter runs alone.
    """
    names = config.bank.estimators
    fit = tuple(n for n in names if alone(config, n).engine.estimator == "direct")
    gone = [n for n in names if n not in fit]
    left_out = f"; left out of the bank: {', '.join(gone)}" if gone else ""
    return Bank(estimators=fit if len(fit) > 1 else ()), left_out


def choose_config(recording: Recording, path: Path | None = None) -> ChosenConfig:
    """The file at ``path``, else what came with the data, else defaults for the log's format.

    Raises :class:`~companion.types.ConfigError` for a file or a text that cannot be used.
    """
    if path is not None:
        config, origin = load(path), str(path)
    elif recording.config_toml is not None:
        origin = f"came with {recording.path}"
        config = parse(recording.config_toml, f"configuration in {recording.path}")
    elif recording.format in _DEFAULT_LATENCY_MS:
        imu_ms, gnss_ms = _DEFAULT_LATENCY_MS[recording.format]
        base = Config()
        imu = msgspec.structs.replace(base.imu, gyro_bias_walk_dps_rts=_WARMING_DPS_RTS)
        sampling = "consumer MEMS"
        rate_hz = _imu_rate_hz(recording)
        if 0 < rate_hz < _UNDERSAMPLED_HZ:
            gyro, accel = _UNDERSAMPLED_NOISE
            imu = msgspec.structs.replace(
                imu, gyro_noise_dps_rthz=gyro, accel_noise_mps2_rthz=accel
            )
            sampling = f"MEMS logged at only {rate_hz:.0f} Hz"
        config = msgspec.structs.replace(
            base,
            imu=msgspec.structs.replace(imu, latency_ms=imu_ms),
            gnss=msgspec.structs.replace(
                base.gnss, latency_ms=gnss_ms, latency_sd_ms=40.0, **_SLOW_ERROR
            ),
        )
        origin = (
            f"defaults for a {recording.format} log: {sampling}, "
            f"IMU {imu_ms:g} ms and GNSS {gnss_ms:g} ms late (--config says it better)"
        )
    else:
        config, origin = Config(), "defaults: consumer MEMS, no latency (--config says it better)"
        if any(v.raw and not has_inputs(v) for v in recording.vehicles):
            raw = msgspec.structs.replace(config.raw_gnss, coupling="tight")
            config = msgspec.structs.replace(config, raw_gnss=raw)
            origin += "; tight coupling, as raw GNSS is all there is"
    if config.engine.estimator == "auto" and _is_slow(recording):
        config, said = _slow(config, path is None and recording.config_toml is None)
        origin += said
    return ChosenConfig(config, origin, to_toml(config))
