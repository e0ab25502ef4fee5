"""A receiver beside the simulated vehicle: raw GPS as UBX or RTCM 3, over TCP or serial.

Told the time; what it has to say is bytes. Messages of two satellites go with each epoch, so that
who connects later has all of them within seconds (a real sky takes thirty).
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from typing import Literal

import numpy as np

from companion.gnss.orbit import E_SAT
from replay.simulator.constellation import Sky
from replay.simulator.live import rtcm, ubx

Protocol = Literal["ublox", "rtcm3"]

SUBFRAMES_OF = 2
"""Satellites whose navigation messages go with an epoch."""


class SimulatedReceiver:
    """One flight's epochs as bytes, each when it is due. Pure."""

    def __init__(
        self, sky: Sky, shift_ns: int, protocol: Protocol = "ublox", latency_ms: float = 80.0
    ) -> None:
        """``shift_ns``: from the recording's clock to that of the process."""
        raw = sky.raw
        self._sky = sky
        self._due = raw.t_ns + shift_ns + round(latency_ms * 1e6)
        self._protocol = protocol
        self._at = 0
        self._turn = 0
        self.silent = False
        self.epochs = 0

    @property
    def next_ns(self) -> int | None:
        """When the next epoch is due; None at the end."""
        return int(self._due[self._at]) if self._at < len(self._due) else None

    def advance(self, now_ns: int) -> bytes:
        """What is said up to now."""
        out = []
        while self._at < len(self._due) and self._due[self._at] <= now_ns:
            if not self.silent:
                out.append(b"".join(self._epoch(self._at)))
                self.epochs += 1
            self._at += 1
        return b"".join(out)

    def _epoch(self, i: int) -> Iterator[bytes]:
        raw = self._sky.raw
        seen = np.flatnonzero(raw.sat[i])
        sats = raw.sat[i, seen]
        tow, measured = float(raw.tow[i]), (raw.pseudorange[i, seen], raw.rate[i, seen])
        if self._protocol == "ublox":
            yield ubx.rawx(int(raw.week[i]), tow, sats, *measured)
        else:
            yield from rtcm.epoch(tow, sats, *measured)
        for k in range(SUBFRAMES_OF):
            sat = int(sats[(self._turn + k) % len(sats)])
            # One issue of ephemerides serves the two hours of any flight here.
            table = self._sky.broadcast.values
            row = next(row for row in table[1:] if int(row[E_SAT]) == sat)
            yield from ubx.lnav(row) if self._protocol == "ublox" else [rtcm.ephemeris(row)]
        self._turn += SUBFRAMES_OF


class TcpServer:
    """Whoever connects is sent everything from then on; one at a time, the last who came."""

    def __init__(self) -> None:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._listening.setblocking(False)
        self._peer: socket.socket | None = None

    @property
    def endpoint(self) -> str:
        """Where to connect to."""
        return f"tcp:127.0.0.1:{self._listening.getsockname()[1]}"

    def write(self, data: bytes) -> None:
        """Take who waits, and send; a peer that is gone or full is let go."""
        with contextlib.suppress(BlockingIOError):
            peer, _ = self._listening.accept()
            peer.setblocking(False)
            self._drop()
            self._peer = peer
        if self._peer is not None and data:
            try:
                self._peer.sendall(data)
            except OSError:
                self._drop()

    def close(self) -> None:
        """Give the port back."""
        self._drop()
        self._listening.close()

    def _drop(self) -> None:
        if self._peer is not None:
            self._peer.close()
            self._peer = None
