"""What vehicles publish, for Foxglove and Lichtblick: neither subscribes to zenoh itself.

Topics, schemas and bytes are those of the run log, so that a layout made for one shows the other.
The sockets are those of foxglove-sdk, which keeps a bounded queue for each client and drops the
oldest of a slow one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from google.protobuf.message import DecodeError

from companion.logbook.schemas import MESSAGES, descriptor_set, topic
from companion.outputs import payloads
from companion.outputs.subscriber import Heard
from companion.types import NS, CompanionError
from companion.watch.picture import VEHICLES

if TYPE_CHECKING:
    import foxglove

_WAITING = 1024
"""Messages that wait for one client; some three seconds of a vehicle."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message on its way to Foxglove."""

    topic: str
    schema: str
    """Full name of the protobuf type."""
    t_ns: int
    """Its own time, which Foxglove draws it at."""
    payload: bytes


def message_of(heard: Heard) -> Message | None:
    """What Foxglove is to be given of a message; None for a liveliness token or a foreign key.

    Raises :class:`~google.protobuf.message.DecodeError` for what is not of the key's type: Foxglove
    would complain of each in its own words.
    """
    schema = payloads.SCHEMAS.get(heard.name)
    if schema is None or heard.payload is None:
        return None
    decoded: Any = MESSAGES[schema].FromString(heard.payload)
    stamp = getattr(decoded, "timestamp", None)
    t_ns = decoded.t_ns if stamp is None else stamp.seconds * NS + stamp.nanos
    return Message(topic(heard.vehicle, heard.name), schema, max(t_ns, 0), heard.payload)


class FoxgloveBridge:
    """A Foxglove WebSocket server that is fed with messages."""

    def __init__(self, host: str, port: int) -> None:
        """Listen; port 0: any that is free.

        Raises :class:`CompanionError` without foxglove-sdk, or for a port that is taken.
        """
        try:
            import foxglove
        except ImportError:
            raise CompanionError(
                "--foxglove needs foxglove-sdk: pip install 'companion-nav[foxglove]'"
            ) from None
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="companion",
                host=host,
                port=port,
                context=self._context,
                message_backlog_size=_WAITING,
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise CompanionError(
                f"{host}:{port}: {error}; choose another --port or --bind"
            ) from None
        self.port: int = self._server.port
        self.broken = 0
        """Messages that were not of their key's type."""
        self._vehicles: set[str] = set()
        self._channels: dict[str, foxglove.Channel] = {}

    def give(self, heard: Heard) -> None:
        """Pass a message on to whoever is connected; one that cannot be read is counted."""
        if heard.vehicle not in self._vehicles:
            if len(self._vehicles) >= VEHICLES:
                return
            self._vehicles.add(heard.vehicle)
        try:
            message = message_of(heard)
        except DecodeError:
            self.broken += 1
            return
        if message is not None:
            self._channel(message).log(message.payload, log_time=message.t_ns)

    def close(self) -> None:
        """Let every client go."""
        self._server.stop()

    def _channel(self, message: Message) -> foxglove.Channel:
        channel = self._channels.get(message.topic)
        if channel is None:
            import foxglove

            schema = foxglove.Schema(
                name=message.schema, encoding="protobuf", data=descriptor_set(message.schema)
            )
            channel = foxglove.Channel(
                message.topic, schema=schema, message_encoding="protobuf", context=self._context
            )
            self._channels[message.topic] = channel
        return channel
