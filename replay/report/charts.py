"""What a panel is made of, as plain objects that become the page's JSON.

Every panel is one or more charts over the common time axis, and may tell of episodes in words; a
chart joins tables, each with a time axis of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec
import numpy as np

from companion.gnss.systems import SYSTEM_NAMES
from companion.types import F64, I64, Channel
from replay.report.run_view import RunView
from replay.report.series import Spans, pack

Style = Literal["line", "dots", "band"]


class Line(msgspec.Struct, frozen=True, omit_defaults=True):
    """One series; ``of`` names what it is of, which gives its colour."""

    label: str
    of: str
    values: str
    style: Style = "line"
    low: str | None = None
    """Of a band: its lower edge, ``values`` being the upper one."""


class Tabled(msgspec.Struct, frozen=True):
    """Series over one time axis."""

    t: str
    lines: tuple[Line, ...]


class Chart(msgspec.Struct, frozen=True, omit_defaults=True):
    """One pair of axes."""

    title: str
    unit: str
    tables: tuple[Tabled, ...]
    limit: float | None = None
    """Where given, the axis goes from −limit to limit and the band may leave it."""
    logarithmic: bool = False


class Told(msgspec.Struct, frozen=True):
    """What happened, in rows of words; each row has the time at which it began [s]."""

    head: tuple[str, ...]
    rows: tuple[tuple[float, tuple[str, ...]], ...]


class Panel(msgspec.Struct, frozen=True):
    """A section of the page."""

    id: str
    title: str
    note: str
    charts: tuple[Chart, ...]
    told: Told | None = None


class Table:
    """Columns over one decimated time axis, on their way to a chart."""

    def __init__(self, t_ns: I64, run: RunView) -> None:
        order = np.flatnonzero(np.diff(t_ns, prepend=t_ns[0] - 1) > 0)
        self._rows = order if len(order) < len(t_ns) else slice(None)
        self._spans = Spans(t_ns[self._rows], run.origin_ns)

    def line(self, label: str, of: str, column: F64, style: Style = "line") -> Line:
        return Line(label, of, pack(self._spans.values(column[self._rows])), style)

    def band(self, label: str, of: str, middle: F64, half: F64) -> Line:
        low, high = (middle - half)[self._rows], (middle + half)[self._rows]
        bottom, top = self._spans.envelope(low, high)
        return Line(label, of, pack(top), "band", pack(bottom))

    def of(self, lines: Iterable[Line]) -> Tabled:
        return Tabled(pack(self._spans.times()), tuple(lines))


_NAMES = {"GNSS": "GNSS"} | {name.upper(): name for name in SYSTEM_NAMES}


def spoken(channel: Channel) -> str:
    """The channel's name for people: ``GNSS velocity``, ``GNSS vertical velocity``, ``baro``."""
    if channel in (Channel.SOURCE_H, Channel.SOURCE_V):
        what = "position" if channel is Channel.SOURCE_H else "height"
        return f"GNSS {what} against its own velocity"
    words = channel.name.split("_")
    if words[-1] == "V":
        words.insert(1, "vertical")
    kept = [w for w in words if w not in ("H", "V")]
    return " ".join(_NAMES.get(w, w.lower()) for w in kept)
