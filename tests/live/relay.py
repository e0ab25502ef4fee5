"""A relay on the MAVLink link that signs for the simulated autopilot, records, and cheats on order.

The simulated autopilot knows no signatures: what it says is signed here, and what the companion
says is verified here, by pymavlink's own code.
"""

from __future__ import annotations

import socket
import threading
import time
from collections import Counter
from types import TracebackType
from typing import Any, Self

from pymavlink.dialects.v20 import ardupilotmega as mavlink

SIGNING_EPOCH_S = 1_420_070_400
"""2015-01-01, from which signatures count time in 10 µs."""
NEAR, FAR = 1, 2
"""Link ids: ours towards the companion, and another one."""


def _signer(key: bytes, link_id: int) -> Any:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.robust_parsing = True
    mav.signing.secret_key = key
    mav.signing.link_id = link_id
    mav.signing.sign_outgoing = True
    # It does not look at a clock by itself.
    mav.signing.timestamp = round((time.time() - SIGNING_EPOCH_S) * 1e5)
    return mav


class Relay:
    """Between ``udpout:`` of a vehicle and one companion; a context manager with a thread."""

    def __init__(self, vehicle: str, key: bytes) -> None:
        _, host, port = vehicle.split(":")
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.connect((host, int(port)))
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self.endpoint = f"udpout:127.0.0.1:{self._near.getsockname()[1]}"
        for end in (self._far, self._near):
            end.settimeout(0.1)
        self._signer = _signer(key, NEAR)
        # Accepts what is signed with the key alone, and raises for the rest: robust parsing counts.
        self._verifier = _signer(key, FAR)
        self._reader = mavlink.MAVLink(None)
        self._reader.robust_parsing = True
        self._companion: tuple[str, int] | None = None
        self._plain = b""
        """The newest of the autopilot's messages, as it sent it."""
        self._old: list[bytes] = []
        """Its heartbeats, signed."""
        self._stop = threading.Event()
        self.said: list[Any] = []
        """Messages of the companion."""
        self.refused: list[Any] = []
        """What it sent that does not hold."""
        self.cheated: Counter[str] = Counter()
        """Datagrams that it must refuse, by why."""
        self._threads = [threading.Thread(target=t) for t in (self._inward, self._outward)]

    def cheat(self) -> None:
        """Send the newest thing the autopilot said without a signature, and an old signed one."""
        assert self._companion is not None
        for why, frame in (("unsigned", self._plain), ("replayed", self._old[0])):
            self._near.sendto(frame, self._companion)
            self.cheated[why] += 1

    def of(self, kind: str) -> list[Any]:
        """Messages of one kind that the companion sent."""
        return [message for message in list(self.said) if message.get_type() == kind]

    def _inward(self) -> None:
        """From the autopilot: signed, then on to the companion."""
        while not self._stop.is_set():
            try:
                data = self._far.recv(65_536)
            except (TimeoutError, ConnectionError):
                continue
            for message in self._reader.parse_buffer(data) or []:
                self._plain = bytes(message.get_msgbuf())
                frame = message.pack(self._signer)
                if message.get_type() == "HEARTBEAT":
                    self._old.append(frame)
                if self._companion is not None:
                    self._near.sendto(frame, self._companion)

    def _outward(self) -> None:
        """From the companion: verified, then on to the autopilot as it is."""
        while not self._stop.is_set():
            try:
                data, self._companion = self._near.recvfrom(65_536)
            except (TimeoutError, ConnectionError):
                continue
            for message in self._verifier.parse_buffer(data) or []:
                bad = message.get_type() == "BAD_DATA"
                (self.refused if bad else self.said).append(message)
            self._far.send(data)

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._far.close()
        self._near.close()
