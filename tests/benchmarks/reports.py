"""Reports of logs whose story is known: size, time to write, and the verdict in words.

``python -m tests.benchmarks.reports``: about a minute. Real logs where they are there, each with
the settings of its format and fuzzy adaptation; then simulated flights with what happened to GNSS,
and the flight thirty times over: an hour at 200 Hz.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from companion.config import Config
from companion.types import F64, NS, GnssSamples
from replay.configuration import ChosenConfig, choose_config
from replay.preparation import navigable, start_ns
from replay.reader import read_log
from replay.report.page import write_report
from replay.report.run_view import RunView
from replay.session import SessionResult, run_session
from replay.simulator import load_scenario, matching_config, simulate
from replay.window import Window
from tests.benchmarks.common import DATA, table

REAL = {
    "bin-erle/copter/15-12-2014_16.BIN": "nothing",
    "bin-erle/copter/22-12-2014_37.BIN": "two gaps in the log",
    "bin-erle/copter/10-11-2014_103.BIN": "the autopilot's estimate ran away",
    "bin-erle/copter/6-11-2014_GPS_issues1.BIN": "no fix from 76 s to the end",
    "bin-erle/copter/6-11-2014_GPS_issues2.BIN": "no fix for 64 s",
    "sitl/c3_outage.tlog": "four outages, 90 s",
}
RAD_PER_M = 1.0 / 6.4e6
FLIGHT_S, TIMES = 120.0, 30


def fuzzy(config: Config) -> Config:
    return msgspec.structs.replace(
        config, adaptation=msgspec.structs.replace(config.adaptation, method="fuzzy")
    )


def view(name: str, run: SessionResult, config: Config, *withheld: Window) -> RunView:
    return RunView(
        name, run.vehicle, config, run.solution, run.reports, run.events,
        withheld=withheld, adaptation=run.adaptation,
    )  # fmt: skip


def real() -> Iterator[tuple[str, RunView]]:
    for log, story in REAL.items():
        if not (DATA / log).exists():
            continue
        recording = read_log([DATA / log])
        config = fuzzy(choose_config(recording).config)
        vehicle = navigable(recording, config, None)[0][0]
        run = run_session(vehicle, ChosenConfig(config, "benchmark", ""))
        yield story, view(Path(log).name, run, config)


def simulated() -> Iterator[tuple[str, RunView]]:
    mission = load_scenario("multirotor-mission")
    mission = msgspec.structs.replace(
        mission,
        trajectory=msgspec.structs.replace(mission.trajectory, duration_s=FLIGHT_S),
        imu=tuple(msgspec.structs.replace(unit, rate_hz=200.0) for unit in mission.imu),
    )
    vehicle, config = simulate(mission, seed=5), fuzzy(matching_config(mission))
    gnss = vehicle.gnss[0]
    t = (gnss.t_ns - start_ns(vehicle)) / NS
    noise = 5.0 * np.random.default_rng(1).normal(size=len(t))

    def flown(off_m: F64, *withheld: Window) -> RunView:
        moved: GnssSamples = replace(gnss, lat=gnss.lat + off_m * RAD_PER_M)
        chosen = ChosenConfig(config, "benchmark", "")
        run = run_session(replace(vehicle, gnss=(moved,)), chosen, outages=withheld)
        return view("simulated", run, config, *withheld)

    nominal = flown(0.0 * t)
    yield "nothing", nominal
    yield "no GNSS from 60 to 90 s", flown(0.0 * t, Window(60.0, 30.0))
    yield "every fourth second 80 m off", flown(80.0 * ((t > 60) & (t % 4 < 1)))
    yield "1.5 m/s of drift from 60 to 90 s", flown(1.5 * np.clip(t - 60, 0, 30) * (t < 90))
    yield "5 m more noise from 60 to 100 s", flown(noise * ((t > 60) & (t < 100)))
    yield "nothing, 30 times over: an hour", hour(nominal)


def hour(run: RunView) -> RunView:
    """The same flight again and again, as far as a report looks at it; without its truth."""
    v = run.vehicle
    streams = {kind: tuple(map(over, getattr(v, kind))) for kind in ("imu", "gnss", "baro", "mag")}
    return replace(
        run,
        name="an hour",
        vehicle=replace(v, truth=None, **streams),
        solution=over(run.solution),
        reports=over(run.reports),
        adaptation=over(run.adaptation),
    )


def over(columns: Any) -> Any:
    """Columns thirty times over, each time later by the flight's length."""
    flight_ns = round(FLIGHT_S * NS)
    made = {
        f.name: np.concatenate([getattr(columns, f.name)] * TIMES)
        for f in fields(columns)
        if isinstance(getattr(columns, f.name), np.ndarray)
    }
    shift = np.repeat(np.arange(TIMES) * flight_ns, len(columns.t_ns))
    return replace(columns, **made | {"t_ns": made["t_ns"] + shift})


def main() -> None:
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "report.html"
        for runs in (real(), simulated()):
            for story, run in runs:
                begin = time.process_time()
                judgement = write_report(run, path)
                cpu_s = time.process_time() - begin
                size = f"{path.stat().st_size / 1e6:.1f}"
                rows.append([run.name, story, size, f"{cpu_s:.1f}", judgement.headline])
    print(table(["log", "MB", "CPU s"], [[row[0], *row[2:4]] for row in rows]))
    for name, story, _, _, verdict in rows:
        print(f"\n{name}: {story}\n  {verdict}")


if __name__ == "__main__":
    main()
