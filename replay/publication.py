"""A replay that is published as a live run is: for trying ground tools on a log."""

from __future__ import annotations

import math
import time

from companion.config import Config
from companion.outputs.publisher import Publisher
from companion.runtime.health import HealthMonitor, usable
from companion.selection import KINDS, Kind
from companion.types import (
    NS,
    AnySamples,
    LogHealth,
    LoopHealth,
    Mode,
    Outputs,
)

HEALTH_NS = NS
"""Of the log's time, between health reports."""
TICK_NS = NS // 10
"""Between looks at the sensors, as live."""
_NO_LOAD = LoopHealth(0.0, math.nan, math.nan, math.nan, 0.0)


def _uses_all(_kind: Kind, _source: str) -> bool:
    """All that is replayed feeds the engine."""
    return True


class Publication:
    """Hands each step to a publisher, and says once a second of the log how the sensors were.

    Health comes of the live process's own monitor. Its load and latencies are not those of a live
    process and are left out.
    """

    def __init__(self, publisher: Publisher, vehicle: str, config: Config, start_ns: int) -> None:
        self._publisher = publisher
        self._monitor = HealthMonitor(vehicle, config.live, start_ns)
        self._min_fix_type = config.gnss.min_fix_type
        self._mode = Mode.ALIGNING
        self._tick_ns = self._health_ns = start_ns

    def step(self, samples: AnySamples, outputs: Outputs) -> None:
        """Publish what came of samples that arrived just now."""
        self._publisher.publish(outputs, time.monotonic_ns())
        if len(outputs.published):
            self._mode = Mode(int(outputs.published.mode[-1]))
        if not len(samples):
            return
        now_ns = int(samples.t_rx_ns[-1])
        kind = KINDS.get(type(samples))
        if kind is not None:
            good = usable(samples, self._min_fix_type)
            self._monitor.arrived(kind, samples.source, len(samples), now_ns, good)
        if not 0 <= now_ns - self._tick_ns < TICK_NS:
            self._tick_ns = now_ns
            for event in self._monitor.tick(now_ns, _uses_all):
                self._publisher.event(event)
        if not 0 <= now_ns - self._health_ns < HEALTH_NS:
            self._health_ns = now_ns
            self._publisher.health(
                self._monitor.report(
                    now_ns,
                    self._mode,
                    _uses_all,
                    lambda _source: (0, 0),
                    _NO_LOAD,
                    LogHealth("off"),
                    {},
                )
            )
