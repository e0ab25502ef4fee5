"""Before a live run begins: its configuration with what earlier runs learned, its files, warmth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from companion.config import Config, parse, to_toml
from companion.engine import Engine
from companion.runtime import saved_state
from companion.types import (
    NS,
    BaroSamples,
    CompanionError,
    ConfigError,
    GnssSamples,
    ImuSamples,
)


@dataclass(frozen=True, slots=True)
class Start:
    """What a run begins with."""

    config: Config
    """Effective: with biases of an earlier run, where there are any. The log keeps it."""
    toml: str
    notes: tuple[str, ...]
    """What was found on the way, for people and as events."""
    log: Path
    state: Path


def prepare(config: Config, log: Path | None) -> Start:
    """Settle configuration and files of a run.

    Raises :class:`ConfigError` for a configuration with nothing to listen to, and
    :class:`CompanionError` where the log's directory cannot be made.
    """
    if not config.mavlink.endpoint and not any(bus.imu for bus in config.can):
        raise ConfigError("nothing to listen to: give [[can]] with an imu, or mavlink.endpoint")
    channels = [bus.channel for bus in config.can]
    if len(set(channels)) != len(channels):
        raise ConfigError("key 'can': two buses have the same channel")
    vehicle = "".join(c if c.isalnum() or c in "-_." else "_" for c in config.vehicle.name)
    directory = Path(config.log.directory)
    if log is None:
        log = directory / f"{vehicle}-{datetime.now(UTC):%Y%m%dT%H%M%SZ}.mcap"
    state_file = config.log.state_file
    state = Path(state_file) if state_file else directory / f"{vehicle}.state.toml"
    for folder in (log.parent, state.parent):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CompanionError(f"{folder}: {error.strerror or error}") from None
    notes: list[str] = []
    if config.live.warm_start:
        config = _warmed(config, state, notes)
    # What a replay will read: not one bit of the configuration may be lost in spelling.
    toml = to_toml(config)
    return Start(parse(toml), toml, tuple(notes), log, state)


def known_imu(config: Config) -> str:
    """The inertial unit that the configuration settles; empty where the autopilot decides.

    An autopilot calibrates its gyros anew at each start, so what an earlier run knew of them is
    worth nothing; a unit of our own is the same one again.
    """
    if config.imu.source != "auto":
        return config.imu.source
    return next((unit.name for bus in config.can for unit in bus.imu), "")


def _warmed(config: Config, state: Path, notes: list[str]) -> Config:
    source = known_imu(config)
    if not source:
        return config
    try:
        saved = saved_state.read(state)
        if saved is None:
            return config
        config = saved_state.warmed(config, source, saved, time.time_ns())
    except saved_state.StateError as error:
        notes.append(f"cold start: {error}")
        return config
    age_s = max(0, time.time_ns() - saved.saved_ns) / NS
    notes.append(f"warm start: biases of '{source}' as they were {age_s:.0f} s ago")
    return config


def warm_up(config: Config) -> None:
    """Run everything that a sample goes through once, so that none in flight is the first."""
    engine = Engine(config)
    n = 300
    t = NS * 1_700_000_000 + np.arange(n) * (NS // 100)
    still = np.tile([0.0, 0.0, -9.80665], (n, 1))
    at_rest = ImuSamples("imu", t, t, np.arange(n), np.zeros((n, 3)), still, np.full(n, np.nan))
    for i in range(n):
        one = slice(i, i + 1)
        engine.step(at_rest.take(one))
        if i % 20 == 0:
            late = t[one] - NS // 10
            three = np.full((1, 3), 1.0)
            place = np.array([0.8]), np.array([0.2]), np.array([100.0])
            sky = np.array([12]), np.array([3])
            fix = GnssSamples("gnss", late, t[one], t[one], *place, 0 * three, three, three, *sky)
            engine.step(fix)
            engine.step(BaroSamples("baro", t[one], t[one], t[one], np.array([1e5])))
    engine.finish()
