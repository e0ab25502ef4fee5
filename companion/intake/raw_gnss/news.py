"""What there is to say of a stream of raw measurements, as events, when it begins."""

from __future__ import annotations

import math
from typing import Literal

from companion.gnss.broadcast import UNHEALTHY
from companion.gnss.systems import satellite_name
from companion.types import NO_DOP, Event

QUIET_S = 60.0
"""Contradictions that come back sooner are one."""
NO_EPHEMERIS_S = 60.0
"""A satellite repeats its own every 30 s."""
_REASON = "its range contradicts the others"
_ITSELF = f"ephemeris {UNHEALTHY}"
Level = Literal["info", "warning"]


class News:
    """What was said of one stream so far. Times ``now`` are GPS time [s]."""

    def __init__(self) -> None:
        self._begun_s: float | None = None
        self._contradicted_s = -math.inf
        self._set: tuple[int, ...] = ()
        self._blamed: dict[int, str] = {}

    def begin(self, now: float) -> None:
        """The first epoch of all, or one behind it."""
        if self._begun_s is None:
            self._begun_s = now

    def contradiction(self, t_ns: int, now: float) -> list[Event]:
        """An epoch's ranges fit no place."""
        said = []
        if now - self._contradicted_s > QUIET_S:
            text = (
                "too few satellites agree on a place, none is used: the receiver's time, its "
                "ephemerides, or signals that are not the satellites'"
            )
            said.append(Event(t_ns, "ranges-contradict", text, "warning"))
        self._contradicted_s = now
        return said

    def nothing_known(self, t_ns: int, now: float) -> list[Event]:
        """An epoch with satellites, and still no ephemeris of any."""
        waited = now - (now if self._begun_s is None else self._begun_s)
        if waited < NO_EPHEMERIS_S:
            return []
        self._begun_s = math.inf
        text = f"no ephemeris in {waited:.0f} s: does the receiver send them?"
        return [Event(t_ns, "no-ephemerides", text, "warning")]

    def satellites(
        self,
        t_ns: int,
        used: list[int],
        gdop: float,
        excluded: list[int],
        without: dict[str, list[int]],
    ) -> list[Event]:
        """Who is used, at fault, or has no ephemeris that may be used."""
        events = []
        sats = tuple(sorted(used))
        if sats != self._set:
            gained = [satellite_name(s) for s in sats if s not in self._set]
            lost = [satellite_name(s) for s in self._set if s not in sats]
            worth = f"GDOP {gdop:.1f}" if gdop < NO_DOP else "of which no place is fixed"
            text = f"{len(sats)} satellites, {worth}" + "".join(
                f"; {word} {' '.join(names)}"
                for word, names in (("new", gained), ("gone", lost))
                if names
            )
            events.append(Event(t_ns, "satellite-set", text))
            self._set = sats
        blamed = dict.fromkeys(excluded, _REASON)
        for why, who in without.items():
            if why != "missing":
                blamed |= dict.fromkeys(who, f"ephemeris {why}")
        for s, why in blamed.items():
            if self._blamed.get(s) != why:
                name = satellite_name(s)
                # That one says so of itself is the usual state of some satellite.
                level: Level = "info" if why == _ITSELF else "warning"
                events.append(Event(t_ns, "satellite-refused", f"{name}: {why}", level))
        # What went out of sight is not news when it comes back.
        self._blamed = {s: why for s, why in (self._blamed | blamed).items() if s not in sats}
        return events
