"""Our own run log, read back: the inputs as a recording, the outputs as a result."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.message import DecodeError

from companion.logbook import columns, messages, schemas
from companion.logbook.adaptation import decode_trace
from companion.logbook.columns import Batch
from companion.logbook.recovery import Condition, Topic, walk
from companion.logbook.satellites import decode_satellites
from companion.proto import run_pb2
from companion.types import (
    NO_SATELLITES,
    NS,
    SMOOTHING_GAVE_WAY,
    SMOOTHING_RESUMED,
    AdaptationTrace,
    AidingReports,
    Event,
    LogFormatError,
    Recording,
    ReferenceSamples,
    Samples,
    Satellites,
    Solution,
    StreamInfo,
    VehicleRecording,
)
from replay.streams import stream_info

_BATCHES: dict[str, tuple[str, Batch]] = {
    "input/imu": ("imu", columns.IMU),
    "input/gnss": ("gnss", columns.GNSS),
    "input/baro": ("baro", columns.BARO),
    "input/mag": ("mag", columns.MAG),
    "input/attitude": ("attitude", columns.ATTITUDE),
    "input/raw": ("raw", columns.RAW),
    "input/broadcast": ("broadcast", columns.BROADCAST),
    "reference/truth": ("truth", columns.REFERENCE),
    "reference/autopilot": ("autopilot", columns.REFERENCE),
}
_RUN_TOPICS = (schemas.CONFIG_TOPIC, schemas.VERSIONS_TOPIC, schemas.SUMMARY_TOPIC)
_OUTPUT_TOPICS = (
    "nav/state",
    "nav/aiding",
    "nav/adaptation",
    "nav/satellites",
    "nav/settled",
    "nav/smoothed",
    "events",
)
_LEVELS = {Log.WARNING: "warning", Log.ERROR: "error"}

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run gave out for one vehicle, as its log has it."""

    vehicle: str
    solution: Solution
    """The published, causal solution."""
    reports: AidingReports
    events: tuple[Event, ...]
    digest: str | None
    """Of the settled solution; None in a log that was not closed."""
    digest_published: str | None
    settled: Solution | None = None
    smoothed: Solution | None = None
    """Only where the writer was asked to keep it."""
    summary: dict[str, Any] = field(default_factory=dict)
    """This vehicle's part of what the run was closed with."""
    config_toml: str | None = None
    metadata: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    satellites: Satellites = NO_SATELLITES


class _Run:
    """Messages of a log, sorted by vehicle and topic; what is common to both ways of reading."""

    def __init__(self, path: Path, names: Iterable[str]) -> None:
        self.path = path
        self.condition = Condition()
        self.messages: dict[str, dict[str, list[bytes]]] = defaultdict(lambda: defaultdict(list))
        self.notes: list[str] = []
        wanted = frozenset((*names, "vehicle"))
        run: dict[str, bytes] = {}

        def is_wanted(topic: Topic) -> bool:
            return topic.name in _RUN_TOPICS or _name(topic) in wanted

        for topic, _, data in walk(path, is_wanted, self.condition):
            if topic.name in _RUN_TOPICS:
                run[topic.name] = data
            else:
                self.messages[topic.metadata["vehicle"]][_name(topic)].append(data)
        topics = self.condition.topics.values()
        if not any(t.name in _RUN_TOPICS or "vehicle" in t.metadata for t in topics):
            reason = "; ".join(self.condition.notes())
            raise LogFormatError(
                f"{path}: an MCAP file, but not a run log of companion"
                + (f" ({reason})" if reason else "")
            )
        config = self._parse(run_pb2.Config, run.get(schemas.CONFIG_TOPIC))
        self.config_toml: str | None = config.toml if config else None
        versions = self._parse(run_pb2.Versions, run.get(schemas.VERSIONS_TOPIC))
        self.metadata: dict[str, str] = dict(versions.metadata) if versions else {}
        if versions and versions.log_format > schemas.LOG_FORMAT:
            raise LogFormatError(
                f"{path}: log format {versions.log_format}; this version reads up to "
                f"{schemas.LOG_FORMAT}"
            )
        self.summary = self._summary(run.get(schemas.SUMMARY_TOPIC))

    def _summary(self, data: bytes | None) -> dict[str, Any]:
        message = self._parse(run_pb2.Summary, data)
        try:
            summary = json.loads(message.json) if message else {}
        except ValueError:
            self.notes.append("the run's summary is not readable")
            return {}
        return summary if isinstance(summary, dict) else {}

    def _parse(self, kind: type[M], data: bytes | None) -> M | None:
        if data is None:
            return None
        try:
            message: M = kind.FromString(data)  # type: ignore[attr-defined]
        except DecodeError:
            self.notes.append(f"an unreadable {kind.__name__} message left out")
            return None
        return message

    def vehicle_info(self, vehicle: str) -> run_pb2.VehicleInfo:
        """What the run said about a vehicle; empty where it said nothing."""
        said = self.messages[vehicle].get("vehicle", [])
        return self._parse(run_pb2.VehicleInfo, said[-1] if said else None) or (
            run_pb2.VehicleInfo(name=vehicle, height_datum="hae")
        )

    def vehicles(self) -> list[str]:
        """Names in order of appearance, also of vehicles that left no message of interest."""
        topics = self.condition.topics.values()
        return list(dict.fromkeys(t.metadata["vehicle"] for t in topics if "vehicle" in t.metadata))

    def all_notes(self) -> tuple[str, ...]:
        return (*self.condition.notes(), *self.notes)


