"""The live page beside a whole system, in a headless Chromium: how soon it says what happens.

``python -m tests.benchmarks.live_page``: about two minutes. The simulated vehicle of the demo, the
companion with its default time-outs, ``companion watch --web`` and the browser share the machine.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from companion.config import Config, Live
from replay.children import Child, free_port
from tests.benchmarks.common import table
from tests.live.system import PATIENCE_S, Companion, config_beside, vehicle_at, written
from tests.watch.browser import opened

PATIENCE_MS = 1000 * PATIENCE_S
FLOWN_S = 20.0


class _Clock:
    """Times from something that is done to what the page shows of it."""

    def __init__(self, page: Any) -> None:
        self._page = page
        self.rows: list[list[str]] = []

    def until(self, what: str, selector: str, **how: Any) -> None:
        begin = time.monotonic()
        self._page.wait_for_selector(selector, timeout=PATIENCE_MS, **how)
        self.rows.append([what, f"{time.monotonic() - begin:.2f}"])


def watching(endpoint: str, port: str) -> Child:
    return Child(
        "companion watch",
        ["companion", "watch", "--web", "--port", port, "--connect", endpoint],
    )


def spent(pid: int) -> tuple[float, float]:
    """CPU time so far [s] and resident memory [MB] of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0, int(fields[21]) * 4096 / 1e6


def default_live(config: Config) -> Config:
    return msgspec.structs.replace(config, live=Live())


def main() -> None:
    if not Path("/proc/self/stat").exists():
        sys.exit("no /proc here: CPU time and memory of a process are read there")
    complaints: list[str] = []
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", str(free_port())
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        vehicle = stack.enter_context(vehicle_at(folder))
        config = written(default_live(config_beside(vehicle, folder, endpoint)), folder)
        page = stack.enter_context(opened("about:blank", complaints))
        clock = _Clock(page)
        with watching(endpoint, port) as watch:
            with Companion(config, folder / "first.mcap") as companion:
                companion.await_event("aligned")
                page.goto(f"http://127.0.0.1:{port}/")
                clock.until("page opened: navigating", "#name:text('navigating')")
                page.wait_for_selector("#gates tr:has-text('gnss position h') td.ok")
                before = spent(watch.pid)[0]
                page.wait_for_timeout(1000 * FLOWN_S)
                cpu_s, memory_mb = spent(watch.pid)
                vehicle.fault("gnss-silent")
                clock.until("GPS killed: its row is red", "#sources tr:has-text('gnss') td.error")
                page.wait_for_timeout(3000)
                vehicle.fault("gnss-silent", on=False)
                clock.until("GPS again: nothing is red", "#sources:not(:has(td.error))")
                companion.send_signal(signal.SIGKILL)
                clock.until("companion killed: gone", "#name:text('gone')")
            with Companion(config, folder / "second.mcap"):
                clock.until("companion started: navigating", "#name:text('navigating')")
                said = list(complaints)
                watch.send_signal(signal.SIGTERM)
                clock.until("watch ended: said so", "#cut:text('No connection')")
                watch.finish()
                with watching(endpoint, port):
                    clock.until("watch started: connected", "#cut", state="hidden")
                    clock.until("and navigating", "#name:text('navigating')")
    print(table(["from … to what the page shows", "s"], clock.rows))
    print(f"\nThe server: {100 * (cpu_s - before) / FLOWN_S:.1f} % of a core, {memory_mb:.0f} MB")
    print(f"On the browser's console until watch was ended: {said if said else 'nothing'}")


if __name__ == "__main__":
    main()
