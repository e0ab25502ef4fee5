"""Inertial units on a CAN bus: one pure codec a wire format, and thin transports.

Codecs turn frames with their times of arrival into :class:`~companion.types.ImuSamples` and back;
``clock`` finds the times of validity. Only ``transport`` touches devices.
"""

from drivers.can_imu.decoder import (
    CanCounters,
    CanFrame,
    CanImuDecoder,
    CanImuEncoder,
    rounding_density,
)
from drivers.can_imu.factory import PROTOCOLS, make_decoder, make_encoder
from drivers.can_imu.transport import CanTransport, ReceivedFrame, open_can

__all__ = [
    "PROTOCOLS",
    "CanCounters",
    "CanFrame",
    "CanImuDecoder",
    "CanImuEncoder",
    "CanTransport",
    "ReceivedFrame",
    "make_decoder",
    "make_encoder",
    "open_can",
    "rounding_density",
]
