"""Commands that make parameters, flights, tables and timings of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.cli.surface.options import (
    ConfigPath,
    JsonFlag,
    VehicleName,
    console_for,
    emit_if,
)


def tune(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Any log that replay reads.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE.toml", help="Without it ./<log>.tuned.toml."),
    ] = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Noise parameters from a log: Allan deviation at rest, innovations in flight; as TOML.

    Densities deg/s/√Hz and m/s²/√Hz, walks per √s, standard deviations m and m/s.

    Example: companion tune parked.tlog -o imu.toml
    """
    console = console_for(as_json)
    from companion.cli.tune import tune_log

    emit_if(as_json, tune_log(console, log, output, config, vehicle))


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(metavar="SCENARIO", help="Name of a built-in scenario, or a .toml file."),
    ],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Directory to write into.")
    ],
    seed: Annotated[int, typer.Option(min=0, help="Seed of every random number.")] = 0,
    as_json: JsonFlag = False,
) -> None:
    """Make a flight with truth: .tlog, CAN log (candump), sensor folder and truth.csv.

    The same scenario and seed give the same files. Units in scenario files: SI, see their keys.

    Example: companion simulate multirotor-mission -o flight --seed 7
    """
    console = console_for(as_json)
    from companion.cli.commands import simulate_scenario

    emit_if(as_json, simulate_scenario(console, scenario, output, seed))


def reproduce(
    paper: Annotated[
        Literal["kamil", "duong", "sasiadek", "yu"],
        typer.Argument(
            metavar="PAPER",
            help="kamil: two-filter smoothing; duong: smoothing on line; sasiadek: pseudoranges, "
            "best four by GDOP; yu: direct filter.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Also write figures and tables here."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Runs of each case; without it the paper's number."),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """A paper's experiment on simulated sensors: its tables beside ours, and its figures.

    Errors m, m/s and degrees, times s, as the tables say.

    Example: companion reproduce kamil -o kamil
    """
    console = console_for(as_json)
    from companion.cli.reproduce import reproduce_paper

    emit_if(as_json, reproduce_paper(console, paper, output, seeds))


def bench(
    only: Annotated[
        str,
        typer.Option(
            metavar="PART,…",
            help="Only these. filter: CPU time an IMU epoch beside a bare loop and smsfusion; "
            "tight: what ranges of 20 satellites add; memory: peak and growth; start: warm and "
            "cold; tlog: needs --tlog.",
        ),
    ] = "filter,tight,memory,start,tlog",
    minutes: Annotated[
        float, typer.Option(min=5, help="Length of the simulated flight for the filter.")
    ] = 60.0,
    repeats: Annotated[int, typer.Option(min=1, help="Rounds; the figures are medians.")] = 5,
    tlog: Annotated[
        Path | None,
        typer.Option(
            metavar="LOG.tlog", help="Also time `companion replay` of it against pymavlink."
        ),
    ] = None,
    config: ConfigPath = None,
    as_json: JsonFlag = False,
) -> None:
    """Speed, memory and start-up time on this machine, beside peers where they are installed.

    CPU in µs an IMU epoch, memory in MB, times in s. Pinned to one core, rounds interleaved.

    Example: companion bench --only filter,start --repeats 5 --json
    """
    console = console_for(as_json)
    parts = only.split(",")
    unknown = set(parts) - {"filter", "tight", "memory", "start", "tlog"}
    if unknown:
        raise typer.BadParameter(
            f"'{unknown.pop()}': filter, tight, memory, start or tlog", param_hint="'--only'"
        )
    from companion.cli.commands import run_bench

    emit_if(as_json, run_bench(console, parts, minutes, repeats, tlog, config))
