"""A recording smoothed on line, as a live run would have had it: a fixed lag behind.

The engine's own smoother, block after block; what it costs beside the filter is timed here.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from companion.config import Config
from companion.engine import Engine
from companion.types import Event, Outputs, Smoothed, Solution, VehicleRecording
from replay.player import BLOCK_S, blocks


@dataclass(frozen=True, slots=True)
class OnLineRun:
    """What came of it."""

    config: Config
    smoothed: Smoothed
    solution: Solution
    """The settled forward solution of the same run."""
    events: tuple[Event, ...]
    digest_smoothed: str | None
    forward_cpu_s: float
    smoothing_cpu_s: float


def on_line_config(
    config: Config, window: int, rate_hz: float | None = None, mixed: bool | None = None
) -> Config:
    """``config`` with the smoother on; rows at least as often as smoothed epochs."""
    changed: dict[str, object] = {"enabled": True, "window": window}
    if rate_hz is not None:
        changed["rate_hz"] = rate_hz
    if mixed is not None:
        changed["mixed"] = mixed
    smoothing = msgspec.structs.replace(config.smoothing, **changed)
    rate = max(config.engine.output_rate_hz, smoothing.rate_hz)
    engine = msgspec.structs.replace(config.engine, output_rate_hz=rate)
    return msgspec.structs.replace(config, smoothing=smoothing, engine=engine)


def smooth_on_line(
    vehicle: VehicleRecording,
    config: Config,
    *,
    block_s: float = BLOCK_S,
    progress: Callable[[float], None] | None = None,
) -> OnLineRun:
    """Run ``vehicle`` through an engine whose ``[smoothing]`` is on."""
    engine = Engine(config)
    found: list[Outputs] = []
    smoothing_s = 0.0
    begin = time.process_time()

    def collect(out: Outputs) -> None:
        nonlocal smoothing_s
        found.append(out)
        before = time.process_time()
        found.append(engine.smooth())
        smoothing_s += time.process_time() - before

    total = sum(len(stream) for stream in vehicle.imu[:1])
    done = 0
    for imu, aids in blocks(vehicle, config, block_s):
        collect(engine.step_block(imu, aids))
        done += len(imu)
        if progress is not None:
            progress(done / max(total, 1))
    collect(engine.finish())
    return OnLineRun(
        config=config,
        smoothed=Smoothed.concatenate([o.smoothed for o in found if len(o.smoothed)]),
        solution=Solution.concatenate([o.settled for o in found if len(o.settled)]),
        events=tuple(e for o in found for e in o.events),
        digest_smoothed=engine.digest_smoothed,
        forward_cpu_s=time.process_time() - begin - smoothing_s,
        smoothing_cpu_s=smoothing_s,
    )
