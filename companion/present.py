"""What people read in the terminal: summaries as tables, progress, and patience."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table

_PATIENCE_S = 2.0
"""Work that is done sooner needs no progress."""
_PLAIN_INTERVAL_S = 5.0
"""Between progress lines where the output is no terminal."""


@contextmanager
def notice_if_slow(console: Console, text: str, after_s: float = 2.0) -> Iterator[None]:
    """Print ``text`` once if the block takes longer than ``after_s``."""
    timer = threading.Timer(after_s, lambda: console.print(text, style="yellow"))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextmanager
def progress(console: Console, label: str) -> Iterator[Callable[[float], None]]:
    """A function to be told the fraction done: a bar on a terminal, else a line now and then.

    Nothing is shown in the first two seconds.
    """
    if console.is_terminal:
        with _bar(console, label) as update:
            yield update
    else:
        yield _plain(console, label)


@contextmanager
def _bar(console: Console, label: str) -> Iterator[Callable[[float], None]]:
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )
    task = bar.add_task(label, total=1.0)
    begin = time.monotonic()

    def update(fraction: float) -> None:
        if not bar.live.is_started and time.monotonic() - begin > _PATIENCE_S:
            bar.start()
        bar.update(task, completed=fraction)

    try:
        yield update
    finally:
        bar.stop()


def _plain(console: Console, label: str) -> Callable[[float], None]:
    due = time.monotonic() + _PATIENCE_S

    def update(fraction: float) -> None:
        nonlocal due
        if time.monotonic() > due:
            due = time.monotonic() + _PLAIN_INTERVAL_S
            console.print(f"{label}: {fraction:.0%}")

    return update


def show_run(console: Console, run: Mapping[str, Any]) -> None:
    """Print one vehicle's entry of ``replay --json``."""
    _show_flight(console, run)
    _show_sensors(console, run["sensors"])
    _show_start(console, run["start"])
    _show_gates(console, run["gates"])
    show_sky(console, run["sky"])
    _show_sources(console, run["sources"])
    show_events(console, run["events"])
    _show_adaptation(console, run["adaptation"])
    if run["accuracy"] is not None:
        show_accuracy(console, run["accuracy"])
    else:
        console.print(f"Accuracy  {escape(run['no_accuracy_because'])}")
    console.print(
        f"Digest    settled {run['digest'][:16]}, published {run['digest_published'][:16]}"
    )
    console.print(
        f"Speed     {run['cpu_s']:.2f} s of CPU, {run['times_real_time']:.0f} times real time"
    )


def _show_flight(console: Console, run: Mapping[str, Any]) -> None:
    flight = run["flight"]
    when = f", from {flight['start_utc']}" if flight["start_utc"] else ""
    console.print(f"[bold]Vehicle {escape(run['vehicle'])}[/bold]{when}")
    if flight["min_height_m"] is None:
        console.print("Flown     nothing: the filter never aligned")
        return
    console.print(
        f"Flown     {span(flight['duration_s'])}, {flight['distance_m']:.0f} m over ground, "
        f"at most {flight['max_speed_mps']:.1f} m/s, height {flight['min_height_m']:.1f} to "
        f"{flight['max_height_m']:.1f} m ({flight['height_datum'].upper()})"
    )
    console.print(f"Settings  {escape(run['config'])}")
    if run["withheld"]:
        windows = ", ".join(
            f"{w['start_s']:g}-{w['start_s'] + w['seconds']:g} s"
            + (f" but for {w['left']} satellites" if w["left"] else "")
            for w in run["withheld"]
        )
        console.print(f"Withheld  GNSS in {windows}")


