"""The ground station's own link, over UDP on this machine."""

from __future__ import annotations

import select
import socket
from contextlib import closing

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.outputs import mavlink_ground as ground
from companion.outputs.ground_link import GroundLink
from companion.types import NS, Mode
from drivers.mavlink.link import ReopeningLink
from tests.outputs.zenoh_help import PATIENCE_S, T0, free_port


def received(station: socket.socket) -> bytes:
    assert select.select([station], [], [], PATIENCE_S)[0]
    return station.recv(1000)


def test_messages_leave_as_component_191_of_the_vehicle() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station:
        station.bind(("127.0.0.1", 0))
        text = f"udpout:127.0.0.1:{station.getsockname()[1]}"
        with closing(GroundLink(ReopeningLink(text, 0), 191, None)) as link:
            link.send(ground.heartbeat(Mode.NAVIGATING))
            assert (link.sent, link.dropped) == (0, 1)
            link.tick(T0, 7)
            link.send(ground.heartbeat(Mode.NAVIGATING))
            (beat,) = mavlink.MAVLink(None).parse_buffer(received(station))
            assert (beat.get_srcSystem(), beat.get_srcComponent()) == (7, 191)
            assert beat.system_status == mavlink.MAV_STATE_ACTIVE
            assert [n.kind for n in link.notices()] == ["ground-up"]


def test_listening_endpoint_answers_who_spoke_and_signs_with_a_key() -> None:
    key = bytes(range(32))
    port = free_port()
    with (
        closing(GroundLink(ReopeningLink(f"udpin:127.0.0.1:{port}", 0), 191, key)) as link,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        link.tick(T0, 1)
        link.send(ground.heartbeat(Mode.ALIGNING))
        assert link.dropped == 1  # nobody is there yet
        station.sendto(b"anything", ("127.0.0.1", port))
        link.tick(T0 + NS, 1)
        link.send(ground.heartbeat(Mode.ALIGNING))
        receiver = mavlink.MAVLink(None)
        receiver.signing.secret_key = key
        (beat,) = receiver.parse_buffer(received(station))
        assert beat.get_signed()


def test_taken_port_is_a_notice() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        text = f"udpin:127.0.0.1:{other.getsockname()[1]}"
        with closing(GroundLink(ReopeningLink(text, 0), 191, None)) as link:
            link.tick(T0, 1)
            (notice,) = link.notices()
            assert notice.kind == "ground-down"
            assert "in use" in notice.text
