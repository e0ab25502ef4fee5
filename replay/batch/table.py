"""The rows of a batch as a CSV file, outliers first."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import msgspec

from replay.batch.outcome import Outcome, Row
from replay.batch.outliers import Found

_FIRST = ("log", "path", "ended", "reason", "stands_out")
_LAST = ("key", "wall_s", "peak_mb")


def write_csv(path: Path, found: Sequence[Found], others: Sequence[Outcome]) -> None:
    """One line a vehicle, then one for each log without any; unknown figures are empty.

    Columns: of :class:`Outcome`, what stands out, and of :class:`Row`; units in their names.
    """
    of_row = tuple(field.name for field in msgspec.structs.fields(Row))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow((*_FIRST, *of_row, *_LAST))
        for one in found:
            cells = [getattr(one.row, name) for name in of_row]
            writer.writerow(_line(one.outcome, "; ".join(one.words), cells))
        for outcome in others:
            writer.writerow(_line(outcome, "", [None] * len(of_row)))


def _line(outcome: Outcome, stands_out: str, cells: Sequence[object]) -> list[object]:
    said = (outcome.log, outcome.path, outcome.ended, outcome.reason, stands_out)
    return [*said, *cells, outcome.key, outcome.wall_s, outcome.peak_mb]
