"""The log of a run, written while it runs.

What comes in is held for a second of arrival time and then written in columns, so that a live
sensor does not cost a message a sample. The order of arrival across
streams is in ``seq``. Nothing is written that a replay of the inputs gives again, apart from the
published states, the aiding reports and the events, which people look at.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.timestamp_pb2 import Timestamp

from companion.logbook import columns, messages, schemas
from companion.logbook.adaptation import encode_trace
from companion.logbook.columns import AnyColumns, Batch
from companion.logbook.health import encode_health
from companion.logbook.mcap_file import McapFile
from companion.logbook.satellites import encode_satellites
from companion.logbook.sink import LogWriteError, Sink
from companion.proto import run_pb2, samples_pb2
from companion.selection import Chosen
from companion.types import (
    I64,
    NS,
    AdaptationTrace,
    AidingReports,
    AnySamples,
    AttitudeSamples,
    BaroSamples,
    BroadcastSamples,
    Event,
    GnssSamples,
    Health,
    ImuSamples,
    MagSamples,
    Outputs,
    RawGnssSamples,
    ReferenceSamples,
    Satellites,
    Smoothed,
    Solution,
    VehicleRecording,
)

BATCH_ROWS = 1024
"""Rows of one message at most."""
HELD_ROWS = 8 * BATCH_ROWS
"""Rows held back at most, whatever their age: bounds memory."""
DRAW_INTERVAL_NS = NS // 10
"""Maps and 3-D views get this rate; the full one is on ``nav/state``."""

_INPUTS: dict[type, tuple[str, Batch]] = {
    ImuSamples: ("imu", columns.IMU),
    GnssSamples: ("gnss", columns.GNSS),
    BaroSamples: ("baro", columns.BARO),
    MagSamples: ("mag", columns.MAG),
    AttitudeSamples: ("attitude", columns.ATTITUDE),
    RawGnssSamples: ("raw", columns.RAW),
    BroadcastSamples: ("broadcast", columns.BROADCAST),
}
_LEVEL = {"info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}


class LogWriter:
    """One MCAP file a run; a context manager.

    Every method raises :class:`LogWriteError` when the disk does not take the data. The file then
    holds all whole chunks and opens as one that was cut; every later write raises again, and
    ``close`` is always safe.
    """

    def __init__(
        self,
        path: Path,
        *,
        config_toml: str,
        metadata: Mapping[str, str],
        settled: bool = False,
        hold_s: float = 1.0,
        chunk_s: float | None = None,
        sink: Sink | None = None,
    ) -> None:
        """Open ``path`` for a run with this configuration.

        ``settled``: write the settled epochs too, not only their digest (about 70 MB an hour at
        50 Hz before compression). ``hold_s``: for how long of arrival time data may wait in memory,
        half of what a power loss can take; a replay, whose input is safe, is faster with more.
        ``chunk_s``: for how long of arrival time a chunk is filled; without it as long.
        ``sink``: what writes the bytes, instead of this process itself, at once.
        """
        self.path = Path(path)
        self._hold_ns = round(hold_s * NS)
        self._file = McapFile(self.path, chunk_span_ns=round((chunk_s or hold_s) * NS), sink=sink)
        self._config_toml = config_toml
        self._metadata = dict(metadata)
        self._settled = settled
        self._schema_ids: dict[str, int] = {}
        self._channel_ids: dict[tuple[str, str], int] = {}
        self._headed = False
        self._window_ns: int | None = None
        self._rows = 0
        self._now_ns = 0
        self._parts: dict[tuple[str, str, str, str], list[AnyColumns]] = {}
        self._reports: dict[str, list[AidingReports]] = {}
        self._traces: dict[str, list[AdaptationTrace]] = {}
        self._satellites: dict[str, list[Satellites]] = {}
        self._published: dict[str, list[Solution]] = {}
        self._smoothed: dict[str, list[Smoothed]] = {}
        self._members: dict[tuple[str, str], list[Solution]] = {}
        self._raw: dict[tuple[str, str], list[tuple[int, int, bytes]]] = {}
        self._origin: dict[str, tuple[float, float, float]] = {}
        self._drawn: dict[str, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.close({})
            return
        # A second failure here is dropped: the one that brought us here is the one to tell.
        with contextlib.suppress(LogWriteError):
            self.close({})

    def describe(self, vehicle: VehicleRecording) -> None:
        """Write what is known of a vehicle: datum, streams and their order of preference."""
        info = run_pb2.VehicleInfo(name=vehicle.name, height_datum=vehicle.height_datum)
        for kind in ("imu", "gnss", "baro", "mag", "attitude", "raw", "broadcast"):
            for samples in getattr(vehicle, kind):
                info.order.add(kind=kind, source=samples.source)
        for kind in ("truth", "autopilot"):
            reference = getattr(vehicle, kind)
            if reference is not None:
                info.order.add(kind=kind, source=reference.source)
        for s in vehicle.streams:
            info.streams.add(
                kind=s.kind,
                source=s.source,
                count=s.count,
                rate_hz=s.rate_hz,
                longest_gap_s=s.longest_gap_s,
                gaps=s.gaps,
                note=s.note,
            )
        starts = [
            int(s.t_rx_ns[0])
            for kind in ("imu", "gnss", "baro", "mag", "attitude", "raw", "broadcast")
            for s in getattr(vehicle, kind)
            if len(s)
        ]
        self._message(vehicle.name, "vehicle", info, min(starts, default=self._now_ns))

    def choose(
        self, vehicle: str, height_datum: Literal["hae", "msl"], chosen: Sequence[Chosen]
    ) -> None:
        """Write which streams a live process uses, each time that one more is chosen."""
        info = run_pb2.VehicleInfo(name=vehicle, height_datum=height_datum, live=True)
        for kind, source, first_seq in chosen:
            info.order.add(kind=kind, source=source, first_seq=first_seq)
        self._message(vehicle, "vehicle", info, self._now_ns)

    def checkpoint(self, seq: int, digest: str, digest_published: str, vehicle: str) -> None:
        """Write everything that arrived up to ``seq``, then the digests of what came of it."""
        self._write_pending()
        said = run_pb2.Checkpoint(seq=seq, digest=digest, digest_published=digest_published)
        self._message(vehicle, "checkpoint", said, self._now_ns)
        self._file.flush()

    def samples(self, block: AnySamples, vehicle: str) -> None:
        """Take a block of input samples of one stream, in order of arrival within it."""
        kind, _ = _INPUTS[type(block)]
        self._parts.setdefault((vehicle, f"input/{kind}", kind, block.source), []).append(block)
        self._arrived(len(block), int(block.t_rx_ns[-1]) if len(block) else self._now_ns)

    def reference(
        self,
        block: ReferenceSamples,
        vehicle: str,
        kind: Literal["truth", "autopilot"] = "truth",
    ) -> None:
        """Write rows of a reference solution, so that the run can be evaluated by itself."""
        self.references([block], vehicle, kind)

    def references(
        self,
        blocks: Sequence[ReferenceSamples],
        vehicle: str,
        kind: Literal["truth", "autopilot"] = "truth",
    ) -> None:
        """Write blocks of one reference as one."""
        source = blocks[0].source
        self._write_columns(vehicle, f"reference/{kind}", columns.REFERENCE, source, blocks)

    def outputs(self, out: Outputs, vehicle: str) -> None:
        """Take what one engine step gave out."""
        rows = len(out.published) + len(out.reports)
        if len(out.published):
            self._published.setdefault(vehicle, []).append(out.published)
            self._now_ns = max(self._now_ns, int(out.published.t_ns[-1]))
        if len(out.reports):
            self._reports.setdefault(vehicle, []).append(out.reports)
        if len(out.adaptation):
            self._traces.setdefault(vehicle, []).append(out.adaptation)
        if len(out.satellites):
            self._satellites.setdefault(vehicle, []).append(out.satellites)
        if self._settled and len(out.settled):
            key = (vehicle, "nav/settled", "solution", "forward")
            self._parts.setdefault(key, []).append(out.settled)
            rows += len(out.settled)
        if len(out.smoothed):
            self._smoothed.setdefault(vehicle, []).append(out.smoothed)
            rows += len(out.smoothed)
        for name, published in out.members:
            self._members.setdefault((vehicle, name), []).append(published)
            rows += len(published)
        for event in out.events:
            self.event(event, vehicle)
        self._arrived(rows, self._now_ns)

    def smoothed(self, epochs: Solution | Smoothed, vehicle: str) -> None:
        """Write a smoothed solution, whole, on its own channel; with its lag if it has one."""
        if isinstance(epochs, Smoothed):
            t_ns, data = epochs.solution.t_ns, messages.encode_smoothed(epochs)
        else:
            t_ns, data = epochs.t_ns, messages.encode_states(epochs)
        channel = self._channel(vehicle, "nav/smoothed", "companion.NavState", t_ns)
        for at in range(0, len(t_ns), BATCH_ROWS):
            part = slice(at, at + BATCH_ROWS)
            self._file.rows(channel, t_ns[part], data[part])

    def event(self, event: Event, vehicle: str) -> None:
        """Write one event at once."""
        seconds, nanos = divmod(event.t_ns, NS)
        log = Log(
            timestamp=Timestamp(seconds=seconds, nanos=nanos),
            level=_LEVEL[event.level],
            message=event.text,
            name=event.kind,
        )
        self._message(vehicle, "events", log, event.t_ns)

    def health(self, health: Health, vehicle: str) -> None:
        """Write the state of the process."""
        channel = self._channel(vehicle, "health", "companion.Health", np.array([health.t_ns]))
        self._file.message(channel, health.t_ns, encode_health(health))

    def raw(self, link: str, t_rx_ns: int, seq: int, frame: bytes, vehicle: str) -> None:
        """Take one frame as it arrived on ``link``, before anything is decoded."""
        self._raw.setdefault((vehicle, link), []).append((t_rx_ns, seq, frame))
        self._arrived(1, t_rx_ns)

    def flush(self) -> None:
        """Hand everything so far to the operating system."""
        self._write_pending()
        self._file.flush()

    def close(self, summary: Mapping[str, Any]) -> None:
        """Finish the file; a second call does nothing.

        ``summary`` is written as JSON: ``digest``, ``digest_published`` and counters, or those of
        several vehicles under ``{"vehicles": {name: …}}``.
        """
        if self._file.closed:
            return
        self._write_pending()
        data = run_pb2.Summary(json=json.dumps(dict(summary), sort_keys=True))
        self._message(None, schemas.SUMMARY_TOPIC, data, self._now_ns)
        self._file.close()

    def _arrived(self, rows: int, now_ns: int) -> None:
        """Count what is held back, and write it when it is enough or old enough."""
        self._now_ns = max(self._now_ns, now_ns)
        self._rows += rows
        if self._window_ns is None:
            self._window_ns = now_ns
        if self._rows >= HELD_ROWS or now_ns - self._window_ns >= self._hold_ns:
            self._write_pending()

    def _write_pending(self) -> None:
        # Emptied before writing: after a failed write the data are gone, and memory stays flat.
        parts, self._parts = self._parts, {}
        published, self._published = self._published, {}
        reports, self._reports = self._reports, {}
        smoothed, self._smoothed = self._smoothed, {}
        members, self._members = self._members, {}
        traces, self._traces = self._traces, {}
        skies, self._satellites = self._satellites, {}
        raw, self._raw = self._raw, {}
        self._rows, self._window_ns = 0, None
        for (vehicle, link), frames in raw.items():
            self._write_raw(vehicle, link, frames)
        for (vehicle, name, kind, source), blocks in parts.items():
            batch = columns.SOLUTION if kind == "solution" else _INPUTS[type(blocks[0])][1]
            self._write_columns(vehicle, name, batch, source, blocks)
        for vehicle, solutions in published.items():
            self._write_states(vehicle, Solution.concatenate(solutions))
        for (vehicle, name), solutions in members.items():
            solution = Solution.concatenate(solutions)
            topic = schemas.member_topic(name)
            channel = self._channel(vehicle, topic, "companion.NavState", solution.t_ns)
            self._file.rows(channel, solution.t_ns, messages.encode_states(solution))
        for vehicle, epochs in smoothed.items():
            self.smoothed(Smoothed.concatenate(epochs), vehicle)
        for vehicle, rows in reports.items():
            joined = AidingReports.concatenate(rows)
            data = messages.encode_reports(joined)
            channel = self._channel(vehicle, "nav/aiding", "companion.AidingReport", joined.t_ns)
            self._file.rows(channel, joined.t_ns, data)
        for vehicle, parts_of_trace in traces.items():
            trace = AdaptationTrace.concatenate(parts_of_trace)
            message = "companion.AdaptationTrace"
            channel = self._channel(vehicle, "nav/adaptation", message, trace.t_ns)
            self._file.rows(channel, trace.t_ns, encode_trace(trace))
        for vehicle, sky in skies.items():
            self._write_satellites(vehicle, sky)

    def _write_satellites(self, vehicle: str, parts: list[Satellites]) -> None:
        sky = Satellites.concatenate(parts)
        channel = self._channel(vehicle, "nav/satellites", "companion.Satellites", sky.t_ns)
        self._file.rows(channel, sky.t_ns, encode_satellites(sky))

    def _write_columns(
        self, vehicle: str, name: str, batch: Batch, source: str, blocks: Sequence[AnyColumns]
    ) -> None:
        joined = columns.join(batch, blocks)
        times = joined.get("t_rx_ns", joined["t_ns"])
        n = len(times)
        channel = self._channel(vehicle, name, batch.message, times)
        # a stream without rows still leaves one message: it says that the stream was there
        for at in range(0, max(n, 1), BATCH_ROWS):
            stop = min(at + BATCH_ROWS, n)
            data = columns.encode(batch, source, joined, at, stop)
            self._file.message(channel, int(times[stop - 1]) if n else self._now_ns, data)

    def _write_states(self, vehicle: str, published: Solution) -> None:
        channel = self._channel(vehicle, "nav/state", "companion.NavState", published.t_ns)
        self._file.rows(channel, published.t_ns, messages.encode_states(published))
        drawn, self._drawn[vehicle] = messages.drawable(
            published, DRAW_INTERVAL_NS, self._drawn.get(vehicle, -1)
        )
        if not len(drawn):
            return
        origin = self._origin.setdefault(
            vehicle, (float(drawn.lat[0]), float(drawn.lon[0]), float(drawn.height[0]))
        )
        for name, message, data in (
            ("nav/fix", "foxglove.LocationFix", messages.encode_fixes(drawn)),
            ("nav/odometry", "foxglove.Odometry", messages.encode_odometry(drawn, origin)),
        ):
            channel = self._channel(vehicle, name, message, drawn.t_ns)
            self._file.rows(channel, drawn.t_ns, data)

    def _write_raw(self, vehicle: str, link: str, frames: list[tuple[int, int, bytes]]) -> None:
        batch = samples_pb2.RawBatch(
            link=link,
            t_rx_ns=[t for t, _, _ in frames],
            seq=[s for _, s, _ in frames],
            size=[len(f) for _, _, f in frames],
            data=b"".join(f for _, _, f in frames),
        )
        self._message(vehicle, "raw", batch, frames[-1][0])

    def _message(self, vehicle: str | None, name: str, message: Any, log_time_ns: int) -> None:
        kind = message.DESCRIPTOR.full_name
        channel = self._channel(vehicle, name, kind, np.array([log_time_ns]))
        self._file.message(channel, log_time_ns, message.SerializeToString())

    def _channel(self, vehicle: str | None, name: str, message: str, t_ns: I64) -> int:
        """The channel of one topic, made at its first use."""
        if not self._headed:
            self._head(int(t_ns[0]) if len(t_ns) else 0)
        key = (vehicle or "", name)
        if key not in self._channel_ids:
            if message not in self._schema_ids:
                data = schemas.descriptor_set(message)
                self._schema_ids[message] = self._file.schema(message, data)
            full = name if vehicle is None else schemas.topic(vehicle, name)
            metadata = {} if vehicle is None else {"vehicle": vehicle}
            self._channel_ids[key] = self._file.channel(full, self._schema_ids[message], metadata)
        return self._channel_ids[key]

    def _head(self, t_ns: int) -> None:
        """Configuration and versions, at the time of the first message.

        Not at opening: no time of the run is known then, and viewers would start in 1970.
        """
        self._headed = True
        self._message(None, schemas.CONFIG_TOPIC, run_pb2.Config(toml=self._config_toml), t_ns)
        versions = run_pb2.Versions(log_format=schemas.LOG_FORMAT, metadata=self._metadata)
        self._message(None, schemas.VERSIONS_TOPIC, versions, t_ns)
