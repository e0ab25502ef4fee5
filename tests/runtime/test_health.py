"""States of sensors and links on simulated time, and what is said about them."""

from __future__ import annotations

from companion.config import Live
from companion.runtime.health import HealthMonitor
from companion.selection import Kind
from companion.types import NS, Event, Health, LogHealth, LoopHealth, Mode

LOOP = LoopHealth(0.1, 1.0, 2.0, 3.0, 4.0)
LOG = LogHealth("writing")
T0 = 1_700_000_000 * NS


class Bench:
    """A monitor with sensors that send at a rate while they are switched on."""

    def __init__(self, **rates: float) -> None:
        self.monitor = HealthMonitor("v", Live(), T0)
        self.now = T0
        self.rates: dict[str, float] = dict(rates)
        self.events: list[Event] = []
        self.unused: set[str] = set()
        self.fix = True
        self._due = dict.fromkeys(rates, float(T0))

    def pass_time(self, seconds: float, **changed: float) -> list[str]:
        """Ticks at 10 Hz and arrivals between them; the kinds of events that came of it."""
        self.rates.update(changed)
        before = len(self.events)
        for _ in range(round(seconds * 10)):
            self.now += NS // 10
            for kind, rate in self.rates.items():
                if not rate:
                    self._due[kind] = self.now
                while rate and self._due[kind] + NS / rate <= self.now:
                    self._due[kind] += NS / rate
                    good = self.fix or _kind(kind) != "gnss"
                    self.monitor.arrived(_kind(kind), kind, 1, int(self._due[kind]), good)
            self.events += self.monitor.tick(self.now, self.uses)
        return [e.kind for e in self.events[before:]]

    def uses(self, _kind: Kind, source: str) -> bool:
        return source not in self.unused

    def report(self, mode: Mode = Mode.NAVIGATING, log: LogHealth = LOG) -> Health:
        return self.monitor.report(self.now, mode, self.uses, lambda _: (3, 1), LOOP, log, {"x": 1})


def _kind(name: str) -> Kind:
    return "imu" if name.startswith("imu") else "gnss"


def test_from_waiting_to_ok() -> None:
    bench = Bench(imu=100.0)
    assert bench.pass_time(3.0) == ["imu-heard"]
    (imu,) = bench.report().sensors
    assert (imu.state, imu.used, imu.lost, imu.saturated) == ("ok", True, 3, 1)
    assert abs(imu.rate_hz - 100.0) < 1.0
    assert imu.age_s < 0.05
    report = bench.report()
    assert (report.level, report.text) == ("ok", "navigating")
    assert report.uptime_s == 3.0
    assert report.counters == {"x": 1}


def test_silence_and_return() -> None:
    bench = Bench(imu=100.0)
    bench.pass_time(3.0)
    assert bench.pass_time(0.4, imu=0.0) == []
    assert bench.pass_time(3.0) == ["imu-silent"]
    assert bench.report().level == "error"
    assert "IMU imu silent" in bench.report().text
    assert bench.report().sensors[0].rate_hz == 0.0
    assert bench.pass_time(1.0, imu=100.0) == ["imu-back"]
    assert "back after 3." in bench.events[-1].text
    assert bench.report().sensors[0].state == "back"
    assert bench.pass_time(3.0) == []
    assert bench.report().sensors[0].state == "ok"


def test_a_slow_sensor() -> None:
    bench = Bench(imu=100.0)
    bench.pass_time(5.0)
    assert bench.pass_time(4.0, imu=50.0) == ["imu-slow"]
    assert bench.report().level == "warning"
    assert bench.pass_time(4.0, imu=100.0) == []
    assert bench.report().sensors[0].state == "ok"


def test_the_configured_rate_counts_from_the_start() -> None:
    bench = Bench(imu=50.0)
    bench.monitor.expect("imu", "imu", 100.0)
    assert bench.pass_time(4.0) == ["imu-heard", "imu-slow"]


def test_a_configured_sensor_that_never_comes() -> None:
    bench = Bench()
    bench.monitor.expect("imu", "imu")
    assert bench.pass_time(20.0) == ["imu-missing"]
    report = bench.report(Mode.ALIGNING)
    assert report.sensors[0].state == "waiting"
    assert report.level == "error"


def test_a_slow_receiver_has_a_longer_time_out() -> None:
    bench = Bench(gnss=1.0)
    assert bench.pass_time(10.0) == ["gnss-heard"]
    assert bench.pass_time(4.0, gnss=0.0) == ["gnss-silent"]


def test_a_receiver_without_a_fix() -> None:
    bench = Bench(imu=100.0, gnss=5.0)
    bench.pass_time(3.0)
    bench.fix = False
    assert bench.pass_time(1.0) == []
    assert bench.pass_time(3.0) == ["gnss-no-fix"]
    report = bench.report()
    assert (report.level, report.text) == ("warning", "GNSS gnss without a fix")
    assert report.sensors[1].rate_hz > 4.0
    bench.unused.add("gnss")  # as at a start: the estimator takes it once it has a fix
    assert "without a fix" in bench.report(Mode.ALIGNING).text
    bench.fix = True
    assert bench.pass_time(1.0) == []
    assert bench.report().sensors[1].state == "ok"


def test_a_stream_that_nobody_uses_may_come_and_go() -> None:
    bench = Bench(imu=100.0, imu2=2.0, imu3=50.0)
    bench.unused |= {"imu2", "imu3"}
    bench.monitor.expect("imu", "imu3")
    bench.pass_time(3.0)
    assert bench.pass_time(3.0, imu2=0.0) == []
    assert [s.state for s in bench.report().sensors if s.source == "imu2"] == ["silent"]
    assert bench.report().level == "ok"
    # A unit of the configuration is missed, but the estimator does not depend on it.
    assert bench.pass_time(3.0, imu3=0.0) == ["imu-silent"]
    assert bench.events[-1].level == "warning"


def test_links() -> None:
    bench = Bench(imu=100.0)
    m = bench.monitor
    told = [
        m.link("can0", "up", "", T0),
        m.link("can0", "lost", "unplugged", T0),
        m.link("can0", "retrying", "not there", T0),
        m.link("can0", "up", "", T0),
        m.link("mavlink", "retrying", "refused", T0),
    ]
    assert [e.kind if e else None for e in told] == [
        "link-up",
        "link-lost",
        None,
        "link-up",
        "link-lost",
    ]
    m.traffic("can0", 1000, 3)
    can, mavlink = bench.report().links
    assert (can.state, can.reopened, can.received, can.malformed) == ("up", 1, 1000, 3)
    assert (mavlink.state, mavlink.note) == ("retrying", "refused")
    bench.pass_time(3.0)
    assert bench.report().text == "mavlink retrying"


def test_modes_and_the_log_in_the_verdict() -> None:
    bench = Bench(imu=100.0)
    bench.pass_time(3.0)
    assert bench.report(Mode.COASTING).text == "coasting"
    assert bench.report(Mode.HEADING_UNKNOWN).level == "warning"
    assert bench.report(Mode.ALIGNING).level == "error"
    assert bench.report(log=LogHealth("stopped")).text == "log stopped"


def test_without_any_imu() -> None:
    assert "no IMU" in Bench().report().text
