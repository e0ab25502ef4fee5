"""What a position source could get away with, and when it was found out: from aiding reports."""

from __future__ import annotations

import msgspec
import numpy as np

from companion.estimation.source_faults import BASE_S
from companion.types import NS, AidingReports, Channel, Verdict


class Source(msgspec.Struct, frozen=True):
    """Horizontal position or height of the receiver over a run; None where nothing was tested."""

    smallest_spike_m: float | None
    """The smallest error along an axis of a single fix that the gate refuses, but for noise:
    √(gate · S), the median over the run."""
    slowest_drift_mps: float | None
    """The slowest drift of position alone that is declared in the end, likewise."""
    drift_found_at_m: float | None
    """How far off a drift is when it is declared."""
    faulty_s: float
    """How long none of it was used because it was faulty or latched off."""
    unconfirmed: int
    """Fixes after gaps that waited for others."""


_PARTS = {
    "position": (Channel.GNSS_POSITION_H, Channel.SOURCE_H),
    "height": (Channel.GNSS_POSITION_V, Channel.SOURCE_V),
}


def sources(reports: AidingReports) -> dict[str, Source]:
    """What each part of the receiver's position was held to; empty without fixes."""
    found = {}
    for name, (position, judged) in _PARTS.items():
        fixes = (reports.channel == position) & (reports.dof > 0)
        if fixes.any():
            found[name] = _source(reports, fixes, reports.channel == judged)
    return found


def _source(
    reports: AidingReports, fixes: np.ndarray[tuple[int], np.dtype[np.bool_]],
    judged: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> Source:  # fmt: skip
    gated = fixes & (reports.verdict <= Verdict.REJECTED_GATE) & np.isfinite(reports.gate)
    largest = np.fmax.reduce(reports.innovation_sd[gated], axis=1)
    spike = np.sqrt(reports.gate[gated]) * largest
    tested = judged & np.isfinite(reports.gate) & (reports.verdict == Verdict.ACCEPTED)
    limit = np.sqrt(reports.gate[tested]) * reports.innovation_sd[tested, 0]
    found_at = float(np.median(limit)) if len(limit) else None
    return Source(
        smallest_spike_m=float(np.median(spike)) if len(spike) else None,
        slowest_drift_mps=found_at / BASE_S if found_at is not None else None,
        drift_found_at_m=found_at,
        faulty_s=_seconds(reports.t_ns[fixes], reports.verdict[fixes] == Verdict.REJECTED_SOURCE),
        unconfirmed=int(np.sum(reports.verdict[fixes] == Verdict.REJECTED_UNCONFIRMED)),
    )


def _seconds(
    t_ns: np.ndarray[tuple[int], np.dtype[np.int64]],
    barred: np.ndarray[tuple[int], np.dtype[np.bool_]],
) -> float:
    """How long fixes were barred: from each of them to the next fix [s]."""
    order = np.argsort(t_ns, kind="stable")
    steps = np.diff(t_ns[order], append=t_ns[order[-1:]])
    return float(steps[barred[order]].sum()) / NS
