"""RTCM 3 against pyrtcm and RTKLIB, and what becomes of a bad stream."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyrtcm
import pyrtklib as rk
import pytest

from companion.gnss import orbit as ob
from companion.gnss.broadcast import Ephemerides
from companion.gnss.messages.rtcm import ephemeris
from companion.gnss.systems import BEIDOU, GALILEO, GPS, C
from companion.types import F64, I64, NS, BroadcastSamples, RawGnssSamples
from drivers.receiver_session import RtcmSession
from drivers.rtcm.decoder import RtcmDecoder
from drivers.rtcm.framer import Framer, pack
from drivers.ublox.decoder import UbxDecoder
from replay.simulator.constellation import ephemerides
from replay.simulator.live import rtcm

WEEK, TOW = 2300, 200_000.0
SATS: I64 = np.array([101, 105, 232, 303, 330])
RANGES: F64 = np.array([2.1e7, 2.3e7, 2.51234e7, 3.9e7, 2.2e7])
RATES: F64 = np.array([5.25, -3.0, 800.0, 0.0, -799.9999])


def _epoch(tow: float, **kw: int) -> bytes:
    return b"".join(rtcm.epoch(tow, SATS, RANGES, RATES, **kw))


def _raw(found: list[RawGnssSamples | BroadcastSamples]) -> list[RawGnssSamples]:
    return [s for s in found if isinstance(s, RawGnssSamples)]


def _rows() -> dict[int, F64]:
    """One ephemeris of each system, with every term in use."""
    out, rng = {}, np.random.default_rng(4)
    for row in ephemerides((GPS, GALILEO, BEIDOU), WEEK, TOW, TOW):
        row = row.copy()
        row[ob.E_DELTA_N : ob.E_IDOT + 1] = rng.normal(0, [5e-9, 8e-9, 4e-10])
        row[ob.E_CUC : ob.E_CIS + 1] = rng.normal(0, [5e-6, 5e-6, 200, 200, 1e-7, 1e-7])
        # Of whole units in which each system says it: 16, 60 and 8 s.
        row[ob.E_TOE_OWN] = 199_200.0 if row[ob.E_SAT] < 300 else 199_208.0
        row[ob.E_TOE] = row[ob.E_TOC] = row[ob.E_TOE_OWN] + (14.0 if row[ob.E_SAT] > 300 else 0.0)
        row[ob.E_AF0], row[ob.E_AF1] = rng.normal(0, 1e-4), rng.normal(0, 1e-11)
        out.setdefault(int(row[ob.E_SAT]) // 100, row)
    return {int(row[ob.E_SAT]): row for row in out.values()}


def test_observations_are_those_that_rtklib_encodes_of_a_recorded_walk(data_dir: Path) -> None:
    recorded = (data_dir / "rtk-walk" / "gnss_1730.ubx").read_bytes()
    raw, out = rk.raw_t(), rk.rtcm_t()
    rk.init_raw(raw, 1)
    rk.init_rtcm(out)
    stream, epochs = b"", 0
    for byte in recorded:
        if rk.input_ubx(raw, byte) != 1:
            continue
        out.time, out.obs.n = raw.obs.data[0].time, raw.obs.n
        for i in range(raw.obs.n):
            out.obs.data[i] = raw.obs.data[i]
        for number, more in ((1077, 1), (1087, 1), (1097, 0)):
            assert rk.gen_rtcm3(out, number, 0, more) == 1
            stream += bytes(out.buff[i] for i in range(out.nbyte))
        epochs += 1
        if epochs == 5:
            break
    theirs = [s for s in UbxDecoder().feed(recorded) if isinstance(s, RawGnssSamples)][:5]
    decoder = RtcmDecoder(near=(2381, 400_000.0))
    ours = _raw(decoder.feed(stream))
    assert decoder.counters.other == 5  # GLONASS
    compared = 0
    for mine, other in zip(ours, theirs, strict=True):
        assert (mine.week[0], mine.tow[0]) == (other.week[0], pytest.approx(other.tow[0], abs=1e-3))
        known = {s: k for k, s in enumerate(other.sat[0].tolist()) if 0 < s < 300}
        assert set(mine.sat[0].tolist()) - {0} == set(known)
        for k, sat in enumerate(mine.sat[0].tolist()):
            if sat:
                j = known[sat]
                # The last bit is 2^-29 ms, half a millimetre; of rates 1e-4 m/s.
                assert abs(mine.pseudorange[0, k] - other.pseudorange[0, j]) < 3e-4
                assert abs(mine.rate[0, k] - other.rate[0, j]) < 6e-5
                assert mine.cn0[0, k] == other.cn0[0, j]
                compared += 1
    assert compared > 50


@pytest.mark.parametrize("kind", [4, 5, 6, 7])
def test_every_kind_says_the_same_to_its_resolution_and_so_says_pyrtcm(kind: int) -> None:
    frames = rtcm.epoch(TOW, SATS, RANGES, RATES, kind=kind)
    [mine] = _raw(RtcmDecoder(near=(WEEK, 0.0)).feed(b"".join(frames)))
    assert mine.sat[0, :5].tolist() == SATS.tolist()
    fine_m = 1e-3 * C * 2.0 ** (-24 if kind < 6 else -29)
    assert np.abs(mine.pseudorange[0, :5] - RANGES).max() <= 0.51 * fine_m
    if kind in (5, 7):
        assert np.abs(mine.rate[0, :5] - RATES).max() < 6e-5
    else:
        assert np.isnan(mine.rate).all()
    assert (mine.cn0[0, :5] == 45.0).all()
    judge = [pyrtcm.RTCMReader.parse(frame) for frame in frames]
    assert [int(m.identity) for m in judge] == [1070 + kind, 1090 + kind, 1120 + kind]
    gps_ms = round(TOW * 1e3)
    stamps = [judge[0].DF004, judge[2].DF427]
    assert stamps == [gps_ms, gps_ms - 14_000]
    names = [f"{getattr(m, f'CELLPRN_{k:02d}')}" for m in judge for k in range(1, m.NCell + 1)]
    assert [int(n) for n in names] == [s % 100 for s in SATS.tolist()]
    fine = "DF400" if kind < 6 else "DF405"
    at = 0
    for message in judge:
        for k in range(1, message.NCell + 1):
            rough = getattr(message, f"DF397_{k:02d}") + getattr(message, f"DF398_{k:02d}")
            theirs = (rough + getattr(message, f"{fine}_{k:02d}")) * 1e-3 * C
            assert mine.pseudorange[0, at] == pytest.approx(theirs, abs=1e-6)
            at += 1


def test_ephemerides_are_those_that_rtklib_reads() -> None:
    """What our encoder says, RTKLIB and our decoder take for the same orbit and clock."""
    judge = rk.rtcm_t()
    rk.init_rtcm(judge)
    judge.time = rk.gpst2time(WEEK, TOW)
    systems = {GPS: rk.SYS_GPS, GALILEO: rk.SYS_GAL, BEIDOU: rk.SYS_CMP}
    place, clock, var = rk.Arr1Ddouble(3), rk.Arr1Ddouble(1), rk.Arr1Ddouble(1)
    mine, sent = np.empty(8), np.empty(8)
    for sat, row in _rows().items():
        frame = rtcm.ephemeris(row)
        assert [rk.input_rtcm3(judge, byte) for byte in frame][-1] == 2
        number = rk.satno(systems[sat // 100 - 1], sat % 100)
        theirs = judge.nav.eph[number - 1]
        found = ephemeris(next(Framer().feed(frame)), (WEEK, TOW))
        assert found is not None
        decoded, fits = found
        assert fits
        assert decoded[ob.E_SAT] == sat
        rk.eph2pos(rk.gpst2time(WEEK, TOW + 900.0), theirs, place, clock, var)
        ob.satellite_at(decoded, WEEK, TOW + 900.0, mine)
        ob.satellite_at(row, WEEK, TOW + 900.0, sent)
        assert np.abs(mine[:3] - [place[i] for i in range(3)]).max() < 1e-5
        assert mine[6] / C + decoded[ob.E_GROUP_DELAY] == pytest.approx(clock[0], abs=1e-15)
        # 2^-32 semicircles at 4e7 m, and the clock's 2^-31 s for GPS.
        assert np.abs(mine[:3] - sent[:3]).max() < 0.2
        assert abs(mine[6] - sent[6]) < 0.3
        index = 1 if sat // 100 == 2 else 0
        assert theirs.tgd[index] == pytest.approx(decoded[ob.E_GROUP_DELAY], abs=1e-18)


def test_geostationary_satellites_keep_their_health_and_accuracy() -> None:
    row = _rows()[319].copy()
    row[ob.E_SAT], row[ob.E_HEALTH] = 303, 1
    found = ephemeris(next(Framer().feed(rtcm.ephemeris(row))), (WEEK, TOW))
    assert found is not None
    assert (found[0][ob.E_SAT], found[0][ob.E_HEALTH], found[0][ob.E_ACCURACY]) == (303, 1, 2.4)


# --------------------------------------------------------------------------- time


def test_weeks_turn_over_and_beidou_is_fourteen_seconds_behind() -> None:
    decoder = RtcmDecoder(near=(WEEK, 604_790.0))
    times = []
    for k in range(30):
        for raw in _raw(decoder.feed(_epoch((604_785.0 + k) % 604_800.0))):
            assert (raw.sat[0] > 0).sum() == 5
            times.append(int(raw.week[0]) * 604_800 + raw.tow[0])
    assert times == [WEEK * 604_800 + 604_785.0 + k for k in range(30)]


def test_a_week_of_ten_bits_dates_the_epochs_behind_it() -> None:
    [gps, galileo, beidou] = [rtcm.ephemeris(row) for row in _rows().values()]
    for message in (gps, galileo, beidou):
        decoder = RtcmDecoder()
        decoder.feed(message)
        assert decoder.dated == 1
        [raw] = _raw(decoder.feed(_epoch(TOW)))
        assert raw.week[0] == WEEK
    # A clock that is right within half a week needs no ephemeris.
    for near in ((WEEK, 500_000.0), (WEEK - 1, 560_000.0)):
        decoder = RtcmDecoder(near=near)
        [raw] = _raw(decoder.feed(_epoch(TOW)))
        assert raw.week[0] == WEEK
        decoder.feed(gps)
        assert decoder.dated == 0


def test_an_ephemeris_of_another_year_is_stale_and_moves_no_time() -> None:
    good, other = _rows()[101], _rows()[101].copy()
    other[ob.E_WEEK] -= 52
    decoder = RtcmDecoder(near=(WEEK, TOW))
    store = Ephemerides()
    for row in (good, other):
        for s in decoder.feed(rtcm.ephemeris(row)):
            assert isinstance(s, BroadcastSamples)
            store.take(s)
    [raw] = _raw(decoder.feed(_epoch(TOW)))
    assert raw.week[0] == WEEK
    chosen, why = store.choose(101, WEEK, TOW)
    assert why == ""
    assert chosen is not None
    assert chosen[ob.E_WEEK] == WEEK


def test_a_computer_without_the_time_gets_it_from_the_ephemerides() -> None:
    for clock_s in (1_000_000, 1_600_000_000, 315_964_800 + WEEK * 604_800 + 200_000):
        session, weeks = RtcmSession(), []
        for k in range(20):
            rx = (clock_s + k) * NS + 80_000_000
            data = _epoch(TOW + k)
            if k == 3:
                data = rtcm.ephemeris(_rows()[101]) + data
            for s in session.feed(k, rx, data):
                assert s.t_rx_ns[0] == rx
                if isinstance(s, RawGnssSamples):
                    weeks.append(int(s.week[0]))
                    # On the clock of the run, whatever it says.
                    assert abs(int(s.t_ns[0]) - rx) < NS
        assert weeks[3:] == [WEEK] * 17


def test_a_receiver_that_was_silent_for_days_comes_back_in_the_right_week() -> None:
    session, rx = RtcmSession(), (315_964_800 + WEEK * 604_800 + 200_000) * NS
    session.feed(0, rx, _epoch(TOW))
    for days in (3, 5, 8):
        later = TOW + days * 86_400.0
        [raw] = session.feed(1, rx + days * 86_400 * NS, _epoch(later % 604_800.0))
        assert isinstance(raw, RawGnssSamples)
        assert raw.week[0] == WEEK + later // 604_800.0


# --------------------------------------------------------------------------- bad streams


def test_bytes_may_be_cut_anywhere_and_noise_is_counted() -> None:
    spoiled = bytearray(_epoch(TOW + 1))
    spoiled[30] ^= 4
    stream = b"$GNGGA,1*00\r\n\xd3" + _epoch(TOW) + bytes(spoiled) + _epoch(TOW + 2)
    decoder = RtcmDecoder(near=(WEEK, TOW))
    found = [s for byte in stream for s in decoder.feed(bytes([byte]))]
    assert [s.tow[0] for s in _raw(found)] == [TOW, TOW + 1, TOW + 2]
    # The GPS message of the second epoch is lost, the others are not.
    assert [int((s.sat[0] > 0).sum()) for s in _raw(found)] == [5, 3, 5]
    assert decoder.framer.bad >= 1
    assert decoder.framer.skipped >= 14
    half = RtcmDecoder(near=(WEEK, TOW))
    assert half.feed(_epoch(TOW)[:-1]) == []
    assert len(half.feed(_epoch(TOW)[-1:])) == 1


def test_an_epoch_whose_last_message_is_lost_ends_with_the_next() -> None:
    decoder = RtcmDecoder(near=(WEEK, TOW))
    gps, galileo, _ = rtcm.epoch(TOW, SATS, RANGES, RATES)
    assert decoder.feed(gps + galileo) == []
    first, second = _raw(decoder.feed(_epoch(TOW + 1)))
    assert (first.tow[0], int((first.sat[0] > 0).sum())) == (TOW, 3)
    assert (second.tow[0], int((second.sat[0] > 0).sum())) == (TOW + 1, 5)


def test_an_encoder_that_calls_every_message_the_last_is_understood() -> None:
    decoder, found = RtcmDecoder(near=(WEEK, TOW)), []
    for k in range(4):
        for system in (1, 2, 3):
            mine = np.isin(SATS // 100, system)
            data = rtcm.epoch(TOW + k, SATS[mine], RANGES[mine], RATES[mine])
            found += _raw(decoder.feed(b"".join(data)))
    assert [int((s.sat[0] > 0).sum()) for s in found] == [2, 5, 5]
    assert decoder.assembly.late == 2


def test_two_receivers_on_one_line_are_not_mixed() -> None:
    decoder = RtcmDecoder(near=(WEEK, TOW))
    found = decoder.feed(_epoch(TOW, station=7) + _epoch(TOW, station=8) + _epoch(TOW + 1))
    assert len(_raw(found)) == 1
    assert decoder.assembly.foreign == 6
    # One that stays alone is taken after a while.
    found = [s for k in range(20) for s in decoder.feed(_epoch(TOW + 2 + k, station=8))]
    assert 5 < len(_raw(found)) < 12


def test_messages_that_cannot_be_are_counted_and_never_raised() -> None:
    rng = np.random.default_rng(5)
    whole = [next(Framer().feed(f)) for f in rtcm.epoch(TOW, SATS, RANGES, RATES)]
    whole += [next(Framer().feed(rtcm.ephemeris(row))) for row in _rows().values()]
    decoder, store = RtcmDecoder(near=(WEEK, TOW)), Ephemerides()
    for _ in range(400):
        payload = bytearray(whole[int(rng.integers(len(whole)))])
        for at in rng.integers(2, len(payload), int(rng.integers(1, 30))):
            payload[at] = int(rng.integers(256))
        for s in decoder.feed(pack(bytes(payload[: int(rng.integers(2, len(payload) + 1))]))):
            if isinstance(s, BroadcastSamples):
                store.take(s)
            else:
                seen = s.sat[0] > 0
                assert ((s.pseudorange[0, seen] > 1.5e7) & (s.pseudorange[0, seen] < 6e7)).all()
                assert (np.abs(s.rate[0, seen]) <= 2e4).all()
    for payload in (b"", b"\x43", b"\x43\x50", bytes(40)):
        decoder.feed(pack(payload))
    assert decoder.framer.frames == 404
    assert decoder.counters.malformed > 50


def test_beidou_may_come_on_b3i() -> None:
    frames = rtcm.epoch(TOW, SATS, RANGES, RATES, b3i=True)
    [raw] = _raw(RtcmDecoder(near=(WEEK, TOW)).feed(b"".join(frames)))
    assert raw.signal[0, :5].tolist() == [0, 0, 0, 1, 1]
    assert pyrtcm.RTCMReader.parse(frames[2]).CELLSIG_01 == "6I"


def test_a_pseudorange_that_is_not_there_is_no_satellite() -> None:
    ranges = RANGES.copy()
    ranges[1] = 0.255 * C  # 255 ms: the rough range's mark for "none"
    [raw] = _raw(RtcmDecoder(near=(WEEK, TOW)).feed(b"".join(rtcm.epoch(TOW, SATS, ranges, RATES))))
    assert 105 not in raw.sat[0]
    assert (raw.sat[0] > 0).sum() == 4
