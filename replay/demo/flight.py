"""The course of a demo: start everything, watch, end everything, look at what is left."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from companion.config import Config, to_toml
from companion.types import AidingReports, CompanionError, Solution, VehicleRecording
from replay.children import Child
from replay.configuration import choose_config
from replay.demo.figures import (
    LATENCY,
    Received,
    position_error_n,
    position_errors,
    read_received,
    spread,
)
from replay.export import export_csv
from replay.reader import read_log
from replay.run_log import RunResult, read_solution
from replay.sensor_folder import read_reference
from replay.session import run_session
from replay.simulator.live.client import VehicleProcess
from replay.simulator.live.scenario import NODE_ID, live_config, live_scenario

REST_S = 8.0
"""On the ground first: time for the filter to level."""
SPARE_S = 60.0
"""The flight is longer than the demo by this, for slow starts."""
LEAST_FLIGHT_S = 150.0
"""A mission flies only if it has time to come home."""
START_S = 60.0
"""The companion must have begun to publish within this long."""
OVERTIME_S = 30.0
SMOOTHED_HZ = 10.0


@dataclass(frozen=True, slots=True)
class Files:
    """What a demo leaves in its directory."""

    directory: Path

    @property
    def config(self) -> Path:
        """Configuration of the companion."""
        return self.directory / "demo.toml"

    @property
    def log(self) -> Path:
        """Its run log."""
        return self.directory / "demo.mcap"

    @property
    def truth(self) -> Path:
        """What was really flown."""
        return self.directory / "truth.csv"

    @property
    def smoothed(self) -> Path:
        """The track smoothed afterwards, in the columns of ``export``."""
        return self.directory / "smoothed.csv"

    @property
    def report(self) -> Path:
        """The page about the flight."""
        return self.directory / "report.html"

    @property
    def received(self) -> Path:
        """What the subscriber had."""
        return self.directory / "received.csv"


@dataclass(frozen=True, slots=True)
class Moment:
    """A second of the demo, for people."""

    elapsed_s: float
    states_hz: float
    latency_p50_ms: float | None
    mode: int
    error_horizontal_m: float
    sd_horizontal_m: float
    speed_mps: float
    height_m: float


def fly(
    files: Files,
    seconds: float,
    imu_hz: float,
    endpoint: str,
    watch: Callable[[Moment | None], None],
) -> dict[str, Any]:
    """Run vehicle, companion and subscriber for ``seconds``; the figures of what came of it.

    ``endpoint``: zenoh's, where the companion listens. ``watch`` is told about each second as it
    passes, None while nothing is published yet. Raises :class:`CompanionError` if one of the
    processes fails; all are ended in any case.
    """
    files.directory.mkdir(parents=True, exist_ok=True)
    flight_s = max(seconds + SPARE_S, LEAST_FLIGHT_S)
    with ExitStack() as stack:
        device = files.directory / "can"
        vehicle = stack.enter_context(_vehicle(files, device, flight_s, imu_hz))
        scenario = live_scenario(flight_s, REST_S, imu_hz)
        config = live_config(
            scenario, vehicle.ready["mavlink"], str(device), endpoint, str(files.directory)
        )
        files.config.write_text(to_toml(config), encoding="utf-8")
        subscriber = stack.enter_context(_subscriber(files, endpoint, config.vehicle.name))
        companion = stack.enter_context(_companion(files, seconds))
        for moment in _moments(files, companion, subscriber, seconds):
            watch(moment)
        companion.finish()
        ran = companion.answer(0.0)
        counts = vehicle.end()
        subscriber.close_input()
        subscriber.finish()
    return {**_figures(files), "companion": ran, "vehicle": counts}


def _vehicle(files: Files, device: Path, flight_s: float, imu_hz: float) -> VehicleProcess:
    arguments = ["--mavlink", "udpin:127.0.0.1:0", "--can", str(device), "--node", str(NODE_ID)]
    arguments += ["--seconds", str(flight_s), "--rest", str(REST_S), "--imu-rate", str(imu_hz)]
    return VehicleProcess([*arguments, "--truth", str(files.truth)])


def _subscriber(files: Files, endpoint: str, vehicle: str) -> Child:
    arguments = ["replay.demo.subscriber", endpoint, vehicle, str(files.received)]
    return Child("the subscriber", arguments)


def _companion(files: Files, seconds: float) -> Child:
    arguments = ["companion", "run", str(files.config), "--for", str(seconds)]
    arguments += ["--log", str(files.log), "--json"]
    return Child("companion run", arguments, files.directory / "companion.txt")


def _moments(
    files: Files, companion: Child, subscriber: Child, seconds: float
) -> Iterator[Moment | None]:
    """What the subscriber says, second by second, until the companion has ended."""
    truth = read_reference(files.truth)
    begin = first = time.monotonic()
    while not companion.wait(0.25):
        now = time.monotonic()
        for said in subscriber.said():
            if not said["states"]:
                yield None
                continue
            first = now if first == begin else first
            state = Received.of_rows([said["last"]])
            error = position_error_n(state, truth)[0]
            yield Moment(
                elapsed_s=now - first,
                states_hz=said["states"],
                latency_p50_ms=said["latency_ms"]["p50"],
                mode=int(state.mode[0]),
                error_horizontal_m=float((error[0] ** 2 + error[1] ** 2) ** 0.5),
                sd_horizontal_m=float((state.sd_pos[0, 0] ** 2 + state.sd_pos[0, 1] ** 2) ** 0.5),
                speed_mps=float((state.vel_n[0] ** 2).sum() ** 0.5),
                height_m=float(state.height[0]),
            )
        if not subscriber.running:
            subscriber.finish()
        if first == begin and now - begin > START_S + seconds:
            raise CompanionError(f"nothing was published: {companion.last_words()}")
        if now - begin > START_S + seconds + OVERTIME_S:
            raise CompanionError("companion run did not end in time")


def _figures(files: Files) -> dict[str, Any]:
    """Everything that ``demo --json`` prints but the directory."""
    received, truth = read_received(files.received), read_reference(files.truth)
    stored = read_solution(files.log)
    recording = read_log([files.log])
    chosen = choose_config(recording)
    flown = replace(recording.vehicles[0], truth=truth)
    replayed = run_session(flown, chosen)
    track = _smoothed(flown, chosen.config)
    if track is not None:
        export_csv(track, files.smoothed)
    inputs = {
        s.source: {"kind": s.kind, "rate_hz": s.rate_hz, "samples": s.count}
        for s in recording.vehicles[0].streams
    }
    return {
        "rates_in": inputs,
        "rate_out_hz": _rate(received),
        "states_received": len(received),
        "latency_ms": spread(received.latency_ms, LATENCY),
        "position_error": position_errors(received, truth),
        "accuracy": _accuracy(flown, chosen.config, stored),
        "smoothed": _smoothed_accuracy(flown, chosen.config, track),
        "report": _report(files, flown, chosen.config, stored, track),
        "digest": {
            "live": stored.digest,
            "replayed": replayed.digest,
            "live_published": stored.digest_published,
            "replayed_published": replayed.digest_published,
            "equal": (stored.digest, stored.digest_published)
            == (replayed.digest, replayed.digest_published),
        },
        "events": [[e.kind, e.text, e.level] for e in stored.events],
    }


def _accuracy(flown: VehicleRecording, config: Config, stored: RunResult) -> dict[str, Any] | None:
    """As ``evaluate --json`` gives it; None for a flight too short to align in."""
    from replay.assessment import assess
    from replay.evaluation import EvaluationError

    with suppress(EvaluationError):
        return assess(
            flown,
            config,
            stored.solution,
            stored.reports,
            digest=stored.digest,
            digest_published=stored.digest_published,
        ).to_json()
    return None


def _smoothed(flown: VehicleRecording, config: Config) -> Solution | None:
    """The log's track, smoothed; None for a flight too short to align in."""
    from companion.smoothing.offline import smooth
    from replay.recorded import record

    run = record(flown, config, rate_hz=SMOOTHED_HZ)
    track = smooth(run.tapes, run.config)
    return track if len(track) else None


