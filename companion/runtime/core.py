"""Everything between "these bytes arrived at that time" and "this came out". Pure.

Each thing that arrives (CAN frame, MAVLink chunk, tick) gets the next number, is logged, decoded,
and its samples step the engine. No clock and no socket: time is an argument. So a run on simulated
time is a run, and the log of a run, replayed, gives the same bits again.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Literal, NamedTuple, Protocol

from companion.bank import Bank, navigator
from companion.config import Config
from companion.estimation.gnss_latency import GnssLatencyEstimator
from companion.logbook import LogWriter
from companion.outlet import NOTHING
from companion.runtime.clock import Reading
from companion.runtime.health import HealthMonitor, usable
from companion.runtime.smoothing_pace import SmoothingPace, Stopwatch
from companion.selection import KINDS, Kind, Selection
from companion.types import (
    NS,
    SMOOTHING_GAVE_WAY,
    SMOOTHING_RESUMED,
    AnySamples,
    BroadcastSamples,
    Event,
    Health,
    ImuSamples,
    LinkState,
    LogHealth,
    LoopHealth,
    Mode,
    Outputs,
    ReferenceSamples,
    Solution,
)

CHECKPOINT_NS = 10 * NS
"""Digests go into the log this often: a run that is killed can be checked up to there."""
REFERENCE_NS = NS
"""The autopilot's own solution is logged in blocks this long."""
TICK_LINK = "tick"
MAVLINK_LINK = "mavlink"
CAN_FRAME = struct.Struct("<IB3x")
"""A logged CAN frame: identifier, length, then the data, as Linux lays out ``struct can_frame``."""
EXTENDED = 0x8000_0000
"""Flag of a 29-bit identifier in it."""
CLOCKS = struct.Struct("<qq")
"""A logged tick: wall clock and CLOCK_MONOTONIC [ns] at its time."""


class CanArrival(NamedTuple):
    """A CAN data frame with its arrival on the run's clock."""

    t_rx_ns: int
    can_id: int
    extended: bool
    data: bytes


class Decoder(Protocol):
    """What the core asks of a CAN IMU driver."""

    source: str

    @property
    def counters(self) -> Any:
        """Dataclass of counters; ``lost``, ``malformed`` and ``saturated`` among them."""

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """Take a frame; whether it was the unit's."""

    def take(self) -> ImuSamples | None:
        """Samples completed since the last call."""


class Session(Protocol):
    """What the core asks of the MAVLink driver."""

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> None:
        """Take bytes as they arrived."""

    def tick(self, now_ns: int) -> None:
        """Let time pass: heartbeats, requests, time-outs."""

    def take(self) -> Sequence[AnySamples]:
        """Samples decoded since the last call, aids before inertial ones."""

    def references(self) -> Sequence[ReferenceSamples]:
        """The autopilot's own solution since the last call."""

    @property
    def vehicle(self) -> tuple[int, int] | None:
        """System and component of the autopilot, once heard."""

    def events(self) -> Sequence[Event]:
        """What happened since the last call."""

    @property
    def height_datum(self) -> Literal["hae", "msl"] | None:
        """What the heights of its fixes count from; None before the first one has decided it."""

    @property
    def counters(self) -> Any:
        """Dataclass of counters; ``pieces`` and ``bad_crc`` among them."""

    @property
    def signing_counters(self) -> Any:
        """Dataclass of what verifying signatures counted; None without a key."""


class Receiver(Protocol):
    """What the core asks of a satellite receiver's driver."""

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> Sequence[AnySamples]:
        """Take bytes as they arrived; the samples that they complete."""

    @property
    def counters(self) -> Mapping[str, int]:
        """What came, by name; ``frames`` and ``malformed`` among them."""


