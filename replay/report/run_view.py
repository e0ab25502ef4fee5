"""What a report is made of: one vehicle's run, gathered from a log or from a replay just now."""

from __future__ import annotations

from dataclasses import dataclass

from companion.config import Config
from companion.types import AidingReports, Event, Mode, ReferenceSamples, Solution, VehicleRecording
from replay.assessment import outages_of, references
from replay.evaluation import Outage
from replay.preparation import start_ns
from replay.window import Window


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
        """Times without GNSS after the solution began."""
        if not len(self.solution):
            return ()
        first = self.solution.t_ns[0]
        return tuple(
            o
            for o in outages_of(self.vehicle, self.config, self.withheld)
            if o.end_ns > first and o.start_ns < self.solution.t_ns[-1]
        )

    def aligned(self) -> Solution:
        """The published epochs that are a solution, in order of time."""
        s = self.solution
        return s.take((s.mode != Mode.ALIGNING).nonzero()[0])
