"""What ``companion batch`` does."""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import compile_kernels
from companion.types import CompanionError
from replay.batch import store
from replay.batch.listing import find_logs
from replay.batch.outcome import Outcome
from replay.batch.outliers import Found, ranked
from replay.batch.scheduling import run
from replay.batch.summary_page import write_page
from replay.batch.table import write_csv
from replay.batch.worker import Job

_PAGE, _TABLE = "index.html", "logs.csv"
_SHOWN = 5
"""Outliers that the terminal names; the page has all."""


def batch_logs(
    console: Console,
    given: Sequence[Path],
    out: Path,
    config: Path | None,
    scheduler: str | None,
    workers: int | None,
    limit_s: float,
    rate_hz: float,
) -> dict[str, Any]:
    """Work on every log that is not done yet; write the page and the table, whatever happens."""
    logs = find_logs(given, out)
    settings = store.settings_key(config, rate_hz)
    jobs = [
        Job(
            name,
            str(path),
            str(out.absolute()),
            None if config is None else str(config.absolute()),
            settings,
            store.program(),
            rate_hz,
            limit_s,
        )
        for name, path in logs.items()
    ]
    _make_room(out)
    if scheduler is None:
        compile_kernels(("filter", "files"))
    console.print(f"Working on {len(jobs)} logs, into {escape(str(out))}")
    outcomes: list[Outcome] = []
    found: list[Found] = []
    begin = time.monotonic()
    try:
        with present.progress(console, f"{len(jobs)} logs") as update:
            for outcome in run(jobs, scheduler, workers or cores()):
                outcomes.append(outcome)
                _say(console, outcome)
                update(len(outcomes) / len(jobs))
    except KeyboardInterrupt:
        console.print(
            f"Interrupted with {len(outcomes)} of {len(jobs)} logs done; the same command goes on"
        )
        raise
    finally:
        wall_s = time.monotonic() - begin
        # An interrupted batch shows what it has; one that never began leaves the last page.
        if outcomes:
            found = _write(out, outcomes, len(jobs), wall_s)
    _summary(console, found, outcomes, wall_s)
    console.print(f"Page      {escape(str(out / _PAGE))}")
    console.print(f"Table     {escape(str(out / _TABLE))}")
    if not found:
        raise CompanionError(f"none of {len(outcomes)} logs could be navigated: see {out / _PAGE}")
    return _result(out, found, outcomes, wall_s)


def _write(out: Path, outcomes: Sequence[Outcome], listed: int, wall_s: float) -> list[Found]:
    """Page and table of what is known; the rows as they are ranked there."""
    found = ranked(outcomes)
    write_csv(out / _TABLE, found, [o for o in outcomes if o.ended != "done"])
    write_page(out / _PAGE, found, outcomes, _words(outcomes, listed, wall_s))
    return found


def cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _make_room(out: Path) -> None:
    for folder in (out, out / "reports"):
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise CompanionError(f"{folder}: {error.strerror or error}") from None


def _say(console: Console, outcome: Outcome) -> None:
    """A line for a log that did not come to an end; the others are in the page."""
    if outcome.ended == "failed":
        console.print(
            f"[red]Failed[/red]    {escape(outcome.log)}: {escape(outcome.reason)}",
            highlight=False,
        )


def _words(outcomes: Sequence[Outcome], listed: int, wall_s: float) -> list[str]:
    reused = sum(o.reused for o in outcomes)
    new = len(outcomes) - reused
    hours = sum(row.duration_s for o in outcomes for row in o.rows) / 3600.0
    words = [
        f"{hours:.1f} hours of flight; {new} logs worked on in {wall_s:.0f} s, {reused} were done "
        "already."
    ]
    if len(outcomes) < listed:
        words.append(
            f"Interrupted: {listed - len(outcomes)} of {listed} logs are missing; the same command "
            "does them and nothing again."
        )
    return words


def _summary(
    console: Console, found: Sequence[Found], outcomes: Sequence[Outcome], wall_s: float
) -> None:
    ended = Counter(o.ended for o in outcomes)
    verdicts = Counter(one.row.verdict for one in found)
    reused = sum(o.reused for o in outcomes)
    console.print(
        f"Logs      {len(outcomes)}: {ended['done']} replayed, {ended['refused']} refused, "
        f"{ended['failed']} failed; {reused} of them done already; {wall_s:.1f} s"
    )
    console.print(
        f"Flights   {len(found)}: {verdicts['good']} good, {verdicts['degraded']} degraded, "
        f"{verdicts['bad']} bad"
    )
    for one in [one for one in found if one.words][:_SHOWN]:
        console.print(
            f"Outlier   {escape(one.outcome.log)}: {escape(one.words[0])}", highlight=False
        )


def _result(
    out: Path, found: Sequence[Found], outcomes: Sequence[Outcome], wall_s: float
) -> dict[str, Any]:
    def of(ended: str) -> dict[str, str]:
        return {o.log: o.reason for o in outcomes if o.ended == ended}

    return {
        "out": str(out),
        "page": str(out / _PAGE),
        "table": str(out / _TABLE),
        "logs": len(outcomes),
        "flights": len(found),
        "verdicts": dict(Counter(one.row.verdict for one in found)),
        "outliers": {one.outcome.log: list(one.words) for one in found if one.words},
        "failed": of("failed"),
        "refused": of("refused"),
        "reused": sum(o.reused for o in outcomes),
        "wall_s": wall_s,
        "log_wall_s": sum(o.wall_s for o in outcomes if not o.reused),
        "peak_mb": max((o.peak_mb for o in outcomes if not o.reused), default=0.0),
    }
