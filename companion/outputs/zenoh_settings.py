"""From the configuration's ``[zenoh]`` to a zenoh session's own configuration."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import zenoh

from companion.config import Zenoh
from companion.types import ConfigError

_PEER = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": False,
    # Scouting is off: nothing to wait for, and a router that is absent is tried again later.
    "open/return_conditions/connect_scouted": False,
    "open/return_conditions/declares": False,
    "connect/timeout_ms": -1,
    "connect/retry": {"period_init_ms": 500, "period_max_ms": 2000, "period_increase_factor": 2},
}
_QUEUE = "transport/link/tx/queue"
_NEEDED = {
    # Cached events are told apart by their time stamps.
    "timestamping/enabled": True,
    # A full queue drops at once: by default each put waits a millisecond for room, in our loop.
    f"{_QUEUE}/congestion_control/drop/wait_before_drop": 0,
    # Room for the burst that one fix makes, which is no congestion.
    f"{_QUEUE}/size/data": 16,
    f"{_QUEUE}/size/data_high": 16,
}


def session_settings(settings: Zenoh) -> zenoh.Config:
    """Configuration of the publisher's session.

    Without ``config_file``: a peer on the endpoints of ``listen`` and ``connect``, without
    scouting. With it, the file decides everything. Raises :class:`ConfigError` for a file that
    zenoh does not take or keys that contradict it.
    """
    if not settings.config_file:
        return peer_settings(settings.listen, settings.connect)
    if settings.connect:
        raise ConfigError(
            "zenoh.connect: is not used beside zenoh.config_file; write the endpoints into that "
            "file, under connect.endpoints"
        )
    return file_settings(Path(settings.config_file))


def peer_settings(listen: Sequence[str], connect: Sequence[str]) -> zenoh.Config:
    """A peer that opens at once and finds nobody but those named.

    Raises :class:`ConfigError` for an endpoint that zenoh cannot read.
    """
    config = zenoh.Config()
    for key, value in _PEER.items():
        config.insert_json5(key, json.dumps(value))
    for key, endpoints in (("listen", listen), ("connect", connect)):
        for endpoint in endpoints:
            if not re.fullmatch(r"[a-z][a-z-]*/[^/]\S*", endpoint):
                raise ConfigError(
                    f"zenoh.{key}: '{endpoint}' is no endpoint; PROTOCOL/ADDRESS, such as "
                    "tcp/127.0.0.1:7447"
                )
        config.insert_json5(f"{key}/endpoints", json.dumps(list(endpoints)))
    return _completed(config)


def client_settings(endpoint: str) -> zenoh.Config:
    """A subscriber of one router or one companion; ``zenoh.open`` raises while nobody is there.

    A client and not a peer: routers hand nothing on from peer to peer.
    Raises :class:`ConfigError` for an endpoint that zenoh cannot read.
    """
    config = peer_settings((), (endpoint,))
    config.insert_json5("mode", '"client"')
    return _completed(config)


def file_settings(path: Path) -> zenoh.Config:
    """A zenoh configuration file; :class:`ConfigError` where there is none or it is wrong."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "not UTF-8 text"
        raise ConfigError(f"zenoh.config_file: {path}: {why}") from None
    try:
        return _completed(zenoh.Config.from_json5(text))
    except zenoh.ZError as error:
        raise ConfigError(f"zenoh.config_file: {path}: {complaint(error)}") from None


def complaint(error: zenoh.ZError) -> str:
    """What zenoh says, in one line, without the places in its own sources."""
    said = re.sub(r"\.?\]? at /\S+", "", str(error)).replace("[", "").strip(" .]!")
    # A syntax error is drawn over several lines: where, the text, and what was expected.
    lines = [line.strip(" -|^>=") for line in said.splitlines()]
    lines = [line for line in lines if line]
    return lines[0] if len(lines) < 2 else f"line {lines[0]}: {lines[-1]}"


def _completed(config: zenoh.Config) -> zenoh.Config:
    """With what publishers and subscribers here rely on, whoever wrote the rest."""
    # Opening must come to an end: it is tried again from here, or by peers in the background.
    if config.get_json("mode") == '"client"':
        waiting: dict[str, Any] = {"connect/timeout_ms": 0, "connect/exit_on_failure": True}
    else:
        waiting = {"connect/exit_on_failure": False}
    for key, value in (_NEEDED | waiting).items():
        config.insert_json5(key, json.dumps(value))
    return config
