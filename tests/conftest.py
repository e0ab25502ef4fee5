"""Shared fixtures: where recorded data lies, and the shipped sample flight."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def root() -> Path:
    """The repository."""
    return ROOT


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Recorded logs beside the repository; the test is skipped where they are absent."""
    path = ROOT.parent / "shared" / "data"
    if not path.is_dir():
        pytest.skip("no recorded logs in ../shared/data")
    return path


@pytest.fixture(scope="session")
def sample_flight() -> Path:
    """The sample flight that ships with the project."""
    found = sorted((ROOT / "replay" / "data").glob("*.tlog"))
    assert found, "the sample flight is part of the project"
    return found[0]
