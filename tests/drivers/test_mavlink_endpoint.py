"""Endpoints over real sockets and pseudo-terminals on this machine, and their reopening."""

from __future__ import annotations

import os
import pty
import select
import socket
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.types import NS, ConfigError, LinkLost
from drivers.backoff import Backoff
from drivers.mavlink.endpoint import Endpoint, open_endpoint
from drivers.mavlink.link import ReopeningLink

WAIT_S = 20.0
"""For a loaded machine; what is awaited comes at once."""


def received(endpoint: Endpoint) -> list[bytes]:
    """What comes next; empty if nothing does in a long time."""
    select.select([endpoint], [], [], WAIT_S)
    return endpoint.read()


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(WAIT_S)
        yield server


def udp_socket() -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(WAIT_S)
    return made


def test_udpin_hears_and_answers() -> None:
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    address = endpoint.address  # type: ignore[attr-defined]
    assert endpoint.datagrams
    assert endpoint.read() == []
    assert not endpoint.write(b"nobody is there yet")
    with udp_socket() as peer:
        peer.sendto(b"one", address)
        assert received(endpoint) == [b"one"]
        assert endpoint.write(b"answer")
        assert peer.recv(100) == b"answer"
    endpoint.close()
    endpoint.close()


def test_udpin_answers_the_last_few_it_heard() -> None:
    endpoint = open_endpoint("udpin:127.0.0.1:0")
    address = endpoint.address  # type: ignore[attr-defined]
    autopilot = udp_socket()
    strangers = [udp_socket() for _ in range(20)]
    for stranger in strangers:
        autopilot.sendto(b"steady", address)
        stranger.sendto(b"noise", address)
        while b"noise" not in received(endpoint):
            pass
    autopilot.sendto(b"steady", address)
    received(endpoint)
    assert endpoint.write(b"for you")
    assert autopilot.recv(100) == b"for you"
    for made in (autopilot, *strangers):
        made.close()
    endpoint.close()


def test_udpout_survives_a_peer_that_is_not_there() -> None:
    with udp_socket() as peer:
        port = peer.getsockname()[1]
    endpoint = open_endpoint(f"udpout:127.0.0.1:{port}")
    # The first is refused by the other side's kernel, which shows at a later call.
    for _ in range(5):
        endpoint.write(b"hello")
        assert endpoint.read() == []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", port))
        peer.settimeout(WAIT_S)
        while not endpoint.write(b"hello"):
            pass
        data, address = peer.recvfrom(100)
        assert data == b"hello"
        peer.sendto(b"and back", address)
        assert received(endpoint) == [b"and back"]
    endpoint.close()


def test_tcp_both_ways_and_closed_by_the_other_side(listener: socket.socket) -> None:
    endpoint = open_endpoint(f"tcp:127.0.0.1:{listener.getsockname()[1]}")
    assert not endpoint.datagrams
    peer, _ = listener.accept()
    peer.sendall(b"hello")
    assert received(endpoint) == [b"hello"]
    assert endpoint.write(b"answer")
    peer.settimeout(WAIT_S)
    assert peer.recv(100) == b"answer"
    peer.close()
    with pytest.raises(LinkLost, match="closed by the other side"):
        received(endpoint)
    endpoint.close()


def test_tcp_that_is_refused_is_lost_at_the_first_read(listener: socket.socket) -> None:
    port = listener.getsockname()[1]
    listener.close()
    # The kernel may know at once, or a moment later.
    with pytest.raises(LinkLost, match="refused"):
        received(open_endpoint(f"tcp:127.0.0.1:{port}"))


def test_a_full_stream_drops_whole_frames_only(listener: socket.socket) -> None:
    endpoint = open_endpoint(f"tcp:127.0.0.1:{listener.getsockname()[1]}")
    peer, _ = listener.accept()
    select.select([], [endpoint], [], WAIT_S)
    frame = bytes(range(256)) * 16
    taken = 0
    while endpoint.write(frame):
        taken += 1
    assert taken > 0
    peer.setblocking(False)
    got = b""
    for _ in range(200_000):
        select.select([peer], [], [], 0.01)
        try:
            got += peer.recv(1 << 16)
        except BlockingIOError:
            # Room again: what was left over goes out before a new frame does.
            if endpoint.write(frame):
                taken += 1
                break
    peer.settimeout(WAIT_S)
    while len(got) < taken * len(frame):
        got += peer.recv(1 << 16)
    assert got == frame * taken
    peer.close()
    endpoint.close()


