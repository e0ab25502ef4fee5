"""The loop: waits on all links and the clock, and hands what comes to the core. Thin.

One thread does everything that the estimator depends on; whatever could wait (disk, adapters,
sessions, terminals) is done behind its back by others.
"""

from __future__ import annotations

import contextlib
import selectors
import signal
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from types import FrameType

from companion.outputs.ground_link import GroundLink
from companion.outputs.publisher import Publisher
from companion.runtime.background import BackgroundFile
from companion.runtime.clock import Reading, RunClock
from companion.runtime.core import MAVLINK_LINK, Core
from companion.runtime.latency import Latencies
from companion.runtime.links import CanLink
from companion.runtime.systemd import Notifier
from companion.types import NS, Event, Health, LoopHealth, Outputs
from drivers.mavlink.link import ReopeningLink
from drivers.mavlink.session import MavlinkSession

HEALTH_NS = NS
SAVE_NS = NS
"""What was learned is kept this often."""


class Stop:
    """SIGINT and SIGTERM end the loop; a second one ends the process, whatever it is doing."""

    def __init__(self) -> None:
        self.asked = False
        self._ours, self._theirs = socket.socketpair()
        self._ours.setblocking(False)
        self._theirs.setblocking(False)

    def fileno(self) -> int:
        """Becomes readable at a signal."""
        return self._ours.fileno()

    def ask(self) -> None:
        """End the loop; from any thread."""
        self.asked = True
        with contextlib.suppress(OSError):
            self._theirs.send(b"\0")

    @contextlib.contextmanager
    def on_signals(self) -> Iterator[None]:
        """Catch the signals inside the block; only in the main thread."""
        before = {s: signal.signal(s, self._caught) for s in (signal.SIGINT, signal.SIGTERM)}
        # Python runs a handler between two bytecodes only: this is what ends a wait.
        wakeup = signal.set_wakeup_fd(self._theirs.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(wakeup)
            for number, handler in before.items():
                signal.signal(number, handler)

    def _caught(self, number: int, _frame: FrameType | None) -> None:
        self.asked = True
        signal.signal(number, signal.SIG_DFL)


@dataclass(slots=True)
class Parts:
    """What the loop brings together."""

    clock: RunClock
    buses: Sequence[CanLink]
    autopilot: ReopeningLink | None
    session: MavlinkSession | None
    publishers: Sequence[Publisher]
    receiver: ReopeningLink | None
    ground: GroundLink | None
    log: BackgroundFile
    notifier: Notifier
    stop: Stop


class Loop:
    """Runs a core until it is stopped or its time is over."""

    def __init__(self, parts: Parts, tick_hz: float) -> None:
        self.latencies = Latencies()
        self.core: Core
        self._p = parts
        self._tick_ns = round(NS / tick_hz)
        self._selector = selectors.DefaultSelector()
        self._registered: dict[str, int] = {}
        self._arrival_ns = 0
        self._refused = ""
        self._stall_ns = self.longest_stall_ns = 0
        self._cpu_s, self._cpu_at_ns = time.process_time(), 0
        self._ready = False

    # ------------------------------------------------------------------ for the core

    def publish(self, out: Outputs) -> None:
        """What an engine step gave out, to everybody, and how long it took since the arrival."""
        some = len(out.published) or len(out.reports) or len(out.smoothed) or len(out.satellites)
        if some or out.events or out.members:
            for publisher in self._p.publishers:
                publisher.publish(out, self._arrival_ns)
        if len(out.smoothed):
            return  # late by design
        self.latencies.add(self._p.clock.read().monotonic - self._arrival_ns)

    def announce(self, event: Event) -> None:
        """An event of the process."""
        for publisher in self._p.publishers:
            publisher.event(event)

    # ------------------------------------------------------------------ the loop

    def run(self, core: Core, seconds: float | None, save: Callable[[], None]) -> None:
        """Go on until a signal, or for ``seconds``.

        ``save`` is called once a second to keep what was learned; it must return at once.
        """
        self.core = core
        p = self._p
        now = p.clock.read()
        begun = now.monotonic
        end = begun + round(seconds * NS) if seconds is not None else None
        tick = begun
        health, keep = begun + HEALTH_NS, begun + SAVE_NS
        self._cpu_at_ns = begun
        self._selector.register(p.stop.fileno(), selectors.EVENT_READ, None)
        for bus in p.buses:
            self._watch(bus, opened=True)
        while not p.stop.asked and (end is None or now.monotonic < end):
            if now.monotonic >= tick:
                self._tick(now)
                # Ticks that were missed are not made up for.
                tick += self._tick_ns * (1 + (now.monotonic - tick) // self._tick_ns)
            if now.monotonic >= health:
                self._report(now)
                health = now.monotonic + HEALTH_NS
            if now.monotonic >= keep:
                save()
                keep = now.monotonic + SAVE_NS
            self._wait(min(tick, end) if end is not None else tick)
            now = p.clock.read()
        self._report(now)

    def _wait(self, until_ns: int) -> None:
        """Sleep until something arrives or it is time, and take what arrived."""
        clock = self._p.clock
        looked = clock.read().monotonic
        found = self._selector.select(max(0.0, (until_ns - looked) / NS))
        worked = clock.read().monotonic
        # Buses first: their frames may carry stamps from before the others were read.
        links = [key.data for key, _ in found if key.data is not None]
        for bus in links:
            if isinstance(bus, CanLink):
                self._read_bus(bus)
        for link in links:
            if isinstance(link, ReopeningLink):
                own = link is self._p.receiver
                self._read_stream(link, self.core.receiver if own else self.core.mavlink)
        self._send()
        self._stall_ns = max(self._stall_ns, clock.read().monotonic - worked)

    def _read_bus(self, bus: CanLink) -> None:
        now = self._p.clock.read()
        frames = bus.read(now)
        if frames:
            # By a kernel stamp the newest frame may be older than the look at the bus.
            self._arrival_ns = now.monotonic - (now.run - frames[-1].t_rx_ns)
            self.core.can(bus.name, frames)
        else:
            self._watch(bus)

    def _read_stream(self, link: ReopeningLink, take: Callable[[int, bytes], None]) -> None:
        now = self._p.clock.read()
        pieces = link.read(now.run)
        for piece in pieces:
            self._arrival_ns = now.monotonic
            take(now.run, piece)
        if not pieces:
            self._watch(link)

    def _send(self) -> None:
        """What the session wants to say; a link that takes nothing loses it."""
        if self._p.session is not None and self._p.autopilot is not None:
            for frame in self._p.session.outgoing():
                self._p.autopilot.write(frame)

    # ------------------------------------------------------------------ now and then

    def _tick(self, now: Reading) -> None:
        p = self._p
        for bus in p.buses:
            self._watch(bus, opened=bus.poll(now.run))
            for state, note in bus.changes():
                self.core.link(bus.name, state, note, now.run)
        if p.autopilot is not None and p.session is not None:
            opened = p.autopilot.poll(now.run)
            if opened:
                p.session.reopened()
            self._watch(p.autopilot, opened=opened)
            for state, note in p.autopilot.changes():
                self.core.link(MAVLINK_LINK, state, note, now.run)
        if p.receiver is not None:
            self._watch(p.receiver, opened=p.receiver.poll(now.run))
            for state, note in p.receiver.changes():
                self.core.link(self.core.receiver_link, state, note, now.run)
        self.core.tick(now)
        self._send()
        self._note_log(now)
        self._note_outputs(now)
        if not self._ready:
            self._ready = True
            p.notifier.ready()
        p.notifier.alive()

    def _watch(self, link: CanLink | ReopeningLink, opened: bool = False) -> None:
        """Wait on a link's descriptor as long as it has one."""
        fd = link.fileno()
        known = self._registered.get(link.name)
        if known is not None and (opened or fd is None):
            # The number may be in use again already, by this link or another one.
            with contextlib.suppress(KeyError, ValueError, OSError):
                self._selector.unregister(known)
            del self._registered[link.name]
            known = None
        if fd is not None and known is None:
            self._selector.register(fd, selectors.EVENT_READ, link)
            self._registered[link.name] = fd

    def _note_outputs(self, now: Reading) -> None:
        """Make events of what happened to the outputs."""
        p = self._p
        notices = [notice for publisher in p.publishers for notice in publisher.notices()]
        if p.ground is not None:
            p.ground.tick(now.run, p.session.system if p.session is not None else 0)
            notices += p.ground.notices()
        for notice in notices:
            self.core.event(Event(now.run, notice.kind, notice.text, notice.level))

    def _note_log(self, now: Reading) -> None:
        """Say it when the disk stops to take the log, and when it does again."""
        refused = self._p.log.refused
        if bool(refused) == bool(self._refused):
            return
        self._refused = refused
        if refused:
            text = f"the log cannot be written: {refused}; what comes is held in memory for now"
            self.core.event(Event(now.run, "log-stopped", text, "error"))
        else:
            lost = self._p.log.health().dropped_bytes
            text = "the log is written again" + (f", {lost} bytes of it are lost" if lost else "")
            self.core.event(Event(now.run, "log-resumed", text, "warning" if lost else "info"))

    def _report(self, now: Reading) -> None:
        """Health, to everybody and into the log."""
        p = self._p
        cpu = time.process_time()
        span_s = (now.monotonic - self._cpu_at_ns) / NS
        load = (cpu - self._cpu_s) / span_s if span_s > 0 else 0.0
        self._cpu_s, self._cpu_at_ns = cpu, now.monotonic
        p50, p99, worst = self.latencies.recent_ms()
        stall, self._stall_ns = self._stall_ns, 0
        self.longest_stall_ns = max(self.longest_stall_ns, stall)
        loop = LoopHealth(load, p50, p99, worst, stall / 1e6)
        malformed = {bus.name: bus.malformed() for bus in p.buses}
        report: Health = self.core.health(now.run, loop, p.log.health(), malformed)
        for publisher in p.publishers:
            publisher.health(report)
        self.core.log_health(report)
        p.notifier.status(f"{report.level}: {report.text}")
