"""From the autopilot's time since boot to the run's clock, without a step in a run.

The target is the line of TIMESYNC; until there is one, the fastest arrivals: run − boot of every
stamped message is the offset plus a delay, and the smallest of many has the shortest delay. What
is handed out is a chain of straight pieces that join, each turned a little towards the target.
Only a restart of the autopilot's clock begins a new chain.
"""

from __future__ import annotations

from collections import deque
from itertools import pairwise
from typing import Literal

import numpy as np

from companion.types import I64, NS
from drivers.mavlink.timesync import Line, TimeSync

Source = Literal["none", "arrival", "timesync"]

ACQUIRE_NS = 3 * NS // 2
"""Before the first piece, arrivals and round trips are gathered for this long at most."""
_ENOUGH = 12
"""Round trips that end the gathering early."""
_UPDATE_NS = NS
_SLEW = 2e-3
"""A piece is turned by at most this: 2 ms a second, a thousandth or two on measured rates."""
_CORRECT_S = 4.0
"""Time in which a piece would take the whole error away."""
_BINS = 40
"""Seconds of arrivals that the envelope is taken from."""
_DRIFT_LIMIT = 200e-6
_BACK_NS = NS
"""A stamp that falls behind the newest by more is of a new boot, once the next ones agree."""
_AHEAD_NS = NS // 2
"""A mapped stamp this far behind its arrival the other way round: from the future, so wrong."""
_LAG_NS = 2 * NS
_LAG_FOR_NS = 3 * NS
"""All stamps arriving so late for so long: the mapping is wrong, not the link slow."""
_AGREE = 3
"""Strange stamps in a row that are believed; a broken frame passes its CRC once in 65536."""
_JUMP_NS = NS // 4
"""A round trip that misses the line by more than this and its own length is of another clock."""
_SAME_CLOCK_NS = 60 * NS
"""TIMESYNC and the stamps count from the same boot, or else TIMESYNC says nothing of the stamps."""


class _Envelope:
    """Smallest delay of each second: line under the points (t, run − boot)."""

    def __init__(self) -> None:
        self._least: deque[tuple[int, int]] = deque(maxlen=_BINS)

    def clear(self) -> None:
        self._least.clear()

    def add(self, rx_ns: int, delay_ns: int) -> None:
        if self._least and rx_ns // NS == self._least[-1][0] // NS:
            if delay_ns < self._least[-1][1]:
                self._least[-1] = rx_ns, delay_ns
        else:
            self._least.append((rx_ns, delay_ns))

    def line(self) -> Line | None:
        """The edge of the lower hull under the middle of the window, its slope bounded."""
        if not self._least:
            return None
        t0, d0 = self._least[0]
        points = [(float(t - t0), float(d - d0)) for t, d in self._least]
        hull: list[tuple[float, float]] = []
        for x, y in points:
            while len(hull) > 1 and _turns_up(hull[-2], hull[-1], (x, y)):
                hull.pop()
            hull.append((x, y))
        middle = points[-1][0] / 2
        low = hull[0]
        slope = 0.0
        for a, b in pairwise(hull):
            if a[0] <= middle <= b[0] and b[0] - a[0] > 5e9:
                low, slope = a, (b[1] - a[1]) / (b[0] - a[0])
        if not slope:
            low = min(hull, key=lambda p: p[1])
        slope = min(max(slope, -_DRIFT_LIMIT), _DRIFT_LIMIT)
        # Delays vary by milliseconds on any link: no more is claimed.
        return Line(t0 + round(low[0]), d0 + round(low[1]), slope, 2e6, 50e-6)


