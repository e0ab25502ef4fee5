"""What a reproduced experiment is: tables with the paper's values beside ours, and figures."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, cast

import msgspec

Cell = str | float | None
"""None: there is no such value, as where the paper shows a curve and prints no number."""


class Table(msgspec.Struct, frozen=True):
    """Rows under named columns; a column for the paper's printed value stands beside ours."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]


class Reproduction(msgspec.Struct, frozen=True):
    """One paper's experiment, done again."""

    paper: str
    """The name on the command line."""
    citation: str
    tables: tuple[Table, ...]
    figures: tuple[str, ...]
    """Files written."""
    notes: tuple[str, ...]
    """One line each: what is the paper's, what had to be assumed, what differs."""


Progress = Callable[[str], None]
"""Told in a few words what is being done."""


class Experiment(Protocol):
    """What a paper's module has."""

    SEEDS: int

    def reproduce(self, out: Path | None, seeds: int, progress: Progress) -> Reproduction:
        """Do it, with so many seeds; figures go to the directory ``out`` where there is one."""


def experiment(paper: str) -> Experiment:
    """The module of a paper; imported here, because it brings the kernels."""
    return cast(Experiment, importlib.import_module(f"replay.reproduce.{paper}"))
