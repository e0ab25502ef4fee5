"""The ``companion`` command: arguments in, one function call, tables or one JSON object out.

Heavy modules are imported inside the commands, so that ``--help`` answers at once. Exit status:
0 success, 1 a failure explained in one line on stderr, 2 wrong usage.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import traceback
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn

import typer
from rich.console import Console

from companion import __version__

if TYPE_CHECKING:
    from replay.window import Window

app = typer.Typer(
    name="companion",
    help="Navigation for drones and vehicles: replay recorded flights through the filter, "
    "evaluate, export, simulate.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)

SolutionName = Annotated[
    Literal["forward", "smoothed"],
    typer.Option(help="As published at the time, or smoothed (made now where the log has none)."),
]
JsonFlag = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout; text for people on stderr.")
]
ConfigPath = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Configuration (TOML). Without it: the one that came with the log, else defaults "
        "for its format. The output says which.",
    ),
]
VehicleName = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Only this vehicle of a log that holds several."),
]


def _console(as_json: bool) -> Console:
    return Console(stderr=as_json, soft_wrap=True)


def _emit(result: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(result, allow_nan=False) + "\n")


def _windows(texts: Sequence[str], option: str) -> list[Window]:
    """``START+SECONDS`` texts as windows; wrong ones are wrong usage."""
    from replay.window import parse_window

    windows = []
    for text in texts:
        try:
            windows.append(parse_window(text))
        except ValueError:
            raise typer.BadParameter(
                f"'{text}': START+SECONDS, both in seconds, such as 120+30",
                param_hint=f"'{option}'",
            ) from None
    return windows


def _speed(text: str) -> float | None:
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise typer.BadParameter(
            f"'{text}': max, 1 (real time) or a factor on real time", param_hint="'--speed'"
        )
    return speed


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        print(f"companion {__version__}")
        raise typer.Exit


@app.command(no_args_is_help=True)
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
            metavar="START+SECONDS",
            help="Withhold GNSS from START, seconds from the recording's start, for SECONDS. "
            "May be repeated.",
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
    console = _console(as_json)
    windows = _windows(outage or [], "--outage")
    factor = _speed(speed or ("1" if publish else "max"))
    from companion.cli.commands import replay_logs

    _emit_if(as_json, replay_logs(console, logs, config, out, windows, factor, vehicle, publish))


@app.command(no_args_is_help=True)
def run(
    config: Annotated[
        Path,
        typer.Argument(metavar="CONFIG", help="Configuration (TOML) with [[can]] or [mavlink]."),
    ],
    seconds: Annotated[
        float | None,
        typer.Option(
            "--for",
            min=0,
            metavar="SECONDS",
            help="End after this long; without it at Ctrl-C or SIGTERM.",
        ),
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option(
            metavar="RUN.mcap",
            help="Run log; without it a new one in log.directory, with the date.",
        ),
    ] = None,
    as_json: JsonFlag = False,
) -> None:
    """Navigate live: sensors in, solution out over zenoh, everything logged.

    Latencies are ms, times seconds. Ctrl-C and SIGTERM end it cleanly; a second one at once.

    Example: companion run configs/multirotor-dronecan.toml --for 60 --log flight.run.mcap
    """
    console = _console(as_json)
    # The start makes a hundred thousand objects that all stay: looking for others costs a tenth of
    # it. The runtime collects again from its first sample on.
    gc.disable()
    try:
        from companion.cli.run import run_live

        result = run_live(console, config, seconds, log)
    finally:
        gc.enable()
    _emit_if(as_json, result)


@app.command(no_args_is_help=True)
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
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Errors of the solution against truth, or against the autopilot's own estimate.

    Position m, velocity m/s, attitude degrees; from the end of alignment on.

    Example: companion evaluate flight.run.mcap --window 60+300 --json
    """
    console = _console(as_json)
    windows = _windows([window] if window is not None else [], "--window")
    from companion.cli.results import evaluate_run

    span = windows[0] if windows else None
    _emit_if(as_json, evaluate_run(console, run, truth, span, config, vehicle, solution))


