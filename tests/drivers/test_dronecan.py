"""DroneCAN RawIMU against the `dronecan` package, and against everything a bus can do wrong."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from drivers.can_imu import CanFrame, make_decoder, make_encoder
from drivers.can_imu.dronecan import SIGNATURE, DroneCanDecoder, DroneCanEncoder, crc16
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

FRAMES = 7
HALF = 2.0**-11
"""Half of the last place of a float16, relative."""


def test_integrals_come_back_as_means():
    sent = samples_of(200, interval_s=STEP_NS * 1e-9)
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, in_groups(make_encoder("dronecan").encode(sent), FRAMES))
    got = taken(decoder)
    # float32 on the wire: 24 bits.
    np.testing.assert_allclose(got.gyro_b, sent.gyro_b, rtol=2e-7)
    np.testing.assert_allclose(got.accel_b, sent.accel_b, rtol=2e-7)
    np.testing.assert_allclose(got.interval_s, sent.interval_s, rtol=1e-7)
    np.testing.assert_allclose(got.t_ns - sent.t_ns, 0, atol=1_000)
    assert decoder.counters.samples == 200
    assert decoder.counters.frames == 200 * FRAMES
    assert decoder.counters.malformed == decoder.counters.lost == 0


def test_without_an_interval_the_latest_values_count():
    sent = samples_of(50)
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, in_groups(make_encoder("dronecan").encode(sent), FRAMES))
    got = taken(decoder)
    np.testing.assert_allclose(got.gyro_b, sent.gyro_b, rtol=HALF, atol=1e-7)
    np.testing.assert_allclose(got.accel_b, sent.accel_b, rtol=HALF, atol=1e-7)
    assert np.isnan(got.interval_s).all()
    assert np.array_equal(got.t_ns, sent.t_rx_ns)


def test_sequence_number_and_arrival_are_those_of_the_completing_frame():
    decoder = make_decoder("imu", "dronecan")
    frames = make_encoder("dronecan").encode(samples_of(1, interval_s=0.005))
    for i, frame in enumerate(frames):
        decoder.feed(100 + i, T0 + 1000 * i, *frame)
    got = taken(decoder)
    assert got.seq.tolist() == [106]
    assert got.t_rx_ns.tolist() == [T0 + 6000]
    assert got.t_ns.tolist() == [T0]
    assert decoder.take() is None


def test_the_stamp_is_used_where_a_node_sets_one():
    sent = samples_of(400)
    decoder = make_decoder("imu", "dronecan")
    encoder = make_encoder("dronecan", stamped=True)
    rng = np.random.default_rng(3)
    late = rng.integers(0, 3_000_000, 400)
    late[0] = 0
    for i, group in enumerate(in_groups(encoder.encode(sent), FRAMES)):
        feed(decoder, group, int(sent.t_ns[i] + late[i]), i * FRAMES)
    got = taken(decoder)
    # The envelope of 200 arrivals a second with up to 3 ms of delay is within 0.1 ms of the truth.
    assert np.abs(got.t_ns - sent.t_ns).max() < 100_000


def test_intervals_take_the_jitter_of_arrival_out():
    rng = np.random.default_rng(4)
    interval = rng.uniform(0.0025, 0.02, 3000)
    sent = samples_of(3000, interval_s=0.005)
    valid = T0 + np.round(np.cumsum(interval) * 1e9 * (1 + 60e-6)).astype(np.int64)
    rx = np.maximum.accumulate(valid + rng.exponential(2e6, 3000).astype(np.int64))
    decoder = make_decoder("imu", "dronecan")
    encoder = DroneCanEncoder()
    for i in range(3000):
        one = sent.take(slice(i, i + 1))
        one.interval_s[0] = interval[i]
        feed(decoder, encoder.encode(one), int(rx[i]), i * FRAMES)
    got = taken(decoder)
    error = (got.t_ns - valid)[600:]
    # Arrivals scatter by 2 ms. The line under ten minima of some hundred arrivals each is known to
    # their own scatter, 2 ms / 100, and its slope moves it by a few times that.
    assert np.abs(error).max() < 200_000
    # The offset is slewed by at most 0.2 % of an interval against a line of up to 500 ppm, but for
    # an arrival earlier than any before it: validity never is after arrival.
    steps = (np.diff(got.t_ns) / np.diff(valid))[600:]
    assert np.percentile(np.abs(steps - 1.0), 99) < 0.0026


def test_intervals_that_leave_gaps_are_no_clock():
    # A unit that integrates over 2.5 ms and sends every 5 ms.
    sent = samples_of(2000, interval_s=0.0025)
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, in_groups(DroneCanEncoder().encode(sent), FRAMES))
    got = taken(decoder)
    assert np.array_equal(got.t_ns[600:], sent.t_rx_ns[600:])
    assert_sane(got)


def test_lost_transfers_are_counted_by_their_number():
    groups = in_groups(DroneCanEncoder().encode(samples_of(300, interval_s=0.005)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    gone = {50, 51, 120, *range(200, 264)}  # the last: two full turns of the 5-bit number
    for i, group in enumerate(groups):
        if i not in gone:
            feed(decoder, group, T0 + i * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == len(gone)
    got = taken(decoder)
    kept = [i for i in range(300) if i not in gone]
    np.testing.assert_allclose(got.t_ns, T0 + STEP_NS * np.array(kept), atol=1_000)


@pytest.mark.parametrize("stall", [18, 31, 33, 50, 200])
def test_a_reader_that_was_held_up_loses_nothing(stall):
    """Samples that wait for the reader come at once behind a pause: none of them was lost."""
    groups = in_groups(DroneCanEncoder().encode(samples_of(1200, interval_s=0.005)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    for i, group in enumerate(groups):
        held_until = next((b + stall for b in (300, 700) if b <= i < b + stall), i)
        feed(decoder, group, T0 + held_until * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == decoder.counters.restarts == 0
    got = taken(decoder)
    # The line may move by the slope that late blocks suggest: within a fifth of a sample.
    np.testing.assert_allclose(got.t_ns, T0 + STEP_NS * np.arange(1200), atol=STEP_NS // 5)


def test_a_backlog_that_comes_in_portions_is_no_loss():
    """An adapter's buffer is handed on piece by piece: 21 samples at once, every period."""
    groups = in_groups(DroneCanEncoder().encode(samples_of(900, interval_s=0.005)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    for i, group in enumerate(groups):
        held_until = 400 + (i - 300) // 21 if 300 <= i < 405 else i
        feed(decoder, group, T0 + held_until * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == decoder.counters.restarts == 0


def test_a_backlog_at_the_start_does_not_spoil_the_period():
    groups = in_groups(DroneCanEncoder().encode(samples_of(600, interval_s=0.005)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    for i, group in enumerate(groups):
        feed(decoder, group, T0 + max(i, 40) * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == decoder.counters.restarts == 0


def test_a_unit_that_becomes_slower_is_learned_anew():
    groups = in_groups(DroneCanEncoder().encode(samples_of(600)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    for i, group in enumerate(groups):
        if i not in (550, 551):
            feed(decoder, group, T0 + (i + 30 * max(0, i - 200)) * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == 2


@pytest.mark.parametrize("silence", [16, 31, 32, 33, 100, 500])
def test_a_unit_that_was_silent_has_lost_what_it_did_not_say(silence):
    groups = in_groups(DroneCanEncoder().encode(samples_of(1200, interval_s=0.005)), FRAMES)
    decoder = make_decoder("imu", "dronecan")
    for i, group in enumerate(groups):
        if not 300 <= i < 300 + silence:
            feed(decoder, group, T0 + i * STEP_NS, i * FRAMES)
    assert decoder.counters.lost == silence
    got = taken(decoder)
    # The first three behind the pause do not know yet how many turns were missed.
    kept = [i for i in range(1200) if not 300 <= i <= 302 + silence]
    later = np.delete(got.t_ns, [300, 301, 302])
    np.testing.assert_allclose(later, T0 + STEP_NS * np.array(kept), atol=STEP_NS // 5)


def test_a_lost_frame_costs_its_transfer_and_no_more():
    groups = in_groups(DroneCanEncoder().encode(samples_of(30, interval_s=0.005)), FRAMES)
    del groups[10][3]
    del groups[20][6]
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, groups)
    assert decoder.counters.samples == 28
    assert decoder.counters.lost == 2
    assert decoder.counters.malformed == 1
    assert decoder.counters.incomplete == 1


def test_frames_and_transfers_that_come_twice_count_once():
    groups = in_groups(DroneCanEncoder().encode(samples_of(30, interval_s=0.005)), FRAMES)
    groups[10] = [frame for frame in groups[10] for _ in range(2)]
    groups[20] = groups[20] * 2
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, groups)
    assert decoder.counters.samples == 30
    assert decoder.counters.repeated >= FRAMES
    assert decoder.counters.lost == decoder.counters.malformed == 0


def test_a_wrong_crc_is_malformed():
    groups = in_groups(DroneCanEncoder().encode(samples_of(3, interval_s=0.005)), FRAMES)
    frame = groups[1][4]
    groups[1][4] = frame._replace(data=bytes([frame.data[0] ^ 1]) + frame.data[1:])
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, groups)
    assert decoder.counters.samples == 2
    assert decoder.counters.malformed == 1


def test_values_that_are_no_numbers_are_dropped():
    sent = samples_of(3, interval_s=0.005)
    sent.gyro_b[1, 2] = math.nan
    decoder = make_decoder("imu", "dronecan")
    feed_each(decoder, in_groups(DroneCanEncoder().encode(sent), FRAMES))
    assert len(taken(decoder)) == 2
    assert decoder.counters.malformed == 1


def test_interleaved_nodes_stay_apart():
    ours, theirs = samples_of(40, seed=1, interval_s=0.005), samples_of(40, seed=2, interval_s=0.01)
    first, second = DroneCanEncoder(50), DroneCanEncoder(51)
    mixed = [
        frame
        for pair in zip(first.encode(ours), second.encode(theirs), strict=True)
        for frame in pair
    ]
    one, two = make_decoder("a", "dronecan", node_id=50), make_decoder("b", "dronecan", node_id=51)
    anyone = make_decoder("c", "dronecan")
    for i, frame in enumerate(mixed):
        claimed = [d.feed(i, T0 + i, *frame) for d in (one, two, anyone)]
        assert claimed[0] != claimed[1]
        assert claimed[2] == claimed[0], "node 0 takes the first node it hears"
    np.testing.assert_allclose(taken(one).gyro_b, ours.gyro_b, rtol=2e-7)
    np.testing.assert_allclose(taken(two).gyro_b, theirs.gyro_b, rtol=2e-7)
    assert len(taken(anyone)) == 40


def test_other_traffic_is_left_alone():
    decoder = make_decoder("imu", "dronecan", node_id=50)
    frame = DroneCanEncoder().encode(samples_of(1))[0]
    others = [
        frame._replace(extended=False, can_id=0x332),
        frame._replace(can_id=frame.can_id | 0x80),  # a service
        frame._replace(can_id=frame.can_id ^ 0x100),  # the next data type
        frame._replace(can_id=frame.can_id ^ 0x01),
    ]
    assert feed(decoder, others) == [False] * 4
    assert decoder.counters.frames == 0


def test_axes_and_saturation():
    sent = samples_of(4, interval_s=0.005, accel_sd=1.0)
    sent.gyro_b[2] = [math.radians(300.0), 0.0, math.radians(-301.0)]
    axes = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    decoder = make_decoder(
        "imu", "dronecan", axes=axes, gyro_range_dps=300.0, accel_range_mps2=150.0
    )
    groups = in_groups(DroneCanEncoder().encode(sent), FRAMES)
    feed_each(decoder, groups[:3])
    assert decoder.saturated == ("gyro_x", "gyro_z")
    feed_each(decoder, groups[3:])
    assert decoder.saturated == ()
    assert decoder.counters.saturated == 1
    np.testing.assert_allclose(
        taken(decoder).accel_b, sent.accel_b[:, [1, 0, 2]] * [1, -1, 1], rtol=2e-7
    )


@pytest.mark.parametrize("seed", range(6))
def test_damaged_traffic_never_raises_and_good_transfers_survive(seed):
    rng = np.random.default_rng(seed)
    sent = samples_of(400, interval_s=0.005)
    frames = DroneCanEncoder().encode(sent)
    decoder = make_decoder("imu", "dronecan")
    ids = [(frames[0].can_id, True), (0x123, False), (frames[0].can_id ^ 1, True)]
    traffic = damaged(frames, rng, ids)
    for i, frame in enumerate(traffic):
        decoder.feed(i, T0 + i * STEP_NS // FRAMES, *frame)
    got = taken(decoder)
    assert_sane(got)
    counters = decoder.counters
    assert counters.samples == len(got) > 50
    assert counters.malformed > 50
    # What got through the CRC is what was sent.
    wanted = sent.gyro_b.astype(np.float32)
    nearest = np.abs(got.gyro_b[:, None, :] - wanted[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-6


def test_random_frames_of_our_id_never_raise():
    rng = np.random.default_rng(0)
    decoder = make_decoder("imu", "dronecan")
    for i in range(20_000):
        decoder.feed(i, T0 + i, 0x0803EB32, True, rng.bytes(int(rng.integers(0, 65))))
    assert decoder.take() is None
    assert decoder.counters.frames == 20_000


def test_transfers_of_other_lengths():
    decoder = DroneCanDecoder(make_decoder("imu", "dronecan")._unit)
    encoder = DroneCanEncoder()
    good = samples_of(1, interval_s=0.005)
    body = b"".join(f.data[:-1] for f in encoder.encode(good))[2:]
    with_covariance = encoder.transfer(body + bytes(72))
    too_long = encoder.transfer(body + bytes(300))
    too_short = encoder.transfer(body[:-1])
    feed_each(decoder, [with_covariance, too_long, too_short])
    assert decoder.counters.samples == 1
    assert decoder.counters.malformed == 2


def _payload(frames: list[CanFrame]) -> bytes:
    return b"".join(frame.data[:-1] for frame in frames)


def test_oracle_decodes_what_we_encode_and_the_other_way_round():
    dronecan = pytest.importorskip("dronecan")
    message_type = dronecan.uavcan.equipment.ahrs.RawIMU
    sent = samples_of(5, interval_s=0.005)
    encoder = DroneCanEncoder()
    for i, group in enumerate(in_groups(encoder.encode(sent), FRAMES)):
        transfer = dronecan.transport.Transfer()
        transfer.from_frames([dronecan.transport.Frame(f.can_id, bytearray(f.data)) for f in group])
        message = transfer.payload
        assert dronecan.get_dronecan_data_type(message).default_dtid == 1003
        assert transfer.source_node_id == 50
        rate = np.array(message.rate_gyro_integral) / message.integration_interval
        np.testing.assert_allclose(rate, sent.gyro_b[i], rtol=1e-6)
        np.testing.assert_allclose(
            np.array(message.accelerometer_latest), sent.accel_b[i], rtol=HALF
        )
    assert dronecan.get_dronecan_data_type(message).get_data_type_signature() == SIGNATURE

    message = message_type()
    message.integration_interval = 0.0025
    message.rate_gyro_integral = [0.001, -0.002, 0.003]
    message.accelerometer_integral = [0.01, 0.02, -0.0245]
    message.timestamp.usec = 1234
    transfer = dronecan.transport.Transfer(
        payload=message, source_node_id=17, transfer_priority=8, transfer_id=3
    )
    decoder = make_decoder("imu", "dronecan")
    feed(decoder, [CanFrame(f.message_id, True, bytes(f.bytes)) for f in transfer.to_frames()])
    got = taken(decoder)
    np.testing.assert_allclose(got.gyro_b[0], [0.4, -0.8, 1.2], rtol=1e-6)
    np.testing.assert_allclose(got.accel_b[0], [4.0, 8.0, -9.8], rtol=1e-6)
    assert decoder.node_id == 17  # type: ignore[attr-defined]


def test_recorded_bus(data_dir: Path):
    """The first seconds of an AP_Periph node's traffic, other nodes and types among it."""
    import gzip

    path = data_dir / "sitl" / "k1_can_mission.candump.log.gz"
    if not path.exists():
        pytest.skip("no recorded bus")
    decoder = make_decoder("imu", "dronecan")
    with gzip.open(path, "rt") as lines:
        for i, line in zip(range(8000), lines, strict=False):
            stamp, _, frame = line.split()
            can_id, data = frame.split("#")
            t_rx = int(stamp[1:11]) * 10**9 + int(stamp[12:-1]) * 1000
            decoder.feed(i, t_rx, int(can_id, 16), len(can_id) == 8, bytes.fromhex(data))
    got = taken(decoder)
    assert len(got) > 700
    assert decoder.counters.lost == decoder.counters.malformed == 0
    assert_sane(got)
    # At rest on the ground, level.
    np.testing.assert_allclose(got.accel_b.mean(axis=0), [0, 0, -9.81], atol=0.15)
    assert np.abs(got.gyro_b.mean(axis=0)).max() < 0.01
    # Once the envelope is found, the intervals are the sensor's clock, slewed by 0.2 % against a
    # line of up to 500 ppm but where an arrival is earlier than any before; arrivals scatter more.
    steps, rest = np.diff(got.t_ns) * 1e-9, slice(600, None)
    assert np.percentile(np.abs(steps / got.interval_s[1:] - 1.0)[rest], 98) < 0.0026
    arrival = np.diff(got.t_rx_ns) * 1e-9
    assert np.abs(arrival / got.interval_s[1:] - 1.0)[rest].mean() > 0.05


def test_crc_of_the_specification():
    """CRC-16-CCITT-FALSE of "123456789" is 0x29B1; ours goes on from the type's signature."""
    import binascii

    signature = SIGNATURE.to_bytes(8, "little")
    assert binascii.crc_hqx(b"123456789", 0xFFFF) == 0x29B1
    assert crc16(b"abc") == binascii.crc_hqx(signature + b"abc", 0xFFFF)
