"""Every recorded log ends as replayed or as a refusal in one line, and in bounded time."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.benchmarks.all_logs import Outcome, examine_all


@pytest.fixture(scope="module")
def outcomes(data_dir: Path) -> list[Outcome]:
    return examine_all(data_dir)


def test_every_log_is_replayed_or_refused(outcomes: list[Outcome]) -> None:
    bad = [f"{o.path}: {o.ended}: {o.text}" for o in outcomes if o.ended in ("crashed", "hung")]
    assert outcomes
    assert not bad, "\n".join(bad)


def test_a_refusal_is_one_line_that_says_why(outcomes: list[Outcome]) -> None:
    refused = [o for o in outcomes if o.ended == "refused"]
    assert refused
    assert all(o.text.strip() and "\n" not in o.text for o in refused)
