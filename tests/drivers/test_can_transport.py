"""Transports on what every machine has: a pseudo-terminal pair and python-can's virtual bus."""

from __future__ import annotations

import os
import select
import tty
from collections.abc import Iterator
from contextlib import suppress

import can
import numpy as np
import pytest

from companion.types import ConfigError, LinkLost
from drivers.can_imu import CanFrame, CanTransport, ReceivedFrame, make_decoder, open_can
from drivers.can_imu.dronecan import DroneCanEncoder
from drivers.can_imu.slcan import SlcanParser, slcan_line, slcan_lines
from tests.drivers.can_frames import T0, samples_of, taken

WAIT_S = 20.0
"""Generous: the machine may be busy. What is waited for comes in milliseconds."""

FRAMES = [
    CanFrame(0x7FF, False, b""),
    CanFrame(0x123, False, bytes(range(8))),
    CanFrame(0x1FFFFFFF, True, b"\x00\xff"),
]


class Adapter:
    """The far side of an slcan adapter."""

    def __init__(self) -> None:
        self.fd, device = os.openpty()
        tty.setraw(device)
        self.path = os.ttyname(device)
        # Held open, as the tty of a plugged-in adapter exists without a reader.
        self._device = device

    def heard(self, until: bytes) -> bytes:
        data = b""
        while until not in data:
            assert select.select([self.fd], [], [], WAIT_S)[0], f"only {data!r}"
            data += os.read(self.fd, 4096)
        return data

    def unplug(self) -> None:
        for fd in (self.fd, self._device):
            with suppress(OSError):
                os.close(fd)


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    one = Adapter()
    yield one
    one.unplug()


def received(bus: CanTransport, count: int) -> list[ReceivedFrame]:
    """At least ``count`` frames, waited for as the runtime does."""
    frames: list[ReceivedFrame] = []
    while len(frames) < count:
        assert select.select([bus.fileno()], [], [], WAIT_S)[0], f"only {len(frames)} frames"
        frames += bus.receive()
    return frames


def test_slcan_opens_the_channel_and_receives(adapter):
    bus = open_can("slcan", adapter.path, 500_000)
    assert adapter.heard(b"O\r") == b"C\rS6\rO\r"
    assert bus.receive() == []
    lines = slcan_lines(FRAMES)
    os.write(adapter.fd, b"\r\a" + lines[:9])  # answers to the commands, and half a frame
    os.write(adapter.fd, lines[9:])
    assert received(bus, 3) == [(*frame, None) for frame in FRAMES]
    assert bus.malformed == 0
    bus.close()
    assert adapter.heard(b"C\r") == b"C\r"
    bus.close()


def test_what_an_earlier_run_left_unread_is_dropped(adapter):
    """It would be taken for what comes now, with a gap behind it."""
    first = open_can("slcan", adapter.path)
    adapter.heard(b"O\r")
    os.write(adapter.fd, slcan_lines(FRAMES))
    received(first, 3)
    os.write(adapter.fd, slcan_lines(FRAMES) * 100)
    first.close()
    second = open_can("slcan", adapter.path)
    os.write(adapter.fd, slcan_lines(FRAMES[:1]))
    assert received(second, 1) == [(*FRAMES[0], None)]
    second.close()


def test_slcan_sends(adapter):
    bus = open_can("slcan", adapter.path, 1_000_000, {"listen_only": False})
    adapter.heard(b"O\r")
    bus.send(FRAMES)
    assert adapter.heard(b"00FF\r") == b"t7FF0\rt12380001020304050607\rT1FFFFFFF200FF\r"
    bus.close()


def test_slcan_carries_an_imu(adapter):
    bus = open_can("slcan", adapter.path)
    sent = samples_of(100, interval_s=0.005)
    os.write(adapter.fd, slcan_lines(DroneCanEncoder().encode(sent)[:350]))
    decoder = make_decoder("imu", "dronecan")
    for i, (can_id, extended, data, _) in enumerate(received(bus, 350)):
        decoder.feed(i, T0, can_id, extended, data)
    np.testing.assert_allclose(taken(decoder).gyro_b, sent.gyro_b[:50], rtol=2e-7)
    bus.close()


def test_an_adapter_that_vanishes_is_a_lost_link(adapter):
    bus = open_can("slcan", adapter.path)
    adapter.unplug()
    assert select.select([bus.fileno()], [], [], WAIT_S)[0], "the loop must be woken"
    with pytest.raises(LinkLost, match="slcan:/dev/"):
        bus.receive()
    with pytest.raises(LinkLost):
        bus.send(FRAMES)
    bus.close()


