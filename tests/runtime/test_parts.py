"""Small parts of the runtime: clock, latencies, choice of streams, links, systemd."""

from __future__ import annotations

import os
import socket
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from companion.config import CanBus, Config, Gnss, Ground, Imu, Mag, ToAutopilot
from companion.runtime.clock import Reading, RunClock, arrival_ns
from companion.runtime.feeds import make_feeds
from companion.runtime.latency import Latencies
from companion.runtime.links import CanLink
from companion.runtime.systemd import Notifier
from companion.selection import Kind, Selection, Thinner
from companion.types import NS, BaroSamples, ConfigError, ImuSamples, LinkLost, MagSamples
from drivers.can_imu import CanTransport
from drivers.can_imu.transport import ReceivedFrame

from .flights import vehicle

# --------------------------------------------------------------------------- clock


def test_the_run_clock_does_not_follow_a_wall_clock_that_is_set() -> None:
    wall, monotonic = [10**18], [5 * NS]
    clock = RunClock(lambda: wall[0], lambda: monotonic[0])
    assert clock.read() == Reading(10**18, 5 * NS, 10**18)
    monotonic[0] += NS
    wall[0] += 3600 * NS
    assert clock.read().run == 10**18 + NS


def test_kernel_stamps_are_compared_with_the_wall_clock_of_the_moment() -> None:
    now = Reading(run=10**18, monotonic=0, wall=2 * 10**18)
    assert arrival_ns(None, now) == now.run
    assert arrival_ns(now.wall - 300, now) == now.run - 300
    # From the future, or from before the clock was set: not believed.
    assert arrival_ns(now.wall + 1, now) == now.run
    assert arrival_ns(now.wall - 2 * NS, now) == now.run


# --------------------------------------------------------------------------- latencies


def test_latencies_of_the_second_and_of_the_run() -> None:
    latencies = Latencies()
    assert np.isnan(latencies.recent_ms()).all()
    assert np.isnan(latencies.of_run_ms()).all()
    rng = np.random.default_rng(1)
    values = np.exp(rng.normal(13.0, 1.0, 20_000)).astype(np.int64)
    for part in np.split(values, 20):
        for value in part.tolist():
            latencies.add(value)
        assert latencies.recent_ms()[2] == part.max() / 1e6
    p50, p99, worst = latencies.of_run_ms()
    # Steps of the histogram are 1.5 % wide.
    assert p50 == pytest.approx(np.percentile(values, 50) / 1e6, rel=0.02)
    assert p99 == pytest.approx(np.percentile(values, 99) / 1e6, rel=0.02)
    assert worst == values.max() / 1e6


# --------------------------------------------------------------------------- choice of streams


def test_thinning_does_not_depend_on_the_blocks() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.integers(1_000_000, 60_000_000, 500))
    field = rng.normal(size=(500, 3))
    mag = MagSamples("m", t, t, np.arange(500), field)
    whole = Thinner(10.0)(mag)
    thin = Thinner(10.0)
    cuts = [0, *sorted(rng.integers(0, 500, 60).tolist()), 500]
    parts = [thin(mag.take(slice(a, b))).t_ns for a, b in pairwise(cuts)]
    assert np.array_equal(np.concatenate(parts), whole.t_ns)
    assert 100 < len(whole) < 400


def _stream(source: str, rate_hz: float, start_s: float, end_s: float) -> list[ImuSamples]:
    t = (np.arange(start_s, end_s, 1.0 / rate_hz) * NS).astype(np.int64)
    zero, nan = np.zeros((1, 3)), np.full(1, np.nan)
    return [
        ImuSamples(source, t[i : i + 1], t[i : i + 1], t[i : i + 1], zero, zero, nan)
        for i in range(len(t))
    ]


def _used(selection: Selection, blocks: list[ImuSamples]) -> list[str]:
    ordered = sorted(blocks, key=lambda b: int(b.t_rx_ns[0]))
    return [b.source for b in ordered if selection.offer(b) is not None]