def _name(topic: Topic) -> str:
    """The topic's part after the vehicle; empty for a topic of no vehicle."""
    if "vehicle" not in topic.metadata:
        return ""
    prefix = schemas.topic(topic.metadata["vehicle"], "")
    return topic.name.removeprefix(prefix)


def read_run(path: Path) -> Recording:
    """The inputs of a run and its references, bit for bit as they were logged.

    A log that was cut is read up to its last whole chunk, with a note. Raises
    :class:`LogFormatError` when the file is not a run log.
    """
    run = _Run(Path(path), (*_BATCHES, "events"))
    vehicles = tuple(_vehicle(run, name) for name in run.vehicles())
    return Recording(
        path=str(path),
        format="mcap",
        vehicles=vehicles,
        notes=run.all_notes(),
        config_toml=run.config_toml,
        metadata=run.metadata,
    )


def _vehicle(run: _Run, name: str) -> VehicleRecording:
    info = run.vehicle_info(name)
    order = [(s.kind, s.source) for s in info.order]
    streams: dict[tuple[str, str], Samples] = {}
    for topic, (kind, batch) in _BATCHES.items():
        by_source: dict[str, list[bytes]] = defaultdict(list)
        for payload in run.messages[name].get(topic, []):
            try:
                by_source[columns.source_of(payload)].append(payload)
            except LogFormatError as error:
                run.notes.append(f"{name}: {error}")
        for source, payloads in by_source.items():
            samples = _samples(run, batch, source, payloads)
            if samples is not None:
                streams[kind, source] = samples
    if info.live:
        streams = _as_used(run, info, streams)
    known = [key for key in order if key in streams]
    keys = known + [key for key in streams if key not in known]

    def of(kind: str) -> tuple[Any, ...]:
        return tuple(streams[key] for key in keys if key[0] == kind)

    return VehicleRecording(
        name=name,
        imu=of("imu"),
        gnss=of("gnss"),
        baro=of("baro"),
        mag=of("mag"),
        raw=of("raw"),
        broadcast=of("broadcast"),
        truth=_only(of("truth")),
        autopilot=_only(of("autopilot")),
        height_datum="msl" if info.height_datum == "msl" else "hae",
        smoothing_gaps=_smoothing_gaps(run, name),
        streams=tuple(
            StreamInfo(s.source, _kind(s.kind), s.count, s.rate_hz, s.longest_gap_s, s.gaps, s.note)
            for s in info.streams
        )
        or tuple(stream_info(streams[key], _kind(key[0])) for key in keys if key[0] != "broadcast"),
        attitude=of("attitude"),
    )


def _as_used(
    run: _Run, info: run_pb2.VehicleInfo, streams: dict[tuple[str, str], Samples]
) -> dict[tuple[str, str], Samples]:
    """What a live process gave to its estimator, from the arrival on from which it did.

    Other streams of a kind stay, for whoever names them; a kind of which the process used none
    goes, or a replay would use what the run did not.
    """
    first = {(s.kind, s.source): s.first_seq for s in info.order}
    kinds = {kind for kind, _ in first} | {"truth", "autopilot", "broadcast"}
    for kind, source in streams:
        if kind not in kinds:
            run.notes.append(f"{info.name}: {source} ({kind}) was logged, not used")
    return {
        key: samples.take(samples.seq >= first[key]) if key in first else samples
        for key, samples in streams.items()
        if key[0] in kinds
    }


def _samples(run: _Run, batch: Batch, source: str, payloads: list[bytes]) -> Samples | None:
    """One stream's columns; batches that are none are left out with a note."""
    try:
        found = columns.decode(batch, payloads)
    except LogFormatError:
        good = [p for p in payloads if _decodes(batch, p)]
        run.notes.append(f"{source}: {len(payloads) - len(good)} unreadable batches left out")
        if not good:
            return None
        found = columns.decode(batch, good)
    kind: Any = batch.type
    samples: Samples = kind(source=source, **found)
    return samples


