"""What the runtime asks of everything it hands its outputs to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

from companion.types import Event, Health, Outputs


@dataclass(frozen=True, slots=True)
class Notice:
    """Something about an output that a person should know; the runtime makes it an event."""

    kind: str
    """Stable kebab-case name: ``zenoh-down``, ``zenoh-up``, …"""
    text: str
    level: Literal["info", "warning", "error"] = "info"


class Publisher(Protocol):
    """One way out. No method blocks, and none raises for what happens outside of the process."""

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:
        """Send what one engine step gave out.

        ``arrival_monotonic_ns``: CLOCK_MONOTONIC when the newest sample behind it arrived.
        """

    def event(self, event: Event) -> None:
        """Send an event that did not come out of an engine step."""

    def health(self, health: Health) -> None:
        """Send the state of the process, about once a second."""

    def config(self, toml: str) -> None:
        """Have the effective configuration ready for whoever asks."""

    def notices(self) -> list[Notice]:
        """What happened to the link since the last call."""

    def close(self) -> None:
        """Say goodbye; whatever does not go at once stays unsent."""
