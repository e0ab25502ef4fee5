"""What is published under which key: payloads and the encodings that name their schema."""

from __future__ import annotations

import struct

import zenoh
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.timestamp_pb2 import Timestamp

from companion.proto import run_pb2
from companion.types import NS, Event

STATE = "nav/state"
FIX = "nav/fix"
ODOMETRY = "nav/odometry"
SMOOTHED = "nav/smoothed"
AIDING = "nav/aiding"
ADAPTATION = "nav/adaptation"
SATELLITES = "nav/satellites"
EVENTS = "events"
HEALTH = "health"
CONFIG = "config"
ALIVE = "@alive"

SCHEMAS = {
    STATE: "companion.NavState",
    FIX: "foxglove.LocationFix",
    ODOMETRY: "foxglove.Odometry",
    SMOOTHED: "companion.NavState",
    AIDING: "companion.AidingReport",
    ADAPTATION: "companion.AdaptationTrace",
    SATELLITES: "companion.Satellites",
    EVENTS: "foxglove.Log",
    HEALTH: "companion.Health",
    CONFIG: "companion.Config",
}
"""Message type under each key; its ``.proto`` is in ``companion/proto`` or Foxglove's schemas."""

_LEVEL = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_ARRIVAL_TAG = b"\xb1\x01"
"""Field 22 of NavState, eight bytes: fields of a message may follow each other in any order."""


def encoding(name: str) -> zenoh.Encoding:
    """``application/protobuf`` with the message type of a key."""
    return zenoh.Encoding("application/protobuf").with_schema(SCHEMAS[name])


def with_arrival(state: bytes, arrival_monotonic_ns: int) -> bytes:
    """A ``NavState`` that says when the newest sample behind it arrived."""
    return state + _ARRIVAL_TAG + struct.pack("<q", arrival_monotonic_ns)


def event_message(event: Event) -> bytes:
    """A ``foxglove.Log``: the kind as its name, the text as its message."""
    seconds, nanos = divmod(event.t_ns, NS)
    return Log(
        timestamp=Timestamp(seconds=seconds, nanos=nanos),
        level=_LEVEL[event.level],
        message=event.text,
        name=event.kind,
    ).SerializeToString()


def config_message(toml: str) -> bytes:
    """A ``companion.Config``."""
    return run_pb2.Config(toml=toml).SerializeToString()
