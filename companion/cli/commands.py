"""What the commands do; each returns the object that ``--json`` prints.

Modules with kernels are imported inside the functions: a wrong command line must not compile.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import msgspec
from rich.console import Console
from rich.markup import escape

from companion import _jit, present
from companion.config import to_toml
from companion.config.settings import alone
from companion.types import (
    CompanionError,
    Recording,
)
from replay import kernels
from replay.window import Window

if TYPE_CHECKING:
    from companion.outputs.publisher import Publisher
    from replay.configuration import ChosenConfig
    from replay.session import SessionResult

_OPEN_S = 1.0
"""A zenoh session is open within milliseconds, or not for long."""
SolutionKind = Literal["forward", "smoothed"]
LOADING = "Loading the numerical kernels …"


def replay_logs(
    console: Console,
    logs: Sequence[Path],
    config_path: Path | None,
    out: Path | None,
    outages: Sequence[Window],
    speed: float | None,
    vehicle_name: str | None,
    publish: bool,
) -> dict[str, Any]:
    """Replay, log, evaluate and describe every vehicle of a run."""
    from replay.preparation import navigable

    recording, chosen = read(console, logs, config_path, vehicle_name)
    fit, refused = navigable(recording, chosen.config, vehicle_name)
    path = out_path(out, logs)
    with present.notice_if_slow(console, LOADING):
        from replay import session
    for one in refused:
        console.print(f"[yellow]Vehicle {escape(one.name)} left out: {escape(one.reason)}")
    if chosen.config.raw_gnss.coupling == "off" and any(vehicle.raw for vehicle in fit):
        console.print('Note      raw GNSS is there and not used: raw_gnss.coupling is "off"')
    runs = []
    with session.run_log(path, recording, chosen, outages) as writer:
        for vehicle in fit:
            with (
                present.progress(console, f"Vehicle {vehicle.name}") as update,
                publication(console, chosen, vehicle.name, publish) as publisher,
            ):
                result = session.run_session(
                    vehicle,
                    chosen,
                    writer=writer,
                    outages=outages,
                    speed=speed,
                    progress=update,
                    publisher=publisher,
                )
            runs.append(_describe(result, outages))
            present.show_run(console, runs[-1])
            if recording.metadata.get("source") == "live" and config_path is None and not outages:
                runs[-1]["live"] = _against_live(console, logs[0], result)
        writer.close(session.closing_summary(runs))
    console.print(f"Run log   {escape(str(path))}")
    return {
        "log": [str(p) for p in logs],
        "format": recording.format,
        "notes": list(recording.notes),
        "refused": {one.name: one.reason for one in refused},
        "out": str(path),
        "vehicles": runs,
    }


def _against_live(console: Console, path: Path, result: SessionResult) -> dict[str, Any] | None:
    """Whether the replay of a live run's log gave the bits of the run; said, and as JSON."""
    from replay.verification import compare_with_live

    found = compare_with_live(
        path,
        result.vehicle,
        result.chosen.config,
        result.digest,
        result.digest_published,
        result.digest_smoothed,
    )
    if found is None:
        console.print("Live      the log holds no digest to compare with: it was cut too early")
        return None
    until = "" if found.until_seq is None else f" up to its last checkpoint, {found.until_seq}"
    if found.equal:
        console.print(f"Live      the same bits as the live run{until}")
    else:
        console.print(f"Live      not the bits of the live run{until}", style="red")
    return plain(found)


@contextmanager
def publication(
    console: Console, chosen: ChosenConfig, vehicle: str, wanted: bool
) -> Iterator[Publisher | None]:
    """A zenoh publisher for one vehicle, or None where none is wanted."""
    if not wanted:
        yield None
        return
    from companion.outputs.zenoh_publisher import ZenohPublisher

    with closing(ZenohPublisher(chosen.config.zenoh, vehicle)) as publisher:
        publisher.config(chosen.toml)
        publisher.link.wait_open(_OPEN_S)
        for notice in publisher.notices():
            console.print(f"[yellow]{notice.kind}: {escape(notice.text)}", highlight=False)
        where = chosen.config.zenoh.config_file or ", ".join(chosen.config.zenoh.listen)
        if publisher.link.live is not None:
            console.print(f"Published on {escape(where)}; companion watch shows it")
        yield publisher


def read_recording(
    console: Console,
    logs: Sequence[Path],
    vehicle_name: str | None,
    config_path: Path | None = None,
) -> Recording:
    """Read a run; ``config_path`` for what only a configuration knows of it: CAN units, clocks."""
    if all(path.exists() for path in logs):
        compile_kernels()
    from replay.configuration import said_of_data
    from replay.reader import read_log

    can, clock = said_of_data(config_path)
    with present.notice_if_slow(console, "Reading …"):
        recording = read_log(logs, vehicle=vehicle_name, can=can, clock=clock)
    for note in recording.notes:
        console.print(f"Note      {escape(note)}")
    return recording


