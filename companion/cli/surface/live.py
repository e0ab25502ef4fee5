"""Commands on links and running processes: arguments in, one function call, one JSON object out."""

from __future__ import annotations

import gc
from pathlib import Path
from typing import Annotated

import typer

from companion.cli.surface.options import (
    JsonFlag,
    console_for,
    emit_if,
)


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
    console = console_for(as_json)
    # The start makes a hundred thousand objects that all stay: looking for others costs a tenth of
    # it. The runtime collects again from its first sample on.
    gc.disable()
    try:
        from companion.cli.run import run_live

        result = run_live(console, config, seconds, log)
    finally:
        gc.enable()
    emit_if(as_json, result)


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
    console = console_for(as_json)
    from companion.cli.demo import run_demo

    emit_if(as_json, run_demo(console, out, seconds, imu_rate))


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
    console = console_for(as_json)
    from companion.cli.check import check_config

    result = check_config(console, config, seconds)
    emit_if(as_json, result)
    if not result["ok"]:
        raise typer.Exit(1)


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
    console = console_for(as_json)
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
    emit_if(as_json, picture or {})
