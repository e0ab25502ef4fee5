"""What a report is made of: one vehicle's run, gathered from a log or from a replay just now."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.config import Config
from companion.types import (
    NO_SATELLITES,
    NS,
    AdaptationTrace,
    AidingReports,
    Channel,
    Event,
    Mode,
    ReferenceSamples,
    Satellites,
    Solution,
    VehicleRecording,
    Verdict,
)
from replay.assessment import outages_of, references, times_of_ranges
from replay.evaluation import Outage
from replay.preparation import start_ns
from replay.window import Window

STOPPED = (Verdict.REJECTED_GATE, Verdict.REJECTED_SOURCE, Verdict.REJECTED_UNCONFIRMED)
"""Verdicts on measurements that were compared with the solution and not used."""
FINAL_NS = 5 * NS
"""A receiver without a fix for this long at the end did not just stop with the log."""
FAULT_GAP_NS = 3 * NS
"""Times at which a source is not used, closer than this, are one."""


@dataclass(frozen=True, slots=True)
class SourceFault:
    """A time in which a receiver's position was taken for faulty and none of it was used."""

    channel: Channel
    source: int
    start_ns: int
    """First and, below, last measurement that was refused for it."""
    end_ns: int


@dataclass(frozen=True, slots=True)
class RunView:
    """One vehicle's recording, solution and everything said on the way."""

    name: str
    """Of the log, for the page's title."""
    vehicle: VehicleRecording
    config: Config
    solution: Solution
    """Published, causal."""
    reports: AidingReports
    events: tuple[Event, ...]
    smoothed: Solution | None = None
    withheld: tuple[Window, ...] = ()
    notes: tuple[str, ...] = ()
    digest: str | None = None
    adaptation: AdaptationTrace = field(default_factory=AdaptationTrace.empty)
    satellites: Satellites = NO_SATELLITES

    @property
    def origin_ns(self) -> int:
        """The time that all seconds of the report count from, as those of outage windows."""
        return start_ns(self.vehicle)

    @property
    def reference(self) -> tuple[str, ReferenceSamples] | None:
        """The better one of what the log has to compare with: ``truth`` or ``autopilot``."""
        found = references(self.vehicle)
        return found[0] if found else None

    def outages(self) -> tuple[Outage, ...]:
        """Times without GNSS after the solution began, the one that it ended in among them."""
        if not len(self.solution):
            return ()
        first, last = self.solution.t_ns[0], int(self.solution.t_ns[-1])
        found = [
            o
            for o in outages_of(self.vehicle, self.config, self.withheld)
            if o.end_ns > first and o.start_ns < last
        ]
        final = self._final_fix_ns()
        if (
            final is not None
            and last - final > FINAL_NS
            and not any(o.end_ns > final for o in found)
        ):
            found.append(Outage(final, last))
        return tuple(found)

    def _final_fix_ns(self) -> int | None:
        """When the last usable fix of the receivers that may be used was valid."""
        if self.config.raw_gnss.coupling != "off":
            seen = times_of_ranges(self.vehicle, self.config)
            late = round(self.config.raw_gnss.latency_ms * 1e6)
            return int(seen.max()) - late if len(seen) else None
        chosen = self.config.gnss.source
        fixed = [
            g.t_ns[g.fix_type >= self.config.gnss.min_fix_type]
            for g in self.vehicle.gnss
            if chosen in ("auto", g.source)
        ]
        times = [int(t.max()) for t in fixed if len(t)]
        return max(times) - round(self.config.gnss.latency_ms * 1e6) if times else None

    def aligned(self) -> Solution:
        """The published epochs that are a solution, in order of time."""
        s = self.solution
        return s.take((s.mode != Mode.ALIGNING).nonzero()[0])

    def source_faults(self) -> list[SourceFault]:
        """When a source was not used because it was held for faulty, in order of time."""
        reports, found = self.reports, []
        for channel in (Channel.GNSS_POSITION_H, Channel.GNSS_POSITION_V):
            refused = (reports.channel == channel) & (reports.verdict == Verdict.REJECTED_SOURCE)
            for source in np.unique(reports.source[refused]):
                t = np.sort(reports.t_ns[refused & (reports.source == source)])
                for part in np.split(t, np.flatnonzero(np.diff(t) > FAULT_GAP_NS) + 1):
                    fault = SourceFault(channel, int(source), int(part[0]), int(part[-1]))
                    found.append(fault)
        return sorted(found, key=lambda fault: fault.start_ns)
