"""Decoders and encoders by the name of their protocol, as configuration spells it."""

from __future__ import annotations

import math
from typing import Any

from companion.types import ConfigError
from drivers.can_imu.decoder import IDENTITY, Axes, CanImuDecoder, CanImuEncoder, Unit
from drivers.can_imu.dronecan import DroneCanDecoder, DroneCanEncoder

PROTOCOLS = ("dronecan",)


def make_decoder(
    name: str,
    protocol: str,
    *,
    node_id: int = 0,
    axes: Axes = IDENTITY,
    rate_hz: float = 0.0,
    gyro_range_dps: float = 0.0,
    accel_range_mps2: float = 0.0,
) -> CanImuDecoder:
    """A decoder for one unit; options as the keys of ``[[can.imu]]``.

    ``name``: the stream's. ``node_id`` 0: the first unit heard. Ranges 0: the wire format's own.
    Raises :class:`ConfigError` for what does not exist.
    """
    unit = Unit(
        name,
        tuple((float(r[0]), float(r[1]), float(r[2])) for r in axes),  # type: ignore[arg-type]
        math.radians(gyro_range_dps) if gyro_range_dps > 0 else math.inf,
        accel_range_mps2 if accel_range_mps2 > 0 else math.inf,
        rate_hz,
    )
    if protocol == "dronecan":
        return DroneCanDecoder(unit, node_id)
    raise ConfigError(f"no CAN IMU protocol '{protocol}'; there is {', '.join(PROTOCOLS)}")


def make_encoder(protocol: str, **options: Any) -> CanImuEncoder:
    """An encoder, for simulators and tests; ``options`` are those of its class."""
    if protocol == "dronecan":
        return DroneCanEncoder(**options)
    raise ConfigError(f"no CAN IMU protocol '{protocol}'; there is {', '.join(PROTOCOLS)}")
