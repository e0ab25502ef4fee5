"""Units that send a frame a quantity: golden frames, times, and everything that can go wrong."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from companion.config import DbcMapping
from companion.types import ConfigError
from drivers.can_imu import (
    PROTOCOLS,
    CanFrame,
    CanImuDecoder,
    make_decoder,
    make_encoder,
    rounding_density,
)
from tests.drivers.can_frames import (
    STEP_NS,
    T0,
    assert_sane,
    damaged,
    feed,
    feed_each,
    in_groups,
    samples_of,
    taken,
)

DBC = """VERSION ""
BS_:
BU_: IMU
BO_ 256 RATES: 8 IMU
 SG_ RATE_X : 7|16@0- (0.01,0) [-327|327] "deg/s" IMU
 SG_ RATE_Y : 23|16@0- (0.01,0) [-327|327] "deg/s" IMU
 SG_ RATE_Z : 39|16@0- (0.01,0) [-327|327] "deg/s" IMU
 SG_ COUNT : 51|4@0+ (1,0) [0|15] "" IMU
BO_ 2566844672 FORCES: 8 IMU
 SG_ ACC_X : 0|18@1- (0.001,0) [-131|131] "g" IMU
 SG_ ACC_Y : 18|18@1- (0.001,0) [-131|131] "g" IMU
 SG_ ACC_Z : 36|18@1- (0.001,0) [-131|131] "g" IMU
BO_ 258 CLOCK: 4 IMU
 SG_ TICKS : 0|24@1+ (0.5,0) [0|8388607] "ms" IMU