def _turns_up(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Whether ``b`` is on or above the line from ``a`` to ``c``: no corner of the lower hull."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


class _Piece:
    """run = run0 + (boot − boot0)(1 + rate), all [ns]."""

    def __init__(self, boot_ns: int, run_ns: int, rate: float) -> None:
        self.boot_ns, self.run_ns, self.rate = boot_ns, run_ns, rate

    def at(self, boot_ns: int) -> int:
        since = boot_ns - self.boot_ns
        return self.run_ns + since + round(since * self.rate)


class BootClock:
    """The mapping of one autopilot, fed with stamps and arrivals and with TIMESYNC."""

    def __init__(self) -> None:
        self.sync = TimeSync()
        self.restarts = 0
        self.source: Source = "none"
        self._envelope = _Envelope()
        self._pieces: deque[_Piece] = deque(maxlen=3)
        self._newest_ns = 0
        self._begun_ns: int | None = None
        self._updated_ns = 0
        self._strange: list[int] = []
        self._lagging_since: int | None = None
        self._jumps = 0

    @property
    def ready(self) -> bool:
        """Whether times can be handed out."""
        return bool(self._pieces)

    @property
    def newest_ns(self) -> int:
        """Newest stamp of this boot [ns since boot]."""
        return self._newest_ns

    def observe(self, boot_us: int, rx_ns: int) -> bool:
        """Take the stamp of a message at its arrival; True if the autopilot's clock restarted.

        Raises nothing: a stamp that cannot be right is left out until others agree with it.
        """
        boot_ns = boot_us * 1000
        if self._begun_ns is None:
            self._begun_ns = rx_ns
        if self._is_strange(boot_ns, rx_ns):
            self._strange.append(boot_ns)
            if len(self._strange) < _AGREE:
                return False
            if max(self._strange) - min(self._strange) < NS:
                self._restart(boot_ns, rx_ns)
                return True
            del self._strange[0]
            return False
        self._strange.clear()
        self._newest_ns = max(self._newest_ns, boot_ns)
        self._envelope.add(rx_ns, rx_ns - boot_ns)
        if self._lags(boot_ns, rx_ns):
            self._restart(boot_ns, rx_ns)
            return True
        return False

    def _is_strange(self, boot_ns: int, rx_ns: int) -> bool:
        if boot_ns < self._newest_ns - _BACK_NS:
            return True
        if not self._pieces:
            return bool(self._newest_ns) and boot_ns > self._newest_ns + 2 * ACQUIRE_NS
        return self._pieces[-1].at(boot_ns) > rx_ns + _AHEAD_NS

    def _lags(self, boot_ns: int, rx_ns: int) -> bool:
        if not self._pieces or rx_ns - self._pieces[-1].at(boot_ns) < _LAG_NS:
            self._lagging_since = None
            return False
        if self._lagging_since is None:
            self._lagging_since = rx_ns
        return rx_ns - self._lagging_since > _LAG_FOR_NS

    def _restart(self, boot_ns: int, rx_ns: int) -> None:
        self.restarts += 1
        self.sync.reset()
        self._envelope.clear()
        self._pieces.clear()
        self._strange.clear()
        self._lagging_since = None
        self._jumps = 0
        self.source = "none"
        self._newest_ns = boot_ns
        self._begun_ns = rx_ns
        self._envelope.add(rx_ns, rx_ns - boot_ns)

    def answered(self, tc1_ns: int, ts1_ns: int, now_ns: int) -> bool:
        """Take a TIMESYNC answer; True if it shows that the autopilot's clock restarted.

        One that is not of the clock of the stamps is left out.
        """
        if self._newest_ns and abs(tc1_ns - self._newest_ns) > _SAME_CLOCK_NS:
            self.sync.refused += 1
            return False
        line = self.sync.last_line
        middle = ts1_ns + (now_ns - ts1_ns) // 2
        limit = _JUMP_NS + (now_ns - ts1_ns)
        if line is not None and abs(middle - tc1_ns - line.offset_at(middle)) > limit:
            self._jumps += 1
            if self._jumps < _AGREE:
                return False
            self._restart(max(tc1_ns, 1), now_ns)
            return True
        if self.sync.answer(tc1_ns, ts1_ns, now_ns):
            self._jumps = 0
        return False

    def update(self, now_ns: int) -> None:
        """Turn towards the target; to be called often."""
        if not self._newest_ns or self._begun_ns is None:
            return
        if not self._pieces:
            waited = now_ns - self._begun_ns
            if waited >= ACQUIRE_NS or len(self.sync) >= _ENOUGH:
                self._begin(now_ns)
            return
        last = self._pieces[-1]
        if now_ns - self._updated_ns < _UPDATE_NS or self._newest_ns <= last.boot_ns:
            return
        self._updated_ns = now_ns
        line = self._target()
        if line is not None:
            run_ns = last.at(self._newest_ns)
            error_ns = self._newest_ns + line.offset_at(run_ns) - run_ns
            turn = min(max(error_ns / (_CORRECT_S * NS), -_SLEW), _SLEW)
            self._pieces.append(_Piece(self._newest_ns, run_ns, line.drift + turn))

    def _target(self) -> Line | None:
        line = self.sync.line()
        if line is not None:
            self.source = "timesync"
            return line
        self.source = "arrival"
        return self._envelope.line()

    def _begin(self, now_ns: int) -> None:
        line = self._target()
        if line is not None:
            run_ns = self._newest_ns + line.offset_at(now_ns)
            self._pieces.append(_Piece(self._newest_ns, run_ns, line.drift))
            self._updated_ns = now_ns

    def to_run(self, boot_us: I64) -> I64:
        """(N,) times of the run [ns] of stamps (N,) [µs since boot]; only when :attr:`ready`."""
        boot_ns = boot_us * 1000
        out = np.empty(boot_ns.shape[0], np.int64)
        for i, stamp in enumerate(boot_ns.tolist()):
            # Newest piece first: nearly every stamp belongs to it.
            piece = next((p for p in reversed(self._pieces) if stamp >= p.boot_ns), self._pieces[0])
            out[i] = piece.at(stamp)
        return out
