"""The bridge to Foxglove, read by a WebSocket client that knows nothing of us."""

from __future__ import annotations

import asyncio
import base64
import json
import signal
import struct
import subprocess
import sys
from contextlib import closing
from typing import Any

import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

from companion.logbook.health import encode_health
from companion.outputs import payloads
from companion.outputs.subscriber import Heard
from companion.types import CompanionError
from replay.children import free_port
from tests.outputs.test_zenoh_publisher import HEALTH
from tests.outputs.zenoh_help import PATIENCE_S, T0
from tests.watch.test_picture import SECOND, event, state
from tests.watch.test_watch_command import publishing

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
websockets = pytest.importorskip("websockets", reason="websockets is not installed")

from companion.watch.foxglove_bridge import FoxgloveBridge, message_of  # noqa: E402


def test_messages_keep_their_bytes_and_their_time() -> None:
    made = message_of(state(50))
    assert made is not None
    assert (made.topic, made.schema) == ("companion/v1/nav/state", "companion.NavState")
    assert made.t_ns == T0 + 1_000_000_000
    said = message_of(event("hello"))
    assert said is not None
    assert (said.schema, said.t_ns) == ("foxglove.Log", T0)
    health = message_of(Heard("v1", payloads.HEALTH, encode_health(HEALTH)))
    assert health is not None
    assert health.t_ns == HEALTH.t_ns


def test_tokens_and_strangers_are_left_out_and_rubbish_is_counted() -> None:
    assert message_of(Heard("v1", payloads.ALIVE, b"")) is None
    assert message_of(Heard("v1", "nav/mine", b"x")) is None
    with pytest.raises(DecodeError):
        message_of(Heard("v1", payloads.STATE, b"\xff\xff"))
    with closing(FoxgloveBridge("127.0.0.1", 0)) as bridge:
        bridge.give(Heard("v1", payloads.STATE, b"\xff\xff"))
        assert bridge.broken == 1
        with pytest.raises(CompanionError, match=r"--port"):
            FoxgloveBridge("127.0.0.1", bridge.port)


async def read(port: int, wanted: set[str]) -> dict[str, tuple[int, Any]]:
    """One decoded message of each topic of ``wanted``, by the schemas that the server names."""
    url = f"ws://127.0.0.1:{port}"
    found: dict[str, tuple[int, Any]] = {}
    async with websockets.connect(url, subprotocols=["foxglove.sdk.v1"]) as socket:
        types: dict[int, tuple[str, Any]] = {}
        while set(found) != wanted:
            raw = await asyncio.wait_for(socket.recv(), PATIENCE_S)
            if isinstance(raw, bytes):
                if raw[0] == 1:  # message data: subscription, time, payload
                    at, t_ns = struct.unpack_from("<IQ", raw, 1)
                    topic, kind = types[at]
                    found[topic] = t_ns, kind.FromString(raw[13:])
                continue
            said = json.loads(raw)
            for channel in said.get("channels", ()) if said["op"] == "advertise" else ():
                if channel["topic"] in wanted:
                    types[channel["id"]] = channel["topic"], described(channel)
                    order = {"id": channel["id"], "channelId": channel["id"]}
                    await socket.send(json.dumps({"op": "subscribe", "subscriptions": [order]}))
    return found


def described(channel: dict[str, Any]) -> Any:
    """The message type of a channel, from nothing but its own description."""
    files = FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))


def test_a_client_reads_what_a_vehicle_publishes() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-u", "-m", "companion", "watch", "--foxglove", "--port", "0"]
    wanted = {f"companion/v1/{name}" for name in ("nav/state", "nav/fix", "nav/aiding", "health")}
    with (
        publishing(endpoint),
        subprocess.Popen(
            [*command, "--connect", endpoint], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True,
        ) as run,
    ):  # fmt: skip
        assert run.stdout is not None
        first = run.stdout.readline()
        assert first.startswith("Foxglove  ws://127.0.0.1:"), run.stderr
        found = asyncio.run(read(int(first.rpartition(":")[2]), wanted))
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=PATIENCE_S)
    assert (run.returncode, err) == (0, "")
    t_ns, fix = found["companion/v1/nav/fix"]
    assert t_ns == fix.timestamp.seconds * 10**9 + fix.timestamp.nanos >= T0
    assert fix.latitude == pytest.approx(45.8366, abs=0.01)
    t_ns, nav = found["companion/v1/nav/state"]
    assert (t_ns, nav.yaw_deg) == (nav.t_ns, pytest.approx(30.0))
    assert found["companion/v1/health"][1].text == "GNSS silent"


def test_the_time_of_a_message_is_never_negative() -> None:
    """Foxglove's times are unsigned."""
    from companion.proto import navigation_pb2

    early = navigation_pb2.AidingReport(t_ns=-SECOND).SerializeToString()
    made = message_of(Heard("v1", payloads.AIDING, early))
    assert made is not None
    assert made.t_ns == 0
