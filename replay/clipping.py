"""Counters of clipped accelerations, as autopilots log them, on the inertial samples they mean."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.types import I64, ImuSamples
from drivers.mavlink.clipping import COUNTED, HOLDS_NS


def with_counter(imu: ImuSamples, seq: I64, rx_ns: I64, count: I64) -> ImuSamples:
    """``imu`` with the samples marked that came while the counter's last message was a rise.

    ``seq``, ``rx_ns`` and ``count`` (M,): number and time of arrival, and value, of each message. A
    mark holds from that message to the next one, as live: what has gone by is not called back.
    """
    rose = np.concatenate([[False], np.diff(count) > 0])
    if not rose.any():
        return imu
    before = np.searchsorted(seq, imu.seq) - 1
    at = np.maximum(before, 0)
    marked = (before >= 0) & rose[at] & (imu.t_rx_ns - rx_ns[at] <= HOLDS_NS)
    return replace(imu, clipped=np.where(marked & (imu.clipped == 0.0), COUNTED, imu.clipped))
