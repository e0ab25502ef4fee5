"""Noise beside good traffic: all good frames come through, nothing is raised, memory is bounded."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from companion.types import NS, ImuSamples
from drivers.mavlink.session import MavlinkSession, SessionSettings

from . import autopilot as sim

STEP_NS = NS // 100


def acquainted(*, datagrams: bool) -> tuple[MavlinkSession, sim.Autopilot, int]:
    """A session that knows its vehicle and its clock, and the time it is."""
    session = MavlinkSession(SessionSettings(datagrams=datagrams, request_rates=False))
    pilot = sim.Autopilot()
    now = sim.START_NS
    for step in range(300):
        now = sim.START_NS + step * STEP_NS
        if step % 100 == 0:
            session.feed(step, now, pilot.packer.pack(pilot.message("HEARTBEAT", 0)))
        session.feed(step, now, pilot.packer.pack(pilot.message("SYSTEM_TIME", pilot.boot_ns(now))))
        session.tick(now)
        session.outgoing()
    assert session.clock.ready
    return session, pilot, now


def noise(rng: np.random.Generator, pilot: sim.Autopilot, kind: str) -> bytes:
    """One piece of what a broken or hostile neighbour may send."""
    if kind == "random":
        return rng.bytes(int(rng.integers(1, 300)))
    if kind == "magic":
        # Looks like a header at every other place, with every length.
        return bytes(rng.choice([0xFD, 0xFE, 0x00, 0xFF], int(rng.integers(1, 300))).tolist())
    frame = bytearray(pilot.packer.pack(pilot.message("HIGHRES_IMU", 5 * NS)))
    pilot.packer._link.seq = (pilot.packer._link.seq - 1) % 256
    if kind == "cut":
        return bytes(frame[: int(rng.integers(1, len(frame)))])
    # The checksum is left alone: one in 65536 of these would be believed.
    frame[int(rng.integers(1, len(frame) - 2))] ^= int(rng.integers(1, 256))
    return bytes(frame)


@pytest.mark.parametrize("datagrams", [True, False], ids=["datagrams", "stream"])
@pytest.mark.parametrize("kind", ["random", "magic", "cut", "flipped"])
def test_good_frames_come_through(kind: str, datagrams: bool) -> None:
    session, pilot, now = acquainted(datagrams=datagrams)
    rng = np.random.default_rng(11)
    good, got = 200, 0
    for step in range(good):
        now += STEP_NS
        session.feed(step, now, noise(rng, pilot, kind))
        frame = pilot.packer.pack(pilot.message("HIGHRES_IMU", pilot.boot_ns(now)))
        session.feed(step, now, frame)
        session.tick(now)
        session.outgoing()
        got += sum(len(s) for s in session.take() if isinstance(s, ImuSamples))
    # On a stream the last ones wait behind what may be the head of a long frame.
    for _ in range(20):
        session.feed(good, now, pilot.packer.pack(pilot.message("HEARTBEAT", 0)))
        got += sum(len(s) for s in session.take() if isinstance(s, ImuSamples))
    assert got == good
    assert session.counters.bad_bytes > good
    assert session.clock.restarts == 0
    assert session.counters.lost == 0


def test_numbers_that_are_none_and_stamps_that_cannot_be() -> None:
    session, pilot, now = acquainted(datagrams=True)
    broken = pilot.message("HIGHRES_IMU", pilot.boot_ns(now))
    broken.xacc = float("nan")
    session.feed(1, now, pilot.packer.pack(broken))
    future = pilot.message("HIGHRES_IMU", pilot.boot_ns(now) + 3600 * NS)
    session.feed(2, now, pilot.packer.pack(future))
    assert not any(isinstance(s, ImuSamples) for s in session.take())
    assert session.counters.unusable == 1
    assert session.counters.not_timed >= 1
    same = pilot.packer.pack(pilot.message("HIGHRES_IMU", pilot.boot_ns(now)))
    session.feed(3, now, same)
    session.feed(4, now, same)
    assert sum(isinstance(s, ImuSamples) for s in session.take()) == 1


@pytest.mark.parametrize("datagrams", [True, False], ids=["datagrams", "stream"])
def test_memory_is_bounded_under_noise(datagrams: bool) -> None:
    session, pilot, now = acquainted(datagrams=datagrams)
    rng = np.random.default_rng(5)
    tracemalloc.start()

    def minute() -> int:
        nonlocal now
        for step in range(200):
            now += STEP_NS
            session.feed(step, now, noise(rng, pilot, ("random", "magic", "flipped")[step % 3]))
            session.tick(now)
        session.outgoing()
        session.take()
        session.references()
        session.events()
        return tracemalloc.get_traced_memory()[0]

    try:
        first = minute()
        last = [minute() for _ in range(3)][-1]
    finally:
        tracemalloc.stop()
    assert last - first < 100_000
    # A peer that never reads our side: what waits for the link is bounded too.
    for _ in range(600):
        now += STEP_NS
        session.tick(now)
    assert len(session.outgoing()) <= 256
