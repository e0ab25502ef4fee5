"""Sessions on free ports, and waiting for what comes over them."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable

import numpy as np
import zenoh

from companion.outputs.zenoh_settings import client_settings, peer_settings
from companion.types import NS, AidingReports, Channel, Mode, Outputs, Solution, Verdict

T0 = 1_700_000_000 * NS
PATIENCE_S = 20.0
"""For what takes milliseconds on an idle machine."""


def free_port() -> int:
    """A TCP port on loopback that nobody listens on now."""
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port: int = s.getsockname()[1]
        return port


def peer(connect: str) -> zenoh.Session:
    """A subscriber's session that waits in the background for somebody to connect to."""
    return zenoh.open(peer_settings((), (connect,)))


def client(connect: str) -> zenoh.Session:
    """A subscriber's session with who listens there."""
    return zenoh.open(client_settings(connect))


def wait_for(condition: Callable[[], object], what: str) -> None:
    """Look until it holds; fails with ``what`` when patience ends."""
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end, f"never: {what}"
        time.sleep(0.01)


def solution(n: int = 1, *, first: int = 0, mode: Mode = Mode.NAVIGATING) -> Solution:
    """Epochs at 50 Hz, north at 10 m/s, level, heading 30°."""
    k = first + np.arange(n)
    half = np.radians(30.0) / 2
    cov = np.zeros((n, 5, 6))
    cov[:, :, [0, 3, 5]] = np.array([1.0, 0.04, 1e-4, 1e-3, 1e-8])[:, None]
    return Solution(
        T0 + k * (NS // 50),
        0.8 + k * 0.2 / 6.37e6,
        np.full(n, 0.15),
        np.full(n, 500.0),
        np.tile([10.0, 0.0, 0.0], (n, 1)),
        np.tile([np.cos(half), 0.0, 0.0, np.sin(half)], (n, 1)),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        cov,
        np.full(n, int(mode)),
        np.zeros(n, np.int64),
    )


def report(
    channel: Channel, verdict: Verdict = Verdict.ACCEPTED, nis: float = 1.0
) -> AidingReports:
    """One aiding report at T0."""
    i = np.array([0])
    return AidingReports(
        np.array([T0]),
        i + channel,
        i,
        i + 2,
        np.full((1, 3), 0.5),
        np.ones((1, 3)),
        np.array([nis]),
        np.array([13.8]),
        np.ones(1),
        i + verdict,
    )


def outputs(published: Solution, reports: AidingReports | None = None) -> Outputs:
    """An engine step that gave this."""
    return Outputs(
        published, Solution.empty(), AidingReports.empty() if reports is None else reports, ()
    )
