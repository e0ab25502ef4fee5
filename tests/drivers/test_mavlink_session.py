"""The live session against a simulated autopilot: samples, rates, events, other systems."""

from __future__ import annotations

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import NS, BaroSamples, GnssSamples, ImuSamples, MagSamples
from drivers.mavlink.packer import Packer
from drivers.mavlink.readings import HELD_NS
from drivers.mavlink.session import MavlinkSession, SessionSettings

from . import autopilot as sim


def air(settings: SessionSettings | None = None, **options: object) -> sim.Air:
    return sim.Air(
        MavlinkSession(settings or SessionSettings()),
        sim.Autopilot(**options),  # type: ignore[arg-type]
    )


def test_samples_units_and_rates() -> None:
    flight = air()
    flight.run(12.0)
    imu = flight.of("HIGHRES_IMU", ImuSamples)
    np.testing.assert_allclose(imu.accel_b[0], sim.ACCEL, atol=1e-6)
    np.testing.assert_allclose(imu.gyro_b[0], sim.GYRO, atol=1e-8)
    assert (np.diff(imu.t_ns) > 0).all()
    assert (np.diff(imu.seq) > 0).all()
    fix = flight.of("GPS_RAW_INT", GnssSamples)
    np.testing.assert_allclose(np.degrees([fix.lat[0], fix.lon[0]]), [47.4, 8.5], atol=1e-9)
    assert flight.session.height_datum == "hae"
    np.testing.assert_allclose(fix.height, 547.5)
    np.testing.assert_allclose(fix.sd_pos[0], [1.2, 1.2, 2.5])
    # Asked for at 10 Hz, but the receiver has 5 epochs a second: repeats are dropped.
    assert np.median(np.diff(fix.t_ns)) == pytest.approx(0.2 * NS, rel=1e-3)
    np.testing.assert_allclose(flight.of("SCALED_PRESSURE", BaroSamples).pressure, 95025.0)
    assert not [s for s in flight.samples if isinstance(s, BaroSamples) and s.source[0] == "H"]
    field = flight.of("HIGHRES_IMU", MagSamples)
    np.testing.assert_allclose(field.field_b[0], [2e-5, -5e-6, 4.3e-5], atol=1e-11)
    measured = {r.message: r.measured_hz for r in flight.session.status(flight.now_ns).rates}
    assert measured["HIGHRES_IMU"] == pytest.approx(100.0, rel=0.05)
    assert measured["SCALED_PRESSURE"] == pytest.approx(10.0, rel=0.1)
    assert flight.kinds() == ["autopilot-found"]
    assert flight.session.counters.bad_bytes == flight.session.counters.lost == 0


def test_a_known_autopilot_needs_no_heartbeat() -> None:
    """Its clock is asked for with its first message, whatever that is."""
    frame = Packer(7, 1).pack(mavlink.MAVLink_scaled_pressure_message(5000, 1000.0, 0.0, 2000))
    for known, found in (((7, 1), True), ((8, 1), False), (None, False)):
        session = MavlinkSession(SessionSettings(known=known))
        session.feed(1, NS, frame)
        assert (session.vehicle is not None) == found
        assert ([e.kind for e in session.events()] == ["autopilot-found"]) == found
        assert len(session.outgoing()) == found  # TIMESYNC
    other = MavlinkSession(SessionSettings(known=(7, 1), system=8))
    other.feed(1, NS, frame)
    assert other.vehicle is None


def test_the_autopilots_solution_is_kept_apart() -> None:
    flight = air()
    flight.run(6.0)
    assert len(flight.references) > 10
    reference = flight.references[-1]
    np.testing.assert_allclose(reference.rpy[0], [0.1, -0.05, 1.0], atol=1e-6)
    np.testing.assert_allclose(reference.vel_n[0], [0.1, -0.2, 0.3])
    np.testing.assert_allclose(reference.height, 547.5)


def test_one_piece_gives_aids_before_inertial_samples() -> None:
    flight = air()
    flight.run(4.0)
    flight.now_ns += NS // 2  # its field and pressure stay the same: until then they are repeats
    boot = flight.autopilot.boot_ns(flight.now_ns)
    names = ("HIGHRES_IMU", "SCALED_PRESSURE", "GPS_RAW_INT")
    frames = [flight.autopilot.packer.pack(flight.autopilot.message(n, boot)) for n in names]
    flight.session.feed(9_999_999, flight.now_ns, b"".join(frames))
    got = flight.session.take()
    assert [type(s) for s in got] == [GnssSamples, BaroSamples, MagSamples, ImuSamples]
    assert {int(s.seq[0]) for s in got} == {9_999_999}


