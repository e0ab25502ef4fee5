"""Publication over zenoh, seen by real subscribers over TCP on this machine."""

from __future__ import annotations

import json
import queue
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zenoh
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from companion.config import Zenoh
from companion.logbook.health import decode_health
from companion.outputs.zenoh_publisher import ZenohPublisher
from companion.proto import navigation_pb2, run_pb2
from companion.types import (
    NS,
    Channel,
    ConfigError,
    Event,
    Health,
    LinkHealth,
    LogHealth,
    LoopHealth,
    Mode,
    SensorHealth,
)
from tests.outputs.zenoh_help import (
    PATIENCE_S,
    T0,
    client,
    free_port,
    outputs,
    peer,
    report,
    solution,
    wait_for,
)

HEALTH = Health(
    "v1",
    T0,
    12.5,
    Mode.NAVIGATING,
    "warning",
    "GNSS silent",
    (SensorHealth("imu", "can0", "ok", True, 200.0, 0.004, 2500, lost=3),),
    (LinkHealth("can0", "up", 2500, malformed=1, reopened=2, note=""),),
    LoopHealth(0.2, 0.3, 0.9, 4.0, 6.0),
    LogHealth("writing", "run.mcap", 1000, 20, 0),
    {"engine.late_fused": 4},
)


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def publisher(endpoint: str) -> Iterator[ZenohPublisher]:
    with closing(ZenohPublisher(Zenoh(listen=(endpoint,)), "v1")) as made:
        assert made.link.wait_open(PATIENCE_S)
        yield made


@pytest.fixture
def session(endpoint: str, publisher: ZenohPublisher) -> Iterator[zenoh.Session]:
    """A subscriber's session, connected."""
    assert publisher.link.live is not None
    with client(endpoint) as made:
        yield made


def listening(session: zenoh.Session, key: str) -> queue.Queue[zenoh.Sample]:
    """Samples of a plain subscriber, declared and known to the publisher's session."""
    samples: queue.Queue[zenoh.Sample] = queue.Queue()
    session.declare_subscriber(key, samples.put)
    return samples


def matched(publisher: ZenohPublisher, *names: str) -> None:
    """Wait until the publisher knows of subscribers of these keys."""
    live = publisher.link.live
    assert live is not None
    wait_for(
        lambda: all(live.publishers[n].matching_status.matching for n in names or ("nav/state",)),
        "subscriptions known",
    )


def test_each_estimator_of_a_bank_has_a_key_of_its_own(
    publisher: ZenohPublisher, session: zenoh.Session
) -> None:
    samples = listening(session, "companion/v1/nav/estimators/*")
    first, second = solution(), solution(first=1)
    out = replace(outputs(first), members=(("direct", first), ("fuzzy+no-mag", second)))
    # A key is declared when its estimator first has something to say; who listens is known later.
    publisher.publish(out, time.monotonic_ns())
    matched(publisher, "nav/estimators/direct", "nav/estimators/fuzzy+no-mag")
    later = solution(first=50)
    publisher.publish(
        replace(out, members=(("direct", later), ("fuzzy+no-mag", later))), time.monotonic_ns()
    )
    keys, newest = set(), 0
    while newest < int(later.t_ns[0]) or len(keys) < 2:
        sample = samples.get(timeout=PATIENCE_S)
        keys.add(str(sample.key_expr).removeprefix("companion/v1/nav/estimators/"))
        newest = max(newest, navigation_pb2.NavState.FromString(sample.payload.to_bytes()).t_ns)
    assert keys == {"direct", "fuzzy+no-mag"}


