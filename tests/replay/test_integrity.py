"""What a receiver could get away with, from reports whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from companion.types import NS, AidingReports, Channel, Verdict
from replay.integrity import sources


def test_spike_drift_and_faulty_time_come_from_the_reports() -> None:
    position, judged = Channel.GNSS_POSITION_H, Channel.SOURCE_H
    rows = [
        # s, channel, deviation m, gate, verdict
        (0, position, 1.0, 16.0, Verdict.ACCEPTED),
        (0, judged, 1.2, np.inf, Verdict.ACCEPTED),
        (1, position, 1.5, 16.0, Verdict.ACCEPTED),
        (1, judged, 1.2, 25.0, Verdict.ACCEPTED),
        (2, position, 2.0, 16.0, Verdict.REJECTED_GATE),
        (3, position, 9.0, 16.0, Verdict.REJECTED_SOURCE),
        (3, judged, 9.0, 25.0, Verdict.REJECTED_SOURCE),
        (5, position, 9.0, 16.0, Verdict.REJECTED_SOURCE),
        (6, position, 9.0, 16.0, Verdict.REJECTED_UNCONFIRMED),
    ]
    t, channel, sd, gate, verdict = (np.array(column) for column in zip(*rows, strict=True))
    n = len(rows)
    plane = np.column_stack([sd, 0.5 * sd, np.full(n, np.nan)])
    reports = AidingReports(
        (t * NS).astype(np.int64), channel, np.zeros(n, np.int64), np.full(n, 2), plane, plane,
        np.ones(n), gate, np.ones(n), verdict,
    )  # fmt: skip
    found = sources(reports)
    assert list(found) == ["position"]
    one = found["position"]
    assert one.smallest_spike_m == pytest.approx(6.0)
    assert one.drift_found_at_m == pytest.approx(6.0)
    assert one.slowest_drift_mps == pytest.approx(0.1)
    assert one.faulty_s == pytest.approx(3.0)
    assert one.unconfirmed == 1
    assert sources(AidingReports.empty()) == {}
