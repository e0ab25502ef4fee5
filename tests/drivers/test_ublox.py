"""UBX: frames from pieces and noise, messages against pyubx2, ephemerides against RTKLIB."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyrtklib as rk
import pytest
from pyubx2 import UBXReader

from companion.gnss import orbit as ob
from companion.gnss.systems import CARRIER_HZ, C
from companion.types import BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.ublox.decoder import UbxDecoder, UbxSamples
from drivers.ublox.framer import Framer, pack
from drivers.ublox.messages import NAV_PVT, RXM_RAWX, RXM_SFRBX, pvt, raw_epoch, subframe
from replay.simulator.live import ubx


@pytest.fixture(scope="module")
def recorded(data_dir: Path) -> bytes:
    return (data_dir / "rtk-walk" / "gnss_1730.ubx").read_bytes()


@pytest.fixture(scope="module")
def decoded(recorded: bytes) -> list[UbxSamples]:
    return UbxDecoder().feed(recorded)


def test_frames_come_whole_out_of_pieces_noise_and_cut_ends() -> None:
    frames = [pack(RXM_RAWX, bytes(range(n))) for n in (16, 0, 40)]
    stream = (
        b"$GNGGA,1*00\r\n"
        + frames[0]
        + b"\xb5"
        + frames[1]
        + b"\xb5\x62\xff\xff\xff\xff"
        + frames[2]
    )
    rng = np.random.default_rng(1)
    for _ in range(20):
        framer, got, at = Framer(), [], 0
        while at < len(stream):
            step = int(rng.integers(1, 9))
            got += [f.payload for f in framer.feed(stream[at : at + step])]
            at += step
        assert got == [bytes(range(16)), b"", bytes(range(40))]
        # An impossible length is noise; every byte is of a frame or skipped.
        assert framer.bad == 0
        assert framer.skipped == len(stream) - sum(map(len, frames))
    framer = Framer()
    assert list(framer.feed(frames[2][:-1])) == []
    assert [f.payload for f in framer.feed(frames[2][-1:])] == [bytes(range(40))]


def test_a_flipped_bit_costs_its_own_frame_only() -> None:
    frames = [pack(NAV_PVT, bytes(20)) for _ in range(3)]
    spoiled = bytearray(b"".join(frames))
    spoiled[len(frames[0]) + 10] ^= 4
    framer = Framer()
    assert len(list(framer.feed(bytes(spoiled)))) == 2
    assert framer.bad == 1


@pytest.mark.parametrize("size", [0, 5, 15, 47, 90])
def test_messages_of_wrong_length_are_none(size: int) -> None:
    assert raw_epoch(bytes([0] * 11 + [7] + [0] * size)) is None
    assert subframe(bytes([0, 1, 0, 0, 9]) + bytes(size)) is None
    assert pvt(bytes(min(size, 83))) is None


def test_a_week_of_another_century_is_no_epoch() -> None:
    sats, ranges = np.array([104]), np.array([2.2e7])
    decoder = UbxDecoder()
    assert decoder.feed(ubx.rawx(60_000, 30.0, sats, ranges, np.zeros(1))) == []
    assert decoder.counters.malformed == 1


def test_rubbish_in_frames_that_check_is_counted_and_never_raised() -> None:
    rng = np.random.default_rng(5)
    decoder = UbxDecoder()
    for _ in range(300):
        kind = int(rng.choice([RXM_RAWX, RXM_SFRBX, NAV_PVT]))
        payload = rng.integers(0, 256, int(rng.choice([16, 48, 80, 92, 24, 7])), np.uint8)
        decoder.feed(pack(kind, payload.tobytes()))
    assert decoder.framer.frames == 300
    assert decoder.counters.malformed > 50


def test_raw_epochs_are_those_of_pyubx2(recorded: bytes, decoded: list[UbxSamples]) -> None:
    theirs = {}
    for frame in Framer().feed(recorded):
        if frame.kind == RXM_RAWX and len(theirs) < 5:
            message = UBXReader.parse(pack(frame.kind, frame.payload), parsebitfield=1)
            theirs[message.rcvTow] = message
    ours = [s for s in decoded if isinstance(s, RawGnssSamples)]
    compared = 0
    for raw in ours[:5]:
        message = theirs[float(raw.tow[0])]
        assert raw.week[0] == message.week
        values = {}
        for k in range(1, message.numMeas + 1):
            part = {n: getattr(message, f"{n}_{k:02d}") for n in ("prMes", "doMes", "svId", "cno")}
            values[part["prMes"]] = part
        for sat, range_, rate, cn0 in zip(
            raw.sat[0], raw.pseudorange[0], raw.rate[0], raw.cn0[0], strict=True
        ):
            if sat == 0:
                continue
            part = values[range_]
            assert part["svId"] == sat % 100
            assert part["cno"] == cn0
            if sat < 300:
                expected = -part["doMes"] * C / CARRIER_HZ[sat // 100 - 1]
                assert rate == pytest.approx(expected, abs=1e-6)
            compared += 1
    assert compared > 80


def test_ephemerides_are_those_of_rtklib(recorded: bytes, decoded: list[UbxSamples]) -> None:
    raw = rk.raw_t()
    rk.init_raw(raw, 1)
    for byte in recorded:
        rk.input_ubx(raw, byte)
    ours = {int(s.sat[0]): s.values[0] for s in decoded if isinstance(s, BroadcastSamples)}
    names = {rk.SYS_GPS: 100, rk.SYS_CMP: 300}
    place, clock, var = rk.Arr1Ddouble(3), rk.Arr1Ddouble(1), rk.Arr1Ddouble(1)
    out, compared = np.empty(8), 0
    for k in range(rk.MAXSAT):
        eph, prn = raw.nav.eph[k], rk.Arr1Dint(1)
        base = names.get(rk.satsys(eph.sat, prn), 0) if eph.sat else 0
        if not base:
            continue
        row = ours[base + prn[0]]
        rk.eph2pos(rk.timeadd(eph.toe, 600.0), eph, place, clock, var)
        ob.satellite_at(row, row[ob.E_WEEK], row[ob.E_TOE] + 600.0, out)
        assert np.abs(out[:3] - [place[i] for i in range(3)]).max() < 1e-5
        assert out[6] / C + row[ob.E_GROUP_DELAY] == pytest.approx(clock[0], abs=1e-15)
        assert (row[ob.E_HEALTH] != 0) == (eph.svh != 0)
        compared += 1
    assert compared >= 10


def test_the_receivers_own_fixes(decoded: list[UbxSamples]) -> None:
    fixes = [s for s in decoded if isinstance(s, GnssSamples)]
    assert len(fixes) == 536
    kinds = [int(f.fix_type[0]) for f in fixes]
    # As the log's provenance counts them: RTK fixed and float.
    assert (kinds.count(6), kinds.count(5)) == (349, 187)
    epochs = [int(s.t_ns[0]) for s in decoded if isinstance(s, RawGnssSamples)]
    # A fix is stamped with the whole millisecond nearest to its navigation epoch.
    assert max(abs(int(f.t_ns[0]) - t) for f, t in zip(fixes, epochs, strict=True)) < 5e6