def test_first_vehicle_is_taken_and_others_are_counted() -> None:
    flight = air(system=7)
    stranger = Packer(3, 1)
    flight.run(2.0)
    before = len(flight.samples)
    assert flight.session.status(flight.now_ns).vehicle == (7, 1)
    beat = stranger.pack(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3))
    imu = stranger.pack(mavlink.MAVLink_raw_imu_message(5_000_000, 0, 0, -1000, 0, 0, 0, 0, 0, 0))
    flight.session.feed(10**6, flight.now_ns, beat + imu)
    assert not flight.session.take()
    assert flight.session.counters.foreign >= 2
    flight.run(1.0)
    assert len(flight.samples) > before


def test_configured_vehicle_is_waited_for() -> None:
    flight = air(SessionSettings(system=2), system=7)
    flight.run(3.0)
    assert flight.session.status(flight.now_ns).vehicle is None
    assert not flight.samples


def test_our_frames_are_of_component_191_in_the_vehicles_system() -> None:
    session = MavlinkSession(SessionSettings())
    flight = sim.Air(session, sim.Autopilot(system=7))
    flight.run(1.5)
    session.tick(flight.now_ns + NS)
    decoder = mavlink.MAVLink(None)
    sent = [decoder.parse_char(frame) for frame in session.outgoing()]
    beats = [m for m in sent if m.get_type() == "HEARTBEAT"]
    assert [(m.get_srcSystem(), m.get_srcComponent()) for m in beats] == [(7, 191)]
    assert beats[0].type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER


def test_mavlink_1_is_understood() -> None:
    flight = air()
    flight.autopilot.packer = sim.OldPacker(1, 1)
    assert flight.autopilot.due(flight.now_ns)[0][0] == 0xFE
    flight.run(6.0)
    assert len(flight.of("HIGHRES_IMU", ImuSamples)) > 300
    assert len(flight.of("GPS_RAW_INT", GnssSamples)) > 15
    assert flight.session.status(flight.now_ns).clock == "timesync"


def test_a_refused_rate_is_halved() -> None:
    flight = air(SessionSettings(imu_rate_hz=200.0))
    flight.autopilot.limit_hz = 120.0
    flight.run(12.0)
    assert ("HIGHRES_IMU", 200.0) in flight.autopilot.asked
    assert flight.autopilot.rates["HIGHRES_IMU"] == pytest.approx(100.0)
    assert flight.kinds().count("rate-lowered") == 1


def test_a_refused_message_is_replaced() -> None:
    flight = air()
    flight.autopilot.refused = {"HIGHRES_IMU", "GPS2_RAW"}
    flight.run(12.0)
    imu = flight.of("RAW_IMU", ImuSamples)
    assert np.median(np.diff(imu.t_ns)) == pytest.approx(0.01 * NS, rel=0.05)
    assert "rate-not-delivered" not in flight.kinds()


def test_a_message_that_is_granted_and_never_comes_is_replaced() -> None:
    flight = air()
    flight.autopilot.silent = {"HIGHRES_IMU"}
    flight.run(20.0)
    assert len(flight.of("RAW_IMU", ImuSamples)) > 500
    # Asked once more before it was given up.
    assert [name for name, _ in flight.autopilot.asked].count("HIGHRES_IMU") == 2


def test_an_old_autopilot_is_asked_for_streams() -> None:
    flight = air(SessionSettings(imu_rate_hz=50.0))
    flight.autopilot.knows_intervals = False
    flight.run(30.0)
    assert (mavlink.MAV_DATA_STREAM_RAW_SENSORS, 50) in flight.autopilot.streams
    assert len(flight.of("RAW_IMU", ImuSamples)) > 500