def test_of_an_autopilots_streams_the_preferred_one_that_is_fast_enough() -> None:
    preferred = {"imu": ("HIGHRES_IMU", "RAW_IMU")}
    both = [*_stream("RAW_IMU", 50, 0, 5), *_stream("HIGHRES_IMU", 50, 0.5, 5)]
    assert set(_used(Selection(Config(), preferred=preferred), both)) == {"HIGHRES_IMU"}
    slow = [*_stream("RAW_IMU", 50, 0, 5), *_stream("HIGHRES_IMU", 5, 0, 5)]
    assert set(_used(Selection(Config(), preferred=preferred), slow)) == {"RAW_IMU"}
    assert _used(Selection(Config(), preferred=preferred), _stream("RAW_IMU", 10, 0, 9)) == []


def test_a_stream_that_speeds_up_is_taken_when_it_has() -> None:
    selection = Selection(Config(), preferred={})
    blocks = [*_stream("RAW_IMU", 4, 0, 10), *_stream("RAW_IMU", 50, 10, 15)]
    used = _used(selection, blocks)
    assert 100 < len(used) < 250
    assert selection.chosen[0].first_seq > 10 * NS


def test_what_an_earlier_run_used_is_used_at_once_if_it_is_good() -> None:
    known: dict[Kind, str] = {"imu": "RAW_IMU", "gnss": "GPS2_RAW"}
    preferred = {"imu": ("HIGHRES_IMU", "RAW_IMU")}
    both = [*_stream("RAW_IMU", 50, 0, 5), *_stream("HIGHRES_IMU", 50, 0, 5)]
    used = _used(Selection(Config(), preferred=preferred, known=known), both)
    assert set(used) == {"RAW_IMU"}
    assert len(used) > 240  # of 250: what it takes to see that it is fast enough
    slow = [*_stream("RAW_IMU", 4, 0, 5), *_stream("HIGHRES_IMU", 50, 0, 5)]
    selection = Selection(Config(), preferred=preferred, known=known)
    assert set(_used(selection, slow)) == {"HIGHRES_IMU"}
    fix = vehicle()[0].gnss[0].take(slice(0, 1))
    blind = replace(fix, source="GPS2_RAW", fix_type=np.zeros(1, np.int64))
    assert selection.offer(blind) is None
    assert selection.offer(replace(fix, source="GPS2_RAW")) is not None


def test_a_named_or_configured_imu_is_used_at_once_and_no_other() -> None:
    both = [*_stream("a", 50, 0, 5), *_stream("b", 50, 0, 5)]
    named = Config(imu=Imu(source="b"))
    assert len(_used(Selection(named, imu="a", preferred={}), both)) == 250
    assert set(_used(Selection(Config(), imu="a", preferred={}), both)) == {"a"}


def test_what_is_switched_off_is_never_used() -> None:
    mag = MagSamples("m", *[np.array([NS])] * 3, np.ones((1, 3)))
    assert Selection(Config(mag=Mag(use=False)), preferred={}).offer(mag) is None


def test_the_first_receiver_with_a_fix_is_used() -> None:
    gnss = vehicle()[0].gnss[0]
    blind = replace(gnss, source="GPS2_RAW", fix_type=np.zeros(len(gnss), np.int64))
    selection = Selection(Config(), preferred={"gnss": ("GPS2_RAW", "GPS_RAW_INT")})
    for i in range(len(gnss)):
        assert selection.offer(blind.take(slice(i, i + 1))) is None
        selection.offer(gnss.take(slice(i, i + 1)))
    assert [c.source for c in selection.chosen] == ["GPS_RAW_INT"]
    named = Selection(Config(gnss=Gnss(source="GPS2_RAW")), preferred={})
    assert named.offer(blind.take(slice(0, 1))) is not None


def test_empty_blocks_choose_nothing() -> None:
    empty = BaroSamples("b", *[np.zeros(0, np.int64)] * 3, np.zeros(0))
    selection = Selection(Config(), preferred={})
    assert selection.offer(empty) is None
    assert selection.chosen == []


# --------------------------------------------------------------------------- links


