"""The live page beside a whole system: simulated vehicle, ``companion run``, ``watch --web``."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import pytest

from replay.children import Child, free_port
from tests.live.system import PATIENCE_S, Companion, config_beside, vehicle_at, written
from tests.watch.browser import opened

PATIENCE_MS = 1000 * PATIENCE_S


@pytest.mark.slow
def test_killed_gps_is_red_within_two_seconds_and_a_killed_companion_is_found_again(
    tmp_path: Path,
) -> None:
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", str(free_port())
    complaints: list[str] = []
    watch = ["companion", "watch", "--web", "--port", port, "--connect", endpoint]
    with (
        vehicle_at(tmp_path) as vehicle,
        Child("companion watch", watch),
        opened("about:blank", complaints) as page,
    ):
        config = written(config_beside(vehicle, tmp_path, endpoint), tmp_path)
        with Companion(config, tmp_path / "first.mcap") as companion:
            companion.await_event("aligned")
            page.goto(f"http://127.0.0.1:{port}/")
            page.wait_for_selector("#name:text('navigating')", timeout=PATIENCE_MS)
            page.wait_for_selector("#gates tr:has-text('gnss position h') td.ok")
            vehicle.fault("gnss-silent")
            begin = time.monotonic()
            page.wait_for_selector("#sources tr:has-text('gnss') td.error", timeout=PATIENCE_MS)
            took = time.monotonic() - begin
            page.wait_for_selector("#sources td.error:text('silent')", timeout=PATIENCE_MS)
            vehicle.fault("gnss-silent", on=False)
            page.wait_for_selector("#sources:not(:has(td.error))", timeout=PATIENCE_MS)
            companion.send_signal(signal.SIGKILL)
            page.wait_for_selector("#name:text('gone')", timeout=PATIENCE_MS)
        with Companion(config, tmp_path / "second.mcap"):
            page.wait_for_selector("#name:text('navigating')", timeout=PATIENCE_MS)
        assert complaints == []
        assert took < 2.0