def span(seconds: float) -> str:
    """``2 min 19 s``."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{seconds:.1f} s"


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=None, pad_edge=False, title_style="bold")
    table.add_column(columns[0])
    for name in columns[1:]:
        table.add_column(name, justify="right")
    return table


def _show_sensors(console: Console, sensors: Sequence[Mapping[str, Any]]) -> None:
    table = _table("Sensors", "stream", "kind", "samples", "Hz", "gaps", "longest gap s")
    for s in sensors:
        table.add_row(
            escape(s["source"]),
            s["kind"],
            str(s["count"]),
            f"{s['rate_hz']:.4g}",
            str(s["gaps"]),
            f"{s['longest_gap_s']:.2f}",
        )
    console.print(table)


def _show_start(console: Console, start: Mapping[str, Any]) -> None:
    if start["levelled_after_s"] is None:
        console.print("Start     never levelled")
    elif start["heading_after_s"] is None:
        console.print("Start     levelled; heading never found (no turn or acceleration shows it)")
    elif start["heading_was_unknown"]:
        console.print(
            f"Start     levelled after {start['levelled_after_s']:.1f} s; heading unknown at "
            f"first, found from motion after {start['heading_after_s']:.1f} s"
        )
    else:
        console.print(f"Start     level and heading after {start['heading_after_s']:.1f} s")
    console.print(
        f"Then      {start['resets']} resets, {start['coasting_s']:.1f} s without aiding, "
        f"at the end {start['final_mode'].replace('_', ' ')}"
    )


def _show_gates(console: Console, gates: Mapping[str, Mapping[str, Any]]) -> None:
    table = _table("Aiding", "channel", "accepted", "refused", "NIS/dof", "why refused")
    for name, gate in gates.items():
        why = ", ".join(f"{k.split('_', 1)[1]} {n}" for k, n in gate["refused"].items())
        table.add_row(
            name.replace("_", " "),
            str(gate["accepted"]),
            str(sum(gate["refused"].values())),
            _number(gate["nis_per_dof"], 2),
            why.replace("_", " "),
        )
    console.print(table)


def _show_sources(console: Console, sources: Mapping[str, Mapping[str, Any]]) -> None:
    for name, source in sources.items():
        refused = [f"single fixes from {_number(source['smallest_spike_m'], 1)} m off"]
        if source["slowest_drift_mps"] is not None:
            refused.append(
                f"drifts from {source['slowest_drift_mps']:.2f} m/s, once "
                f"{source['drift_found_at_m']:.1f} m off"
            )
        faulty = f"; faulty for {source['faulty_s']:.1f} s" if source["faulty_s"] > 0 else ""
        console.print(
            f"GNSS      {name}: refused are {', and '.join(refused)}{faulty}", highlight=False
        )


def show_sky(console: Console, sky: Mapping[str, Any] | None) -> None:
    """Print ``sky`` of ``replay --json``, a line."""
    if sky is None:
        return
    geometry = ""
    if sky["gdop_median"] is not None:
        geometry = (
            f"; GDOP {sky['gdop_median']:.1f}, at worst {sky['gdop_worst']:.1f} "
            f"(HDOP {sky['hdop_median']:.1f}, VDOP {sky['vdop_median']:.1f})"
        )
    few = sky["fewer_than_four"]
    said = [f"{few} of {sky['epochs']} epochs with fewer than 4"] if few else []
    said += [f"{sky['excluded']} ranges contradicted the others"] if sky["excluded"] else []
    said += [f"the set changed {sky['changes']} times"] if sky["changes"] else []
    console.print(
        f"Sky       {sky['satellites_least']} to {sky['satellites_most']} satellites in use, "
        f"{sky['satellites_median']:.0f} in the median{geometry}"
        + "".join(f"; {one}" for one in said),
        highlight=False,
    )


def show_events(console: Console, events: Sequence[Mapping[str, Any]], most: int = 12) -> None:
    """The first of them; changes of the set of satellites are counted above, by the sky."""
    colour = {"info": "default", "warning": "yellow", "error": "red"}
    every, events = len(events), [e for e in events if e["kind"] != "satellite-set"]
    for event in events[:most]:
        at = (
            f"{round(event['time_s'], 1) + 0.0:8.1f} s" if event["time_s"] is not None else " " * 10
        )
        console.print(
            f"[{colour[event['level']]}]{at}  {event['kind']}: {escape(event['text'])}",
            highlight=False,
        )
    left_out = every - min(len(events), most)
    if left_out:
        console.print(f"           and {left_out} more events; the log has them all")


def _show_adaptation(
    console: Console, episodes: Sequence[Mapping[str, Any]], most: int = 12
) -> None:
    if not episodes:
        return
    legend = "(innovations: what a sensor measured beside what the filter foresaw)"
    console.print(f"[bold]Adapted[/bold]   {legend}", highlight=False)
    for e in episodes[:most]:
        what = e["channel"].replace("_", " ")
        if e["what"] == "R":
            what += f" trusted {e['greatest'] ** 0.5:.1f} times less (R ×{e['greatest']:.3g})"
        elif e["what"] == "Q":
            what = f"inertial unit trusted less (Q ×{e['greatest']:.3g}), by {what}"
        else:
            what = f"past weighted less (α {e['greatest']:.3f}), by {what}"
        because = f": {e['because']}" if e["because"] else ""
        console.print(
            f"{e['start_s']:8.1f} to {e['end_s']:.1f} s  {what}{because}", highlight=False
        )
    if len(episodes) > most:
        console.print(f"           and {len(episodes) - most} more")


def show_accuracy(console: Console, accuracy: Mapping[str, Any]) -> None:
    """Print one ``evaluate --json`` object."""
    against = {"truth": "truth", "autopilot": "the autopilot's own estimate"}
    table = _table(
        f"Errors against {against[accuracy['reference']]}, RMS over "
        f"{span(accuracy['duration_s'])} ({accuracy['solution']} solution)",
        "",
        *("north", "east", "down", "horizontal", "3-D"),
    )
    p, v = accuracy["position_rmse_m"], accuracy["velocity_rmse_mps"]
    table.add_row("position m", *(_number(p[k], 3) for k in ("n", "e", "d", "horizontal", "3d")))
    table.add_row(
        "velocity m/s", *(_number(v[k], 3) for k in ("n", "e", "d")), "", _number(v["3d"], 3)
    )
    console.print(table)
    a = accuracy["attitude_rmse_deg"]
    console.print(
        "attitude  "
        + ", ".join(f"{k} {_number(a[k], 2)}" for k in ("roll", "pitch", "yaw"))
        + " deg"
    )
    console.print(
        f"NEES      {_number(accuracy['position_nees_mean'], 2)} of position "
        "(3 where the stated standard deviations are honest)"
    )
    _show_outages(console, accuracy["outages"])


def _show_outages(console: Console, outages: Sequence[Mapping[str, Any]]) -> None:
    if not outages:
        return
    table = _table("Without GNSS", "from s", "seconds", "largest error m", "error at its end m")
    for o in outages:
        table.add_row(
            f"{o['start_s']:.1f}",
            f"{o['seconds']:.1f}",
            _number(o["max_horizontal_error_m"], 2),
            _number(o["end_horizontal_error_m"], 2),
        )
    console.print(table)


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