def _smoothed_accuracy(
    flown: VehicleRecording, config: Config, track: Solution | None
) -> dict[str, Any] | None:
    from replay.assessment import assess
    from replay.evaluation import EvaluationError

    if track is None:
        return None
    with suppress(EvaluationError):
        none = AidingReports.empty()  # innovations belong to the forward run
        return assess(flown, config, track, none, solution_kind="smoothed").to_json()
    return None


def _report(
    files: Files,
    flown: VehicleRecording,
    config: Config,
    stored: RunResult,
    track: Solution | None,
) -> dict[str, str]:
    """The page about the flight, written; its verdict."""
    from replay.report.page import write_report
    from replay.report.run_view import RunView

    view = RunView(
        name=files.log.name,
        vehicle=flown,
        config=config,
        solution=stored.solution,
        reports=stored.reports,
        events=stored.events,
        smoothed=track,
        digest=stored.digest,
        adaptation=stored.adaptation,
        satellites=stored.satellites,
    )
    judgement = write_report(view, files.report)
    return {"verdict": judgement.level, "headline": judgement.headline}


def _rate(received: Received) -> float | None:
    if len(received) < 2:
        return None
    span_s = float(received.receipt_ns[-1] - received.receipt_ns[0]) * 1e-9
    return (len(received) - 1) / span_s if span_s > 0 else None