def test_state_arrives_with_schema_latency_and_exact_bits(
    publisher: ZenohPublisher, session: zenoh.Session
) -> None:
    samples = listening(session, "companion/*/nav/**")
    matched(publisher, "nav/state", "nav/fix", "nav/odometry", "nav/aiding")
    sent = solution()
    arrival = time.monotonic_ns()
    publisher.publish(outputs(sent, report(Channel.BARO)), arrival)
    got = {str(s.key_expr): s for s in (samples.get(timeout=PATIENCE_S) for _ in range(4))}
    state = got["companion/v1/nav/state"]
    assert str(state.encoding) == "application/protobuf;companion.NavState"
    assert state.congestion_control == zenoh.CongestionControl.DROP
    assert state.express
    message = navigation_pb2.NavState.FromString(state.payload.to_bytes())
    assert (message.t_ns, message.lat, message.lon) == (T0, sent.lat[0], sent.lon[0])
    assert list(message.cov_vel) == list(sent.cov[0, 1])
    assert message.arrival_monotonic_ns == arrival
    fix = got["companion/v1/nav/fix"]
    assert str(fix.encoding) == "application/protobuf;foxglove.LocationFix"
    assert LocationFix.FromString(fix.payload.to_bytes()).altitude == 500.0
    odometry = got["companion/v1/nav/odometry"]
    assert str(odometry.encoding) == "application/protobuf;foxglove.Odometry"
    assert Odometry.FromString(odometry.payload.to_bytes()).pose.position.x == 0.0
    aiding = got["companion/v1/nav/aiding"]
    assert str(aiding.encoding) == "application/protobuf;companion.AidingReport"
    parsed = navigation_pb2.AidingReport.FromString(aiding.payload.to_bytes())
    assert parsed.channel == navigation_pb2.AidingReport.BARO


def test_health_arrives_whole(publisher: ZenohPublisher, session: zenoh.Session) -> None:
    publisher.health(HEALTH)
    samples = advanced(session, "companion/v1/health")
    sample = samples.get(timeout=PATIENCE_S)
    assert str(sample.encoding) == "application/protobuf;companion.Health"
    assert decode_health(sample.payload.to_bytes()) == HEALTH


def advanced(session: zenoh.Session, key: str) -> queue.Queue[zenoh.Sample]:
    """Samples of a subscriber that asks for what it missed."""
    samples: queue.Queue[zenoh.Sample] = queue.Queue()
    held = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        samples.put,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    KEPT.append(held)
    return samples


KEPT: list[Any] = []
"""Advanced subscribers live as long as their objects."""


def event_texts(samples: queue.Queue[zenoh.Sample], n: int) -> list[str]:
    return [
        Log.FromString(samples.get(timeout=PATIENCE_S).payload.to_bytes()).message for _ in range(n)
    ]


def test_late_subscriber_gets_the_events_it_missed(endpoint: str) -> None:
    with closing(ZenohPublisher(Zenoh(listen=(endpoint,)), "v1")) as publisher:
        # Before the session is open, and after.
        publisher.event(Event(T0, "aligned", "one"))
        assert publisher.link.wait_open(PATIENCE_S)
        publisher.event(Event(T0 + NS, "heading-found", "two", "warning"))
        with client(endpoint) as session:
            assert event_texts(advanced(session, "companion/*/events"), 2) == ["one", "two"]


