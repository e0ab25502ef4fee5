"""What the sections of the live process may hold, each refusal naming the key and what is right."""

from __future__ import annotations

from typing import TYPE_CHECKING

from companion.config.live import CanBus, CanImu, DbcMapping, Ground, Live, Mavlink, ToAutopilot
from companion.config.ranges import (
    mavlink_endpoint,
    not_empty,
    positive,
    rotation,
    within,
    zenoh_endpoint,
)
from companion.types import ConfigError

if TYPE_CHECKING:
    from companion.config import Config

NODE_IDS = {
    # UAVCAN v0: seven bits, 0 being anonymous.
    "dronecan": (127, "DroneCAN node (0: any)"),
    # SAE J1939-81: 254 is the null address, 255 the broadcast.
    "openimu-j1939": (253, "J1939 source address (0: any)"),
}


def check_live(config: Config) -> None:
    """Raise :class:`ConfigError` at the first value of the live sections that cannot be used."""
    names: dict[str, str] = {}
    for i, bus in enumerate(config.can):
        _bus(f"can[{i}]", bus, names)
    _mavlink(config.mavlink)
    _ground(config.ground, config.mavlink)
    _to_autopilot(config.to_autopilot, config.mavlink)
    receiver = config.raw_gnss.endpoint
    if receiver and receiver in (config.mavlink.endpoint, config.ground.endpoint):
        raise ConfigError(f"key 'raw_gnss.endpoint': '{receiver}' is used for MAVLink already")
    for name in ("listen", "connect"):
        for i, endpoint in enumerate(getattr(config.zenoh, name)):
            zenoh_endpoint(f"zenoh.{name}[{i}]", endpoint)
    within("zenoh.state_rate_hz", config.zenoh.state_rate_hz, 0.1, 1000.0, "Hz")
    not_empty("log.directory", config.log.directory, "a directory, such as 'logs'")
    _live(config.live)


def _bus(key: str, bus: CanBus, names: dict[str, str]) -> None:
    not_empty(f"{key}.channel", bus.channel, "as python-can wants it, such as 'can0'")
    not_empty(f"{key}.interface", bus.interface, "a python-can interface, such as 'socketcan'")
    within(f"{key}.bitrate", bus.bitrate, 10_000, 8_000_000, "bit/s")
    for i, unit in enumerate(bus.imu):
        where = f"{key}.imu[{i}]"
        _can_imu(where, unit)
        if unit.name in names:
            raise ConfigError(
                f"key '{where}.name': '{unit.name}' is the name of {names[unit.name]} too; "
                "streams need names of their own"
            )
        names[unit.name] = where


def _can_imu(key: str, unit: CanImu) -> None:
    not_empty(f"{key}.name", unit.name, "a name for the stream")
    rotation(f"{key}.axes", unit.axes)
    if unit.protocol in NODE_IDS:
        highest, what = NODE_IDS[unit.protocol]
        within(f"{key}.node_id", unit.node_id, 0, highest, what)
    elif unit.node_id:
        raise ConfigError(
            f"key '{key}.node_id': protocol '{unit.protocol}' has no node ids; leave it out"
        )
    within(f"{key}.rate_hz", unit.rate_hz, 0.0, 10_000.0, "Hz", " (0: learned)")
    own = " (0: the wire format's own)"
    within(f"{key}.gyro_range_dps", unit.gyro_range_dps, 0.0, 100_000.0, "deg/s", own)
    within(f"{key}.accel_range_mps2", unit.accel_range_mps2, 0.0, 100_000.0, "m/s²", own)
    if unit.protocol == "dbc" and unit.dbc is None:
        raise ConfigError(
            f"key '{key}.dbc': protocol 'dbc' needs the section [can.imu.dbc] with file, "
            "gyro_signals and accel_signals"
        )
    if unit.protocol != "dbc" and unit.dbc is not None:
        raise ConfigError(
            f"key '{key}.dbc': only with protocol 'dbc'; '{unit.protocol}' is built in"
        )
    if unit.dbc is not None:
        _dbc(f"{key}.dbc", unit.dbc)


def _dbc(key: str, mapping: DbcMapping) -> None:
    not_empty(f"{key}.file", mapping.file, "path of a DBC file, relative to the configuration")
    seen: dict[str, str] = {}
    for name in ("gyro_signals", "accel_signals"):
        for i, signal in enumerate(getattr(mapping, name)):
            where = f"{key}.{name}[{i}]"
            not_empty(where, signal, "name of a signal in the DBC file")
            if signal in seen:
                raise ConfigError(f"key '{where}': '{signal}' is {seen[signal]} already")
            seen[signal] = f"{name}[{i}]"
    # Negative factors turn an axis round; the axes matrix is there for that.
    positive(f"{key}.gyro_scale", mapping.gyro_scale, "factor")
    positive(f"{key}.accel_scale", mapping.accel_scale, "factor")


def _mavlink(link: Mavlink) -> None:
    if link.endpoint:
        mavlink_endpoint("mavlink.endpoint", link.endpoint)
    within("mavlink.baud", link.baud, 1200, 12_000_000, "bit/s")
    within("mavlink.system", link.system, 0, 255, "system id", " (0: the first autopilot heard)")
    within("mavlink.component", link.component, 1, 255, "component id", ", 191 as a rule")
    for name in ("imu", "gnss", "baro", "mag"):
        # One message an autopilot tick at most; MAV_CMD_SET_MESSAGE_INTERVAL counts in µs.
        within(f"mavlink.{name}_rate_hz", getattr(link, f"{name}_rate_hz"), 0.1, 1000.0, "Hz")


def _ground(ground: Ground, link: Mavlink) -> None:
    if ground.endpoint == "autopilot":
        _needs_link("ground.endpoint", "'autopilot' means that link", link)
    elif ground.endpoint:
        mavlink_endpoint("ground.endpoint", ground.endpoint)
    within("ground.rate_hz", ground.rate_hz, 0.1, 100.0, "Hz")


def _to_autopilot(feed: ToAutopilot, link: Mavlink) -> None:
    if feed.message != "off":
        _needs_link("to_autopilot.message", f"'{feed.message}' goes over that link", link)
    # Measured against ArduPilot: positions at 2-3 Hz let its estimate run away by tens of metres.
    why = "; autopilots drop slower and faster feeds"
    within("to_autopilot.rate_hz", feed.rate_hz, 4.0, 50.0, "Hz", why)
    within("to_autopilot.max_sd_m", feed.max_sd_m, 0.1, 1000.0, "m")
    within("to_autopilot.gps_id", feed.gps_id, 0, 3, "receiver number")


def _needs_link(key: str, why: str, link: Mavlink) -> None:
    if not link.endpoint:
        raise ConfigError(f"key '{key}': needs 'mavlink.endpoint': {why}")


def _live(live: Live) -> None:
    within("live.tick_hz", live.tick_hz, 0.1, 1000.0, "Hz")
    for name in ("imu_timeout_s", "gnss_timeout_s", "aid_timeout_s"):
        within(f"live.{name}", getattr(live, name), 0.01, 3600.0, "seconds")
