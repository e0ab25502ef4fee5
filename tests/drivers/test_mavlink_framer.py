"""The MAVLink codec against pymavlink's own packers and parser."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from drivers.mavlink.columns import decode
from drivers.mavlink.dialect import crc_table, layout, message_id, message_name
from drivers.mavlink.framer import MAX_FRAME, StreamFramer, index_frames


def frames(count: int = 40) -> list[bytes]:
    """Messages of both versions, some signed, with payloads that end in zeros and do not."""
    link = mavlink.MAVLink(None, srcSystem=3, srcComponent=4)
    out = []
    for i in range(count):
        link.seq = i
        link.signing.sign_outgoing = i % 4 == 3
        link.signing.secret_key = bytes(32)
        message = (
            mavlink.MAVLink_attitude_message(1000 + i, 0.1 * i, -0.2, 0.3, 0, 0, 0)
            if i % 2
            else mavlink.MAVLink_statustext_message(6, b"hello", 0, 0)
        )
        out.append(bytes(message.pack(link, force_mavlink1=i % 4 == 1)))
    return out


def as_array(data: bytes) -> np.ndarray[tuple[int], np.dtype[np.uint8]]:
    return np.frombuffer(data, np.uint8)


@pytest.mark.parametrize("msgid", sorted(mavlink.mavlink_map))
def test_layout_has_the_packers_size(msgid: int) -> None:
    cls = mavlink.mavlink_map[msgid]
    assert layout(msgid).itemsize == cls.unpacker.size
    assert crc_table()[msgid, 0] == cls.crc_extra
    assert message_id(message_name(msgid)) == msgid


def test_all_frames_found_with_their_headers() -> None:
    sent = frames()
    index = index_frames(as_array(b"".join(sent)))
    assert len(index) == len(sent)
    assert index.bad_bytes == 0
    assert index.start.tolist() == np.cumsum([0, *map(len, sent[:-1])]).tolist()
    assert index.version.tolist() == [1 if i % 4 == 1 else 2 for i in range(len(sent))]
    assert index.signed.tolist() == [i % 4 == 3 for i in range(len(sent))]
    assert index.seq.tolist() == list(range(len(sent)))
    assert set(index.system) == {3}
    assert set(index.component) == {4}
    assert index.checked.all()


def test_columns_have_what_was_packed() -> None:
    buf = as_array(b"".join(frames()))
    index = index_frames(buf)
    rows = np.flatnonzero(index.msgid == message_id("ATTITUDE"))
    table = decode(buf, index, message_id("ATTITUDE"), rows)
    assert table["time_boot_ms"].tolist() == [1000 + i for i in range(1, 40, 2)]
    np.testing.assert_array_equal(table["roll"], np.float32([0.1 * i for i in range(1, 40, 2)]))
    text = np.flatnonzero(index.msgid == message_id("STATUSTEXT"))
    assert decode(buf, index, message_id("STATUSTEXT"), text)["text"][0] == b"hello"


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=60), st.integers(0, 39))
def test_noise_between_frames_costs_no_frame(noise: bytes, where: int) -> None:
    sent = frames()
    data = b"".join(sent[:where]) + noise + b"".join(sent[where:])
    index = index_frames(as_array(data))
    # Noise cannot make a frame that passes its CRC but once in 65536 tries.
    assert len(index) == len(sent)
    assert index.bad_bytes == len(noise)


def test_a_broken_frame_is_counted_and_its_neighbours_survive() -> None:
    sent = frames()
    broken = bytearray(sent[10])
    broken[-4] ^= 0x10
    index = index_frames(as_array(b"".join([*sent[:10], bytes(broken), *sent[11:]])))
    assert len(index) == len(sent) - 1
    assert index.bad_crc == 1
    assert index.bad_bytes == len(broken)


def test_unknown_messages_are_kept_unchecked_in_step_only() -> None:
    sent = frames()
    unknown = bytearray(sent[11])
    unknown[7:10] = (0xFF, 0xFF, 0x7F)
    index = index_frames(as_array(b"".join([*sent[:10], bytes(unknown), *sent[10:]])))
    assert len(index) == len(sent) + 1
    assert (~index.checked).sum() == 1
    out_of_step = index_frames(as_array(b"".join([*sent[:10], b"\0", bytes(unknown), *sent[10:]])))
    assert len(out_of_step) == len(sent)
    assert out_of_step.bad_bytes == 1 + len(unknown)


@pytest.mark.parametrize("piece", [1, 7, 64, 1000])
def test_pieces_give_the_same_frames_as_the_whole(piece: int) -> None:
    data = b"junk" + b"".join(frames())
    whole = index_frames(as_array(data))
    framer = StreamFramer()
    seq: list[int] = []
    for at in range(0, len(data), piece):
        _, index = framer.feed(data[at : at + piece])
        seq += index.seq.tolist()
    assert seq == whole.seq.tolist()
    assert framer.bad_bytes == whole.bad_bytes == 4


def test_noise_on_a_stream_is_not_kept() -> None:
    framer = StreamFramer()
    rng = np.random.default_rng(3)
    total = 0
    for _ in range(200):
        piece = rng.bytes(500)
        total += len(piece)
        framer.feed(piece)
        # What waits is at most the head of one frame and what it claims to hold.
        assert total - framer.bad_bytes <= MAX_FRAME
