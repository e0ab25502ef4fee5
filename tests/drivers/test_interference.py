"""What receivers say of jamming and spoofing, and drivers of clipping, on the samples."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from companion.types import NS, ImuSamples
from drivers.mavlink.clipping import COUNTED, HOLDS_NS, ClipCounters
from drivers.ublox.decoder import UbxDecoder
from drivers.ublox.framer import pack
from drivers.ublox.interference import MON_HW, MON_RF, NAV_STATUS, SEC_SIG, Interference
from drivers.ublox.messages import NAV_PVT
from replay.clipping import with_counter


def hardware(state: int, indicator: int) -> bytes:
    payload = bytearray(60)
    payload[22], payload[45] = state << 2 | 1, indicator
    return bytes(payload)


def radio(*bands: tuple[int, int]) -> bytes:
    """One block a band: state, indicator."""
    blocks = [
        struct.pack("<BBBBI4xHHBbBbB3x", i, state, 2, 1, 0, 90, 4000, indicator, 0, 128, 0, 128)
        for i, (state, indicator) in enumerate(bands)
    ]
    return bytes([0, len(bands), 0, 0]) + b"".join(blocks)


def status(spoofing: int) -> bytes:
    return struct.pack("<IBBBBII", 0, 3, 0xDD, 0, spoofing << 3 | 1, 0, 0)


def signals(jamming: int, spoofing: int, on: int = 1) -> bytes:
    return bytes([1, 0, 0, 0, jamming << 1 | on, 0, 0, 0, spoofing << 1 | on, 0, 0, 0])


@pytest.mark.parametrize(
    ("kind", "payload", "share"),
    [
        (MON_HW, hardware(0, 0), 0.0),
        (MON_HW, hardware(1, 51), 0.2),
        (MON_HW, hardware(3, 51), 1.0),
        (MON_RF, radio((1, 0), (2, 26)), 0.5),
        (MON_RF, radio((1, 0), (0, 204)), 0.8),
        (NAV_STATUS, status(0), math.nan),
        (NAV_STATUS, status(1), 0.0),
        (NAV_STATUS, status(2), 0.5),
        (NAV_STATUS, status(3), 1.0),
        (SEC_SIG, signals(1, 1), 0.0),
        (SEC_SIG, signals(2, 3), 1.0),
        (SEC_SIG, signals(3, 3, on=0), math.nan),
        (SEC_SIG, bytes([2, 2 << 1 | 1, 0, 0]), 0.5),
    ],
)
def test_states_and_indicators_as_the_interface_descriptions_have_them(
    kind: int, payload: bytes, share: float
) -> None:
    said = Interference()
    assert said.take(kind, payload)
    np.testing.assert_equal(said.share, share)


def test_the_worst_of_all_messages_goes_with_the_next_fix() -> None:
    fix = pack(NAV_PVT, _pvt())
    decoder = UbxDecoder()
    (before,) = decoder.feed(fix)
    assert np.isnan(before.interference).all()
    (jammed,) = decoder.feed(pack(MON_HW, hardware(1, 51)) + pack(NAV_STATUS, status(2)) + fix)
    assert jammed.interference.tolist() == [0.5]
    (after,) = decoder.feed(pack(NAV_STATUS, status(1)) + fix)
    assert after.interference.tolist() == [0.2]


@pytest.mark.parametrize("kind", [MON_HW, MON_RF, NAV_STATUS, SEC_SIG])
@pytest.mark.parametrize("size", [0, 1, 3, 11, 59, 300])
def test_wrong_lengths_are_counted_and_say_nothing(kind: int, size: int) -> None:
    decoder = UbxDecoder()
    assert decoder.feed(pack(kind, b"\x01" * size)) == []
    assert decoder.counters.malformed == (not (kind == SEC_SIG and size == 12))
    (fix,) = decoder.feed(pack(NAV_PVT, _pvt()))
    assert np.isnan(fix.interference).all()


def _pvt() -> bytes:
    """A fix of 2024-05-01 12:00:00 at 47.4°, 8.5°."""
    payload = bytearray(92)
    struct.pack_into("<IHBBBBBB", payload, 0, 302418000, 2024, 5, 1, 12, 0, 0, 0x37)
    payload[20], payload[21], payload[23] = 3, 1, 12
    struct.pack_into("<iiiiII", payload, 24, 85000000, 474000000, 500000, 450000, 1000, 2000)
    return bytes(payload)


def _imu(t: np.ndarray) -> ImuSamples:
    n = len(t)
    return ImuSamples("IMU", t, t, np.arange(n) * 10, np.zeros((n, 3)), np.zeros((n, 3)),
                      np.full(n, np.nan))  # fmt: skip


def test_a_rise_of_the_counter_marks_what_comes_until_its_next_message() -> None:
    """Live and from a log alike; a rise speaks for two seconds at most."""
    t = np.arange(600) * NS // 100
    seq = np.array([95, 1095, 2095, 3095])
    rx, count = t[seq // 10 + 1] - 1, np.array([7, 7, 9, 9])
    imu = with_counter(_imu(t), seq, rx, count)
    marked = np.flatnonzero(imu.clipped)
    assert marked[0] == 210
    assert marked[-1] == 309
    assert set(imu.clipped[marked].tolist()) == {COUNTED}
    live, at = ClipCounters(), 0
    for i in range(len(t)):
        while at < len(seq) and seq[at] < 10 * i:
            live.take(np.array([[count[at], 0, 0]]), int(rx[at]))
            at += 1
        assert live.rising("RAW_IMU", int(t[i])) == (imu.clipped[i] > 0)
        assert not live.rising("SCALED_IMU2", int(t[i]))
    silent = with_counter(_imu(t), seq[:3], rx[:3], count[:3])
    assert t[np.flatnonzero(silent.clipped)[-1]] - rx[2] <= HOLDS_NS
    assert np.flatnonzero(silent.clipped)[-1] == 409


def test_a_counter_that_begins_anew_is_no_rise() -> None:
    live = ClipCounters()
    for value in (5, 0, 0):
        live.take(np.array([[value, 0, 0]]), NS)
        assert not live.rising("HIGHRES_IMU", NS)
