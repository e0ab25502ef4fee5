"""Messages of pymavlink's dialect to MAVLink 2 frames of one sender on one link."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from drivers.mavlink.signing import Signing

ONBOARD_COMPUTER = 191
"""Our component id, unless configured otherwise."""


class Packer:
    """Packs with one system and component id, counts frames, signs where a key is given."""

    def __init__(
        self, system: int, component: int = ONBOARD_COMPUTER, signing: Signing | None = None
    ) -> None:
        self._link = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self._signing = signing

    @property
    def system(self) -> int:
        """Our system id: that of the vehicle we ride on."""
        return int(self._link.srcSystem)

    @system.setter
    def system(self, system: int) -> None:
        self._link.srcSystem = system

    def pack(self, message: Any) -> bytes:
        """The frame of a ``MAVLink_…_message``; raises as pymavlink does for a value that does not
        fit its field."""
        frame = bytes(message.pack(self._link))
        self._link.seq = (self._link.seq + 1) % 256
        return frame if self._signing is None else self._signing.sign(frame)
