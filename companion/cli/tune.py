"""What ``companion tune`` does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from companion import present
from companion.cli.commands import LOADING, plain, read
from companion.types import CompanionError


def tune_log(
    console: Console,
    log: Path,
    output: Path | None,
    config_path: Path | None,
    vehicle_name: str | None,
) -> dict[str, Any]:
    """Noise parameters from a log, shown beside the present ones and written as TOML."""
    from replay.preparation import navigable

    recording, chosen = read(console, [log], config_path, vehicle_name)
    fit, _ = navigable(recording, None, vehicle_name)
    with present.notice_if_slow(console, LOADING):
        from replay.tuning.parameter import as_toml
        from replay.tuning.tune import tune
    with present.notice_if_slow(console, "Running the flight some times …"):
        tuned = tune(fit[0], chosen.config)
    path = output if output is not None else Path(f"{log.resolve().stem}.tuned.toml")
    title = f"Noise of vehicle {fit[0].name} as its log {log.name} shows it."
    try:
        path.write_text(as_toml(tuned.parameters, title), encoding="utf-8")
    except OSError as error:
        raise CompanionError(f"{path}: {error.strerror or error}") from None
    table = Table("key", "before", "after", "from", box=None)
    for p in tuned.parameters:
        after = "–" if p.after is None else f"{p.after:.3g}"
        table.add_row(f"{p.section}.{p.key}", f"{p.before:.3g}", after, escape(p.reason))
    console.print(table)
    for note in tuned.notes:
        console.print(f"Note      {escape(note)}")
    console.print(f"Wrote     {escape(str(path))}")
    return plain(
        {
            "log": str(log),
            "vehicle": fit[0].name,
            "out": str(path),
            "rest_s": tuned.rest_s,
            "parameters": tuned.parameters,
            "notes": tuned.notes,
        }
    )