def test_a_flood_that_nobody_reads_drops_whole_frames_and_does_not_block(adapter):
    bus = open_can("slcan", adapter.path)
    for _ in range(200):
        bus.send(FRAMES * 50)
    assert bus.dropped > 0
    heard = SlcanParser()
    adapter.heard(b"O\r")
    os.set_blocking(adapter.fd, False)
    for _ in range(50):
        with suppress(BlockingIOError):
            while True:
                heard.feed(os.read(adapter.fd, 4096))
        bus.send(FRAMES)
    bus.close()
    assert heard.malformed == 0


def test_adapters_that_are_not_there():
    with pytest.raises(LinkLost, match=r"slcan:/dev/nothing: No such file"):
        open_can("slcan", "/dev/nothing")
    with pytest.raises(LinkLost, match="socketcan:can9"):
        open_can("socketcan", "can9")


@pytest.mark.parametrize(
    ("interface", "options", "match"),
    [
        ("no-such-interface", {}, "no-such-interface"),
        ("slcan", {"ttybaud": 3}, "ttybaud"),
        ("slcan", {"tty_baudrate": 12345}, "12345"),
    ],
)
def test_what_cannot_be_configured(interface, options, match):
    with pytest.raises(ConfigError, match=match):
        open_can(interface, "x", 1_000_000, options)


def test_slcan_bit_rates():
    with pytest.raises(ConfigError, match="bitrate 123"):
        open_can("slcan", "/dev/null", 123)


def test_an_interface_without_a_descriptor_gets_a_thread():
    bus = open_can("virtual", "companion-test")
    other = can.Bus("companion-test", "virtual", ignore_config=True)
    try:
        for can_id, extended, data in FRAMES:
            other.send(can.Message(arbitration_id=can_id, is_extended_id=extended, data=data))
        other.send(can.Message(arbitration_id=1, is_remote_frame=True))
        other.send(can.Message(is_error_frame=True))
        other.send(can.Message(arbitration_id=2, is_extended_id=False, data=b"last"))
        frames = received(bus, 4)
        assert frames[:3] == [(*frame, None) for frame in FRAMES]
        assert frames[3].data == b"last"
        assert bus.malformed == 1
        bus.send(FRAMES)
        heard = [other.recv(timeout=WAIT_S) for _ in FRAMES]
        assert [bytes(m.data) for m in heard if m is not None] == [f.data for f in FRAMES]
    finally:
        other.shutdown()
        bus.close()
        bus.close()


def test_a_bus_that_fails_under_the_thread_is_a_lost_link(monkeypatch):
    bus = open_can("virtual", "companion-test-2")

    def broken(*_: object, **__: object) -> None:
        raise can.CanOperationError("the device is gone")

    monkeypatch.setattr(bus._bus, "recv", broken)  # type: ignore[attr-defined]
    assert select.select([bus.fileno()], [], [], WAIT_S)[0]
    with pytest.raises(LinkLost, match="virtual:companion-test-2: the device is gone"):
        bus.receive()
    bus.close()


@pytest.mark.parametrize(
    "line",
    [
        b"T0803EB3",  # cut
        b"T0803EB32900112233445566778899",  # nine bytes
        b"T0803EB328B80700000000",  # fewer than it says
        b"TFFFFFFFF0",  # 32 bits
        b"tFFF0",  # 12 bits
        b"t12G0",
        b"t1232zz00",
        b"t123x",
        b"\xff\xfe",
        b"t1238" + b"00" * 40,
        b"x" * 500,
    ],
)
def test_malformed_lines_are_counted_and_dropped(line):
    parser = SlcanParser()
    good = slcan_line(*FRAMES[1])
    assert parser.feed(good + line + b"\r" + good) == [FRAMES[1]] * 2
    assert parser.malformed == 1


def test_an_endless_line_does_not_grow():
    parser = SlcanParser()
    for _ in range(1000):
        assert parser.feed(b"T" * 100) == []
    assert parser.malformed == 1000
    assert parser.feed(b"\r" + slcan_line(*FRAMES[1])) == [FRAMES[1]]


def test_answers_remote_frames_and_stamps_are_no_errors():
    parser = SlcanParser()
    data = b"\r\az\rZ\rV1013\rNA123\rF00\rr1230\rR000001230\r" + b"t1231FFABCD\r"
    assert parser.feed(data) == [CanFrame(0x123, False, b"\xff")]
    assert parser.malformed == 0


def test_pieces_of_any_size_give_the_same_frames():
    rng = np.random.default_rng(5)
    frames = [
        CanFrame(int(rng.integers(0, 1 << 29)), True, rng.bytes(int(rng.integers(0, 9))))
        for _ in range(300)
    ]
    data = slcan_lines(frames)
    parser = SlcanParser()
    got, at = [], 0
    while at < len(data):
        size = int(rng.integers(1, 60))
        got += parser.feed(data[at : at + size])
        at += size
    assert got == frames
