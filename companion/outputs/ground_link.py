"""A link of our own to a ground station, where it is not the autopilot's."""

from __future__ import annotations

from typing import Any

from companion.outputs.publisher import Notice
from drivers.mavlink.link import ReopeningLink
from drivers.mavlink.packer import Packer
from drivers.mavlink.signing import Signing


class GroundLink:
    """Packs messages as our component of the vehicle's system and writes them, or drops them.

    The owner calls :meth:`tick` about ten times a second. What the ground station says is read, so
    that a listening endpoint knows whom to answer, and not acted upon.
    """

    def __init__(self, link: ReopeningLink, component: int, signing_key: bytes | None) -> None:
        self._link = link
        self._signing = Signing(signing_key) if signing_key is not None else None
        self._packer = Packer(1, component, self._signing)
        self.sent = 0
        self.dropped = 0
        """Messages that the link did not take."""

    def tick(self, now_ns: int, system: int) -> None:
        """Open, read, and take over the system id of the vehicle once it is known (not 0)."""
        if self._signing is not None:
            self._signing.set_time(now_ns)
        if system:
            self._packer.system = system
        self._link.poll(now_ns)
        self._link.read(now_ns)

    def send(self, message: Any) -> None:
        """Write a message, or count it as dropped."""
        if self._link.write(self._packer.pack(message)):
            self.sent += 1
        else:
            self.dropped += 1

    def notices(self) -> list[Notice]:
        """The link's openings and losses since the last call."""
        return [
            Notice("ground-up", f"ground link {self._link.name} is open")
            if state == "up"
            else Notice("ground-down", f"ground link {self._link.name}: {note}", "warning")
            for state, note in self._link.changes()
        ]

    def close(self) -> None:
        """Give the device or socket back."""
        self._link.close()
