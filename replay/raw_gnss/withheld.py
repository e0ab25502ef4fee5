"""Raw GNSS with satellites taken away, to see what a solution would have been with few of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.config import RawGnss
from companion.gnss.corrected import S_SAT
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import I64, BroadcastSamples, RawGnssSamples

_EPOCHS = 3
"""From nowhere, the first of them finds the place and the next one elevations."""


def highest(raw: RawGnssSamples, known: BroadcastSamples, t_ns: int, count: int) -> I64:
    """The ``count`` satellites that stand highest at ``t_ns``; fewer where fewer are used then."""
    receiver = Receiver(RawGnss())
    receiver.listen(known)
    last = min(int(np.searchsorted(raw.t_ns, t_ns)), len(raw) - 1)
    seen = [receiver.take(raw, i) for i in range(max(last + 1 - _EPOCHS, 0), last + 1)][-1]
    order = np.argsort(-seen.sky[:, 1], kind="stable")
    names: I64 = seen.rows[order[:count], S_SAT].astype(np.int64)
    return names


def only(raw: RawGnssSamples, begin_ns: int, end_ns: int, keep: I64) -> RawGnssSamples:
    """Only the satellites ``keep`` from ``begin_ns`` to ``end_ns``."""
    inside = (raw.t_ns >= begin_ns) & (raw.t_ns < end_ns)
    return replace(raw, sat=np.where(inside[:, None] & ~np.isin(raw.sat, keep), 0, raw.sat))


def with_few(
    raw: RawGnssSamples, known: BroadcastSamples, begin_ns: int, end_ns: int, left: int
) -> RawGnssSamples:
    """Only the ``left`` satellites that stand highest at ``begin_ns`` from there to ``end_ns``."""
    if not ((raw.t_ns >= begin_ns) & (raw.t_ns < end_ns)).any():
        return raw
    return only(raw, begin_ns, end_ns, highest(raw, known, begin_ns, left))