@app.command(no_args_is_help=True)
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
        typer.Option(metavar="START+SECONDS", help="Withhold GNSS, as in replay."),
    ] = None,
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Run several estimators or settings on one log, side by side.

    Errors against truth, or the autopilot's estimate where there is none: metres, m/s, degrees.

    Example: companion compare flight.tlog --estimators none,fuzzy,none+no-source-faults
    """
    console = _console(as_json)
    windows = _windows(outage or [], "--outage")
    names = [name.strip() for name in estimators.split(",") if name.strip()]
    from companion.cli.compare import compare_settings

    _emit_if(as_json, compare_settings(console, logs, names, config, windows, vehicle))


@app.command(no_args_is_help=True)
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
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Smooth a run: every epoch from all measurements, those after it too.

    Writes a run log with the forward and the smoothed solution. Metres, m/s, degrees.

    Example: companion smooth flight.run.mcap --rate 20
    """
    console = _console(as_json)
    windows = _windows(outage or [], "--outage")
    from companion.cli.smooth import smooth_run

    if window is not None and method != "on-line":
        raise typer.BadParameter("goes with --method on-line", param_hint="'--window'")
    made = smooth_run(
        console, run, method, rate, not states_only, out, windows, config, vehicle, window
    )
    _emit_if(as_json, made)


@app.command(no_args_is_help=True)
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
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """Write the solution to a file that other programs read.

    Times are ns, angles degrees, heights metres over the ellipsoid (or the log's own datum).

    Example: companion export flight.run.mcap --format kml --solution smoothed -o flight.kml
    """
    console = _console(as_json)
    from companion.cli.results import export_run

    result = export_run(console, run, output, file_format, config, vehicle, solution, rate)
    _emit_if(as_json, result)


@app.command(no_args_is_help=True)
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
    config: ConfigPath = None,
    vehicle: VehicleName = None,
    as_json: JsonFlag = False,
) -> None:
    """One page about a run: verdict, track, states with ±σ, errors, innovations, sensors, events.

    It opens without a network. Lengths m, speeds m/s, angles degrees, times s.

    Example: companion report flight.run.mcap -o flight.html
    """
    console = _console(as_json)
    from companion.cli.results import report_run

    _emit_if(as_json, report_run(console, run, output, config, vehicle))


@app.command(no_args_is_help=True)
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
    console = _console(as_json)
    from companion.cli.tune import tune_log

    _emit_if(as_json, tune_log(console, log, output, config, vehicle))


@app.command(no_args_is_help=True)
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
    console = _console(as_json)
    from companion.cli.commands import simulate_scenario

    _emit_if(as_json, simulate_scenario(console, scenario, output, seed))


@app.command()
def demo(
    seconds: Annotated[
        float, typer.Option("--for", min=5.0, max=3600.0, metavar="SECONDS", help="How long.")
    ] = 30.0,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Directory for the log and all else that is left.")
    ] = Path("companion-demo"),
    imu_rate: Annotated[
        float, typer.Option(min=50.0, max=1000.0, metavar="HZ", help="Of the simulated CAN IMU.")
    ] = 200.0,
    as_json: JsonFlag = False,
) -> None:
    """The whole system with no hardware: simulated vehicle, companion, zenoh subscriber.

    Three processes on this machine in real time; CAN frames through an slcan adapter on a
    pseudo-terminal, MAVLink over UDP. Latency ms, errors m. At the end the log is replayed.

    Example: companion demo --for 30
    """
    console = _console(as_json)
    from companion.cli.demo import run_demo

    _emit_if(as_json, run_demo(console, out, seconds, imu_rate))


@app.command(no_args_is_help=True)
def check(
    config: Annotated[
        Path, typer.Argument(metavar="CONFIG", help="Configuration of a live vehicle (TOML).")
    ],
    seconds: Annotated[
        float, typer.Option("--for", min=1.0, metavar="SECONDS", help="How long to listen.")
    ] = 8.0,
    as_json: JsonFlag = False,
) -> None:
    """Open each link of a configuration, say what is heard at what rate, and what is missing.

    Rates Hz, noise densities deg/s/√Hz and m/s²/√Hz. Exit 0: it can navigate; 1: it cannot.

    Example: companion check configs/multirotor.toml --for 10
    """
    console = _console(as_json)
    from companion.cli.check import check_config

    result = check_config(console, config, seconds)
    _emit_if(as_json, result)
    if not result["ok"]:
        raise typer.Exit(1)


