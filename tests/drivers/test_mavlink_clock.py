"""The match of clocks: error against true time, no steps, restarts, autopilots without TIMESYNC.

The errors are printed (``pytest -s``); the limits are the driver's promise of a millisecond.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from companion.types import F64, NS, GnssSamples, ImuSamples
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.session import MavlinkSession, SessionSettings
from drivers.mavlink.timesync import TimeSync

from . import autopilot as sim

IMU_HZ = 20.0
"""Slow enough that the true time nearest to a stamp is that of the sample: 25 ms to spare."""


def flown(seconds: float, pilot: sim.Autopilot) -> sim.Air:
    """A flight with nothing but what the clock needs."""
    settings = SessionSettings(
        imu_rate_hz=IMU_HZ, gnss_rate_hz=0, baro_rate_hz=0, reference_rate_hz=0
    )
    air = sim.Air(MavlinkSession(settings), pilot)
    air.run(seconds)
    return air


def errors_ms(air: sim.Air) -> F64:
    """(N,) stamped minus true time of the inertial samples."""
    stamped = air.of("HIGHRES_IMU", ImuSamples).t_ns
    true = np.array(air.autopilot.sampled_ns)
    at = np.clip(np.searchsorted(true, stamped), 1, len(true) - 1)
    near = np.where(stamped - true[at - 1] < true[at] - stamped, true[at - 1], true[at])
    return (stamped - near) * 1e-6


def described(error: F64) -> str:
    """Mean, deviation and worst of errors [ms]."""
    return f"mean {error.mean():+.3f}, sd {error.std():.3f}, worst {np.abs(error).max():.3f} ms"


@pytest.mark.parametrize(
    ("there", "back", "drift_ppm"),
    [
        (sim.PROMPT, sim.PROMPT, 0.0),
        (sim.jitter(0.001, 0.002), sim.jitter(0.001, 0.010), 50.0),
        (sim.jitter(0.001, 0.010), sim.jitter(0.001, 0.002), -50.0),
    ],
    ids=["prompt", "slow back, +50 ppm", "slow there, -50 ppm"],
)
def test_error_with_jitter_that_differs_both_ways(
    there: sim.Delay, back: sim.Delay, drift_ppm: float
) -> None:
    air = flown(90.0, sim.Autopilot(to_it=there, to_us=back, drift_ppm=drift_ppm))
    error = errors_ms(air)
    settled = error[len(error) // 3 :]
    status = air.session.status(air.now_ns)
    print(f"\nfrom the start: {described(error)}; after 30 s: {described(settled)}")
    print(f"claimed sd {status.clock_sd_ms:.3f} ms, drift {status.drift_ppm:+.1f} ppm")
    assert np.abs(settled).max() < 1.0
    assert np.abs(error).max() < 3.0
    assert status.clock == "timesync"
    assert status.drift_ppm == pytest.approx(-drift_ppm, abs=20.0)


def test_time_never_steps_and_never_goes_back() -> None:
    air = flown(60.0, sim.Autopilot(to_us=sim.jitter(0.001, 0.02), drift_ppm=50.0))
    stamped = air.of("HIGHRES_IMU", ImuSamples).t_ns
    # Sent every 50 ms of true time to the millisecond; 2 ms a second is the fastest turn.
    steps = np.diff(stamped) - np.diff(np.array(air.autopilot.sampled_ns))[-len(stamped) + 1 :]
    print(f"\nlargest change of an interval {np.abs(steps).max() * 1e-6:.3f} ms")
    assert np.abs(steps).max() < 0.2e6


def test_without_timesync_the_fastest_arrivals_count() -> None:
    pilot = sim.Autopilot(timesync=False, to_us=sim.jitter(0.002, 0.004), drift_ppm=50.0)
    air = flown(90.0, pilot)
    error = errors_ms(air)[600:]
    print(f"\nafter 30 s: {described(error)} of which 2 ms are the shortest way")
    assert air.session.status(air.now_ns).clock == "arrival"
    # Late by the shortest way, and by what the fastest of a second's twenty exceed it.
    assert error.min() > 1.0
    assert error.max() < 4.0


def test_timesync_that_answers_later_is_turned_to_and_not_stepped_to() -> None:
    pilot = sim.Autopilot(timesync=False, to_us=sim.jitter(0.020, 0.002))
    air = flown(10.0, pilot)
    pilot.timesync = True
    pilot.to_it = sim.jitter(0.020, 0.002)
    before = errors_ms(air)[-1]
    air.run(40.0)
    error = errors_ms(air)
    print(f"\nby arrivals {before:+.2f} ms, by TIMESYNC {error[-1]:+.3f} ms")
    assert before > 15.0
    assert abs(error[-1]) < 1.0
    assert np.abs(np.diff(error)).max() < 0.25


def test_restart_of_the_autopilot_is_a_new_match() -> None:
    pilot = sim.Autopilot(drift_ppm=50.0, to_us=sim.jitter(0.001, 0.005))
    air = flown(40.0, pilot)
    for _ in range(2):
        pilot.on = False
        air.run(3.0)
        pilot.reboot(air.now_ns)
        pilot.on = True
        air.run(40.0)
    assert air.kinds().count("autopilot-restarted") == 2
    assert air.session.status(air.now_ns).restarts == 2
    stamped = air.of("HIGHRES_IMU", ImuSamples).t_ns
    assert (np.diff(stamped) > 0).all()
    error = errors_ms(air)
    print(f"\nwith two restarts: {described(error)}")
    assert np.abs(error).max() < 3.0
    # All was asked for again: the rate after the restart is that of before.
    assert stamped[-1] - stamped[-int(10 * IMU_HZ)] == pytest.approx(10 * NS, rel=0.02)


def test_one_stray_stamp_is_no_restart() -> None:
    pilot = sim.Autopilot()
    air = flown(5.0, pilot)
    for boot_ns in (10**9, 10**15):
        frame = pilot.packer.pack(pilot.message("HIGHRES_IMU", boot_ns))
        air.session.feed(10**6, air.now_ns, frame)
        air.run(1.0)
    assert air.session.clock.restarts == 0
    assert np.abs(errors_ms(air)).max() < 3.0


def test_a_link_that_stalls_does_not_move_the_clock() -> None:
    pilot = sim.Autopilot()
    air = flown(20.0, pilot)
    pilot.to_us = sim.jitter(1.5, 0.01)
    air.run(10.0)
    pilot.to_us = sim.PROMPT
    air.run(20.0)
    assert air.session.clock.restarts == 0
    assert np.abs(errors_ms(air)).max() < 3.0


def test_answers_to_others_are_refused() -> None:
    sync = TimeSync()
    asked = sync.request(sim.START_NS)
    assert asked == sim.START_NS
    assert sync.request(sim.START_NS + 1) is None
    assert not sync.answer(5 * NS, sim.START_NS - 7, sim.START_NS + NS // 100)
    assert not sync.answer(5 * NS, asked, asked + 2 * NS)
    assert sync.refused == 2
    assert sync.answer(5 * NS, asked, asked + NS // 100)
    assert len(sync) == 1


def test_timesync_of_another_clock_than_the_stamps_says_nothing() -> None:
    clock = BootClock()
    now = sim.START_NS
    for step in range(40):
        now = sim.START_NS + step * NS // 10
        clock.observe(20_000_000 + step * 100_000, now)
        asked = clock.sync.request(now)
        if asked is not None:
            clock.answered(now, asked, now + 1_000_000)  # Unix time instead of time since boot
        clock.update(now)
    assert clock.ready
    assert clock.source == "arrival"
    assert clock.sync.refused > 10


def test_memory_of_the_match_is_bounded() -> None:
    clock = BootClock()
    for step in range(4_000):
        now = sim.START_NS + step * NS // 10
        clock.observe(20_000_000 + step * 100_000, now)
        asked = clock.sync.request(now)
        if asked is not None:
            clock.answered(20 * NS + step * NS // 10, asked, now + 1_000_000)
        clock.update(now)
    assert len(clock.sync) < 300
    sizes = itertools.chain(clock._pieces, clock._envelope._least)
    assert len(list(sizes)) < 100


def test_fixes_keep_their_own_older_stamp() -> None:
    pilot = sim.Autopilot()
    air = sim.Air(MavlinkSession(SessionSettings(gnss_rate_hz=7.0)), pilot)
    air.run(6.0)
    # An epoch every 200 ms of the autopilot's clock, sent up to 143 ms later.
    fix = air.of("GPS_RAW_INT", GnssSamples)
    assert np.median(np.diff(fix.t_ns)) == pytest.approx(0.2 * NS, abs=1e5)
    assert np.ptp(fix.t_rx_ns - fix.t_ns) > 0.05 * NS
