"""Whether a replay gives what the live run gave: the bits, by their digests."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from companion.bank import Bank, navigator
from companion.config import Config
from companion.engine import Engine
from companion.types import Samples, VehicleRecording
from replay.player import arrivals
from replay.run_log import read_digests

LIVE = "live"
"""``source`` in the metadata of a log that a live process wrote."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """A live run's digests beside those of its replay."""

    equal: bool
    until_seq: int | None
    """A run that did not end can be compared up to its last checkpoint; None: the whole run."""
    live: str
    live_published: str


def compare_with_live(
    path: Path,
    vehicle: VehicleRecording,
    config: Config,
    digest: str,
    digest_published: str,
    digest_smoothed: str | None = None,
) -> Comparison | None:
    """Hold a replay of the log at ``path`` against the run that wrote it.

    ``digest``, ``digest_published`` and, of a run that smoothed, ``digest_smoothed``: of the replay
    of the whole log. A log that was not closed is replayed once more, up to its last checkpoint.
    None for a log without digests to compare with.
    """
    stored = read_digests(path, vehicle.name)
    if stored is None:
        return None
    if stored.seq is not None:
        engine = _played_until(vehicle, config, stored.seq)
        digest, digest_published = engine.digest, engine.digest_published
    equal = (stored.digest, stored.digest_published) == (digest, digest_published)
    equal &= stored.digest_smoothed == digest_smoothed or stored.seq is not None
    return Comparison(equal, stored.seq, stored.digest, stored.digest_published)


def _played_until(vehicle: VehicleRecording, config: Config, seq: int) -> Engine | Bank:
    """The engine after everything up to an arrival, not finished: the run went on."""

    def cut(streams: tuple[Any, ...]) -> tuple[Any, ...]:
        found: list[Samples] = [s.take(s.seq <= seq) for s in streams]
        return tuple(s for s in found if len(s))

    until = replace(
        vehicle,
        imu=cut(vehicle.imu),
        gnss=cut(vehicle.gnss),
        baro=cut(vehicle.baro),
        mag=cut(vehicle.mag),
        raw=cut(vehicle.raw),
        broadcast=cut(vehicle.broadcast),
    )
    engine = navigator(config)
    if until.imu:
        for block in arrivals(until, config):
            engine.step(block)
    return engine
