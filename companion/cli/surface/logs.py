"""Commands on recorded flights: arguments in, one function call, one JSON object out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from companion.cli.surface.options import (
    ConfigPath,
    EstimatorName,
    JsonFlag,
    SolutionName,
    VehicleName,
    console_for,
    emit_if,
    speed_of,
    windows_of,
)


def replay(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG…",
            help="MAVLink .tlog, ArduPilot .BIN, PX4 .ulg, a run log (.mcap) or a sensor folder; "
            "several belong to one run: a candump .log(.gz) beside a .tlog is its CAN IMU.",
        ),
    ],
    config: ConfigPath = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="RUN.mcap", help="Run log to write; without it ./<log>.run.mcap."),
    ] = None,
    outage: Annotated[
        list[str] | None,
        typer.Option(
            metavar="START+SECONDS[:LEFT]",
            help="Withhold GNSS from START, seconds from the recording's start, for SECONDS; of "
            "raw GNSS, all but the LEFT highest satellites. May be repeated.",
        ),
    ] = None,
    speed: Annotated[
        str | None,
        typer.Option(metavar="max|1|N", help="As fast as it goes (max), or N times real time."),
    ] = None,
    publish: Annotated[
        bool,
        typer.Option(
            "--publish",
            help="Publish over zenoh as a live run does; --speed 1 unless another is given.",
        ),
    ] = False,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Run a recorded flight through the filter; write its log and a summary.

    Lengths are metres, speeds m/s, angles degrees, times seconds.

    Example: companion replay flight.tlog --outage 120+30 --out flight.run.mcap
    """
    console = console_for(as_json)
    windows = windows_of(outage or [], "--outage")
    factor = speed_of(speed or ("1" if publish else "max"))
    from companion.cli.commands import replay_logs

    emit_if(as_json, replay_logs(console, logs, config, out, windows, factor, vehicle, publish))


def evaluate(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run log, or any log: it is replayed first.")
    ],
    truth: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="Truth in the columns of a sensor folder's truth.csv."),
    ] = None,
    window: Annotated[
        str | None,
        typer.Option(
            metavar="START+SECONDS",
            help="Only this span, in seconds from the recording's start.",
        ),
    ] = None,
    solution: SolutionName = "forward",
    estimator: EstimatorName = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Errors of the solution against truth, or against the autopilot's own estimate.

    Position m, velocity m/s, attitude degrees; from the end of alignment on.

    Example: companion evaluate flight.run.mcap --window 60+300 --json
    """
    console = console_for(as_json)
    windows = windows_of([window] if window is not None else [], "--window")
    from companion.cli.results import evaluate_run

    span = windows[0] if windows else None
    emit_if(as_json, evaluate_run(console, run, truth, span, config, vehicle, solution, estimator))


def compare(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG…", help="What replay reads; read once.")
    ],
    estimators: Annotated[
        str,
        typer.Option(
            metavar="A,B,…",
            help="Settings, by commas: adaptation methods (none, fuzzy, flac, innovation, "
            "variational, huber, igg3), estimators (error-state), no-source-faults, "
            "as-configured; several joined by +; or NAME=FILE.toml, a file with keys to change. "
            "Without it every adaptation.",
        ),
    ] = "",
    outage: Annotated[
        list[str] | None,
        typer.Option(metavar="START+SECONDS[:LEFT]", help="Withhold GNSS, as in replay."),
    ] = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Run several estimators or settings on one log, side by side.

    Errors against truth, or the autopilot's estimate where there is none: metres, m/s, degrees.

    Example: companion compare flight.tlog --estimators none,fuzzy,none+no-source-faults
    """
    console = console_for(as_json)
    windows = windows_of(outage or [], "--outage")
    names = [name.strip() for name in estimators.split(",") if name.strip()]
    from companion.cli.compare import compare_settings

    emit_if(as_json, compare_settings(console, logs, names, config, windows, vehicle))


