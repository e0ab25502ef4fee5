"""Time of validity from a sensor's own clock or counter, on the clock of arrivals.

A sensor samples evenly; its frames arrive late by what the bus and the adapter made them wait,
never early. So validity is sensor time plus the lower envelope of (arrival − sensor time), and the
envelope is a line: two crystals differ by tens of parts per million, a learned counter rate by
more. Causal, in order, and a function of its arguments alone, so that a recorded bus gives the same
times again.
"""

from __future__ import annotations

import math
from collections import deque

NS = 1_000_000_000

_BLOCK_NS = NS
"""The envelope is kept as the least delay in each second of sensor time."""
_BLOCKS = 10
_FIT_BLOCKS = 4
"""With fewer of them a slope would follow the scatter of the least delays."""
_SCATTER_NS = 2e6
"""Least delays of a second scatter by less than this while the bus is read in time."""
_SLEW = 2e-3
"""Fastest correction of the offset, s/s: a sample interval is off by 0.2 % at most."""
_EARLY_NS = NS
"""Arrived this long before it can be valid: the sensor's clock was set forward."""
_LATE_NS = NS
_LATE_FOR_NS = 2 * NS
"""Late by more than that for this long: the clock was set back unseen. A stalled reader's backlog
is late too, but drains at once."""


class SensorClock:
    """Maps sensor time to the arrival clock; feed it each sample once, in order."""

    def __init__(self, drift_ppm: float = 500.0) -> None:
        """``drift_ppm``: largest rate difference of the two clocks that is believed."""
        self.restarts = 0
        self._drift = drift_ppm * 1e-6
        self._last_ns: int | None = None
        self._begin(0, 0)

    def _begin(self, sensor_ns: int, rx_ns: int) -> None:
        self._sensor0, self._base = sensor_ns, rx_ns - sensor_ns
        self._x = 0.0
        self._offset = 0.0
        self._slope = 0.0
        self._anchor: float | None = None
        self._late_since: int | None = None
        self._blocks: deque[tuple[float, float]] = deque(maxlen=_BLOCKS)
        self._block_end = float(_BLOCK_NS)
        self._least = (0.0, 0.0)

    def at(self, sensor_ns: int, rx_ns: int) -> int:
        """Time of validity [ns, arrival clock] of the sample stamped ``sensor_ns``.

        Later than that of the sample before, and not after ``rx_ns`` except by the nanosecond
        that samples read together may need to stay apart.
        """
        if self._last_ns is None:
            self._begin(sensor_ns, rx_ns)
        elif self._restarted(sensor_ns, rx_ns):
            self.restarts += 1
            self._begin(sensor_ns, rx_ns)
        # Relative to the first sample, so that float64 holds them to well below a nanosecond.
        x = float(sensor_ns - self._sensor0)
        delay = float(rx_ns - sensor_ns - self._base)
        self._settle(x, delay)
        t_ns = sensor_ns + self._base + round(self._offset)
        if self._last_ns is not None and t_ns <= self._last_ns:
            t_ns = self._last_ns + 1
        self._last_ns = t_ns
        return t_ns

    def _restarted(self, sensor_ns: int, rx_ns: int) -> bool:
        x = float(sensor_ns - self._sensor0)
        excess = float(rx_ns - sensor_ns - self._base) - self._offset
        if x < self._x or excess < -_EARLY_NS:
            return True
        if excess < _LATE_NS:
            self._late_since = None
        elif self._late_since is None:
            self._late_since = rx_ns
        return self._late_since is not None and rx_ns - self._late_since > _LATE_FOR_NS

    def _settle(self, x: float, delay: float) -> None:
        """Move the offset towards the envelope's line, seen up to this sample."""
        elapsed = x - self._x
        self._x = x
        if x >= self._block_end:
            self._blocks.append(self._least)
            self._block_end = x + _BLOCK_NS
            self._least = (x, delay)
            self._fit()
        elif delay < self._least[1] or elapsed == 0.0:
            self._least = (x, delay)
        ahead = self._offset + self._slope * elapsed
        if self._anchor is None:
            target = min(ahead, delay)
            self._offset = target
            return
        target = self._anchor + self._slope * x
        limit = _SLEW * elapsed
        self._offset = min(ahead + max(-limit, min(limit, target - ahead)), delay)

    def _fit(self) -> None:
        """Slope by least squares over the blocks' least delays; the line lies under all of them.

        A block far above the lowest one is a second in which nothing came in time, and says
        nothing of the clock.
        """
        if len(self._blocks) < _FIT_BLOCKS:
            return
        x0, y0 = min(self._blocks, key=_delay)
        good = [
            (x, y) for x, y in self._blocks if y - y0 <= _SCATTER_NS + self._drift * abs(x - x0)
        ]
        if len(good) >= _FIT_BLOCKS:
            mean_x = sum(x for x, _ in good) / len(good)
            mean_y = sum(y for _, y in good) / len(good)
            sxx = sum((x - mean_x) ** 2 for x, _ in good)
            sxy = sum((x - mean_x) * (y - mean_y) for x, y in good)
            self._slope = max(-self._drift, min(self._drift, sxy / sxx))
        self._anchor = min(y - self._slope * x for x, y in good)


