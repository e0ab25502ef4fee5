"""Decoders and encoders by the name of their protocol, as configuration spells it."""

from __future__ import annotations

import math
from typing import Any

from companion.types import ConfigError
from drivers.can_imu.dbc import DbcDecoder, DbcEncoder
from drivers.can_imu.dbc_signals import Mapping
from drivers.can_imu.decoder import IDENTITY, Axes, CanImuDecoder, CanImuEncoder, Unit
from drivers.can_imu.dronecan import DroneCanDecoder, DroneCanEncoder
from drivers.can_imu.openimu import OpenImuDecoder, OpenImuEncoder
from drivers.can_imu.sbg import SbgDecoder, SbgEncoder
from drivers.can_imu.xsens import XsensDecoder, XsensEncoder

_ENCODERS: dict[str, type[CanImuEncoder]] = {
    "dronecan": DroneCanEncoder,
    "xsens-mti": XsensEncoder,
    "sbg-ellipse": SbgEncoder,
    "openimu-j1939": OpenImuEncoder,
    "dbc": DbcEncoder,
}
PROTOCOLS = tuple(_ENCODERS)


def make_decoder(
    name: str,
    protocol: str,
    *,
    node_id: int = 0,
    axes: Axes = IDENTITY,
    rate_hz: float = 0.0,
    gyro_range_dps: float = 0.0,
    accel_range_mps2: float = 0.0,
    dbc: Mapping | None = None,
) -> CanImuDecoder:
    """A decoder for one unit; options as the keys of ``[[can.imu]]``.

    ``name``: the stream's. ``node_id`` 0: the first unit heard. Ranges 0: the wire format's own.
    ``dbc``: signals of protocol ``dbc``, its ``file`` as it can be opened.
    Raises :class:`ConfigError` for what does not exist.
    """
    unit = Unit(
        name,
        tuple((float(r[0]), float(r[1]), float(r[2])) for r in axes),  # type: ignore[arg-type]
        math.radians(gyro_range_dps) if gyro_range_dps > 0 else math.inf,
        accel_range_mps2 if accel_range_mps2 > 0 else math.inf,
        rate_hz,
    )
    if protocol == "dbc":
        if dbc is None:
            raise ConfigError(f"CAN IMU '{name}': protocol 'dbc' needs a [can.imu.dbc] table")
        return DbcDecoder(unit, dbc)
    if protocol == "dronecan":
        return DroneCanDecoder(unit, node_id)
    if protocol == "openimu-j1939":
        return OpenImuDecoder(unit, node_id)
    if protocol == "xsens-mti":
        return XsensDecoder(unit)
    if protocol == "sbg-ellipse":
        return SbgDecoder(unit)
    raise _unknown(protocol)


def make_encoder(protocol: str, **options: Any) -> CanImuEncoder:
    """An encoder, for simulators and tests; ``options`` are those of its class."""
    encoder = _ENCODERS.get(protocol)
    if encoder is None:
        raise _unknown(protocol)
    return encoder(**options)


def _unknown(protocol: str) -> ConfigError:
    return ConfigError(f"no CAN IMU protocol '{protocol}'; there is {', '.join(PROTOCOLS)}")
