"""Signatures against pymavlink's as oracle, replay protection, and a session with a key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import NS, ConfigError, ImuSamples
from drivers.mavlink.packer import Packer
from drivers.mavlink.session import MavlinkSession, SessionSettings
from drivers.mavlink.signing import Refusal, Signing, read_key

from . import autopilot as sim

KEY = bytes(range(32))
OTHER_KEY = bytes(32)
EPOCH_NS = 1_420_070_400 * NS
"""2015-01-01: signing counts from here in steps of 10 µs."""


def oracle(key: bytes = KEY, *, ticks: int = 0, link_id: int = 0) -> Any:
    """pymavlink's own end of a signed link."""
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    link.signing.secret_key = key
    link.signing.link_id = link_id
    link.signing.timestamp = ticks
    link.signing.sign_outgoing = True
    link.signing.allow_unsigned_callback = None
    return link


def attitude(link: Any, ms: int = 1000) -> bytes:
    frame = bytes(mavlink.MAVLink_attitude_message(ms, 0.1, 0.2, 0.3, 0, 0, 0).pack(link))
    link.seq = (link.seq + 1) % 256
    return frame


def signing(key: bytes = KEY) -> Signing:
    made = Signing(key)
    made.set_time(sim.START_NS)
    return made


def now_ticks() -> int:
    return (sim.START_NS - EPOCH_NS) // 10_000


def test_pymavlink_verifies_what_we_sign() -> None:
    packer = Packer(1, 191, signing())
    theirs = oracle(ticks=now_ticks())
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    for _ in range(3):
        message = theirs.parse_char(packer.pack(beat))
        assert message.get_type() == "HEARTBEAT"
        assert message.get_signed()
        assert message.get_srcComponent() == 191
    with pytest.raises(mavlink.MAVError, match="signature"):
        oracle(OTHER_KEY, ticks=now_ticks()).parse_char(packer.pack(beat))


def test_our_timestamp_advances_with_every_frame_and_with_time() -> None:
    ours = signing()
    packer = Packer(1, 191, ours)
    beat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    ticks = [int.from_bytes(packer.pack(beat)[-12:-6], "little") for _ in range(5)]
    assert ticks == list(range(now_ticks() + 1, now_ticks() + 6))
    ours.set_time(sim.START_NS + NS)
    later = int.from_bytes(packer.pack(beat)[-12:-6], "little")
    assert later == now_ticks() + 100_001
    ours.set_time(sim.START_NS - 3600 * NS)
    assert int.from_bytes(packer.pack(beat)[-12:-6], "little") == later + 1


def test_we_verify_what_pymavlink_signs() -> None:
    ours, theirs = signing(), oracle(ticks=now_ticks())
    for _ in range(4):
        assert ours.verify(attitude(theirs), signed=True) is None
    assert ours.counters.accepted == 4


def test_refusals_have_names_and_are_counted() -> None:
    ours, theirs = signing(), oracle(ticks=now_ticks())
    first, second = attitude(theirs), attitude(theirs)
    assert ours.verify(first, signed=True) is None
    assert ours.verify(first, signed=True) is Refusal.REPLAYED
    assert ours.verify(second, signed=True) is None
    assert ours.verify(first, signed=True) is Refusal.REPLAYED
    flipped = bytearray(attitude(theirs))
    flipped[12] ^= 1
    assert ours.verify(bytes(flipped), signed=True) is Refusal.BAD_SIGNATURE
    assert ours.verify(attitude(oracle(OTHER_KEY)), signed=True) is Refusal.BAD_SIGNATURE
    assert ours.verify(b"anything", signed=False) is Refusal.UNSIGNED
    counters = ours.counters
    assert (counters.accepted, counters.replayed) == (2, 2)
    assert (counters.bad_signature, counters.unsigned) == (2, 1)


def test_streams_are_kept_apart_and_a_stale_one_may_not_begin() -> None:
    ours = signing()
    assert ours.verify(attitude(oracle(ticks=now_ticks() + 50)), signed=True) is None
    # Another link of the same sender has its own time, up to a minute behind ours.
    behind = oracle(ticks=now_ticks() - 5_900_000, link_id=3)
    assert ours.verify(attitude(behind), signed=True) is None
    stale = oracle(ticks=now_ticks() - 6_100_000, link_id=4)
    assert ours.verify(attitude(stale), signed=True) is Refusal.REPLAYED


def test_a_companion_without_time_learns_it_from_the_autopilot() -> None:
    ours = Signing(KEY)
    ours.set_time(0)  # 1970: no clock of its own
    assert ours.verify(attitude(oracle(ticks=now_ticks())), signed=True) is None
    frame = Packer(1, 191, ours).pack(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3))
    assert int.from_bytes(frame[-12:-6], "little") > now_ticks()


@pytest.mark.parametrize("text", [KEY, KEY.hex().encode(), KEY.hex().upper().encode() + b"\n"])
def test_key_files_raw_and_hexadecimal(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "signing.key"
    path.write_bytes(text)
    assert read_key(path) == KEY


@pytest.mark.parametrize("text", [b"", b"short", KEY + b"x", b"zz" * 32])
def test_bad_key_files_are_told_without_their_content(text: bytes, tmp_path: Path) -> None:
    path = tmp_path / "signing.key"
    path.write_bytes(text)
    with pytest.raises(ConfigError, match="must hold 32 bytes") as caught:
        read_key(path)
    assert not text or text.decode("latin1") not in str(caught.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_key(tmp_path / "absent")


def signed_flight() -> sim.Air:
    settings = SessionSettings(signing_key=KEY, imu_rate_hz=20.0)
    flight = sim.Air(MavlinkSession(settings), sim.Autopilot(signing=signing()))
    flight.run(5.0)
    return flight


def test_a_signed_session_flies_and_refuses_strangers() -> None:
    flight = signed_flight()
    assert len(flight.of("HIGHRES_IMU", ImuSamples)) > 40
    counters = flight.session.status(flight.now_ns).signing
    assert counters is not None
    assert counters.unsigned == counters.bad_signature == counters.replayed == 0
    # A stranger in the autopilot's name: unsigned, then with another key.
    imu = flight.autopilot.message("HIGHRES_IMU", flight.autopilot.boot_ns(flight.now_ns))
    for stranger in (Packer(1, 1), Packer(1, 1, signing(OTHER_KEY))):
        flight.session.feed(10**6, flight.now_ns, stranger.pack(imu))
    assert not flight.session.take()
    assert (counters.unsigned, counters.bad_signature) == (1, 1)


def test_a_recorded_frame_sent_again_is_refused() -> None:
    flight = signed_flight()
    beat = flight.autopilot.message("HIGHRES_IMU", flight.autopilot.boot_ns(flight.now_ns))
    flight.autopilot.packer._signing.set_time(flight.now_ns)  # type: ignore[union-attr]
    recorded = flight.autopilot.packer.pack(beat)
    flight.session.feed(10**6, flight.now_ns, recorded)
    assert flight.session.take()
    for _ in range(3):
        flight.session.feed(10**6, flight.now_ns, recorded)
    assert not flight.session.take()
    counters = flight.session.status(flight.now_ns).signing
    assert counters is not None
    assert counters.replayed == 3


def test_what_we_send_is_signed() -> None:
    flight = signed_flight()
    flight.session.tick(flight.now_ns + NS)
    sent = flight.session.outgoing()
    theirs = oracle(ticks=now_ticks())
    assert sent
    assert all(theirs.parse_char(frame).get_signed() for frame in sent)