def smooth(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run log, or any log that replay reads.")
    ],
    method: Annotated[
        Literal[
            "bryson-frazier",
            "rts",
            "two-filter",
            "two-filter-straight",
            "two-filter-weighted",
            "on-line",
        ],
        typer.Option(
            help="bryson-frazier: optimal, inverts nothing; rts: the reference beside it; "
            "two-filter: the log run backwards, too, and faded over inside each outage, position "
            "and velocity together; two-filter-straight: each by itself, as Kamil et al. 2014; "
            "two-filter-weighted: the same two runs weighted by their covariances; on-line: as "
            "while flying, after every fix a few update intervals back."
        ),
    ] = "bryson-frazier",
    window: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=100,
            metavar="N",
            help="on-line: update intervals, from fix to fix, to look back over.",
        ),
    ] = None,
    rate: Annotated[
        float, typer.Option(min=0.1, max=1000.0, metavar="HZ", help="Smoothed epochs per second.")
    ] = 10.0,
    states_only: Annotated[
        bool, typer.Option("--states-only", help="Without standard deviations: faster, smaller.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="RUN.mcap", help="Run log to write; else ./<log>.smoothed.mcap."),
    ] = None,
    outage: Annotated[
        list[str] | None,
        typer.Option(
            metavar="START+SECONDS",
            help="Withhold GNSS, as in replay; without it what the run itself withheld.",
        ),
    ] = None,
    estimator: EstimatorName = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Smooth a run: every epoch from all measurements, those after it too.

    Writes a run log with the forward and the smoothed solution. Metres, m/s, degrees.

    Example: companion smooth flight.run.mcap --rate 20
    """
    console = console_for(as_json)
    windows = windows_of(outage or [], "--outage")
    from companion.cli.smooth import smooth_run

    if window is not None and method != "on-line":
        raise typer.BadParameter("goes with --method on-line", param_hint="'--window'")
    made = smooth_run(
        console, run, method, rate, not states_only, out, windows, config, vehicle, window,
        estimator,
    )  # fmt: skip
    emit_if(as_json, made)


def export(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run log, or any log: it is replayed first.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")],
    file_format: Annotated[
        Literal["csv", "kml", "gpx", "geojson", "ros2"],
        typer.Option(
            "--format",
            help="csv: t_ns, degrees, metres, m/s, standard deviations. kml: with times, outages "
            "in another colour. gpx, geojson: the track in stretches. ros2: a bag, one .mcap with "
            "odometry and fixes.",
        ),
    ] = "csv",
    solution: Annotated[
        Literal["forward", "smoothed", "autopilot"],
        typer.Option(
            help="As published at the time, smoothed (made now where the log has none), or the "
            "autopilot's own."
        ),
    ] = "forward",
    rate: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            metavar="HZ",
            help="At most this many epochs a second; without it all in csv and ros2, 5 in maps.",
        ),
    ] = None,
    estimator: EstimatorName = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Write the solution to a file that other programs read.

    Times are ns, angles degrees, heights metres over the ellipsoid (or the log's own datum).

    Example: companion export flight.run.mcap --format kml --solution smoothed -o flight.kml
    """
    console = console_for(as_json)
    from companion.cli.results import export_run

    result = export_run(
        console, run, output, file_format, config, vehicle, solution, rate, estimator
    )
    emit_if(as_json, result)


def report(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="A run log, or any log: it is replayed first.")
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE.html",
            help="Without it ./<log>.report.html.",
        ),
    ] = None,
    estimator: EstimatorName = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """One page about a run: verdict, track, states with ±σ, errors, innovations, sensors, events.

    It opens without a network. Lengths m, speeds m/s, angles degrees, times s.

    Example: companion report flight.run.mcap -o flight.html
    """
    console = console_for(as_json)
    from companion.cli.results import report_run

    emit_if(as_json, report_run(console, run, output, config, vehicle, estimator))


def batch(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG…",
            help="What replay reads, each a run of its own; of a folder everything below it.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Where pages, table and what is done are kept. The same DIR again: only what is "
            "new or changed is worked on.",
        ),
    ],
    config: ConfigPath = None,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="tcp://HOST:PORT",
            help="A Dask cluster whose workers see the same paths; without it this machine.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, metavar="N", help="Logs at a time on this machine; else all cores."),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option(min=1.0, metavar="SECONDS", help="A log that takes longer is given up."),
    ] = 1800.0,
    rate: Annotated[
        float, typer.Option(min=0.1, max=1000.0, metavar="HZ", help="Smoothed epochs per second.")
    ] = 10.0,
    as_json: JsonFlag = False,
) -> None:
    """Replay, smooth, evaluate and report many logs, on all cores or a Dask cluster.

    DIR/index.html: outliers first; DIR/logs.csv: a row a flight, in m, m/s, degrees and s. A log
    that cannot be read, crashes or hangs is listed there, and the others go on.

    Example: companion batch flights/ -o fleet
    """
    console = console_for(as_json)
    from companion.cli.batch import batch_logs

    made = batch_logs(console, logs, output, config, scheduler, workers, timeout, rate)
    emit_if(as_json, made)


def satellites(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH…",
            help="One receiver's raw measurements: u-blox .ubx, RTCM 3 .rtcm3, RINEX observation "
            "and navigation files, GnssLogger .txt; or the folder that holds them.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="FILE.csv", help="Fixes, as gnss.csv of a sensor folder."
        ),
    ] = None,
    config: ConfigPath = None,
    as_json: JsonFlag = False,
) -> None:
    """Raw GNSS by itself: satellites, geometry, what is refused, a least-squares place an epoch.

    No inertial unit is in it. Degrees, metres above the ellipsoid, m/s. [raw_gnss] of --config says
    which satellites are used and what their ranges are worth.

    Example: companion satellites receiver.ubx -o fixes.csv
    """
    console = console_for(as_json)
    from companion.cli.satellites import solve_receiver

    emit_if(as_json, solve_receiver(console, paths, config, output))
