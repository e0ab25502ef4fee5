"""Configuration of the live process: links, log, outputs. None of it reaches the engine.

Positions and units are as written in each key; nothing here changes the bits of a solution that
a replay of the run's log gives again.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from companion.config.section import Section

Row = tuple[float, float, float]


class DbcMapping(Section):
    """How the signals of a DBC file make an inertial sample."""

    file: str
    """Path of the DBC file, relative to the configuration file."""
    gyro_signals: tuple[str, str, str]
    """Signal names of the angular rate, in the sensor's x, y, z."""
    accel_signals: tuple[str, str, str]
    """The same of specific force, the sensor's x, y, z."""
    gyro_unit: Literal["rad/s", "deg/s", "mrad/s"] = "rad/s"
    """Of the DBC's physical values."""
    accel_unit: Literal["m/s2", "g", "mg"] = "m/s2"
    """Of the DBC's physical values."""
    gyro_scale: float = 1.0
    """Further factor on the physical value, for a DBC that has it wrong."""
    accel_scale: float = 1.0
    """The same for the accelerometer."""
    complete_on: str = ""
    """Message name that completes a sample; empty: the last one needed of a cycle."""
    time_signal: str = ""
    """The sensor's own clock, where it sends one."""
    time_unit: Literal["ns", "us", "100us", "ms", "s"] = "us"
    """Of ``time_signal``."""
    counter_signal: str = ""
    """A counter that goes up by one a sample: finds lost and repeated ones."""


class CanImu(Section):
    """One inertial unit on a CAN bus."""

    name: str
    """Name of the stream in the log and for ``imu.source``."""
    protocol: Literal["dronecan", "xsens-mti", "sbg-ellipse", "openimu-j1939", "dbc"]
    """What the unit speaks; ``dbc``: any unit, by its DBC file."""
    node_id: int = 0
    """DroneCAN node or J1939 source address; 0: any."""
    axes: tuple[Row, Row, Row] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    """Rotation from the unit's axes to those of the vehicle's first IMU, row by row."""
    rate_hz: float = 0.0
    """Expected sample rate; 0: learned. Silence is judged by it."""
    gyro_range_dps: float = 0.0
    """Full scale; an axis at it is flagged as saturated. 0: the wire format's own. It holds for the
    filter too, where ``imu.gyro_range_dps`` is not given."""
    accel_range_mps2: float = 0.0
    """The same for the accelerometer."""
    dbc: DbcMapping | None = None
    """With ``protocol = "dbc"``."""


class CanBus(Section):
    """One CAN bus, opened by python-can."""

    channel: str
    """As python-can wants it: ``can0``, ``/dev/ttyACM0``, …"""
    interface: str = "socketcan"
    """Of python-can: ``socketcan``, ``slcan``, ``socketcand``, ``virtual``, …"""
    bitrate: int = 1_000_000
    """Where the interface sets it; SocketCAN has it from ``ip link``."""
    options: dict[str, str | int | float | bool] = msgspec.field(default_factory=dict)
    """Further keyword arguments of python-can's bus."""
    imu: tuple[CanImu, ...] = ()


class Mavlink(Section):
    """The link to the autopilot."""

    endpoint: str = ""
    """``udpin:HOST:PORT``, ``udpout:HOST:PORT``, ``tcp:HOST:PORT`` or a serial device.

    Empty: none."""
    baud: int = 921_600
    """Of a serial device."""
    system: int = 0
    """System id of the vehicle; 0: the first autopilot that is heard."""
    component: int = 191
    """Our own component id: an onboard computer."""
    imu: bool = True
    """Ask for and use the autopilot's IMU where there is no CAN IMU."""
    imu_rate_hz: float = 100.0
    """Rate to ask for."""
    gnss_rate_hz: float = 10.0
    """Rate to ask for."""
    baro_rate_hz: float = 10.0
    """Rate to ask for."""
    mag_rate_hz: float = 10.0
    """Rate to ask for."""
    request_rates: bool = True
    """Ask for message intervals; off on a link that somebody else sets up."""
    signing_key_file: str = ""
    """32 bytes, raw or hexadecimal; with it unsigned traffic is refused."""


class Zenoh(Section):
    """Publication over zenoh: peer on loopback unless a configuration file says otherwise."""

    enabled: bool = True
    """Publish at all."""
    config_file: str = ""
    """A zenoh configuration (JSON5): routers, TLS, user/password, access control."""
    listen: tuple[str, ...] = ("tcp/127.0.0.1:7447",)
    """Endpoints that others may connect to; anything but loopback is open to the network."""
    connect: tuple[str, ...] = ()
    """Endpoints to connect to: routers, or subscribers that listen."""
    state_rate_hz: float = 50.0
    """At most; epochs come at ``engine.output_rate_hz``."""


class Ground(Section):
    """MAVLink to a ground station."""

    endpoint: str = ""
    """As ``mavlink.endpoint``; ``autopilot``: over that link; empty: off."""
    rate_hz: float = 10.0
    """Of each message."""


class ToAutopilot(Section):
    """Our solution as an input of the autopilot's own estimator. Off by default.

    A solution made from the autopilot's GPS and IMU would be counted twice.
    """

    message: Literal["off", "odometry-ardupilot", "odometry-px4", "gps-input"] = "off"
    """What to send: ODOMETRY as ArduPilot or as PX4 accepts it, or GPS_INPUT."""
    rate_hz: float = 20.0
    """Messages a second."""
    gps_id: int = 1
    """Receiver number that GPS_INPUT stands for."""
    max_sd_m: float = 20.0
    """Horizontal 1σ beyond which the solution is no help: withheld, or sent as no fix."""


class Log(Section):
    """Where and what the live process logs."""

    directory: str = "logs"
    """Where runs are written, unless ``--log`` names a file."""
    raw: bool = True
    """Log MAVLink and CAN frames as they arrive, beside the decoded samples."""
    state_file: str = ""
    """Biases kept from run to run; empty: ``<directory>/<vehicle>.state.toml``."""


class Live(Section):
    """Time-outs of the runtime."""

    tick_hz: float = 10.0
    """How often the loop looks at time-outs, health and pacing."""
    imu_timeout_s: float = 0.5
    """An IMU without a sample for this long is silent."""
    gnss_timeout_s: float = 2.0
    """The same for GNSS."""
    aid_timeout_s: float = 3.0
    """Barometer and magnetometer."""
    warm_start: bool = True
    """Begin with the biases of ``log.state_file``, their deviations widened with age."""