def test_what_is_not_delivered_is_an_event_and_not_a_failure() -> None:
    flight = air(SessionSettings(imu_rate_hz=10.0))
    flight.autopilot.silent = {"SCALED_PRESSURE"}
    flight.run(20.0)
    told = [e for e in flight.events if e.kind == "rate-not-delivered"]
    assert len(told) == 1
    assert "SCALED_PRESSURE comes at 0.0 Hz, asked for 10 Hz" in told[0].text
    flight.autopilot.silent = set()
    flight.run(70.0)
    assert flight.kinds().count("rate-delivered") == 1
    # Meanwhile the pressure in HIGHRES_IMU stood in, ten a second, without what it merely repeats.
    stood_in = flight.of("HIGHRES_IMU", BaroSamples)
    assert len(stood_in) > 10
    assert np.median(np.diff(stood_in.t_ns)) >= HELD_NS - NS // 10
    assert np.diff(stood_in.t_ns).min() > NS // 10 + NS // 20


def test_requests_are_repeated_after_a_silence() -> None:
    flight = air()
    flight.run(8.0)
    flight.autopilot.on = False
    flight.run(8.0)
    assert flight.kinds()[-1] == "autopilot-silent"
    assert not flight.session.status(flight.now_ns).alive
    flight.autopilot.asked.clear()
    flight.autopilot.on = True
    flight.run(6.0)
    assert flight.kinds()[-1] == "autopilot-back"
    assert ("HIGHRES_IMU", 100.0) in flight.autopilot.asked


def test_nothing_is_asked_where_somebody_else_sets_rates() -> None:
    flight = air(SessionSettings(request_rates=False))
    flight.run(8.0)
    assert not flight.autopilot.asked
    assert not flight.autopilot.streams


def test_the_autopilots_timesync_is_answered_with_the_run_clock() -> None:
    flight = air()
    flight.run(3.0)
    request = mavlink.MAVLink_timesync_message(0, 123_456_789)
    flight._send(flight.autopilot.packer.pack(request), True, flight.now_ns)
    asked_ns = flight.now_ns
    flight.run(0.2)
    ((ts1, tc1),) = flight.autopilot.answers
    assert ts1 == 123_456_789
    assert 0 <= tc1 - asked_ns < NS // 10


def test_the_autopilots_origin_is_kept_until_it_restarts() -> None:
    flight = air()
    flight.run(6.0)
    session = flight.session
    assert session.system == 1
    assert session.undulation_m == pytest.approx(47.5)
    assert session.origin is None
    told = mavlink.MAVLink_gps_global_origin_message(473_970_000, 85_450_000, 488_120)
    session.feed(10**9, flight.now_ns, Packer(1, 1).pack(told))
    assert session.origin == (473_970_000, 85_450_000, 488_120)
    flight.autopilot.reboot(flight.now_ns)
    flight.run(6.0)
    assert session.origin is None


def test_the_first_fix_of_a_new_boot_is_not_put_into_the_old_one() -> None:
    flight = air()
    flight.run(20.0)
    session, before = flight.session, flight.session.counters.not_timed
    # 0.3 s after a reboot that nothing else has told of.
    fix = mavlink.MAVLink_gps_raw_int_message(
        300_000, 3, sim.LAT_E7, sim.LON_E7, sim.ALT_MM, 80, 120, 500, 9000, 14
    )
    session.feed(10**9, flight.now_ns, Packer(1, 1).pack(fix))
    assert session.take() == []
    assert session.counters.not_timed == before + 1
    flight.autopilot.reboot(flight.now_ns)
    flight.run(6.0)
    fixes = flight.of("GPS_RAW_INT", GnssSamples)
    assert (fixes.t_rx_ns - fixes.t_ns).max() < NS
    assert fixes.t_ns[-1] > flight.now_ns - NS


def test_a_counter_of_clipped_accelerations_marks_what_follows_it() -> None:
    flight = air()
    flight.run(4.0)
    flight.session.take()
    seq, found = 9_999_999, []
    for count in (3, 3, 4, 4):
        flight.now_ns += NS // 10
        boot = flight.autopilot.boot_ns(flight.now_ns)
        vibration = mavlink.MAVLink_vibration_message(boot // 1000, 1.0, 1.0, 1.0, count, 0, 0)
        inertial = flight.autopilot.message("HIGHRES_IMU", boot)
        frames = [flight.autopilot.packer.pack(m) for m in (vibration, inertial)]
        flight.session.feed(seq, flight.now_ns, b"".join(frames))
        seq += 1
        (imu,) = [s for s in flight.session.take() if isinstance(s, ImuSamples)]
        found += imu.clipped.tolist()
    assert found == [0.0, 0.0, 0.5, 0.0]
