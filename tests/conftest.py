"""Shared fixtures: where recorded data lies, and the shipped sample flight."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Side by side (pytest-xdist), a file stays together, and live tests never meet each other.

    They run in real time with processes of their own: two at once would be each other's load.
    """
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        folder = item.path.parent.name
        group = "live" if folder == "live" else str(item.path)
        item.add_marker(pytest.mark.xdist_group(group))


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