@app.command()
def watch(
    vehicle: Annotated[
        str | None, typer.Option(metavar="NAME", help="Only this vehicle; all without it.")
    ] = None,
    connect: Annotated[
        str,
        typer.Option(metavar="ENDPOINT", help="A companion's zenoh.listen, or a zenoh router."),
    ] = "tcp/127.0.0.1:7447",
    zenoh_config: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="zenoh configuration (TLS, user and password) instead."),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="One picture, then exit.")] = False,
    web: Annotated[bool, typer.Option("--web", help="As a page for a browser.")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="For Foxglove and Lichtblick, as a WebSocket.")
    ] = False,
    bind: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Where to serve these two. No password!")
    ] = "127.0.0.1",
    port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, show_default="8470 and 8765", help="Of these two; 0: any free one."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="One picture as one JSON object on stdout.")
    ] = False,
) -> None:
    """Live state of a running companion in the terminal or a browser, over zenoh; Ctrl-C ends it.

    Position degrees and m, velocity m/s, attitude degrees, ± one standard deviation, ages s.

    Example: companion watch --connect tcp/192.168.1.20:7447 --web
    """
    console = _console(as_json)
    if web + foxglove + (once or as_json) > 1:
        raise typer.BadParameter("only one of --web, --foxglove and --once (or --json)")
    if web or foxglove:
        from companion.cli.watch import listen_to

        subscriber, where = listen_to(vehicle, connect, zenoh_config)
        if web:
            from companion.cli.watch_web import serve
        else:
            from companion.cli.watch_foxglove import serve
        chosen = port if port is not None else 8470 if web else 8765
        serve(console, subscriber, where, bind, chosen)
        return
    from companion.cli.watch import watch as follow

    picture = follow(console, vehicle, connect, zenoh_config, once or as_json)
    _emit_if(as_json, picture or {})


@app.command(no_args_is_help=True)
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
    console = _console(as_json)
    from companion.cli.reproduce import reproduce_paper

    _emit_if(as_json, reproduce_paper(console, paper, output, seeds))


@app.command(no_args_is_help=True)
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
    console = _console(as_json)
    from companion.cli.batch import batch_logs

    made = batch_logs(console, logs, output, config, scheduler, workers, timeout, rate)
    _emit_if(as_json, made)


@app.command()
def bench(
    only: Annotated[
        str,
        typer.Option(
            metavar="PART,…",
            help="Only these. filter: CPU time an IMU epoch beside a bare loop and smsfusion; "
            "memory: peak and growth; start: warm and cold; tlog: needs --tlog.",
        ),
    ] = "filter,memory,start,tlog",
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
    console = _console(as_json)
    parts = only.split(",")
    unknown = set(parts) - {"filter", "memory", "start", "tlog"}
    if unknown:
        raise typer.BadParameter(
            f"'{unknown.pop()}': filter, memory, start or tlog", param_hint="'--only'"
        )
    from companion.cli.commands import run_bench

    _emit_if(as_json, run_bench(console, parts, minutes, repeats, tlog, config))


def _emit_if(as_json: bool, result: Mapping[str, Any]) -> None:
    if as_json:
        _emit(result)


def _fail(text: str, argv: Sequence[str]) -> NoReturn:
    """One line on stderr (and one JSON object where one was asked for); exit 1."""
    line = " ".join(text.split())
    print(f"error: {line}", file=sys.stderr)
    if "--json" in argv:
        _emit({"error": line})
    sys.exit(1)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Entry point: runs a command and turns every failure into one line and a status."""
    args = list(sys.argv[1:] if argv is None else argv)
    try:
        app(args, prog_name="companion")
    except BrokenPipeError:
        # The reader of our output went away (`| head`); nothing is left to tell it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        _fail(_one_line(error), args)
    sys.exit(0)


def _one_line(error: Exception) -> str:
    from companion.types import CompanionError

    if isinstance(error, CompanionError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'input/output'}: {error.strerror or error}"
    if isinstance(error, MemoryError):
        return "not enough memory for this log"
    if os.environ.get("COMPANION_DEBUG"):
        traceback.print_exception(error)
    return (
        f"internal error {type(error).__name__}: {error}; "
        "run with COMPANION_DEBUG=1 for the traceback"
    )
