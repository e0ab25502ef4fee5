"""The live page in a browser, beside publishers of made-up vehicles."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest

from companion.config import Zenoh
from companion.logbook.adaptation import encode_trace
from companion.outputs import payloads
from companion.outputs.zenoh_publisher import ZenohPublisher
from companion.types import Channel, Solution
from replay.children import free_port
from tests.outputs.test_zenoh_publisher import HEALTH
from tests.outputs.zenoh_help import PATIENCE_S, outputs, report, solution
from tests.watch.browser import opened
from tests.watch.test_web_model import adapted

PATIENCE_MS = 1000 * PATIENCE_S


class Vehicle:
    """Publishes states at 50 Hz and fixes at 5 Hz, as long as they are wanted."""

    def __init__(self, endpoint: str, name: str, *, connect: bool = False) -> None:
        listen, other = ((), (endpoint,)) if connect else ((endpoint,), ())
        self.publisher = ZenohPublisher(Zenoh(listen=listen, connect=other), name)
        self.fixes = threading.Event()
        self.fixes.set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._fly)

    def _fly(self) -> None:
        k = 0
        while not self._stop.wait(0.02):
            now = time.monotonic_ns()
            self.publisher.publish(outputs(solution(first=k), report(Channel.BARO)), now)
            if k % 10 == 0 and self.fixes.is_set():
                fix = report(Channel.GNSS_POSITION_H)
                self.publisher.publish(outputs(Solution.empty(), fix), now)
            if k % 50 == 0:
                self.publisher.health(HEALTH)
            k += 1

    def adapt(self) -> None:
        """One adapted measurement."""
        for row in encode_trace(adapted()):
            self.publisher._put(payloads.ADAPTATION, row.tobytes())

    def __enter__(self) -> Vehicle:
        assert self.publisher.link.wait_open(PATIENCE_S)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self.publisher.close()


@contextmanager
def watching(endpoint: str, port: int) -> Iterator[None]:
    command = [sys.executable, "-u", "-m", "companion", "watch", "--web", "--port", str(port)]
    with subprocess.Popen(
        [*command, "--connect", endpoint], stdout=subprocess.PIPE, text=True
    ) as run:
        assert run.stdout is not None
        assert run.stdout.readline().startswith("Page ")
        try:
            yield
        finally:
            run.terminate()
        assert run.wait(PATIENCE_S) == 0


def test_values_move_a_lost_receiver_is_red_and_connections_come_back() -> None:
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    complaints: list[str] = []
    with watching(endpoint, port), opened(f"http://127.0.0.1:{port}/", complaints) as page:
        page.wait_for_selector("#cut:text('nobody listens')", timeout=PATIENCE_MS)
        with Vehicle(endpoint, "boat") as boat:
            page.wait_for_selector("#name:text('boat: navigating')", timeout=PATIENCE_MS)
            page.wait_for_selector("#gates td.ok", timeout=PATIENCE_MS)
            first = page.inner_text("#numbers")
            page.wait_for_timeout(600)
            assert page.inner_text("#numbers") != first
            assert page.locator("#charts canvas").count() == 7
            assert not page.locator("#adaptation").is_visible()
            boat.adapt()
            page.wait_for_selector("#adaptation :text('more than expected')", timeout=PATIENCE_MS)

            boat.fixes.clear()
            begin = time.monotonic()
            page.wait_for_selector("#gates td.error:text('overdue')", timeout=PATIENCE_MS)
            # 0.7 s and a frame; a second more for a machine that does other things.
            assert time.monotonic() - begin < 2.0
            assert "GNSS: no measurement" in page.inner_text("#alarms")
            boat.fixes.set()
            page.wait_for_selector("#gates:not(:has(td.error))", timeout=PATIENCE_MS)
        page.wait_for_selector("#name:text('boat: gone')", timeout=PATIENCE_MS)
        with Vehicle(endpoint, "boat"):
            page.wait_for_selector("#name:text('boat: navigating')", timeout=PATIENCE_MS)
        assert complaints == []


def test_the_page_finds_a_watch_that_was_started_again() -> None:
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    complaints: list[str] = []
    with Vehicle(endpoint, "boat"), opened("about:blank", complaints) as page:
        with watching(endpoint, port):
            page.goto(f"http://127.0.0.1:{port}/")
            page.wait_for_selector("#name:text('boat: navigating')", timeout=PATIENCE_MS)
        page.wait_for_selector("#cut:text('No connection')", timeout=PATIENCE_MS)
        with watching(endpoint, port):
            page.wait_for_selector("#cut", state="hidden", timeout=PATIENCE_MS)
            page.wait_for_selector("#name:text('boat: navigating')", timeout=PATIENCE_MS)
    # The browser itself notes each attempt in between, and nothing else is said.
    assert {c for c in complaints if "ERR_CONNECTION_REFUSED" not in c} <= {
        "Failed to load resource: net::ERR_INCOMPLETE_CHUNKED_ENCODING"
    }


def test_several_vehicles_through_a_router() -> None:
    zenoh = pytest.importorskip("zenoh")
    endpoint, port = f"tcp/127.0.0.1:{free_port()}", free_port()
    config = zenoh.Config()
    for key, value in {
        "mode": '"router"', "listen/endpoints": f'["{endpoint}"]',
        "scouting/multicast/enabled": "false", "scouting/gossip/enabled": "false",
    }.items():  # fmt: skip
        config.insert_json5(key, value)
    complaints: list[str] = []
    with (
        closing(zenoh.open(config)),
        Vehicle(endpoint, "boat", connect=True),
        Vehicle(endpoint, "<b>plane</b>", connect=True),
        watching(endpoint, port),
        opened(f"http://127.0.0.1:{port}/", complaints) as page,
    ):
        page.wait_for_selector("#vehicles button >> nth=1", timeout=PATIENCE_MS)
        page.click("#vehicles button:has-text('plane')")
        # Names come from outside: they are text, whatever they look like.
        page.wait_for_selector("#name:text('<b>plane<_b>: navigating')", timeout=PATIENCE_MS)
        page.click("#vehicles button:has-text('boat')")
        page.wait_for_selector("#name:text('boat: navigating')", timeout=PATIENCE_MS)
        assert page.url.endswith("#boat")
    assert complaints == []