def read(
    console: Console,
    logs: Sequence[Path],
    config_path: Path | None,
    vehicle_name: str | None,
    estimator: str | None = None,
) -> tuple[Recording, ChosenConfig]:
    """A recording and its configuration, with its bank dissolved into one ``estimator`` if asked.

    Raises :class:`CompanionError` for an estimator that is not known, with the words that are.
    """
    from replay.configuration import choose_config

    recording = read_recording(console, logs, vehicle_name, config_path)
    chosen = choose_config(recording, config_path)
    if estimator is not None:
        chosen = _one_estimator(chosen, estimator)
    compile_kernels(kernels.parts_of(chosen.config))
    return recording, chosen


def _one_estimator(chosen: ChosenConfig, name: str) -> ChosenConfig:
    """The choice with the estimator that is asked for in the place of what it would run."""
    try:
        config = alone(chosen.config, name)
    except CompanionError as error:
        raise CompanionError(f"--estimator: {error}") from None
    if config.engine.estimator == "direct":
        smoothing = msgspec.structs.replace(config.smoothing, enabled=False)
        config = msgspec.structs.replace(config, smoothing=smoothing)
    return replace(chosen, config=config, toml=to_toml(config))


def out_path(out: Path | None, logs: Sequence[Path], ending: str = "run") -> Path:
    """Where the run log goes, ``<log>.<ending>.mcap``; never over a log that is being read."""
    inputs = {p.resolve() for p in logs}
    if out is None:
        name = logs[0].resolve().name
        stem = name if logs[0].is_dir() else Path(name.removesuffix(".run.mcap")).stem
        out = Path(f"{stem}.{ending}.mcap")
        if out.resolve() in inputs:
            out = Path(f"{stem}.again.{ending}.mcap")
    if out.resolve() in inputs:
        raise CompanionError(f"{out}: is the log being read; choose another --out")
    if not out.parent.is_dir():
        raise CompanionError(f"{out}: the directory {out.parent} does not exist")
    return out


def _describe(result: SessionResult, outages: Sequence[Window]) -> dict[str, Any]:
    """One vehicle's entry of ``replay --json``."""
    from replay.assessment import assess
    from replay.evaluation import EvaluationError
    from replay.summary import summarise

    summary = summarise(
        result.vehicle,
        result.solution,
        result.reports,
        result.events,
        result.adaptation,
        result.satellites,
    )
    accuracy, why_none = None, None
    try:
        accuracy = assess(
            result.vehicle,
            result.chosen.config,
            result.solution,
            result.reports,
            withheld=outages,
            digest=result.digest,
            digest_published=result.digest_published,
        ).to_json()
    except EvaluationError as error:
        why_none = str(error)
    wall_s = max(result.wall_s, 1e-9)
    return plain(
        {
            **msgspec.structs.asdict(summary),
            "config": result.chosen.origin,
            "withheld": [plain(w) for w in outages],
            "accuracy": accuracy,
            "no_accuracy_because": why_none,
            "digest": result.digest,
            "digest_published": result.digest_published,
            "cpu_s": result.cpu_s,
            "times_real_time": summary.flight.duration_s / wall_s,
        }
    )


def plain(value: Any) -> dict[str, Any]:
    """As it will be in JSON: plain types, and None for what is not a number."""
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(value))
    return plain


def compile_kernels(parts: Sequence[str] = ("filter",)) -> None:
    """Compile the kernels of ``parts`` where that was never done, visibly; else cost nothing.

    Parts of :mod:`replay.kernels`. Others compile when they are first called, and a line says so.
    """
    console = Console(stderr=True, soft_wrap=True)
    if not kernels.compiled(*parts):
        console.print(
            "First start here: compiling the numerical kernels, once; about a minute …",
            style="yellow",
        )
        with present.progress(console, "Compiling kernels") as update:
            kernels.load(parts, update)

    def tell() -> None:
        _jit.waits.clear()
        console.print("Compiling further kernels, once; up to a minute …", style="yellow")

    _jit.waits[:] = [tell]


def simulate_scenario(console: Console, scenario: str, output: Path, seed: int) -> dict[str, Any]:
    """Simulate, and write sensor folder, telemetry log and truth into one directory."""
    compile_kernels(["simulator"])
    with present.notice_if_slow(console, LOADING):
        from replay.simulator import load_scenario
        from replay.simulator.flight import write_flight
    made = load_scenario(scenario)
    duration_s = made.trajectory.duration_s
    with present.notice_if_slow(console, f"Simulating {duration_s:g} s …"):
        write_flight(made, seed, output)
    console.print(f"Simulated {escape(made.name)} with seed {seed}, {duration_s:g} s")
    console.print(f"Replay    companion replay {escape(str(output))}")
    return {
        "scenario": made.name,
        "seed": seed,
        "duration_s": duration_s,
        "out": str(output),
        "tlog": str(output / "flight.tlog"),
    }


def run_bench(
    console: Console,
    parts: Sequence[str],
    minutes: float,
    repeats: int,
    tlog: Path | None,
    config_path: Path | None,
) -> dict[str, Any]:
    """Measure speed, memory and start-up on this machine."""
    compile_kernels(tuple(kernels.PARTS))
    with present.notice_if_slow(console, LOADING):
        from replay import bench
    with present.progress(console, "Measuring") as update:
        figures = bench.main(
            [part for part in bench.PARTS if part in parts],
            duration_s=60.0 * minutes,
            repeats=repeats,
            tlog=tlog,
            config=config_path,
            progress=update,
        )
    for line in bench.lines(figures):
        console.print(escape(line))
    return figures
