"""``reproduce duong`` on short drives: its tables are complete and say what the paper's say."""

from __future__ import annotations

from pathlib import Path

import pytest

from replay.reproduce import figures
from replay.reproduce.duong import drives
from replay.reproduce.duong.experiment import reproduce


def test_short_drives_show_the_papers_order(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(drives, "FIRST_S", 330.0)
    monkeypatch.setattr(drives, "SECOND_S", 300.0)
    said: list[str] = []
    found = reproduce(tmp_path, 1, said.append)
    outages, cost, rates, windows = (
        {row[0]: dict(zip(table.columns, row, strict=True)) for row in table.rows}
        for table in found.tables
    )
    error = [outages[name]["inside outages m"] for name in ("forward", "on-line", "off-line")]
    assert error[1] < 0.4 * error[0]
    assert error[2] < 0.4 * error[0]
    assert set(cost) == {"forward", "on-line", "off-line"}
    # Smoothed epochs are as good at any rate; mixed with the filter's they are not.
    smoothed = [rates[f"{hz} Hz"]["smoothed m"] for hz in (10, 25, 50)]
    mixed = [rates[f"{hz} Hz"]["mixed m"] for hz in (10, 25, 50)]
    assert max(smoothed) < 1.05 * min(smoothed)
    assert mixed[0] > mixed[1] > mixed[2]
    ours = [windows[w]["3-D RMSE m"] for w in ("1", "7", "forward")]
    assert ours[1] < ours[0] < ours[2]
    assert len(said) == 2
    if figures.available():
        assert [Path(name).stat().st_size > 20_000 for name in found.figures] == [True]
