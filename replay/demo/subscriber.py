"""A subscriber of ``nav/state`` in a process of its own: ``python -m replay.demo.subscriber``.

Says once a second how many states came and how late, as a line of JSON; ends with its standard
input and then writes every state that it received as CSV. Latency is from the arrival of the newest
sample behind a state, which the companion stamps with CLOCK_MONOTONIC, to its receipt here.
"""

from __future__ import annotations

import argparse
import json
import os
import select
import sys
import threading
import time
from pathlib import Path

import zenoh

from companion.logbook.schemas import topic
from companion.outputs.zenoh_settings import client_settings
from companion.proto.navigation_pb2 import NavState
from replay.demo.figures import LATENCY, Received, spread, write_received

RETRY_S = 0.2
SAY_S = 1.0


class _Collector:
    """Takes samples from zenoh's thread; a state is parsed later, so that receipt is prompt."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._new: list[tuple[int, bytes]] = []
        self._rows: list[tuple[float, ...]] = []

    def take(self, sample: zenoh.Sample) -> None:
        now = time.monotonic_ns()
        with self._lock:
            self._new.append((now, sample.payload.to_bytes()))

    def digest(self) -> list[tuple[float, ...]]:
        """Parse what is new and return it."""
        with self._lock:
            new, self._new = self._new, []
        rows = []
        for receipt_ns, payload in new:
            state = NavState.FromString(payload)
            rows.append(
                (
                    state.t_ns,
                    state.arrival_monotonic_ns,
                    receipt_ns,
                    state.mode,
                    state.lat,
                    state.lon,
                    state.height,
                    *state.vel_n,
                    *state.sd_pos_m,
                )
            )
        self._rows += rows
        return rows

    def received(self) -> Received:
        self.digest()
        return Received.of_rows(self._rows)


def _open(endpoint: str) -> zenoh.Session | None:
    """A session with the companion; None if standard input ends while nobody is there."""
    while True:
        try:
            return zenoh.open(client_settings(endpoint))
        except zenoh.ZError:
            readable, _, _ = select.select([sys.stdin], [], [], RETRY_S)
            if readable and not os.read(sys.stdin.fileno(), 4096):
                return None


def _say(rows: list[tuple[float, ...]]) -> None:
    said: dict[str, object] = {"states": len(rows)}
    if rows:
        received = Received.of_rows(rows)
        said |= {"latency_ms": spread(received.latency_ms, LATENCY), "last": rows[-1]}
    sys.stdout.write(json.dumps(said) + "\n")
    sys.stdout.flush()


def listen(endpoint: str, vehicle: str, out: Path) -> None:
    """Subscribe until standard input ends; then write ``out``."""
    collector = _Collector()
    session = _open(endpoint)
    if session is not None:
        with session, session.declare_subscriber(topic(vehicle, "nav/state"), collector.take):
            _until_told(collector)
    write_received(collector.received(), out)


def _until_told(collector: _Collector) -> None:
    due = time.monotonic() + SAY_S
    while True:
        readable, _, _ = select.select([sys.stdin], [], [], max(due - time.monotonic(), 0.0))
        if readable and not os.read(sys.stdin.fileno(), 4096):
            return
        if time.monotonic() >= due:
            due += SAY_S
            _say(collector.digest())


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m replay.demo.subscriber")
    parser.add_argument("endpoint", help="of the companion: tcp/127.0.0.1:7447")
    parser.add_argument("vehicle")
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    listen(given.endpoint, given.vehicle, given.out)


if __name__ == "__main__":
    main()
