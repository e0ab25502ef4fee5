"""``companion reproduce kamil`` on one of its routes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from companion.cli.reproduce import reproduce_paper
from replay.reproduce.kamil import experiment
from replay.reproduce.kamil.routes import ROUTES, drive, length_m


def test_the_routes_are_as_long_as_the_papers() -> None:
    for route in ROUTES:
        plan, duration = drive(route)
        assert 350.0 <= length_m(plan, duration) <= 1701.0
        assert 70.0 <= duration <= 350.0


def test_tables_and_figure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(experiment, "ROUTES", ROUTES[1:2])
    monkeypatch.setattr(experiment, "OUTAGES_S", (30.0,))
    said = Console(file=(tmp_path / "said.txt").open("w", encoding="utf-8"), width=140)
    found = reproduce_paper(said, "kamil", tmp_path, 1)
    assert json.loads((tmp_path / "kamil.json").read_text(encoding="utf-8")) == found
    (figure,) = found["figures"]
    assert Path(figure).read_bytes().startswith(b"\x89PNG")
    inside = next(t for t in found["tables"] if t["title"].startswith("Horizontal"))
    worst = {(row[0], row[1]): row[3] for row in inside["rows"]}
    for seconds in experiment.OUTAGES_S:
        assert worst["consistent", seconds] < worst["forward", seconds]
        assert worst["straight (the paper's)", seconds] < worst["forward", seconds]
        assert worst["optimal", seconds] < worst["straight (the paper's)", seconds]
