"""Thinning a stream of epochs to a rate."""

from __future__ import annotations

from companion.types import NS


class Pacer:
    """Says which epochs to send so that there are at most ``rate_hz`` a second.

    Epochs that come at the rate itself all pass, also when their times jitter by a tenth of the
    interval; of faster ones the grid stays even.
    """

    def __init__(self, rate_hz: float) -> None:
        self._interval_ns = round(NS / rate_hz)
        self._due_ns: int | None = None

    def due(self, t_ns: int) -> bool:
        """Whether to send the epoch at ``t_ns``; call it once for each."""
        due, interval = self._due_ns, self._interval_ns
        # A clock that jumped back is a new beginning, not a long wait.
        if due is not None and due - 2 * interval < t_ns < due - interval // 10:
            return False
        behind = due is None or abs(t_ns - due) > interval
        self._due_ns = (t_ns if behind or due is None else due) + interval
        return True