def test_latest_state_and_configuration_answer_queries(
    publisher: ZenohPublisher, session: zenoh.Session
) -> None:
    def ask(key: str) -> list[zenoh.Reply]:
        return list(session.get(key, timeout=PATIENCE_S))

    assert ask("companion/v1/nav/state") == []
    publisher.publish(outputs(solution(3)), 1)
    publisher.config("[vehicle]\nname = 'v1'\n")
    (reply,) = ask("companion/v1/nav/state")
    assert reply.ok is not None
    assert str(reply.ok.encoding) == "application/protobuf;companion.NavState"
    state = navigation_pb2.NavState.FromString(reply.ok.payload.to_bytes())
    assert state.t_ns == T0 + 2 * (NS // 50)
    (reply,) = ask("companion/*/config")
    assert reply.ok is not None
    assert str(reply.ok.encoding) == "application/protobuf;companion.Config"
    assert "v1" in run_pb2.Config.FromString(reply.ok.payload.to_bytes()).toml


def test_liveliness_shows_a_vehicle_appearing_and_vanishing(endpoint: str) -> None:
    seen: queue.Queue[tuple[str, zenoh.SampleKind]] = queue.Queue()
    with peer(endpoint) as session:
        session.liveliness().declare_subscriber(
            "companion/*/@alive", lambda s: seen.put((str(s.key_expr), s.kind)), history=True
        )
        with closing(ZenohPublisher(Zenoh(listen=(endpoint,)), "a/b c")) as publisher:
            assert publisher.link.wait_open(PATIENCE_S)
            assert seen.get(timeout=PATIENCE_S) == ("companion/a_b_c/@alive", zenoh.SampleKind.PUT)
        assert seen.get(timeout=PATIENCE_S) == ("companion/a_b_c/@alive", zenoh.SampleKind.DELETE)


def test_state_rate_is_a_limit(endpoint: str) -> None:
    settings = Zenoh(listen=(endpoint,), state_rate_hz=10.0)
    with closing(ZenohPublisher(settings, "v1")) as publisher:
        assert publisher.link.wait_open(PATIENCE_S)
        with peer(endpoint) as session:
            samples = listening(session, "companion/v1/nav/state")
            matched(publisher)
            for k in range(100):
                publisher.publish(outputs(solution(first=k)), 0)
            wait_for(lambda: samples.qsize() == 20, "2 s of 50 Hz at 10 Hz")


def test_taken_port_is_a_notice_and_tried_again(endpoint: str) -> None:
    port = int(endpoint.rsplit(":", 1)[1])
    with socket.socket() as other:
        other.bind(("127.0.0.1", port))
        other.listen()
        publisher = ZenohPublisher(Zenoh(listen=(endpoint,)), "v1")
        notices = []
        wait_for(lambda: notices.extend(publisher.notices()) or notices, "a notice")
        publisher.publish(outputs(solution()), 0)
    with closing(publisher):
        assert [n.kind for n in notices] == ["zenoh-down"]
        assert "already in use" in notices[0].text
        assert publisher.link.wait_open(PATIENCE_S)
        assert [n.kind for n in publisher.notices()] == ["zenoh-up"]


def test_dead_session_is_opened_again(publisher: ZenohPublisher, endpoint: str) -> None:
    session = publisher.link._session
    assert session is not None
    session.close()  # type: ignore[no-untyped-call]
    wait_for(
        lambda: publisher.publish(outputs(solution()), 0) or publisher.link.live is None, "noticed"
    )
    assert publisher.link.wait_open(PATIENCE_S)
    with peer(endpoint) as other:
        samples = advanced(other, "companion/v1/events")
        publisher.event(Event(T0, "reset", "after"))
        assert event_texts(samples, 1) == ["after"]


ROUTER = """
import json, sys, zenoh
c = zenoh.Config()
for k, v in {"mode": "router", "listen/endpoints": [sys.argv[1]],
             "scouting/multicast/enabled": False}.items():
    c.insert_json5(k, json.dumps(v))
with zenoh.open(c):
    print("up", flush=True)
    sys.stdin.read()
"""
READER_THAT_STOPS = """
import json, sys, zenoh
from companion.outputs.zenoh_settings import client_settings
s = zenoh.open(client_settings(sys.argv[1]))
sub = s.declare_subscriber("companion/**", lambda sample: None)
print("up", flush=True)
sys.stdin.read()
"""


def spawned(code: str, endpoint: str, root: Path) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", code, endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=root,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "up\n"
    return process


def longest_publish_s(publisher: ZenohPublisher, n: int) -> float:
    """Longest of ``n`` calls."""
    longest = 0.0
    burst = outputs(solution(20), report(Channel.BARO))
    for k in range(n):
        wall = time.monotonic()
        publisher.publish(burst, k)
        longest = max(longest, time.monotonic() - wall)
    return longest


def test_subscriber_that_never_reads_blocks_nothing(
    publisher: ZenohPublisher, endpoint: str, root: Path
) -> None:
    with spawned(READER_THAT_STOPS, endpoint, root) as reader:
        matched(publisher)
        reader.send_signal(signal.SIGSTOP)
        # 10 MB, more than sockets and queues hold.
        longest = longest_publish_s(publisher, 500)
        reader.kill()
    # A blocking put stood for seconds; scheduling on a loaded machine takes tens of milliseconds.
    assert longest < 1.0


def test_killed_router_blocks_nothing_and_what_was_missed_comes_after(
    endpoint: str, root: Path
) -> None:
    settings = Zenoh(listen=(), connect=(endpoint,))
    with closing(ZenohPublisher(settings, "v1")) as publisher:
        assert publisher.link.wait_open(PATIENCE_S)  # the router is absent
        router = spawned(ROUTER, endpoint, root)
        with client(endpoint) as session:
            samples = advanced(session, "companion/*/events")
            publisher.event(Event(T0, "a", "before"))
            assert event_texts(samples, 1) == ["before"]
            router.kill()
            router.wait()
            wait_for(lambda: not list(session.info.routers_zid()), "router gone")
            publisher.event(Event(T0, "b", "meanwhile"))
            assert longest_publish_s(publisher, 200) < 1.0
            router = spawned(ROUTER, endpoint, root)
            publisher.event(Event(T0, "c", "after"))
            assert event_texts(samples, 2) == ["meanwhile", "after"]
        router.kill()
        router.wait()
        assert publisher.notices() == []


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"listen": ("nonsense",)}, "zenoh.listen: 'nonsense' is no endpoint"),
        ({"config_file": "absent.json5"}, "absent.json5: No such file"),
        ({"config_file": "z.json5", "connect": ("tcp/1.2.3.4:1",)}, "zenoh.connect: is not used"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)):
        ZenohPublisher(Zenoh(**settings), "v1")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"mode": "peerx"}', "unknown variant `peerx`"),
        ('{"lissen": {}}', "unknown field `lissen`"),
        ("{bad", "line 1:1: expected"),
    ],
)
def test_bad_zenoh_file_is_refused_in_one_line(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "z.json5").write_text(text)
    with pytest.raises(ConfigError) as raised:
        ZenohPublisher(Zenoh(config_file=str(tmp_path / "z.json5")), "v1")
    assert words in str(raised.value)
    assert "z.json5" in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_file_decides_everything(tmp_path: Path, endpoint: str) -> None:
    file = {"mode": "peer", "listen": {"endpoints": [endpoint]},
            "scouting": {"multicast": {"enabled": False}}}  # fmt: skip
    (tmp_path / "z.json5").write_text(json.dumps(file))
    # The default of `listen` is not used.
    with closing(ZenohPublisher(Zenoh(config_file=str(tmp_path / "z.json5")), "v1")) as publisher:
        assert publisher.link.wait_open(PATIENCE_S)
        publisher.event(Event(T0, "a", "one"))
        with client(endpoint) as session:
            assert event_texts(advanced(session, "companion/*/events"), 1) == ["one"]


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_a_file_cannot_make_the_process_wait_for_a_router(
    mode: str, tmp_path: Path, endpoint: str
) -> None:
    file = {"mode": mode, "scouting": {"multicast": {"enabled": False}},
            "connect": {"endpoints": [endpoint], "timeout_ms": -1, "exit_on_failure": True},
            "listen": {"endpoints": []}}  # fmt: skip
    (tmp_path / "z.json5").write_text(json.dumps(file))
    publisher = ZenohPublisher(Zenoh(config_file=str(tmp_path / "z.json5")), "v1")
    publisher.publish(outputs(solution()), 1)
    publisher.close()
    publisher.link._thread.join(PATIENCE_S)
    assert not publisher.link._thread.is_alive()