class FakeBus(CanTransport):
    """A bus that can be unplugged."""

    def __init__(self) -> None:
        super().__init__("fake")
        self.gone = False
        self._pair = socket.socketpair()

    def fileno(self) -> int:
        return self._pair[0].fileno()

    def receive(self) -> list[ReceivedFrame]:
        if self.gone:
            raise LinkLost("fake: unplugged")
        return [ReceivedFrame(1, False, b"x", None)]

    def send(self, frames: object) -> None:
        raise NotImplementedError

    def close(self) -> None:
        for end in self._pair:
            end.close()


def test_a_bus_that_is_unplugged_and_plugged_in_again() -> None:
    plugged = [FakeBus()]

    def opener(_: CanBus) -> CanTransport:
        if plugged[0].gone:
            raise LinkLost("fake: not there")
        return plugged[0]

    link = CanLink(CanBus(channel="fake"), opener)
    now = Reading(0, 0, 0)
    link.open_first(0)
    assert link.fileno() is not None
    assert [f.data for f in link.read(now)] == [b"x"]
    plugged[0].gone = True
    assert link.read(now) == []
    assert link.fileno() is None
    assert link.read(now) == []

    def poll_until(state: str) -> bool:
        at = 0
        while True:  # each attempt is a thread's, and ends at once here
            at += NS
            opened = link.poll(at)
            found = link.changes()
            states.extend(found)
            if any(s == state for s, _ in found):
                return opened

    states: list[tuple[str, str]] = []
    assert not poll_until("retrying")
    plugged[0] = FakeBus()
    assert poll_until("up")
    assert states == [
        ("up", ""),
        ("lost", "fake: unplugged"),
        ("retrying", "fake: not there"),
        ("up", ""),
    ]
    assert link.fileno() == plugged[0].fileno()
    link.close()


def test_a_bus_that_can_never_be_opened_is_said_at_once() -> None:
    link = CanLink(CanBus(channel="x", interface="no-such-interface"))
    with pytest.raises(ConfigError, match="no-such-interface"):
        link.open_first(0)


# --------------------------------------------------------------------------- systemd


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_hears_the_process(tmp_path: Path, abstract: bool) -> None:
    name = f"@companion-test-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind("\0" + name[1:] if abstract else name)
        server.settimeout(20)
        environment = {"NOTIFY_SOCKET": name, "WATCHDOG_USEC": "3000000"}
        notifier = Notifier(environment)
        assert notifier.watchdog_ns == 1_500_000_000
        notifier.ready()
        notifier.alive()
        notifier.status("two\nlines")
        notifier.stopping()
        told = [server.recv(100) for _ in range(4)]
        notifier.close()
    assert told == [b"READY=1", b"WATCHDOG=1", b"STATUS=two lines", b"STOPPING=1"]


def test_without_systemd_nothing_is_said(tmp_path: Path) -> None:
    silent = Notifier({})
    silent.ready()
    silent.alive()
    gone = Notifier({"NOTIFY_SOCKET": str(tmp_path / "nobody"), "WATCHDOG_USEC": "nonsense"})
    gone.ready()
    assert gone.watchdog_ns == 0
    assert Notifier({"WATCHDOG_USEC": "1000", "WATCHDOG_PID": "1"}).watchdog_ns == 0


# --------------------------------------------------------------------------- feeds


def test_feeds_that_need_the_autopilots_link_say_so() -> None:
    for config in (
        Config(to_autopilot=ToAutopilot(message="gps-input")),
        Config(ground=Ground(endpoint="autopilot")),
    ):
        with pytest.raises(ConfigError, match="needs the autopilot's link"):
            make_feeds(config, Path(), None, 0)
    assert list(make_feeds(Config(), Path(), None, 0).publishers) == []


def test_a_ground_station_gets_a_link_of_its_own() -> None:
    feeds = make_feeds(Config(ground=Ground(endpoint="udpin:127.0.0.1:0")), Path(), None, 0)
    assert len(feeds.publishers) == 1
    assert feeds.ground is not None
    feeds.ground.close()
