"""Before a live run begins: its configuration with what earlier runs learned, its files, warmth."""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.config import Config, parse, to_toml
from companion.engine import Engine
from companion.gnss.orbit import (
    E_I0,
    E_M0,
    E_OMEGA0,
    E_SAT,
    E_SQRT_A,
    E_TOC_WEEK,
    E_WEEK,
    EPHEMERIS_SIZE,
)
from companion.runtime import saved_state
from companion.runtime.saved_state import SavedState
from companion.selection import KINDS, Kind
from companion.types import (
    NS,
    SATELLITES,
    BaroSamples,
    BroadcastSamples,
    CompanionError,
    ConfigError,
    GnssSamples,
    ImuSamples,
    RawGnssSamples,
)
from drivers.mavlink.packer import Packer
from drivers.mavlink.session import MavlinkSession, SessionSettings


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
    saved: SavedState | None = None
    """What an earlier run left, where it was of use."""

    @property
    def known(self) -> dict[Kind, str]:
        """Streams that an earlier run used, by kind."""
        inputs = self.saved.inputs if self.saved is not None else {}
        return {kind: inputs[kind] for kind in KINDS.values() if kind in inputs}


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
    saved: SavedState | None = None
    if config.live.warm_start:
        config, saved = _warmed(config, state, notes)
    # What a replay will read: not one bit of the configuration may be lost in spelling.
    toml = to_toml(config)
    return Start(parse(toml), toml, tuple(notes), log, state, saved)


def known_imu(config: Config) -> str:
    """The inertial unit that the configuration settles; empty where the autopilot decides.

    An autopilot calibrates its gyros anew at each start, so what an earlier run knew of them is
    worth nothing; a unit of our own is the same one again.
    """
    if config.imu.source != "auto":
        return config.imu.source
    return next((unit.name for bus in config.can for unit in bus.imu), "")


def _warmed(config: Config, path: Path, notes: list[str]) -> tuple[Config, SavedState | None]:
    """The configuration with what ``path`` holds; notes say what that is, or why it is not used."""
    source = known_imu(config)
    now_ns = time.time_ns()
    try:
        saved = saved_state.read(path)
        if saved is None:
            return config, None
        config = saved_state.warmed(config, source, saved, now_ns)
    except saved_state.StateError as error:
        notes.append(f"cold start: {error}")
        return config, None
    parts = []
    if saved.biases is not None and source:
        age_s = max(0, now_ns - saved.biases.saved_ns) / NS
        parts.append(f"biases of '{source}' as they were {age_s:.0f} s ago")
    if saved.heading is not None:
        age_s = max(0, now_ns - saved.heading.t_ns) / NS
        parts.append(f"heading {saved.heading.heading_deg % 360:.0f}° of {age_s:.0f} s ago")
    if parts:
        notes.append(f"warm start: {', '.join(parts)}")
    return config, saved


def warm_up(config: Config) -> None:
    """Run everything that a sample goes through once, so that none in flight is the first."""
    if config.mavlink.endpoint:
        hear_an_autopilot()
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
    if config.raw_gnss.coupling != "off":
        _see_satellites(engine, int(t[-1]))
    engine.finish()


def _see_satellites(engine: Engine, t_ns: int) -> None:
    """Satellites that are not there: to find that their ranges fit no place takes every kernel."""
    values = np.zeros((6, EPHEMERIS_SIZE))
    values[:, E_SAT] = np.arange(101, 107)
    values[:, E_SQRT_A], values[:, E_M0] = 5153.6, np.arange(6.0)
    values[:, E_OMEGA0], values[:, E_I0] = np.arange(6.0), 0.96
    values[:, E_WEEK] = values[:, E_TOC_WEEK] = 2300
    stamps = np.full(6, t_ns)
    sats = values[:, E_SAT].astype(np.int64)
    engine.step(BroadcastSamples("raw", stamps, stamps, np.arange(6), sats, values))
    columns = np.full((5, 1, SATELLITES), np.nan)
    columns[0, 0, :6], columns[1, 0, :6] = 2.2e7, 0.0
    sat = np.zeros((1, SATELLITES), np.int64)
    sat[0, :6] = sats
    one = stamps[:1]
    week, tow = np.array([2300]), np.zeros(1)
    engine.step(RawGnssSamples("raw", one, one, one, week, tow, sat, 0 * sat, *columns))


def hear_an_autopilot() -> None:
    """Framer, decoder and converter, with a stranger's messages and a session of nobody."""
    packer, now = Packer(system=1, component=1), NS * 1_700_000_000
    beat = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3)
    pressure = mavlink.MAVLink_scaled_pressure_message(1000, 1000.0, 0.0, 2000)
    pieces = [packer.pack(beat), packer.pack(pressure)]
    for datagrams in (True, False):
        session = MavlinkSession(SessionSettings(datagrams=datagrams))
        for piece in pieces:
            session.feed(1, now, piece)
        session.take()
