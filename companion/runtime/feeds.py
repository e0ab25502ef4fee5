"""MAVLink out, as a configuration wants it: to a ground station, to the autopilot's estimator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.config import Config
from companion.outputs.ground_link import GroundLink
from companion.outputs.mavlink_feeds import AutopilotFeed, GroundFeed, MessageLink
from companion.outputs.publisher import Publisher
from companion.types import ConfigError
from drivers.mavlink.link import ReopeningLink
from drivers.mavlink.session import MavlinkSession
from drivers.mavlink.signing import read_key

OVER_AUTOPILOT = "autopilot"
"""``ground.endpoint`` that stands for the autopilot's link."""


@dataclass(frozen=True, slots=True)
class Feeds:
    """Publishers of MAVLink, and the link that they have of their own."""

    publishers: Sequence[Publisher]
    ground: GroundLink | None


def make_feeds(
    config: Config, directory: Path, session: MavlinkSession | None, start_ns: int
) -> Feeds:
    """The feeds that ``[ground]`` and ``[to_autopilot]`` ask for.

    ``directory``: what the key file is relative to. Raises :class:`ConfigError` for a feed that
    needs the autopilot's link where there is none.
    """
    publishers: list[Publisher] = []
    ground: GroundLink | None = None
    endpoint = config.ground.endpoint
    if endpoint:
        link: MessageLink
        if endpoint == OVER_AUTOPILOT:
            link = _needed(session, "ground.endpoint")
        else:
            key_file = config.mavlink.signing_key_file
            key = read_key(directory / key_file) if key_file else None
            own = ReopeningLink(endpoint, config.mavlink.baud)
            link = ground = GroundLink(own, config.mavlink.component, key)
        undulation = (lambda: session.undulation_m) if session is not None else (lambda: None)
        publishers.append(GroundFeed(config.ground, link, start_ns, undulation))
    if config.to_autopilot.message != "off":
        autopilot = _needed(session, "to_autopilot.message")
        publishers.append(AutopilotFeed(config.to_autopilot, autopilot))
    return Feeds(publishers, ground)


def _needed(session: MavlinkSession | None, key: str) -> MavlinkSession:
    if session is None:
        raise ConfigError(f"key '{key}': needs the autopilot's link, mavlink.endpoint")
    return session
