"""The page's model: messages in, frames for each reader out. Pure: time is passed in.

A reader has a :class:`Cursor`: how far it has been told. A frame holds the present in full, and of
what grows only what the reader lacks, so that one that missed frames lacks nothing afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import msgspec

from companion.outputs.subscriber import Heard
from companion.types import NS
from companion.watch.as_json import picture_json
from companion.watch.picture import Fleet, VehiclePicture
from companion.watch.web.history import History, LatLon, plane_m

TICK_S = 0.2
"""Five frames a second."""


@dataclass(frozen=True, slots=True)
class Told:
    """How far a reader knows one vehicle."""

    generation: int = -1
    points: int = 0
    row: int = -1
    events: int = 0


@dataclass(frozen=True, slots=True)
class Cursor:
    """How far a reader has been told; the first frame of a new one says everything."""

    vehicles: tuple[tuple[str, Told], ...] = ()


@dataclass(slots=True)
class _Followed:
    picture: VehiclePicture
    history: History = field(default_factory=History)
    now: dict[str, Any] = field(default_factory=dict)


class PageModel:
    """All vehicles, with as much of their past as a page shows."""

    def __init__(self, session: str, begin_ns: int) -> None:
        """``session`` tells a page whether it still talks with the process that it knows."""
        self._session = session
        self._begin_ns = begin_ns
        self._fleet = Fleet()
        self._followed: dict[str, _Followed] = {}
        self._origin: LatLon | None = None
        self._tick = 0
        self._now_s = 0.0
        self._link = ""

    def update(self, heard: Heard) -> None:
        """Take a message, at the time when it came."""
        v = self._fleet.update(heard, heard.receipt_ns)
        if v is None:
            return
        followed = self._followed.setdefault(v.name, _Followed(v))
        if self._origin is None and v.mode is not None and v.mode > 0:
            self._origin = v.state.lat, v.state.lon
        now_s = (heard.receipt_ns - self._begin_ns) / NS
        followed.history.note(heard.name, v, self._origin, now_s)

    def tick(self, now_ns: int, link: str = "") -> None:
        """Close the rows and take the present; ``link``: what is wrong with the connection."""
        self._tick += 1
        self._now_s = (now_ns - self._begin_ns) / NS
        self._link = link
        for followed in self._followed.values():
            v = followed.picture
            followed.history.tick(self._tick, v, now_ns)
            followed.now = picture_json(v, now_ns)
            del followed.now["events"]
            if self._origin is not None and v.state is not None:
                place = plane_m((v.state.lat, v.state.lon), self._origin)
                followed.now["place_m"] = [round(x, 2) for x in place]

    def frame(self, cursor: Cursor) -> tuple[bytes, Cursor]:
        """What a reader that knows ``cursor`` must be told, as JSON, and what it knows then."""
        known = dict(cursor.vehicles)
        vehicles, told = {}, []
        for name, followed in self._followed.items():
            after, news = _news(followed, known.get(name, Told()))
            vehicles[name] = {"now": followed.now, "anew": name not in known, **news}
            told.append((name, after))
        frame = {
            "session": self._session,
            "tick": self._tick,
            "tick_s": TICK_S,
            "now_s": round(self._now_s, 2),
            "link": self._link,
            "vehicles": vehicles,
        }
        return msgspec.json.encode(frame), Cursor(tuple(told))


def _news(followed: _Followed, before: Told) -> tuple[Told, dict[str, Any]]:
    """What ``before`` lacks of one vehicle's track, rows and events."""
    v, history = followed.picture, followed.history
    track = history.track
    again = track.generation != before.generation
    fresh = v.events_heard - before.events
    news = {
        "track": {"again": again, "points": track.points[0 if again else before.points :]},
        "rows": [row for row in history.rows if row[0] > before.row],
        "events": list(v.events)[-fresh:] if fresh else [],
    }
    last = history.rows[-1][0] if history.rows else before.row
    return Told(track.generation, len(track.points), last, v.events_heard), news
