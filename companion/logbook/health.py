"""Health of the process as a protobuf message: for the log and for subscribers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, cast

from google.protobuf.message import DecodeError

from companion.proto import health_pb2
from companion.types import (
    Health,
    LinkHealth,
    LogFormatError,
    LogHealth,
    LoopHealth,
    Mode,
    SensorHealth,
)

_NESTED = {"sensors", "links", "loop", "log", "counters"}


def encode_health(health: Health) -> bytes:
    """A ``companion.Health`` message; words become the enumerators of the same name."""
    message = health_pb2.Health(counters=health.counters)
    _fill(message, health, {"level": health_pb2.Health.Level})
    for sensor in health.sensors:
        _fill(message.sensors.add(), sensor, {"state": health_pb2.SensorHealth.State})
    for link in health.links:
        _fill(message.links.add(), link, {"state": health_pb2.LinkHealth.State})
    _fill(message.loop, health.loop, {})
    _fill(message.log, health.log, {"state": health_pb2.LogHealth.State})
    return message.SerializeToString()


def decode_health(data: bytes) -> Health:
    """What :func:`encode_health` was given.

    Raises :class:`LogFormatError` when it is no Health, or one of a later version whose words this
    one does not know.
    """
    try:
        message = health_pb2.Health.FromString(data)
        log = _values(message.log, LogHealth, {"state": health_pb2.LogHealth.State})
        own = _values(message, Health, {"level": health_pb2.Health.Level})
        return Health(
            **{**own, "mode": Mode(message.mode)},
            sensors=tuple(
                SensorHealth(**_values(m, SensorHealth, {"state": health_pb2.SensorHealth.State}))
                for m in message.sensors
            ),
            links=tuple(
                LinkHealth(**_values(m, LinkHealth, {"state": health_pb2.LinkHealth.State}))
                for m in message.links
            ),
            loop=LoopHealth(**_values(message.loop, LoopHealth, {})),
            log=LogHealth(**log),
            counters=dict(message.counters),
        )
    except (DecodeError, ValueError):
        raise LogFormatError("not a companion.Health message of a known version") from None


def _fill(message: Any, value: Any, enums: dict[str, Any]) -> None:
    """Copy the plain fields of a dataclass to the fields of the same name."""
    for name in (f.name for f in fields(value)):
        if name not in _NESTED:
            plain = getattr(value, name)
            if name in enums:
                plain = enums[name].Value(plain.upper().replace("-", "_"))
            setattr(message, name, plain)


def _values(message: Any, kind: type, enums: dict[str, Any]) -> dict[str, Any]:
    """The plain fields of a message as arguments of its dataclass."""
    names = (f.name for f in fields(cast(Any, kind)) if f.name not in _NESTED)
    return {
        name: enums[name].Name(getattr(message, name)).lower().replace("_", "-")
        if name in enums
        else getattr(message, name)
        for name in names
    }