def _delay(block: tuple[float, float]) -> float:
    return block[1]


class Unwrapped:
    """A clock of ``bits`` that wraps, as nanoseconds that do not."""

    def __init__(self, bits: int, tick_ns: float) -> None:
        self._modulus = 1 << bits
        self._tick_ns = tick_ns
        self._raw: int | None = None
        self._ticks = 0

    def at(self, raw: int) -> int:
        """Time since the first reading [ns]; a step back of less than half the range shows."""
        if self._raw is not None:
            step = (raw - self._raw) % self._modulus
            self._ticks += step - self._modulus if step > self._modulus // 2 else step
        self._raw = raw
        return round(self._ticks * self._tick_ns)


_IN_STEP = 0.75
"""Periods since the sample before from which on a sample does not come out of a backlog."""
_STEPS = 3
"""Samples in step, one behind the other, after which there is no backlog."""
_PAUSE = 0.5
"""Turns of the counter for which nothing came, after which the next sample alone says nothing."""

_KNOWN = 16
"""Steps after which the period is known well enough to tell a pause."""

_BACKLOG = 512
"""Samples that may wait in an adapter before anybody listens."""
_PAUSES = 4
"""So many one after the other are none."""


class Counter:
    """A counter of ``bits`` that goes up by one a sample and wraps; finds lost and repeated ones.

    Time of arrival resolves how often it wrapped while nothing came: a 5-bit counter at 160 Hz
    does so every 0.2 s. After a pause the samples behind it tell silence of the sensor, where they
    come in step, from a reader that was held up, where they come at once: whole turns of the
    counter are only counted once samples have come in step.
    """

    def __init__(self, bits: int, rate_hz: float = 0.0) -> None:
        """``rate_hz``: expected rate; 0: learned from arrivals."""
        self.total = 0
        """Samples since the first one, lost ones included."""
        self.period_ns = NS / rate_hz if rate_hz > 0 else 0.0
        self._modulus = 1 << bits
        self._last: tuple[int, int] | None = None
        self._steps = _KNOWN if rate_hz > 0 else 0
        self._begun = False
        self._apart = 0
        self._pauses = 0
        self._pending = False
        """Behind a pause, and not known yet whether turns were missed."""
        self._in_step = 0
        self._waited = 0.0
        self._late = 0.0
        """Periods that a pause and the backlog behind it leave unexplained."""

    def advance(self, raw: int, rx_ns: int) -> int:
        """Steps since the sample before: 1 in order, 0 a repeat, more: some were lost; −1: restart.

        The first sample counts as in order.
        """
        if self._last is None:
            self._last = raw, rx_ns
            return 1
        last_raw, last_rx = self._last
        steps = (raw - last_raw) % self._modulus
        elapsed = rx_ns - last_rx
        if self.period_ns > 0:
            passed = elapsed / self.period_ns
            if steps > 2.0 * (passed + self._late) + 0.25 * self._modulus + 8.0:
                # More than can have been sent in this time: it began again.
                self._last = raw, rx_ns
                self._late, self._pending = 0.0, False
                self.total += 1
                return -1
            held_up = self._pending or passed >= _PAUSE * self._modulus
            steps += self._modulus * self._turns(steps, passed)
        else:
            held_up = False
        if steps == 0:
            return 0
        self._last = raw, rx_ns
        self.total += steps
        # A pause and the backlog behind it say nothing of the period, once there is one.
        if self._drained(elapsed) and steps == 1 and not (held_up and self._known):
            # A mean over the first samples that turns into one over the last hundred or so.
            self._steps = min(self._steps + 1, 128)
            self.period_ns += (elapsed - self.period_ns) / self._steps
        return steps

    def _drained(self, elapsed: int) -> bool:
        """Whether what had waited before anybody listened is through: it says nothing either."""
        if not self._begun:
            self._apart = self._apart + 1 if elapsed > 0 else 0
            self._begun = self._apart >= _STEPS or self.total >= _BACKLOG
        return self._begun

    @property
    def _known(self) -> bool:
        return self._steps >= _KNOWN

    def _turns(self, steps: int, passed: float) -> int:
        """Whole turns beside ``steps`` in the ``passed`` periods since the sample before."""
        self._pauses = self._pauses + 1 if passed >= _PAUSE * self._modulus else 0
        if self._pauses > _PAUSES:
            self._steps = 0  # it has become slow: learned anew
        if not self._known:
            self._late, self._pending = 0.0, False
            return 0
        pause = passed >= _PAUSE * self._modulus
        if pause and steps == 0:
            return math.floor(passed / self._modulus + 0.5)
        if not (pause or self._pending):
            return 0
        self._late += passed - steps
        if pause:
            self._pending, self._in_step, self._waited = True, 0, 0.0
            return 0
        self._in_step = self._in_step + 1 if passed >= _IN_STEP else 0
        self._waited += passed
        if self._in_step < _STEPS and self._waited < self._modulus:
            return 0
        turns = math.floor(self._late / self._modulus + 0.5)
        self._late, self._pending = 0.0, False
        return max(0, turns)
