"""A live u-blox receiver: bytes cut anywhere, times on the run's clock, and its own fix."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from companion.gnss.orbit import E_SAT
from companion.types import NS, BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.receiver_session import receiver_session
from drivers.ublox.decoder import UbxDecoder
from replay.simulator.constellation import ephemerides
from replay.simulator.live import ubx

WEEK, TOW = 2300, 604_790.0
RUN_NS = 1_750_000_000 * NS


def _epoch(k: int) -> bytes:
    """Epoch ``k``, five a second, over the turn of the week."""
    total = WEEK * 604_800 + TOW + 0.2 * k
    week, tow = divmod(total, 604_800)
    sats = np.array([101, 105, 230])
    return ubx.rawx(int(week), tow, sats, np.array([2.1e7, 2.3e7, 2.5e7]), np.array([5.0, -3, 1]))


def test_epochs_are_evenly_spaced_on_the_runs_clock_however_they_arrive() -> None:
    session, rng = receiver_session("ublox"), np.random.default_rng(1)
    times = []
    for k in range(200):
        rx = RUN_NS + round(0.2 * k * NS) + 60_000_000 + int(rng.exponential(2e6))
        for s in session.feed(k, rx, _epoch(k)):
            assert isinstance(s, RawGnssSamples)
            assert s.seq[0] == k
            assert s.t_rx_ns[0] == rx
            times.append(int(s.t_ns[0]))
    assert len(times) == 200
    steps = np.array([b - a for a, b in pairwise(times[50:])])
    # The line's jitter is 2 ms; what is left of it is the correction's slew, 0.2 %.
    assert np.abs(steps - 0.2 * NS).max() < 0.0025 * 0.2 * NS
    assert abs(times[-1] - (RUN_NS + round(0.2 * 199 * NS) + 60_000_000)) < 2_000_000


def test_bytes_may_be_cut_anywhere_and_noise_is_counted() -> None:
    whole = b"$GNGGA,1*00\r\n" + _epoch(0) + b"\xb5\x62\x02\x15\xff\xff" + _epoch(1)
    session = receiver_session("ublox")
    found = [s for k, byte in enumerate(whole) for s in session.feed(k, RUN_NS, bytes([byte]))]
    assert len(found) == 2
    assert session.counters["epochs"] == 2
    # An impossible length is no frame: NMEA's 13 bytes, and 6.
    assert session.counters["skipped_bytes"] == 19
    assert session.counters["malformed"] == 0


def test_subframes_make_the_ephemeris_that_was_sent() -> None:
    row = ephemerides((0,), WEEK, 0.0, 10.0)[3]
    session = receiver_session("ublox")
    session.feed(0, RUN_NS, ubx.rawx(WEEK, 30.0, np.array([104]), np.array([2.2e7]), np.zeros(1)))
    found = [s for f in ubx.lnav(row) for s in session.feed(1, RUN_NS, f)]
    assert len(found) == 1
    assert isinstance(found[0], BroadcastSamples)
    values = found[0].values[0]
    assert values[E_SAT] == row[E_SAT]
    # Angles to 2^-31 semicircles, 0.04 m at that radius; √A to 2^-19.
    assert np.abs(values[[5, 6]] - row[[5, 6]]).max() < 1e-5


@pytest.mark.parametrize("raw_first", [True, False])
def test_the_receivers_own_fix_needs_no_raw_measurements(raw_first: bool) -> None:
    session = receiver_session("ublox")
    if raw_first:
        session.feed(
            0, RUN_NS, ubx.rawx(WEEK, 99.8, np.array([104]), np.array([2.2e7]), np.ones(1))
        )
    place, vel = np.array([0.8, 0.2, 420.0]), np.array([3.0, -4.0, 0.5])
    pvt = ubx.nav_pvt(WEEK, 100.0, place, vel, (1.0, 2.0, 0.3))
    [fix] = session.feed(1, RUN_NS + NS // 5, pvt)
    assert isinstance(fix, GnssSamples)
    assert fix.lat[0] == pytest.approx(0.8, abs=1e-9)
    assert fix.height[0] == pytest.approx(420.0, abs=1e-3)
    assert np.allclose(fix.vel_n[0], vel)
    assert fix.fix_type[0] == 3
    assert fix.t_ns[0] == RUN_NS + NS // 5 if not raw_first else abs(fix.t_ns[0] - RUN_NS) < NS


@pytest.mark.parametrize("tow", [604_799.0, 0.0, 5.0, 17.0, 18.0, 30.0])
def test_a_fix_has_the_right_week_while_utc_is_still_in_the_week_before(tow: float) -> None:
    """Its date is UTC, 18 s behind: it turns to Sunday when the second of week is 18 already."""
    found = UbxDecoder().feed(ubx.nav_pvt(WEEK, tow, np.ones(3), np.ones(3), (1.0, 2.0, 0.3)))
    assert [int(s.t_ns[0]) for s in found] == [round((WEEK * 604_800 + tow) * NS)]
