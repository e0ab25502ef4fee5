"""``companion compare``: several estimators or settings on one log, side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from companion import present
from companion.cli.commands import LOADING, compile_kernels, plain, read
from replay.window import Window


def compare_settings(
    console: Console,
    logs: Sequence[Path],
    names: Sequence[str],
    config_path: Path | None,
    outages: Sequence[Window],
    vehicle_name: str | None,
) -> dict[str, Any]:
    """Run every setting on every vehicle of a run; tables, and what ``--json`` prints."""
    compile_kernels()
    from replay.preparation import navigable

    recording, chosen = read(console, logs, config_path, vehicle_name)
    with present.notice_if_slow(console, LOADING):
        from replay import comparison
    wanted = comparison.settings(chosen, names or comparison.usual(chosen.config))
    fit, refused = navigable(recording, None, vehicle_name)
    for one in refused:
        console.print(f"[yellow]Vehicle {escape(one.name)} left out: {escape(one.reason)}")
    vehicles = []
    for vehicle in fit:
        with present.progress(console, f"Vehicle {vehicle.name}") as update:
            rows = comparison.compare(vehicle, wanted, outages, update)
        entry = plain({"vehicle": vehicle.name, "settings": rows})
        _show(console, entry)
        vehicles.append(entry)
    return {"log": [str(p) for p in logs], "config": chosen.origin, "vehicles": vehicles}


def _show(console: Console, entry: Mapping[str, Any]) -> None:
    rows = entry["settings"]
    known = next((r["reference"] for r in rows if r["reference"]), None)
    against = {"truth": "truth", "autopilot": "the autopilot's own estimate", None: "nothing"}
    console.print(
        f"[bold]Vehicle {escape(entry['vehicle'])}[/bold], errors against {against[known]}"
    )
    if known is None:
        console.print(f"Accuracy  {escape(rows[0]['no_accuracy_because'])}")
    # RMS errors; the largest error inside any time without GNSS; share of measurements refused.
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    columns = ("hor. m", "down m", "vel. m/s", "yaw °", "NEES", "outage m", "refused", "resets",
               "CPU s")  # fmt: skip
    for name in columns:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(escape(row["name"]), *_cells(row))
    console.print(table)
    for row in rows:
        said = f"; {_counted(row['warnings'])}" if row["warnings"] else ""
        digests = f"settled {row['digest'][:16]}, published {row['digest_published'][:16]}"
        console.print(f"{escape(row['name'])}: {digests}{said}", highlight=False)


def _cells(row: Mapping[str, Any]) -> list[str]:
    def number(section: str, key: str, digits: int) -> str:
        value = (row[section] or {}).get(key)
        return "-" if value is None else f"{value:.{digits}f}"

    ends = [o["max_horizontal_error_m"] for o in row["outages"]]
    worst = [e for e in ends if e is not None]
    nees = row["position_nees_mean"]
    seen = row["accepted"] + row["rejected"]
    return [
        number("position_rmse_m", "horizontal", 3),
        number("position_rmse_m", "d", 3),
        number("velocity_rmse_mps", "3d", 3),
        number("attitude_rmse_deg", "yaw", 2),
        "-" if nees is None else f"{nees:.2f}",
        f"{max(worst):.2f}" if worst else "-",
        f"{100.0 * row['rejected'] / max(seen, 1):.1f} %",
        str(row["resets"]),
        f"{row['cpu_s']:.2f}",
    ]


def _counted(kinds: Sequence[str]) -> str:
    """``source-fault 2, relocked 1``: kinds with how often, in the order of their first."""
    return ", ".join(f"{kind} {kinds.count(kind)}" for kind in dict.fromkeys(kinds))
