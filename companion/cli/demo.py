"""``companion demo``: the whole system on this machine, with no hardware."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import compile_kernels, plain
from companion.types import CompanionError, Mode

if TYPE_CHECKING:
    from replay.demo.flight import Files, Moment

TELL_EVERY_S = 5.0


def run_demo(console: Console, directory: Path, seconds: float, imu_hz: float) -> dict[str, Any]:
    """Fly, show what happens, compare live with replay; what ``--json`` prints."""
    compile_kernels(["filter", "simulator", "smoothing"])
    with present.notice_if_slow(console, "Loading …"):
        from replay.children import free_port
        from replay.demo.flight import Files, fly
    files = Files(directory)
    console.print(
        f"Starting three processes for {seconds:g} s: a simulated vehicle (CAN IMU behind an slcan "
        "adapter, autopilot over MAVLink), the companion, and a zenoh subscriber …"
    )
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    console.print("See it while it flies, from another terminal:")
    console.print(f"  companion watch --web --connect {endpoint}", highlight=False)
    figures = fly(files, seconds, imu_hz, endpoint, _Teller(console))
    figures = plain({"seconds": seconds, "directory": str(directory), **figures})
    _show(console, figures)
    _show_next(console, files)
    if not figures["digest"]["equal"]:
        raise CompanionError(
            f"live and replay differ: {figures['digest']['live']} and "
            f"{figures['digest']['replayed']}"
        )
    return figures


class _Teller:
    """Prints how it goes, every few seconds."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._due_s = 0.0
        self._waiting = False

    def __call__(self, moment: Moment | None) -> None:
        if moment is None:
            return
        if moment.elapsed_s < self._due_s:
            return
        self._due_s = moment.elapsed_s + TELL_EVERY_S - 0.5
        latency = moment.latency_p50_ms
        self._console.print(
            f"{moment.elapsed_s:6.0f} s  {Mode(moment.mode).name.lower().replace('_', ' '):15s}"
            f"  {moment.speed_mps:4.1f} m/s  height {moment.height_m:6.1f} m"
            f"  error {moment.error_horizontal_m:5.2f} m (says {moment.sd_horizontal_m:.2f})"
            f"  {moment.states_hz:3.0f} states/s"
            + (f", {latency:.2f} ms late" if latency is not None else ""),
            highlight=False,
        )


def _show(console: Console, figures: dict[str, Any]) -> None:
    rates = ", ".join(
        f"{name} {s['rate_hz']:.4g} Hz"
        for name, s in figures["rates_in"].items()
        if s["kind"] not in ("truth", "autopilot")
    )
    console.print(f"In        {escape(rates)}")
    out_hz = figures["rate_out_hz"]
    console.print(
        f"Out       {figures['states_received']} states at the subscriber"
        + (f", {out_hz:.1f} a second" if out_hz is not None else "")
    )
    latency = figures["latency_ms"]
    if latency["p50"] is not None:
        console.print(
            f"Latency   from a sample's arrival to the subscriber: {latency['p50']:.2f} ms median, "
            f"{latency['p99']:.2f} ms p99, {latency['max']:.2f} ms at most"
        )
    error = figures["position_error"]
    if error["horizontal_rms_m"] is not None:
        console.print(
            f"Error     {error['horizontal_rms_m']:.2f} m RMS horizontally, at most "
            f"{error['horizontal_max_m']:.2f} m, {error['rms_3d_m']:.2f} m RMS in 3-D, as received"
        )
    if figures["accuracy"] is not None:
        present.show_accuracy(console, figures["accuracy"])
    smoothed = figures["smoothed"]
    if smoothed is not None:
        console.print(
            f"Smoothed  {smoothed['position_rmse_m']['horizontal']:.2f} m RMS horizontally, "
            f"{smoothed['velocity_rmse_mps']['3d']:.3f} m/s: the same log, every epoch from all "
            "measurements"
        )
    console.print(escape(figures["report"]["headline"]), highlight=False)
    digest = figures["digest"]
    verdict = "equal to the bit" if digest["equal"] else "[red]different[/red]"
    console.print(
        f"Replay    the log, replayed: {verdict} (settled {(digest['live'] or 'none')[:16]}, "
        f"published {(digest['live_published'] or 'none')[:16]})"
    )


def _show_next(console: Console, files: Files) -> None:
    console.print(f"Run log   {escape(str(files.log))}")
    console.print(f"Report    {escape(str(files.report))}, for a browser")
    console.print("Try next")
    for line in (
        f"companion evaluate {files.log} --truth {files.truth}",
        f"companion replay {files.log} --outage 20+8 --out outage.mcap",
        f"companion smooth {files.log}",
        f"companion export {files.log} --format kml -o demo.kml",
        "companion check configs/multirotor.toml    # with your own links in it; then: run",
    ):
        console.print(f"  {escape(line)}", highlight=False)