"""
FORCES = 2566844672 & 0x1FFFFFFF


@dataclass(frozen=True)
class UnitUnderTest:
    """A protocol with what its wire format can hold."""

    protocol: str
    frames: int
    gyro_step: float
    accel_step: float
    ids: tuple[tuple[int, bool], ...]


UNITS = (
    UnitUnderTest("xsens-mti", 4, 2**-9, 2**-8, ((0x32, False), (0x34, False), (5, False))),
    UnitUnderTest("sbg-ellipse", 3, 1e-3, 1e-2, ((0x121, False), (0x122, False), (0x120, False))),
    UnitUnderTest(
        "openimu-j1939", 2, math.radians(1 / 128), 1e-2, ((0x0CF02A80, True), (0x08F02D80, True))
    ),
    UnitUnderTest("dbc", 2, math.radians(0.01), 9.80665e-3, ((256, False), (FORCES, True))),
)


@pytest.fixture
def mapping(tmp_path: Path) -> DbcMapping:
    path = tmp_path / "unit.dbc"
    path.write_text(DBC)
    return DbcMapping(
        file=str(path),
        gyro_signals=("RATE_X", "RATE_Y", "RATE_Z"),
        accel_signals=("ACC_X", "FORCES.ACC_Y", "ACC_Z"),
        gyro_unit="deg/s",
        accel_unit="g",
        counter_signal="COUNT",
    )


def decoder_of(unit: UnitUnderTest, mapping: DbcMapping, **options: object) -> CanImuDecoder:
    return make_decoder(
        "imu",
        unit.protocol,
        dbc=mapping if unit.protocol == "dbc" else None,
        **options,  # type: ignore[arg-type]
    )


def groups_of(unit: UnitUnderTest, mapping: DbcMapping, sent) -> list[list[CanFrame]]:
    options = {"mapping": mapping} if unit.protocol == "dbc" else {}
    return in_groups(make_encoder(unit.protocol, **options).encode(sent), unit.frames)


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
def test_samples_come_back_within_half_a_step(unit, mapping):
    sent = samples_of(300)
    decoder = decoder_of(unit, mapping)
    feed_each(decoder, groups_of(unit, mapping, sent))
    got = taken(decoder)
    # Rounding to the nearest step; the sum of one ulp where the wire has an offset.
    np.testing.assert_allclose(got.gyro_b, sent.gyro_b, rtol=0, atol=0.5001 * unit.gyro_step)
    np.testing.assert_allclose(got.accel_b, sent.accel_b, rtol=0, atol=0.5001 * unit.accel_step)
    assert np.isnan(got.interval_s).all()
    np.testing.assert_allclose(got.t_ns - sent.t_ns, 0, atol=1_000)
    counters = decoder.counters
    assert (counters.frames, counters.samples) == (300 * unit.frames, 300)
    assert counters.malformed == counters.lost == counters.incomplete == counters.repeated == 0
    assert got.seq.tolist() == [(i + 1) * unit.frames - 1 for i in range(300)]


def golden(decoder: CanImuDecoder, *frames: tuple[int, bool, str]) -> list[float]:
    feed(decoder, [CanFrame(i, x, bytes.fromhex(data)) for i, x, data in frames])
    got = taken(decoder)
    return [*got.gyro_b[0].tolist(), *got.accel_b[0].tolist()]


def test_golden_xsens():
    """512 steps of 2⁻⁹ rad/s are 1 rad/s; 2511 steps of 2⁻⁸ m/s² are 9.80859375 m/s²."""
    frames = [(0x032, False, "0200 FF80 0001"), (0x034, False, "0180 FDC0 09CF")]
    for pair in (frames, [(0x061, False, frames[0][2]), (0x062, False, frames[1][2])]):
        got = golden(make_decoder("imu", "xsens-mti"), *pair)
        assert got == [1.0, -0.25, 2.0**-9, 1.5, -2.25, 9.80859375]


def test_golden_sbg():
    """1000 of 0.001 rad/s, least byte first; −981 of 0.01 m/s²."""
    got = golden(
        make_decoder("imu", "sbg-ellipse"),
        (0x120, False, "40420F00 0100 C409"),
        (0x121, False, "0100 6400 2BFC"),
        (0x122, False, "E803 18FC 0100"),
    )
    assert got == pytest.approx([1.0, -1.0, 0.001, 0.01, 1.0, -9.81], abs=1e-12)


def test_golden_openimu():
    """(32000 + 128) / 128 − 250 is 1 deg/s; 31019 · 0.01 − 320 is −9.81 m/s²."""
    got = golden(
        make_decoder("imu", "openimu-j1939"),
        (0x0CF02A80, True, "807D 007D 007C FFFF"),
        (0x08F02D80, True, "007D 647D 2B79 FFFF"),
    )
    assert got == pytest.approx([math.radians(1), 0, math.radians(-2), 0.0, 1.0, -9.81], abs=1e-12)


def test_golden_dbc(mapping):
    """By hand: 100 · 0.01 deg/s big-endian; 18-bit signed fields of 0.001 g little-endian."""
    forces = (1000 & 0x3FFFF) | (-500 & 0x3FFFF) << 18 | (-1000 & 0x3FFFF) << 36
    got = golden(
        make_decoder("imu", "dbc", dbc=mapping),
        (256, False, "0064 FF9C 0001 0000"),
        (FORCES, True, forces.to_bytes(8, "little").hex()),
    )
    rates = [math.radians(x) for x in (1.0, -1.0, 0.01)]
    assert got == pytest.approx([*rates, 9.80665, -4.903325, -9.80665], abs=1e-12)


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
def test_a_lost_frame_costs_one_sample_and_never_mixes_two(unit, mapping):
    sent = samples_of(400)
    groups = groups_of(unit, mapping, sent)
    rng = np.random.default_rng(7)
    inertial = [i for i, f in enumerate(groups[0]) if (f.can_id, f.extended) in unit.ids[:2]]
    hit = set(range(100, 400, 5))
    for i in hit:
        del groups[i][inertial[int(rng.integers(0, 2))]]
    decoder = decoder_of(unit, mapping)
    spread = STEP_NS // 10  # the frames of a sample come one after the other, then silence
    seq = 0
    for i, group in enumerate(groups):
        for k, frame in enumerate(group):
            decoder.feed(seq, T0 + i * STEP_NS + k * spread // unit.frames, *frame)
            seq += 1
    got = taken(decoder)
    kept = np.array([i for i in range(400) if i not in hit])
    assert len(got) == len(kept)
    np.testing.assert_allclose(got.gyro_b, sent.gyro_b[kept], atol=0.5001 * unit.gyro_step)
    np.testing.assert_allclose(got.accel_b, sent.accel_b[kept], atol=0.5001 * unit.accel_step)
    assert decoder.counters.incomplete == len(hit)


@pytest.mark.parametrize("protocol", ["openimu-j1939", "sbg-ellipse", "dbc"])
@pytest.mark.parametrize("gyro_first", [True, False])
def test_the_order_of_a_units_frames_is_learned(protocol, gyro_first, mapping):
    """Without a time or a counter to lead it, and listening from the middle of a sample."""
    unit = next(u for u in UNITS if u.protocol == protocol)
    mapping = DbcMapping(
        file=mapping.file,
        gyro_signals=mapping.gyro_signals,
        accel_signals=mapping.accel_signals,
        gyro_unit="deg/s",
        accel_unit="g",
    )
    sent = samples_of(200)
    decoder = decoder_of(unit, mapping)
    seq = 0
    for i, group in enumerate(groups_of(unit, mapping, sent)):
        pair = [f for f in group if f.can_id != 0x120]
        if (pair[0].can_id in (0x122, 0x0CF02A80, 256)) != gyro_first:
            pair.reverse()
        for k, frame in enumerate(pair):
            if seq:
                decoder.feed(seq, T0 + i * STEP_NS + k * STEP_NS // 10, *frame)
            seq += 1
    got = taken(decoder)
    assert len(got) >= 195
    settled = got.take(slice(-150, None))
    np.testing.assert_allclose(settled.gyro_b, sent.gyro_b[-150:], atol=0.5001 * unit.gyro_step)
    np.testing.assert_allclose(settled.accel_b, sent.accel_b[-150:], atol=0.5001 * unit.accel_step)
    assert settled.t_ns.tolist() == sent.t_ns[-150:].tolist()


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
@pytest.mark.parametrize("seed", range(3))
def test_damaged_traffic_never_raises(unit, seed, mapping):
    rng = np.random.default_rng(seed)
    sent = samples_of(500)
    traffic = damaged([f for g in groups_of(unit, mapping, sent) for f in g], rng, unit.ids)
    decoder = decoder_of(unit, mapping)
    for i, frame in enumerate(traffic):
        decoder.feed(i, T0 + i * STEP_NS // unit.frames, *frame)
    got = taken(decoder)
    assert_sane(got)
    assert 100 < decoder.counters.samples == len(got) <= 600
    assert decoder.counters.malformed > 0
    assert decoder.counters.incomplete > 0


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
def test_random_frames_never_raise(unit, mapping):
    rng = np.random.default_rng(1)
    decoder = decoder_of(unit, mapping)
    for i in range(5_000):
        can_id, extended = unit.ids[rng.integers(0, len(unit.ids))]
        data = rng.bytes(int(rng.integers(0, 65)))
        decoder.feed(i, T0 + i * 100_000, can_id, extended, data)
        decoder.feed(i, T0 + i * 100_000, int(rng.integers(0, 1 << 29)), extended, data)
    assert decoder.counters.frames >= 4_900


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
def test_saturation_is_seen_at_the_end_of_the_wire_format(unit, mapping):
    sent = samples_of(3, accel_sd=1.0)
    sent.gyro_b[1, 1] = -1e4
    sent.accel_b[2, 2] = 1e6
    decoder = decoder_of(unit, mapping)
    seen = []
    for i, group in enumerate(groups_of(unit, mapping, sent)):
        feed(decoder, group, T0 + i * STEP_NS, i * 10)
        seen.append(decoder.saturated)
    assert seen == [(), ("gyro_y",), ("accel_z",)]
    assert decoder.counters.saturated == 2


@pytest.mark.parametrize("unit", UNITS, ids=lambda u: u.protocol)
def test_rounding_adds_the_noise_that_is_stated(unit, mapping):
    """By Monte Carlo: integrated error of rounding grows with the stated density."""
    decoder = decoder_of(unit, mapping)
    assert decoder.steps == pytest.approx((unit.gyro_step, unit.accel_step))
    sent = samples_of(4000)
    feed_each(decoder, groups_of(unit, mapping, sent))
    got, rate_hz = taken(decoder), 1e9 / STEP_NS
    for step, error in ((unit.gyro_step, got.gyro_b - sent.gyro_b),
                        (unit.accel_step, got.accel_b - sent.accel_b)):  # fmt: skip
        density = np.sqrt(np.mean(error**2) / rate_hz)
        # 12,000 values: their RMS is known to better than 1 %.
        assert density == pytest.approx(rounding_density(step, rate_hz), rel=0.03)


@pytest.mark.parametrize("protocol", ["xsens-mti", "sbg-ellipse"])
def test_the_units_clock_takes_the_jitter_of_arrival_out(protocol):
    unit = next(u for u in UNITS if u.protocol == protocol)
    rng = np.random.default_rng(2)
    sent = samples_of(4000)
    # A stamp wraps on the way (uint32 of µs: 4295 s; of 100 µs: 5 days), and drifts by 40 ppm.
    stamp = np.round((sent.t_ns - T0) * (1 + 40e-6)).astype(np.int64)
    tick = 100_000 if protocol == "xsens-mti" else 1_000
    stamp += (2**32 - 2000) * tick
    groups = in_groups(
        make_encoder(protocol).encode(
            type(sent)("imu", stamp, sent.t_rx_ns, sent.seq, sent.gyro_b, sent.accel_b,
                       sent.interval_s)
        ),
        unit.frames,
    )  # fmt: skip
    rx = np.maximum.accumulate(sent.t_ns + rng.exponential(2e6, 4000).astype(np.int64))
    decoder = make_decoder("imu", protocol)
    for i, group in enumerate(groups):
        feed(decoder, group, int(rx[i]), 10 * i)
    got = taken(decoder)
    assert_sane(got)
    assert decoder.counters.restarts == 0
    # As with DroneCAN's intervals: minima over a second of 200 arrivals scatter by 2 ms / 200;
    # Xsens ticks of 0.1 ms add their own.
    error = (got.t_ns - sent.t_ns)[1000:]
    assert np.abs(error).max() < 200_000 + tick


def test_a_counter_alone_is_a_clock_too():
    rng = np.random.default_rng(3)
    sent = samples_of(4000)
    groups = in_groups(make_encoder("xsens-mti", stamped=False).encode(sent), 3)
    gone = {1000, 1001, *range(2000, 2100)}
    rx = np.maximum.accumulate(sent.t_ns + rng.exponential(1e6, 4000).astype(np.int64))
    decoder = make_decoder("imu", "xsens-mti")
    for i, group in enumerate(groups):
        if i not in gone:
            feed(decoder, group, int(rx[i]), 10 * i)
    assert decoder.counters.lost == len(gone)
    got = taken(decoder)
    assert_sane(got)
    kept = np.array([i for i in range(4000) if i not in gone])
    error = (got.t_ns - sent.t_ns[kept])[1500:]
    assert np.abs(error).max() < 300_000


@pytest.mark.parametrize("protocol", ["xsens-mti", "sbg-ellipse"])
def test_a_unit_that_restarts_is_recognised(protocol):
    unit = next(u for u in UNITS if u.protocol == protocol)
    sent = samples_of(1000)
    clock = sent.t_ns - T0 + 3_600_000_000_000
    clock[500:] = sent.t_ns[500:] - sent.t_ns[500]
    encoder = make_encoder(protocol)
    parts = (type(sent)("imu", clock, clock, sent.seq, sent.gyro_b, sent.accel_b, sent.interval_s),)
    groups = in_groups(encoder.encode(parts[0]), unit.frames)
    decoder = make_decoder("imu", protocol)
    feed_each(decoder, groups)
    got = taken(decoder)
    assert_sane(got)
    assert decoder.counters.restarts == 1
    assert decoder.counters.lost == 0
    np.testing.assert_allclose(got.t_ns, sent.t_ns, atol=200_000)


def test_j1939_errors_addresses_and_lengths():
    decoder = make_decoder("imu", "openimu-j1939", node_id=0x80)
    good = make_encoder("openimu-j1939").encode(samples_of(1))
    other = [f._replace(can_id=f.can_id ^ 1) for f in good]
    assert feed(decoder, other) == [False, False]
    error = good[0]._replace(data=b"\x00\xfe" + good[0].data[2:])
    short = good[0]._replace(data=good[0].data[:6])
    assert feed(decoder, [error, short]) == [True, True]
    assert decoder.counters.malformed == 2
    # Priority may differ: the message is its PGN and address.
    feed(decoder, [f._replace(can_id=f.can_id ^ 0x04000000) for f in good])
    assert len(taken(decoder)) == 1


def test_high_rate_samples_replace_the_slow_ones():
    decoder = make_decoder("imu", "xsens-mti")
    sent = samples_of(50)
    slow = in_groups(make_encoder("xsens-mti").encode(sent), 4)
    twin = {0x32: 0x61, 0x34: 0x62}
    fast = [[f._replace(can_id=twin[f.can_id]) for f in group[2:]] for group in slow]
    feed_each(decoder, [f + s for f, s in zip(fast, slow, strict=True)])
    assert len(taken(decoder)) == 50
    assert decoder.counters.lost == 0


class TestDbc:
    def test_the_vendors_own_file_agrees_with_the_built_in_driver(self, data_dir):
        path = data_dir / "can" / "sbgCan.dbc"
        if not path.exists():
            pytest.skip("no vendor DBC")
        mapping = DbcMapping(
            file=str(path),
            gyro_signals=("GYRO_X", "GYRO_Y", "GYRO_Z"),
            accel_signals=tuple(f"SBG_ECAN_MSG_IMU_ACCEL.ACCEL_{axis}" for axis in "XYZ"),
            time_signal="SBG_ECAN_MSG_IMU_INFO.TIME_STAMP",
            complete_on="SBG_ECAN_MSG_IMU_GYRO",
        )
        sent = samples_of(1000)
        frames = make_encoder("sbg-ellipse").encode(sent)
        ours, general = (
            make_decoder("imu", "sbg-ellipse"),
            make_decoder("imu", "dbc", dbc=mapping),
        )
        for decoder in (ours, general):
            feed_each(decoder, in_groups(frames, 3))
        a, b = taken(ours), taken(general)
        np.testing.assert_allclose(a.gyro_b, b.gyro_b, rtol=1e-15)
        np.testing.assert_allclose(a.accel_b, b.accel_b, rtol=1e-15)
        assert a.t_ns.tolist() == b.t_ns.tolist()
        assert general._limits == pytest.approx(ours._limits)

    def test_signals_read_as_cantools_reads_them(self, data_dir):
        """A real car's bus: big-endian 10-bit fields with offsets, against cantools itself."""
        cantools = pytest.importorskip("cantools")
        folder = data_dir / "can"
        if not (folder / "derived_candump.log").exists():
            pytest.skip("no recorded bus")
        mapping = DbcMapping(
            file=str(folder / "_toyota_2017.dbc"),
            gyro_signals=("YAW_RATE", "YAW_RATE", "YAW_RATE"),
            accel_signals=("KINEMATICS.ACCEL_X", "KINEMATICS.ACCEL_Y", "KINEMATICS.ACCEL_X"),
        )
        database = cantools.database.load_file(mapping.file, strict=False)
        decoder = make_decoder("imu", "dbc", dbc=mapping)
        wanted = []
        with (folder / "derived_candump.log").open() as lines:
            for i, line in enumerate(lines):
                can_id, data = line.split()[2].split("#")
                frame = CanFrame(int(can_id, 16), len(can_id) == 8, bytes.fromhex(data))
                if decoder.feed(i, T0 + i * 1000, *frame):
                    wanted.append(database.decode_message(36, frame.data))
                if len(wanted) == 500:
                    break
        got = taken(decoder)
        assert len(got) == 500
        for row, message in zip(got.accel_b, wanted, strict=True):
            assert row[0] == pytest.approx(message["ACCEL_X"], abs=1e-12)
            assert row[1] == pytest.approx(message["ACCEL_Y"], abs=1e-12)
        yaw = [message["YAW_RATE"] for message in wanted]
        np.testing.assert_allclose(got.gyro_b[:, 2], yaw, atol=1e-12)

    def test_time_that_wraps_and_a_named_end(self, mapping):
        mapping = DbcMapping(
            file=mapping.file,
            gyro_signals=mapping.gyro_signals,
            accel_signals=mapping.accel_signals,
            time_signal="TICKS",
            time_unit="ms",
            complete_on="CLOCK",
            gyro_unit="deg/s",
            accel_unit="g",
        )
        sent = samples_of(300)
        clock = (2**24 - 300) * 500_000 + (sent.t_ns - T0)
        stamped = type(sent)(
            "imu", clock, clock, sent.seq, sent.gyro_b, sent.accel_b, sent.interval_s
        )
        groups = in_groups(make_encoder("dbc", mapping=mapping).encode(stamped), 3)
        assert groups[0][-1].can_id == 258
        decoder = make_decoder("imu", "dbc", dbc=mapping)
        feed_each(decoder, [groups[0][-1:], *groups])
        assert decoder.counters.incomplete == 1
        assert decoder.counters.restarts == 0
        got = taken(decoder)
        # The clock ticks every 0.5 ms.
        np.testing.assert_allclose(np.diff(got.t_ns), STEP_NS, atol=500_000)

    def test_counter_finds_lost_and_repeated(self, mapping):
        groups = in_groups(make_encoder("dbc", mapping=mapping).encode(samples_of(200)), 2)
        decoder = make_decoder("imu", "dbc", dbc=mapping)
        groups[90] = groups[90] * 2
        feed_each(decoder, groups[:100])
        for i in range(137, 200):  # two turns of the 4-bit counter and five
            feed(decoder, groups[i], T0 + i * STEP_NS, 1000 + 10 * i)
        assert decoder.counters.lost == 37
        assert decoder.counters.samples == 163
        assert decoder.counters.repeated == 1

    def test_multiplexed_signals(self, tmp_path):
        path = tmp_path / "mux.dbc"
        path.write_text(
            'VERSION ""\nBS_:\nBU_: IMU\nBO_ 100 M: 8 IMU\n'
            ' SG_ PAGE M : 0|8@1+ (1,0) [0|3] "" IMU\n'
            + "".join(
                f' SG_ {n} m{page} : {8 + 16 * i}|16@1- (0.001,0) [0|0] "" IMU\n'
                for page, names in ((1, ("GX", "GY", "GZ")), (2, ("OX", "OY", "OZ")))
                for i, n in enumerate(names)
            )
            + "BO_ 101 A: 6 IMU\n"
            + "".join(
                f' SG_ {n} : {16 * i}|16@1- (0.01,0) [0|0] "" IMU\n'
                for i, n in enumerate(("AX", "AY", "AZ"))
            )
        )
        mapping = DbcMapping(
            file=str(path), gyro_signals=("GX", "GY", "GZ"), accel_signals=("AX", "AY", "AZ")
        )
        decoder = make_decoder("imu", "dbc", dbc=mapping)
        frames = [
            CanFrame(100, False, bytes.fromhex("01E803000000000000")[:8]),
            CanFrame(100, False, bytes.fromhex("02FFFF000000000000")[:8]),
            CanFrame(101, False, bytes.fromhex("6400000000000000")),
        ]
        assert feed(decoder, frames) == [True, False, True]
        got = taken(decoder)
        assert got.gyro_b[0, 0] == pytest.approx(1.0)
        assert got.accel_b[0, 0] == pytest.approx(1.0)
        with pytest.raises(ConfigError, match="multiplexed"):
            make_encoder("dbc", mapping=mapping)

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"file": "missing.dbc"}, "missing.dbc"),
            ({"gyro_signals": ("RATE_X", "RATE_Y", "RATEZ")}, "did you mean 'RATE_Z'"),
            ({"gyro_signals": ("RATE_X", "RATE_Y", "OTHER.RATE_Z")}, r"no signal 'OTHER.RATE_Z'"),
            ({"complete_on": "NOBODY"}, "complete_on: 'NOBODY'"),
            ({"complete_on": "CLOCK"}, "complete_on: 'CLOCK'"),
            ({"time_signal": "TIKS"}, "time_signal: no signal 'TIKS'"),
        ],
    )
    def test_mappings_that_cannot_be_used(self, mapping, change, match):
        import msgspec

        with pytest.raises(ConfigError, match=match):
            make_decoder("imu", "dbc", dbc=msgspec.structs.replace(mapping, **change))

    def test_files_that_are_no_dbc(self, mapping, tmp_path, data_dir):
        import msgspec

        bad = tmp_path / "bad.dbc"
        bad.write_bytes(b"\x00\xff not a database")
        paths = [bad, *sorted((data_dir / "can" / "malformed").glob("*.dbc"))]
        for path in paths:
            with pytest.raises(ConfigError, match=str(path)):
                make_decoder("imu", "dbc", dbc=msgspec.structs.replace(mapping, file=str(path)))

    def test_a_signal_in_two_messages_needs_the_message(self, tmp_path, mapping):
        import msgspec

        path = tmp_path / "two.dbc"
        again = DBC[DBC.index("BO_ 256") : DBC.index("BO_ 2566")]
        path.write_text(DBC + again.replace("256 RATES", "300 SPARE"))
        with pytest.raises(ConfigError, match=r"RATES\.RATE_X, SPARE\.RATE_X"):
            make_decoder("imu", "dbc", dbc=msgspec.structs.replace(mapping, file=str(path)))


def test_names_of_protocols_are_those_of_the_configuration():
    from typing import get_args

    import msgspec

    from companion.config import CanImu

    kinds = {field.name: field.type for field in msgspec.structs.fields(CanImu)}
    assert set(PROTOCOLS) == set(get_args(kinds["protocol"]))
    with pytest.raises(ConfigError, match="no CAN IMU protocol 'lin'"):
        make_decoder("imu", "lin")
    with pytest.raises(ConfigError, match="no CAN IMU protocol 'lin'"):
        make_encoder("lin")
    with pytest.raises(ConfigError, match=r"\[can\.imu\.dbc\]"):
        make_decoder("imu", "dbc")