def _smoothing_gaps(run: _Run, vehicle: str) -> tuple[tuple[int, int], ...]:
    """When a live run's smoother gave way, by its own events: a replay must do the same."""
    gaps: list[tuple[int, int]] = []
    for data in run.messages[vehicle].get("events", []):
        event = _event(run, data)
        if event is not None and event.kind == SMOOTHING_GAVE_WAY:
            gaps.append((event.t_ns, int(np.iinfo(np.int64).max)))
        elif event is not None and event.kind == SMOOTHING_RESUMED and gaps:
            gaps[-1] = gaps[-1][0], event.t_ns
    return tuple(gaps)


def _decodes(batch: Batch, payload: bytes) -> bool:
    try:
        columns.decode(batch, [payload])
    except LogFormatError:
        return False
    return True


def _only(found: tuple[ReferenceSamples, ...]) -> ReferenceSamples | None:
    return found[0] if found else None


def _kind(kind: str) -> Any:
    known = ("imu", "gnss", "baro", "mag", "attitude", "raw", "truth", "autopilot")
    return kind if kind in known else "autopilot"


def read_solution(path: Path, vehicle: str | None = None) -> RunResult:
    """What the run gave out for ``vehicle``, or for the only or first one.

    Raises :class:`LogFormatError` when the file is not a run log, or has no such vehicle.
    """
    run = _Run(Path(path), _OUTPUT_TOPICS)
    names = run.vehicles()
    if not names or (vehicle is not None and vehicle not in names):
        has = f"it has {', '.join(names)}" if names else "it has none"
        raise LogFormatError(f"{path}: no vehicle {vehicle or ''} in this run; {has}")
    name = vehicle if vehicle is not None else names[0]
    if vehicle is None and len(names) > 1:
        run.notes.append(f"vehicle {name} of {', '.join(names)}")
    found = run.messages[name]
    try:
        solution = messages.decode_states(found.get("nav/state", []))
        reports = messages.decode_reports(found.get("nav/aiding", []))
        settled = _settled(found.get("nav/settled", []))
        smoothed = messages.decode_states(found.get("nav/smoothed", []))
        adaptation = decode_trace(found.get("nav/adaptation", []))
        satellites = decode_satellites(found.get("nav/satellites", []))
    except LogFormatError as error:
        raise LogFormatError(f"{path}: {error}") from None
    events = tuple(e for data in found.get("events", []) if (e := _event(run, data)) is not None)
    per_vehicle = run.summary.get("vehicles")
    summary = per_vehicle.get(name, {}) if isinstance(per_vehicle, dict) else run.summary
    return RunResult(
        vehicle=name,
        solution=solution,
        reports=reports,
        events=events,
        digest=summary.get("digest"),
        digest_published=summary.get("digest_published"),
        settled=settled,
        smoothed=smoothed if len(smoothed) else None,
        summary=summary,
        config_toml=run.config_toml,
        metadata=run.metadata,
        notes=run.all_notes(),
        adaptation=adaptation,
        satellites=satellites,
    )


@dataclass(frozen=True, slots=True)
class RunDigests:
    """Digests that a run wrote about itself."""

    seq: int | None
    """The arrival up to which they count; None: the whole run."""
    digest: str
    digest_published: str
    digest_smoothed: str | None
    """Of what was smoothed on line, in a log that was closed."""


def read_digests(path: Path, vehicle: str) -> RunDigests | None:
    """What the run was closed with, else its last checkpoint; None where there is neither."""
    run = _Run(Path(path), ("checkpoint",))
    per_vehicle = run.summary.get("vehicles")
    closed = per_vehicle.get(vehicle, {}) if isinstance(per_vehicle, dict) else run.summary
    if "digest" in closed and "digest_published" in closed:
        smoothed = closed.get("digest_smoothed")
        return RunDigests(None, str(closed["digest"]), str(closed["digest_published"]), smoothed)
    said = run.messages[vehicle].get("checkpoint", [])
    last = run._parse(run_pb2.Checkpoint, said[-1] if said else None)
    return RunDigests(last.seq, last.digest, last.digest_published, None) if last else None


def _settled(payloads: list[bytes]) -> Solution | None:
    if not payloads:
        return None
    return Solution(**columns.decode(columns.SOLUTION, payloads))


def _event(run: _Run, data: bytes) -> Event | None:
    log = run._parse(Log, data)
    if log is None:
        return None
    level: Any = _LEVELS.get(log.level, "info")
    t_ns = log.timestamp.seconds * NS + log.timestamp.nanos
    return Event(int(np.int64(t_ns)), log.name, log.message, level)
