"""What ``companion reproduce`` does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from companion import present
from companion.cli.commands import LOADING, compile_kernels, plain

if TYPE_CHECKING:
    from replay.reproduce import paper as papers


def reproduce_paper(
    console: Console, paper: str, out: Path | None, seeds: int | None
) -> dict[str, Any]:
    """Do a paper's experiment, print its tables, and keep them in ``out`` with its figures."""
    compile_kernels(["filter", "simulator"])
    with present.notice_if_slow(console, LOADING):
        from replay.reproduce.paper import experiment

        module = experiment(paper)

    def progress(text: str) -> None:
        console.print(escape(text), style="bright_black")

    found = module.reproduce(out, module.SEEDS if seeds is None else seeds, progress)
    console.print(f"\n{escape(found.citation)}", highlight=False)
    for table in found.tables:
        console.print(_drawn(table))
    for note in found.notes:
        console.print(f"- {escape(note)}", highlight=False)
    result = plain(found)
    if out is not None:
        from msgspec import json

        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{paper}.json"
        path.write_bytes(json.format(json.encode(result)) + b"\n")
        for name in (*found.figures, str(path)):
            console.print(f"Wrote     {escape(name)}", highlight=False)
    return result


def _drawn(table: papers.Table) -> Table:
    drawn = Table(title=escape(table.title), title_justify="left", box=None, pad_edge=False)
    for index, name in enumerate(table.columns):
        drawn.add_column(escape(name), justify="left" if index == 0 else "right")
    for row in table.rows:
        drawn.add_row(*(_cell(value) for value in row))
    return drawn


def _cell(value: papers.Cell) -> str:
    if value is None:
        return "–"
    return escape(value) if isinstance(value, str) else f"{value:.4g}"
