"""Configuration of the live process: ranges, names, and its round trip through TOML."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.config import CanBus, CanImu, Config, DbcMapping, Mavlink, Zenoh, parse, to_toml
from companion.config.ranges import mavlink_endpoint
from companion.types import ConfigError

BUS = "[[can]]\nchannel = 'can0'\n"
UNIT = BUS + "[[can.imu]]\nname = 'a'\nprotocol = '{}'\n"
DBC = (
    UNIT.format("dbc")
    + "[can.imu.dbc]\nfile = 'a.dbc'\ngyro_signals = ['p', 'q', 'r']\n"
    + "accel_signals = ['x', 'y', 'z']\n"
)
LINK = "[mavlink]\nendpoint = 'udpin:0.0.0.0:14550'\n"


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        # --- unknown keys and wrong types inside tables of tables
        (UNIT.format("xsens-mti") + "rate = 3", "unknown key 'can[0].imu[0].rate'; did you mean"),
        (BUS + BUS + "chanel = 'x'", "unknown key 'can[1].chanel'; did you mean 'channel'?"),
        (DBC + "giro_scale = 1.0", "unknown key 'can[0].imu[0].dbc.giro_scale'"),
        (UNIT.format("xsens"), "'can[0].imu[0].protocol': Invalid enum value 'xsens'; one of"),
        (UNIT.format("xsens"), "'xsens-mti'"),
        (BUS + "[can.options]\na = [1]", "key 'can[0].options"),
        ("[can]\nchannel = 'can0'", "key 'can': is a list of tables; write [[can]]"),
        (BUS + "[can.imu]\nname = 'a'", "key 'can[0].imu': is a list of tables"),
        ("[[can]]\nbitrate = 500000", "missing required field `channel`"),
        # --- CAN
        ("[[can]]\nchannel = ' '", "key 'can[0].channel': as python-can wants it, such as 'can0'"),
        (BUS + "interface = ''", "key 'can[0].interface': a python-can interface"),
        (BUS + "bitrate = 250", "key 'can[0].bitrate': bit/s between 10000 and 8e+06, got 250"),
        (UNIT.format("dronecan") + "node_id = 128", "between 0 and 127, got 128"),
        (UNIT.format("dronecan") + "node_id = -1", "key 'can[0].imu[0].node_id': DroneCAN node"),
        (UNIT.format("openimu-j1939") + "node_id = 254", "J1939 source address (0: any) between"),
        (UNIT.format("sbg-ellipse") + "node_id = 3", "protocol 'sbg-ellipse' has no node ids"),
        (UNIT.format("xsens-mti") + "rate_hz = -1", "'can[0].imu[0].rate_hz': Hz between 0 and"),
        (
            UNIT.format("xsens-mti") + "rate_hz = nan",
            "Hz between 0 and 10000 (0: learned), got nan",
        ),
        (UNIT.format("xsens-mti") + "gyro_range_dps = -2", "gyro_range_dps': deg/s between"),
        (UNIT.format("xsens-mti") + "accel_range_mps2 = inf", "accel_range_mps2': m/s² between"),
        (UNIT.format("xsens-mti") + "axes = [[1,0,0],[0,1,0],[0,0,2]]", "imu[0].axes': rows must"),
        (UNIT.format("xsens-mti") + "axes = [[0,1,0],[1,0,0],[0,0,1]]", "axes': determinant is −1"),
        (UNIT.format("xsens-mti") + "axes = [[nan,0,0],[0,1,0],[0,0,1]]", "imu[0].axes': rows"),
        (BUS + "[[can.imu]]\nname = ''\nprotocol = 'dronecan'", "imu[0].name': a name for"),
        (
            UNIT.format("xsens-mti") + UNIT.format("dronecan"),
            "key 'can[1].imu[0].name': 'a' is the name of can[0].imu[0] too",
        ),
        # --- DBC
        (UNIT.format("dbc"), "needs the section [can.imu.dbc] with file, gyro_signals"),
        (DBC.replace("protocol = 'dbc'", "protocol = 'dronecan'"), "only with protocol 'dbc'"),
        (DBC.replace("'a.dbc'", "''"), "key 'can[0].imu[0].dbc.file': path of a DBC file"),
        (DBC.replace("'q'", "''"), "dbc.gyro_signals[1]': name of a signal"),
        (DBC.replace("'z'", "'p'"), "dbc.accel_signals[2]': 'p' is gyro_signals[0] already"),
        (
            DBC.replace(", 'z'", ""),
            "can[0].imu[0].dbc.accel_signals': Expected `array` of length 3",
        ),
        (DBC + "gyro_scale = 0.0", "dbc.gyro_scale': factor above 0, got 0"),
        (DBC + "accel_scale = inf", "dbc.accel_scale': factor above 0, got inf"),
        # --- MAVLink and what goes over it
        ("[mavlink]\nendpoint = 'udp:1.2.3.4:14550'", "key 'mavlink.endpoint': 'udpin:HOST:PORT'"),
        ("[mavlink]\nendpoint = 'ttyACM0'", "or a device such as /dev/ttyS0, got 'ttyACM0'"),
        ("[mavlink]\nendpoint = 'tcp:14550'", "key 'mavlink.endpoint': 'tcp:HOST:PORT'"),
        ("[mavlink]\nendpoint = 'udpin::14550'", "key 'mavlink.endpoint': 'udpin:HOST:PORT'"),
        ("[mavlink]\nendpoint = 'udpin:::1:14550'", "an IPv6 host in brackets"),
        ("[mavlink]\nendpoint = 'udpout:host:0'", "port between 1 and 65535, got '0'"),
        ("[mavlink]\nendpoint = 'udpin:host:70000'", "port between 0 and 65535, got '70000'"),
        ("[mavlink]\nendpoint = 'tcp:host:mavlink'", "port between 1 and 65535, got 'mavlink'"),
        ("[mavlink]\nbaud = 300", "key 'mavlink.baud': bit/s between 1200 and"),
        ("[mavlink]\nsystem = 256", "system id between 0 and 255 (0: the first autopilot heard)"),
        ("[mavlink]\ncomponent = 0", "key 'mavlink.component': component id between 1 and 255"),
        ("[mavlink]\nimu_rate_hz = 0.0", "key 'mavlink.imu_rate_hz': Hz between 0.1 and 1000"),
        ("[mavlink]\nmag_rate_hz = nan", "key 'mavlink.mag_rate_hz': Hz between"),
        ("[ground]\nendpoint = 'radio'", "key 'ground.endpoint': 'udpin:HOST:PORT'"),
        ("[ground]\nendpoint = 'autopilot'", "'ground.endpoint': needs 'mavlink.endpoint'"),
        ("[ground]\nrate_hz = 0", "key 'ground.rate_hz': Hz between 0.1 and 100"),
        ("[to_autopilot]\nmessage = 'gps-input'", "'to_autopilot.message': needs 'mavlink.endp"),
        (LINK + "[to_autopilot]\nrate_hz = 2.0", "'to_autopilot.rate_hz': Hz between 4 and 50"),
        ("[to_autopilot]\ngps_id = 4", "key 'to_autopilot.gps_id': receiver number between 0"),
        # --- zenoh, log, time-outs
        ("[zenoh]\nlisten = ['127.0.0.1:7447']", "key 'zenoh.listen[0]': 'TRANSPORT/ADDRESS'"),
        ("[zenoh]\nconnect = ['http/a:1']", "key 'zenoh.connect[0]': 'TRANSPORT/ADDRESS' such as"),
        ("[zenoh]\nstate_rate_hz = -1", "key 'zenoh.state_rate_hz': Hz between"),
        ("[log]\ndirectory = ''", "key 'log.directory': a directory, such as 'logs'"),
        ("[live]\ntick_hz = 0", "key 'live.tick_hz': Hz between 0.1 and 1000, got 0"),
        ("[live]\nimu_timeout_s = 0", "key 'live.imu_timeout_s': seconds between 0.01 and"),
        ("[live]\ngnss_timeout_s = -2", "key 'live.gnss_timeout_s': seconds between"),
        ("[live]\naid_timeout_s = inf", "key 'live.aid_timeout_s': seconds between"),
    ],
)
def test_refused_by_name_and_told_what_is_right(text: str, wanted: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(wanted)) as caught:
        parse(text, "vehicle.toml")
    assert str(caught.value).startswith("vehicle.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "endpoint",
    [
        "udpin:0.0.0.0:14550", "udpin:127.0.0.1:0", "udpout:[::1]:14550", "tcp:sitl.local:5760",
        "/dev/ttyACM0", "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0", "COM3",
    ],
)  # fmt: skip
def test_endpoints_that_can_be_opened_are_taken(endpoint: str) -> None:
    assert parse(f"[mavlink]\nendpoint = '{endpoint}'").mavlink.endpoint == endpoint


@given(st.text(max_size=40))
def test_any_endpoint_is_taken_or_refused_in_one_line(text: str) -> None:
    with suppress(ConfigError):
        mavlink_endpoint("mavlink.endpoint", text)


def test_a_whole_live_configuration_is_taken() -> None:
    config = parse(
        DBC
        + "complete_on = 'Inertial'\n"
        + "[can.options]\nfd = true\n"
        + LINK
        + "[ground]\nendpoint = 'autopilot'\n[to_autopilot]\nmessage = 'odometry-px4'\n"
        + "rate_hz = 30\n[zenoh]\nconnect = ['tls/router.local:7447']\n[live]\ntick_hz = 20\n"
    )
    assert config.can[0].imu[0].dbc is not None
    assert config.can[0].options == {"fd": True}
    assert parse(to_toml(config)) == config


# --------------------------------------------------------------------------- round trip

WORD = st.text(min_size=1, max_size=12).filter(lambda word: bool(word.strip()))
TURNS = st.sampled_from(
    [
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.6, -0.8, 0.0), (0.8, 0.6, 0.0), (0.0, 0.0, 1.0)),
    ]
)
SIGNALS = st.lists(WORD, min_size=6, max_size=6, unique=True)


@st.composite
def _mappings(draw: st.DrawFn) -> DbcMapping:
    signals = draw(SIGNALS)
    return DbcMapping(
        file=draw(WORD),
        gyro_signals=tuple(signals[:3]),  # type: ignore[arg-type]
        accel_signals=tuple(signals[3:]),  # type: ignore[arg-type]
        gyro_scale=draw(st.floats(1e-300, 1e300)),
        time_signal=draw(st.text(max_size=5)),
        time_unit=draw(st.sampled_from(["ns", "us", "100us", "ms", "s"])),
    )


@st.composite
def _units(draw: st.DrawFn, name: str) -> CanImu:
    protocol: Any = draw(st.sampled_from(["dronecan", "xsens-mti", "dbc"]))
    return CanImu(
        name=name,
        protocol=protocol,
        node_id=draw(st.integers(0, 127)) if protocol == "dronecan" else 0,
        axes=draw(TURNS),
        rate_hz=draw(st.floats(0, 1e4)),
        dbc=draw(_mappings()) if protocol == "dbc" else None,
    )


@st.composite
def _buses(draw: st.DrawFn) -> tuple[CanBus, ...]:
    names = iter(draw(st.lists(WORD, min_size=6, max_size=6, unique=True)))
    options = st.dictionaries(
        st.text(max_size=8),
        st.text(max_size=8)
        | st.booleans()
        | st.integers(-(2**63), 2**63 - 1)
        | st.floats(allow_nan=False),
        max_size=3,
    )
    return tuple(
        CanBus(
            channel=draw(WORD),
            options=draw(options),
            imu=tuple(draw(_units(next(names))) for _ in range(draw(st.integers(0, 2)))),
        )
        for _ in range(draw(st.integers(0, 3)))
    )


@settings(max_examples=40, deadline=None)
@given(_buses(), st.lists(WORD, max_size=3), st.text(max_size=20))
def test_tables_of_tables_come_back_from_toml(
    buses: tuple[CanBus, ...], addresses: list[str], key_file: str
) -> None:
    config = Config(
        can=buses,
        zenoh=Zenoh(connect=tuple(f"tcp/{a}" for a in addresses)),
        mavlink=Mavlink(signing_key_file=key_file),
    )
    text = to_toml(config)
    again = parse(text)
    assert again == config
    # 1 and 1.0 and true are equal in Python, not for a bus.
    for ours, theirs in zip(config.can, again.can, strict=True):
        assert {k: type(v) for k, v in ours.options.items()} == {
            k: type(v) for k, v in theirs.options.items()
        }
    assert to_toml(again) == text


LITERALS = (
    "nan", "inf", "-inf", "-1", "0", "0.0", "1e400", "99999999999999999999", "true", "''", "' '",
    "'x'", "'a:b:c'", "[]", "[1, 2]", "[[1]]", "['', '', '']", "{}", "{ a = 1 }", "1979-05-27",
)  # fmt: skip


def _refusal(text: str) -> str:
    """What the configuration is refused with; empty where it is taken."""
    try:
        parse(text)
    except ConfigError as error:
        return str(error)
    return ""


def test_anything_in_place_of_a_live_value_is_taken_or_refused_by_its_key() -> None:
    lines = to_toml(parse(DBC + "[can.options]\nfd = true\n" + LINK)).splitlines()
    refused = 0
    for at in range(lines.index("[[can]]"), len(lines)):
        key, equals, _ = lines[at].partition(" = ")
        if not equals:
            continue
        for literal in LITERALS:
            text = "\n".join([*lines[:at], f"{key} = {literal}", *lines[at + 1 :]])
            said = _refusal(text)
            if said:
                refused += 1
                # A value inside a free table of options has no name of ours.
                assert (key if key != "fd" else "options") in said
                assert "\n" not in said
    assert refused > 500


UNITS = """
[[can]]
channel = "can0"
[[can.imu]]
name = "front"
protocol = "dronecan"
node_id = 42
gyro_range_dps = 2000.0
accel_range_mps2 = 157.0
"""
REAR = """
[[can.imu]]
name = "rear"
protocol = "dronecan"
node_id = 43
gyro_range_dps = 500.0
"""


def test_a_full_scale_is_said_once() -> None:
    """Of a CAN unit; what [imu] says itself counts more, and of two units a name decides."""
    imu = parse(UNITS).imu
    assert (imu.gyro_range_dps, imu.accel_range_mps2) == (2000.0, 157.0)
    imu = parse("[imu]\naccel_range_mps2 = 78.5\n" + UNITS).imu
    assert (imu.gyro_range_dps, imu.accel_range_mps2) == (2000.0, 78.5)
    assert parse(UNITS + REAR).imu.gyro_range_dps == 0.0
    both = parse('[imu]\nsource = "rear"\n[[further_imu]]\nsource = "front"\n' + UNITS + REAR)
    assert both.imu.gyro_range_dps == 500.0
    assert both.further_imu[0].gyro_range_dps == 2000.0
    assert parse('[imu]\nsource = "HIGHRES_IMU"\n' + UNITS).imu.gyro_range_dps == 0.0
