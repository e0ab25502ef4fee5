"""Which of several estimators to publish: the consistent one, with hysteresis. Pure.

Judged on a grid of half seconds, from what each gave out until then. An estimator is *sound* while
it is fresh, has not been reset for a while and its normalised innovations are what it claims. The
one in use is left when it is no longer sound, or navigates no longer while another does; an earlier
one of the list is gone back to once it has been sound for long. Never to one that was just reset.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.types import NS, AidingReports, Channel, Event, Mode, Outputs, Verdict

DECIDE_NS = NS // 2
SPANS_NS = (20 * NS, 3 * NS)
"""Innovations of this long say whether an estimator is consistent: for long, and just now."""
LEAST = 8
"""Measurements in it for a judgement at all."""
WINSOR = 16.0
"""What one component's squared innovation counts for at most: one wild fix is the gate's matter."""
INCONSISTENT, CONSISTENT = 3.0, 2.0
"""Mean squared innovation per component above which an estimator claims too much, and below which
it may be switched to. Noise of twice what it claims gives 4."""
STALE_NS = NS
SETTLED_NS = 10 * NS
"""A reset is forgotten after so long."""
PATIENCE = 3
"""Decisions in a row against the one in use before it is left; a reset is one too many."""
RETURN_NS = 30 * NS

_RANK = {Mode.ALIGNING: 0, Mode.HEADING_UNKNOWN: 1, Mode.COASTING: 2, Mode.NAVIGATING: 3}
_JUDGED = (
    Channel.GNSS_POSITION_H,
    Channel.GNSS_POSITION_V,
    Channel.GNSS_VELOCITY_H,
    Channel.GNSS_VELOCITY_V,
)
_RESETTING = ("relocked", "diverged", "broken", "imu-gap", "clock-back", "level-lost")


@dataclass(slots=True)
class Standing:
    """What is known of one estimator."""

    name: str
    mode: Mode = Mode.ALIGNING
    newest_ns: int = 0
    resets: int = 0
    reset_ns: int | None = None
    started: bool = False
    sound_since_ns: int | None = None
    innovations: deque[tuple[int, float, int]] = field(default_factory=deque)
    """(time, squared innovation, components) of the last while."""
    nis: float | None = None
    """Mean squared innovation per component, of the worse of the two spans; None with too few."""

    def note(self, out: Outputs) -> None:
        """Take in what a piece of the run gave out."""
        if len(out.published):
            last = out.published
            self.newest_ns, self.mode = int(last.t_ns[-1]), Mode(int(last.mode[-1]))
            resets = int(last.resets[-1])
            if self.started and resets != self.resets:
                self.reset_ns = self.newest_ns
            self.resets, self.started = resets, True
        for event in out.events:
            if event.kind in _RESETTING and self.started:
                self.reset_ns = max(event.t_ns, self.reset_ns or event.t_ns)
        self._note_reports(out.reports)

    def _note_reports(self, r: AidingReports) -> None:
        if not len(r):
            return
        seen = (r.verdict == Verdict.ACCEPTED) | (r.verdict == Verdict.REJECTED_GATE)
        rows = np.flatnonzero(seen & np.isin(r.channel, _JUDGED) & (r.dof > 0))
        for i in rows.tolist():
            dof = int(r.dof[i])
            self.innovations.append((int(r.t_ns[i]), min(float(r.nis[i]), WINSOR * dof), dof))

    def judge(self, now_ns: int) -> None:
        """Forget what is old, and see whether it is sound at ``now_ns``."""
        # Late aids come out of order.
        kept = sorted(i for i in self.innovations if now_ns - i[0] <= SPANS_NS[0])
        self.innovations = deque(kept)
        means = [self._mean(now_ns - span) for span in SPANS_NS]
        self.nis = max((m for m in means if m is not None), default=None)
        sound = self.why_not(now_ns, INCONSISTENT) == ""
        if not sound:
            self.sound_since_ns = None
        elif self.sound_since_ns is None:
            self.sound_since_ns = now_ns

    def _mean(self, since_ns: int) -> float | None:
        """Mean squared innovation per component; None with too few."""
        found = [i for i in self.innovations if i[0] >= since_ns]
        if len(found) < LEAST:
            return None
        return sum(i[1] for i in found) / sum(i[2] for i in found)

    @property
    def rank(self) -> int:
        """How much its mode is worth."""
        return _RANK[self.mode]

    def why_not(self, now_ns: int, limit: float) -> str:
        """Why it is not sound, in words; empty where it is."""
        if not self.started or now_ns - self.newest_ns > STALE_NS:
            return "gives no solution"
        if self.reset_ns is not None and now_ns - self.reset_ns < SETTLED_NS:
            return f"was reset {(now_ns - self.reset_ns) / NS:.1f} s ago"
        nis = self.nis
        if nis is not None and nis > limit:
            return f"innovations {nis:.1f} times what it claims"
        return ""


class Selector:
    """Chooses among estimators by name, in order of preference."""

    def __init__(self, names: Sequence[str]) -> None:
        self.standings = [Standing(name) for name in names]
        self.current = 0
        self.switches = 0
        self._against = 0
        self._begin_ns: int | None = None

    def decide(self, now_ns: int) -> Event | None:
        """Judge all at ``now_ns``; the event where another one is published from now on."""
        if self._begin_ns is None:
            self._begin_ns = now_ns
        for standing in self.standings:
            standing.judge(now_ns)
        mine = self.standings[self.current]
        best = max(s.rank for s in self.standings if s.sound_since_ns is not None or s is mine)
        why = mine.why_not(now_ns, INCONSISTENT)
        if not why and mine.rank < best:
            why = f"is {mine.mode.name.lower().replace('_', ' ')}"
        if why:
            self._against += 1
            if not mine.started and now_ns - self._begin_ns < SETTLED_NS:
                return None  # it may take longer to begin than the others do
            urgent = why.startswith(("was reset", "gives no"))
            if urgent or self._against >= PATIENCE:
                return self._switch(now_ns, why)
            return None
        self._against = 0
        for at in range(self.current):
            earlier = self.standings[at]
            since = earlier.sound_since_ns
            if since is not None and now_ns - since >= RETURN_NS and earlier.rank >= mine.rank:
                return self._to(at, now_ns, f"it has been sound for {RETURN_NS // NS} s")
        return None

    def _switch(self, now_ns: int, why: str) -> Event | None:
        """To the first sound estimator whose mode is no worse, if there is one."""
        mine = self.standings[self.current]
        for at, other in enumerate(self.standings):
            fit = other.why_not(now_ns, CONSISTENT) == "" and other.rank >= mine.rank
            if at != self.current and fit:
                return self._to(at, now_ns, f"{mine.name} {why}")
        return None

    def _to(self, at: int, now_ns: int, why: str) -> Event:
        before = self.standings[self.current].name
        self.current, self._against = at, 0
        self.switches += 1
        name = self.standings[at].name
        text = f"{name} is published in place of {before}: {why}"
        return Event(now_ns, "estimator-switched", text, "warning")