def test_serial_device_both_ways_and_gone() -> None:
    master, slave = pty.openpty()
    tty.setraw(master)
    endpoint = open_endpoint(os.ttyname(slave), 921_600)
    os.close(slave)
    assert endpoint.read() == []
    every_byte = bytes(range(256))
    os.write(master, every_byte)
    got = b""
    while len(got) < 256:
        got += b"".join(received(endpoint))
    assert got == every_byte
    assert endpoint.write(every_byte)
    assert os.read(master, 1000) == every_byte
    os.close(master)
    with pytest.raises(LinkLost):
        received(endpoint)
    endpoint.close()
    endpoint.close()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "not one of"),
        ("COM3", "not one of"),
        ("udpin:14550", "a host and a port"),
        ("tcp:localhost:port", "a host and a port"),
        ("udpout:127.0.0.1:99999", "a host and a port"),
        ("/dev/ttyACM0,fast", "not one of"),
        ("/dev/null,12345", "no serial speed of 12345 baud; near: 9600"),
    ],
)
def test_what_names_no_endpoint_is_a_configuration_error(text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        open_endpoint(text)


@pytest.mark.parametrize("text", ["/dev/null", "/no/such/device", "udpin:192.0.2.1:14550"])
def test_what_cannot_be_opened_now_is_a_lost_link(text: str) -> None:
    with pytest.raises(LinkLost):
        open_endpoint(text)


def test_backoff_doubles_up_to_its_limit_and_starts_over() -> None:
    backoff = Backoff(NS, 4 * NS)
    now, waits = 0, []
    assert backoff.due(now)
    for _ in range(4):
        backoff.failed(now)
        wait = next(s for s in range(100) if backoff.due(now + s * NS))
        waits.append(wait)
        now += wait * NS
    assert waits == [1, 2, 4, 4]
    backoff.worked()
    backoff.failed(now)
    assert backoff.due(now + NS)


def polled(link: ReopeningLink, now_ns: int) -> int:
    """Poll once a tenth of a second until it opens; the time it did."""
    for step in range(1000):
        if link.poll(now_ns + step * NS // 10):
            return now_ns + step * NS // 10
    raise AssertionError("never opened")


def test_tcp_server_killed_and_restarted() -> None:
    attempts = []

    def opener(text: str, baud: int) -> Endpoint:
        attempts.append(text)
        return open_endpoint(text, baud)

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        link = ReopeningLink(f"tcp:127.0.0.1:{port}", 0, opener)
        now = polled(link, 0)
        peer, _ = server.accept()
        peer.sendall(b"first")
        select.select([link.fileno()], [], [], WAIT_S)
        assert link.read(now) == [b"first"]
        # The dying side closes first: the address is then in use for nobody.
        link_number = link.fileno()
        assert link_number is not None
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        peer.close()
    select.select([link_number], [], [], WAIT_S)
    assert link.read(now) == []
    assert link.fileno() is None
    assert not link.write(b"nobody")
    # Nobody listens: attempts are refused, further and further apart.
    attempts.clear()
    for step in range(100):
        link.poll(now + step * NS // 10)
        link.read(now + step * NS // 10)
    assert 3 <= len(attempts) <= 5
    with socket.create_server(("127.0.0.1", port)) as server:
        server.settimeout(WAIT_S)
        now = polled(link, now + 20 * NS)
        peer, _ = server.accept()
        peer.sendall(b"second")
        number = link.fileno()
        assert number is not None
        select.select([number], [], [], WAIT_S)
        assert link.read(now) == [b"second"]
        peer.close()
    states = [state for state, _ in link.changes()]
    assert states == ["up", "lost", "retrying", "up"]
    assert link.reopened >= 1
    link.close()


def test_serial_device_unplugged_and_back(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    link = ReopeningLink(str(device), 115_200)
    assert not link.poll(0)
    assert link.changes()[0][0] == "retrying"
    now = 0
    for data in (b"before", b"after"):
        master, slave = pty.openpty()
        tty.setraw(master)
        device.symlink_to(os.ttyname(slave))
        now = polled(link, now)
        os.close(slave)
        os.write(master, data)
        number = link.fileno()
        assert number is not None
        select.select([number], [], [], WAIT_S)
        assert link.read(now) == [data]
        device.unlink()
        os.close(master)
        select.select([number], [], [], WAIT_S)
        assert link.read(now) == []
        assert link.fileno() is None
        assert not link.poll(now)
        now += 10 * NS
    assert [state for state, _ in link.changes()] == ["up", "lost", "up", "lost"]
    assert link.reopened == 1


def test_a_text_that_names_no_endpoint_is_told_and_not_retried() -> None:
    with pytest.raises(ConfigError):
        ReopeningLink("udpin:nowhere", 0).poll(0)
