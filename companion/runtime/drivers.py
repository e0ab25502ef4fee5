"""Drivers as a configuration wants them."""

from __future__ import annotations

from pathlib import Path

import msgspec

from companion.config import CanBus, CanImu, Mavlink
from drivers.can_imu import CanImuDecoder, make_decoder
from drivers.mavlink.session import MavlinkSession, SessionSettings
from drivers.mavlink.signing import read_key


def can_decoders(bus: CanBus, directory: Path) -> list[CanImuDecoder]:
    """A decoder for each unit of a bus; ``directory`` is what DBC files are relative to.

    Raises :class:`~companion.types.ConfigError` for a unit that cannot be decoded.
    """
    return [_decoder(unit, directory) for unit in bus.imu]


def _decoder(unit: CanImu, directory: Path) -> CanImuDecoder:
    dbc = unit.dbc
    if dbc is not None:
        dbc = msgspec.structs.replace(dbc, file=str(directory / dbc.file))
    return make_decoder(
        unit.name,
        unit.protocol,
        node_id=unit.node_id,
        axes=unit.axes,
        rate_hz=unit.rate_hz,
        gyro_range_dps=unit.gyro_range_dps,
        accel_range_mps2=unit.accel_range_mps2,
        dbc=dbc,
    )


def mavlink_session(
    mavlink: Mavlink, directory: Path, known: tuple[int, int] | None = None
) -> MavlinkSession:
    """The autopilot's session; ``directory`` is what the key file is relative to.

    ``known``: system and component of the autopilot that was there before.
    Raises :class:`~companion.types.ConfigError` for a key that cannot be read.
    """
    key_file = mavlink.signing_key_file
    settings = SessionSettings(
        system=mavlink.system,
        known=known,
        component=mavlink.component,
        imu=mavlink.imu,
        imu_rate_hz=mavlink.imu_rate_hz,
        gnss_rate_hz=mavlink.gnss_rate_hz,
        baro_rate_hz=mavlink.baro_rate_hz,
        mag_rate_hz=mavlink.mag_rate_hz,
        request_rates=mavlink.request_rates,
        datagrams=mavlink.endpoint.startswith(("udp:", "udpin:", "udpout:")),
        signing_key=read_key(directory / key_file) if key_file else None,
    )
    return MavlinkSession(settings)
