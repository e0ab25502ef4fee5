"""The other end of the publication: what vehicles say, queued for one reader."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import zenoh

from companion.outputs import payloads
from companion.outputs.publisher import Notice
from companion.outputs.zenoh_link import ZenohLink

RETRY_S = 0.5
_QUEUED = 10_000
"""Messages that wait for a slow reader; more are dropped."""


@dataclass(frozen=True, slots=True)
class Heard:
    """One message of a vehicle."""

    vehicle: str
    name: str
    """Key below the vehicle's: ``nav/state``, ``health``, ``@alive``, …"""
    payload: bytes | None
    """None: an ``@alive`` token that vanished."""
    receipt_ns: int = 0
    """CLOCK_MONOTONIC when it came, however long it then waited for its reader."""


class Subscriber:
    """Subscribes to one vehicle or all (``*``); opens, and opens again, in the background."""

    def __init__(self, settings: Callable[[], zenoh.Config], vehicle: str = "*") -> None:
        """``settings``: for instance ``lambda: client_settings("tcp/127.0.0.1:7447")``."""
        self._root = f"companion/{vehicle}"
        self._heard: queue.Queue[Heard] = queue.Queue(_QUEUED)
        self.dropped = 0
        self.link = ZenohLink(settings, self._declare, retry_s=RETRY_S)

    def take(self, timeout_s: float) -> list[Heard]:
        """All that has come, after waiting at most ``timeout_s`` for the first."""
        out: list[Heard] = []
        try:
            out.append(self._heard.get(timeout=timeout_s))
            while True:
                out.append(self._heard.get_nowait())
        except queue.Empty:
            return out

    def notices(self) -> list[Notice]:
        """Whether anybody can be reached."""
        return self.link.notices()

    def close(self) -> None:
        """Close the session."""
        self.link.close()

    def _declare(self, session: zenoh.Session) -> list[Any]:
        return [
            session.liveliness().declare_subscriber(
                f"{self._root}/{payloads.ALIVE}", self._take, history=True
            ),
            session.declare_subscriber(f"{self._root}/nav/*", self._take),
            *(self._declare_kept(session, name) for name in (payloads.EVENTS, payloads.HEALTH)),
        ]

    def _declare_kept(self, session: zenoh.Session, name: str) -> Any:
        """A subscription that asks for what was said before it, or missed."""
        return zenoh.ext.declare_advanced_subscriber(
            session,
            f"{self._root}/{name}",
            self._take,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )

    def _take(self, sample: zenoh.Sample) -> None:
        _, vehicle, name = str(sample.key_expr).split("/", 2)
        gone = sample.kind == zenoh.SampleKind.DELETE
        payload = None if gone else sample.payload.to_bytes()
        try:
            self._heard.put_nowait(Heard(vehicle, name, payload, time.monotonic_ns()))
        except queue.Full:
            self.dropped += 1
