"""What the sky was like over a run: satellites in use, their geometry, what was left out."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from companion.gnss.geometry import GDOP, HDOP, VDOP
from companion.types import F64, NO_DOP, Event, Satellites

FULL = 4
"""Satellites that fix a place and a clock."""


class Sky(msgspec.Struct, frozen=True):
    """Counts over the epochs of raw GNSS; None where no epoch has a geometry."""

    epochs: int
    satellites_least: int
    satellites_median: float
    satellites_most: int
    fewer_than_four: int
    """Epochs."""
    gdop_median: float | None
    gdop_worst: float | None
    hdop_median: float | None
    vdop_median: float | None
    excluded: int
    """Ranges that contradicted the others, over all epochs."""
    changes: int
    """Of the set of satellites in use, the first set not counted."""


def sky(satellites: Satellites, events: Sequence[Event]) -> Sky | None:
    """The sky of a run; None without raw GNSS."""
    if not len(satellites):
        return None
    used = satellites.used
    known = satellites.dop[satellites.dop[:, GDOP] < NO_DOP]
    return Sky(
        epochs=len(satellites),
        satellites_least=int(used.min()),
        satellites_median=float(np.median(used)),
        satellites_most=int(used.max()),
        fewer_than_four=int(np.count_nonzero(used < FULL)),
        gdop_median=_median(known[:, GDOP]),
        gdop_worst=float(known[:, GDOP].max()) if len(known) else None,
        hdop_median=_median(known[:, HDOP]),
        vdop_median=_median(known[:, VDOP]),
        excluded=int(satellites.excluded.sum()),
        changes=max(0, sum(e.kind == "satellite-set" for e in events) - 1),
    )


def _median(values: F64) -> float | None:
    return float(np.median(values)) if len(values) else None