class Core:
    """One vehicle: drivers, selection, engine, health and log, in order of arrival."""

    def __init__(
        self,
        config: Config,
        writer: LogWriter,
        *,
        start_ns: int,
        decoders: Mapping[str, Sequence[Decoder]],
        session: Session | None,
        receiver: Receiver | None = None,
        preferred: Mapping[Kind, Sequence[str]],
        known: Mapping[Kind, str] | None = None,
        publish: Callable[[Outputs], None],
        announce: Callable[[Event], None],
        stopwatch: Stopwatch = lambda: 0,
    ) -> None:
        """``decoders`` by CAN link; ``preferred`` and ``known`` as for :class:`Selection`.

        ``publish`` gets what each engine step gave out, ``announce`` every other event;
        ``stopwatch`` tells how long a step takes, which decides whether the smoother gives way.
        """
        self.config = config
        self.vehicle = config.vehicle.name
        self.engine = navigator(config)
        self._stopwatch = stopwatch
        self.pace = SmoothingPace(config, start_ns)
        self._latency = GnssLatencyEstimator(config)
        self._writer = writer
        self._decoders = decoders
        self._session = session
        self._receiver = receiver
        self.receiver_link = config.raw_gnss.protocol
        """Name of its line in the log and in health."""
        further = {unit.source for unit in config.further_imu}
        units = [d.source for link in decoders.values() for d in link if d.source not in further]
        self.selection = Selection(
            config, imu=units[0] if units else "", preferred=preferred, known=known
        )
        self.monitor = HealthMonitor(self.vehicle, config.live, start_ns)
        for bus in config.can:
            for unit in bus.imu:
                self.monitor.expect("imu", unit.name, unit.rate_hz)
        self._by_source = {d.source: d for link in decoders.values() for d in link}
        self._publish = publish
        self._announce = announce
        self._raw = config.log.raw
        self._seq = 0
        self.now_ns = self._start_ns = start_ns
        """Time of the latest arrival."""
        self._last_rx: dict[str, int] = {}
        self._checkpoint_ns = self._reference_ns = start_ns
        self._references: list[ReferenceSamples] = []
        self._chosen = 0
        self._datum: Literal["hae", "msl"] | None = None
        self._received = dict.fromkeys(decoders, 0)
        self.last = Solution.empty()
        """The newest epochs published together."""

    # ------------------------------------------------------------------ arrivals

    def can(self, link: str, frames: Sequence[CanArrival]) -> None:
        """Frames of one bus, in their order."""
        decoders = self._decoders[link]
        self._received[link] += len(frames)
        for t, can_id, extended, data in frames:
            seq, now = self._next(link, t)
            if self._raw:
                head = CAN_FRAME.pack(can_id | EXTENDED if extended else can_id, len(data))
                self._writer.raw(link, now, seq, head + data, self.vehicle)
            for decoder in decoders:
                if decoder.feed(seq, now, can_id, extended, data):
                    break
        taken = [made for d in decoders if (made := d.take()) is not None]
        for one in self.selection.ordered(taken):
            self._take(one)

    def mavlink(self, t_rx_ns: int, data: bytes) -> None:
        """A datagram, or a piece of a stream."""
        if self._session is None:
            return
        seq, now = self._next(MAVLINK_LINK, t_rx_ns)
        if self._raw:
            self._writer.raw(MAVLINK_LINK, now, seq, data, self.vehicle)
        self._session.feed(seq, now, data)
        self._drain_session(self._session)

    def receiver(self, t_rx_ns: int, data: bytes) -> None:
        """Bytes of a satellite receiver, cut anywhere."""
        if self._receiver is None:
            return
        seq, now = self._next(self.receiver_link, t_rx_ns)
        if self._raw:
            self._writer.raw(self.receiver_link, now, seq, data, self.vehicle)
        for samples in self._receiver.feed(seq, now, data):
            if isinstance(samples, BroadcastSamples):
                # Of no use but to raw measurements, and wanted before the first of them.
                self._writer.samples(samples, self.vehicle)
                self._give_out(self.engine.step(samples))
            else:
                self._take(samples)

    def tick(self, now: Reading) -> None:
        """Time passes: an arrival like any other."""
        seq, t = self._next(TICK_LINK, now.run)
        clocks = CLOCKS.pack(now.wall, now.monotonic)
        self._writer.raw(TICK_LINK, t, seq, clocks, self.vehicle)
        if self._session is not None:
            self._session.tick(t)
            self._drain_session(self._session)
        for event in self.monitor.tick(t, self.selection.uses):
            self.event(event)
        self._pace_smoother(t)
        if t - self._reference_ns >= REFERENCE_NS:
            self._reference_ns = t
            self._write_references()
        if t - self._checkpoint_ns >= CHECKPOINT_NS:
            self._checkpoint_ns = t
            self.checkpoint()

    def link(self, name: str, state: LinkState, note: str, t_ns: int) -> None:
        """A link was opened, was lost or could not be opened."""
        event = self.monitor.link(name, state, note, t_ns)
        if event is not None:
            self.event(event)

    def event(self, event: Event) -> None:
        """Log and announce something that is not of the engine."""
        self._writer.event(event, self.vehicle)
        self._announce(event)

    def _next(self, link: str, t_rx_ns: int) -> tuple[int, int]:
        """Number and time of an arrival; on one link time never goes back."""
        self._seq += 1
        at = max(t_rx_ns, self._last_rx.get(link, t_rx_ns))
        self._last_rx[link] = self.now_ns = at
        return self._seq, at

    # ------------------------------------------------------------------ samples

    def _drain_session(self, session: Session) -> None:
        # All that came with one piece have one number: the order of the kinds is the session's, and
        # that of a replay.
        for samples in self.selection.ordered(session.take()):
            self._take(samples)
        self._references += session.references()
        for event in session.events():
            self.event(event)
        if session.height_datum != self._datum:
            self._datum = session.height_datum
            self._note_choice()

    def _take(self, samples: AnySamples) -> None:
        """Log samples, then let the engine have what is chosen of them."""
        self._writer.samples(samples, self.vehicle)
        kind = KINDS[type(samples)]
        good = usable(samples, self.config.gnss.min_fix_type)
        at = int(samples.t_rx_ns[-1])
        self.monitor.arrived(kind, samples.source, len(samples), at, good)
        fed = self.selection.offer(samples)
        if len(self.selection.chosen) != self._chosen:
            self._note_choice()
        if fed is not None:
            begin = self._stopwatch()
            out = self.engine.step(fed)
            took = self._stopwatch() - begin
            self._give_out(out)
            if isinstance(fed, ImuSamples) and self.engine.on_line.running is not None:
                self.pace.filtered(took, len(fed))
                self._smooth()
            self._latency.add(fed, out)
            for event in self._latency.events():
                self.event(event)

    def _smooth(self) -> None:
        """What is due of the smoother, once the filter's own is on its way."""
        begin = self._stopwatch()
        out = self.engine.smooth()
        self.pace.smoothed(self._stopwatch() - begin, int(out.smoothed.smoothed.sum()))
        if out is not NOTHING:
            self._give_out(out)

    def _pace_smoother(self, now_ns: int) -> None:
        """Let the smoother give way where the process does not keep up with it."""
        smoother, reached = self.engine.on_line.running, self.engine.reached_ns
        if smoother is None or reached is None:
            return
        decision = self.pace.tick(now_ns)
        # From the next sample on: windows that end there are not due yet, here or in a replay.
        since = reached + 1
        if decision == "give-way":
            smoother.give_way(since)
            text = f"filter and smoother took {self.pace.load:.0%} of a core: no smoothing for now"
            self.event(Event(since, SMOOTHING_GAVE_WAY, text, "warning"))
        elif decision == "resume":
            smoother.resume(since)
            self.event(Event(since, SMOOTHING_RESUMED, "there is room again: smoothing goes on"))

    def _give_out(self, out: Outputs) -> None:
        if len(out.published):
            self.last = out.published
        # People are served before the log is.
        self._publish(out)
        self._writer.outputs(out, self.vehicle)

    def _note_choice(self) -> None:
        """Say in the log which streams the engine gets, so that a replay takes the same."""
        for kind, source, _ in self.selection.chosen[self._chosen :]:
            text = f"{source} is the {kind} input of the estimator"
            self.event(Event(self.now_ns, f"{kind}-chosen", text))
        self._chosen = len(self.selection.chosen)
        self._writer.choose(self.vehicle, self._datum or "hae", self.selection.chosen)

    def log_health(self, health: Health) -> None:
        """Put a report into the log."""
        self._writer.health(health, self.vehicle)

    def _write_references(self) -> None:
        by_source: dict[str, list[ReferenceSamples]] = {}
        for block in self._references:
            by_source.setdefault(block.source, []).append(block)
        self._references = []
        for blocks in by_source.values():
            self._writer.references(blocks, self.vehicle, "autopilot")

    # ------------------------------------------------------------------ state

    @property
    def autopilot(self) -> tuple[int, int] | None:
        """System and component of the autopilot, once heard."""
        return self._session.vehicle if self._session is not None else None

    @property
    def mode(self) -> Mode:
        """Of the newest published epoch."""
        return Mode(int(self.last.mode[-1])) if len(self.last) else Mode.ALIGNING

    def health(
        self, t_ns: int, loop: LoopHealth, log: LogHealth, malformed: Mapping[str, int]
    ) -> Health:
        """The state of everything now; ``malformed``: what adapters sent that was no frame."""
        for link, received in self._received.items():
            bad = malformed.get(link, 0)
            bad += sum(d.counters.malformed for d in self._decoders[link])
            self.monitor.traffic(link, received, bad)
        if self._session is not None:
            counters = self._session.counters
            self.monitor.traffic(MAVLINK_LINK, counters.frames, counters.bad_crc)
        if self._receiver is not None:
            heard = self._receiver.counters
            self.monitor.traffic(self.receiver_link, heard["frames"], heard["malformed"])
        fusion = self.engine.fusion
        return self.monitor.report(
            t_ns, self.mode, self.selection.uses, self._driver_counts, loop, log, self.counters(),
            fusion.excluded() if fusion is not None else {},
        )  # fmt: skip

    def counters(self) -> dict[str, int]:
        """Everything that is counted, by a stable name."""
        engine = self.engine.counters
        out = {
            f"engine.{name}": getattr(engine, name)
            for name in engine.__slots__
            if name != "refused"
        }
        out |= {f"engine.refused.{name}": count for name, count in engine.refused.items()}
        out |= self._smoothing_counters()
        if isinstance(self.engine, Bank):
            out |= {"bank.selected": self.engine.selector.current}
            out |= {"bank.switches": self.engine.selector.switches}
        out |= self.engine.fusion.counts() if self.engine.fusion is not None else {}
        for source, decoder in self._by_source.items():
            out |= {f"{source}.{name}": n for name, n in asdict(decoder.counters).items()}
        if self._session is not None:
            out |= {f"mavlink.{name}": n for name, n in asdict(self._session.counters).items()}
            signing = self._session.signing_counters
            if signing is not None:
                out |= {f"mavlink.signing.{name}": n for name, n in asdict(signing).items()}
        if self._receiver is not None:
            heard, link = self._receiver.counters, self.receiver_link
            out |= {f"{link}.{name}": n for name, n in heard.items()}
        return out

    def _smoothing_counters(self) -> dict[str, int]:
        """What came of the smoother, what it took, and the output rate that it could keep up."""
        smoother = self.engine.on_line.running
        if smoother is None:
            return {}
        interval_s = smoother.covered_ns / max(smoother.intervals, 1) / NS
        bound = self.pace.rate_bound_hz(self.now_ns - self._start_ns, interval_s)
        return {
            "smoothing.epochs": smoother.smoothed,
            "smoothing.as_filtered": smoother.filtered,
            "smoothing.failures": smoother.failures,
            **self.pace.counters(),
            **({"smoothing.rate_bound_hz": round(bound)} if math.isfinite(bound) else {}),
        }

    def _driver_counts(self, source: str) -> tuple[int, int]:
        decoder = self._by_source.get(source)
        return (decoder.counters.lost, decoder.counters.saturated) if decoder else (0, 0)

    def checkpoint(self) -> None:
        """Log the digests of what the engine has given out so far."""
        engine = self.engine
        self._writer.checkpoint(self._seq, engine.digest, engine.digest_published, self.vehicle)

    def finish(self) -> dict[str, Any]:
        """End the run: settle the engine; what the log is closed with."""
        self._give_out(self.engine.finish())
        self._give_out(self.engine.smooth())
        self._write_references()
        return {
            "digest": self.engine.digest,
            "digest_published": self.engine.digest_published,
            "digest_smoothed": self.engine.digest_smoothed,
            "counters": self.counters(),
            "inputs": [c._asdict() for c in self.selection.chosen],
        }
