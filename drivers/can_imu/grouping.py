"""Samples that come as several frames: one of angular rate, one of acceleration, perhaps a time.

A sample is complete when both inertial frames are there. Whatever belongs to the next one before
that shows that a frame was lost: the sample is given up and counted.
"""

from __future__ import annotations

from drivers.can_imu.clock import Counter, SensorClock, Unwrapped
from drivers.can_imu.decoder import CanImuDecoder, Unit, Vec3

_GYRO, _ACCEL, _LEAD = 1, 2, 4
_LEARN = 64
"""Steps of a counter after which its period is believed."""
_GAPS = 16
"""Gaps between frames that an order is learned from, and that it is averaged over."""
_COUNTER_DRIFT_PPM = 10_000.0
"""A period learned over so few steps is off by up to the scatter of arrivals over their sum."""


class Timing:
    """Time of validity of samples that may carry a time, a counter, both or neither."""

    def __init__(self, clock: Unwrapped | None, counter: Counter | None) -> None:
        self.restarts = 0
        self._unwrapped = clock
        self._counter = counter
        self._by_time: SensorClock | None = None
        self._by_count: SensorClock | None = None
        self._period_ns = round(counter.period_ns) if counter else 0
        self._sensor_ns = 0
        self._last_rx = 0
        self._last_t = -1

    def steps(self, count: int | None, rx_ns: int) -> int:
        """Steps of the counter since the sample before, as :meth:`Counter.advance`; 1 without."""
        if self._counter is None or count is None:
            return 1
        return self._counter.advance(count, rx_ns)

    def at(self, stamp: int | None, count: int | None, rx_ns: int) -> int:
        """Time of validity [ns]; ``rx_ns``: arrival of the sample's first frame."""
        if self._unwrapped is not None and (stamp is not None or self._by_time is not None):
            t_ns = self._stamped(self._unwrapped, stamp, rx_ns)
        elif self._counter is not None and count is not None:
            t_ns = self._counted(self._counter, rx_ns)
        else:
            t_ns = rx_ns
        self._last_rx = rx_ns
        self._last_t = max(t_ns, self._last_t + 1)
        return self._last_t

    def _stamped(self, clock: Unwrapped, stamp: int | None, rx_ns: int) -> int:
        if self._by_time is None:
            self._by_time = SensorClock()
        if stamp is not None:
            self._sensor_ns = clock.at(stamp)
        else:
            # Its time was lost: as late as the sample before.
            self._sensor_ns += rx_ns - self._last_rx
        t_ns = self._by_time.at(self._sensor_ns, rx_ns)
        self.restarts = self._by_time.restarts
        return t_ns

    def _counted(self, counter: Counter, rx_ns: int) -> int:
        if not self._period_ns:
            if counter.total < _LEARN:
                return rx_ns
            self._period_ns = round(counter.period_ns)
        if self._by_count is None:
            self._by_count = SensorClock(_COUNTER_DRIFT_PPM)
        return self._by_count.at(counter.total * max(self._period_ns, 1), rx_ns)


class CycleStart:
    """Which of a unit's messages begins a sample: the one before which the bus is silent longest.

    Without it, a decoder that begins to listen in the middle would pair each message with those of
    another sample for good.
    """

    def __init__(self, count: int, first: int | None) -> None:
        """``count`` messages, numbered from 0; ``first``: assumed until it is known better."""
        self.first = first
        self._last: tuple[int, int] | None = None
        self._gap_ns = [0.0] * count
        self._heard = [0] * count

    def heard(self, message: int, t_rx_ns: int) -> None:
        """A message arrived."""
        if self._last is not None and self._last[0] != message:
            gap = t_rx_ns - self._last[1]
            count = self._heard[message] = min(self._heard[message] + 1, _GAPS)
            self._gap_ns[message] += (gap - self._gap_ns[message]) / count
            if min(self._heard) == _GAPS:
                second, longest = sorted(self._gap_ns)[-2:]
                # Not for a small difference: frames that are read together have no gaps at all.
                if longest > 2.0 * second:
                    self.first = self._gap_ns.index(longest)
        self._last = message, t_rx_ns


class GroupedDecoder(CanImuDecoder):
    """Base of units with a frame for each quantity; a time and a counter lead a sample."""

    def __init__(
        self,
        unit: Unit,
        full_scale: tuple[float, ...],
        *,
        clock: Unwrapped | None = None,
        counter: Counter | None = None,
    ) -> None:
        super().__init__(unit, full_scale)
        self._timing = Timing(clock, counter)
        self._order = CycleStart(2, first=0)
        self._led = False
        """A time or a counter was heard: it says where a sample begins."""
        self._have = 0
        self._first_rx = 0
        self._stamp: int | None = None
        self._count: int | None = None
        self._rate: Vec3 = (0.0, 0.0, 0.0)
        self._force: Vec3 = (0.0, 0.0, 0.0)

    def _lead(self, t_rx_ns: int, *, stamp: int | None = None, count: int | None = None) -> None:
        """A time or a counter: what is pending and has an inertial part is given up."""
        again = self._stamp if stamp is not None else self._count
        if self._have & (_GYRO | _ACCEL) or (self._have & _LEAD and again is not None):
            if again is not None and again in (stamp, count):
                self.counters.repeated += 1
                return
            self.counters.incomplete += 1
            self._clear()
        self._led = True
        self._open(_LEAD, t_rx_ns)
        if stamp is not None:
            self._stamp = stamp
        if count is not None:
            self._count = count

    def _gyro(self, seq: int, t_rx_ns: int, rate: Vec3) -> None:
        if self._admit(_GYRO, t_rx_ns, rate == self._rate):
            self._rate = rate
            if self._have & _ACCEL:
                self._complete(seq, t_rx_ns)

    def _accel(self, seq: int, t_rx_ns: int, force: Vec3) -> None:
        if self._admit(_ACCEL, t_rx_ns, force == self._force):
            self._force = force
            if self._have & _GYRO:
                self._complete(seq, t_rx_ns)

    def _admit(self, part: int, t_rx_ns: int, same: bool) -> bool:
        """Whether an inertial part becomes part of the pending sample; ``same``: as it was."""
        number = int(part == _ACCEL)
        if not self._led:
            self._order.heard(number, t_rx_ns)
        if self._have & part:
            if same:
                # A copy, or a sensor at rest whose other frame was lost: validity is the later one.
                self.counters.repeated += 1
                if not self._have & _LEAD:
                    self._first_rx = t_rx_ns
                return False
            self.counters.incomplete += 1
            self._clear()
        if not self._have and not self._led and number != self._order.first:
            # The second half of a sample whose first was lost, or sent before we listened.
            self.counters.incomplete += 1
            return False
        self._open(part, t_rx_ns)
        return True

    def _open(self, part: int, t_rx_ns: int) -> None:
        if not self._have:
            self._first_rx = t_rx_ns
        self._have |= part

    def _clear(self) -> None:
        self._have = 0
        self._stamp = self._count = None

    def _complete(self, seq: int, t_rx_ns: int) -> None:
        stamp, count = self._stamp, self._count
        self._clear()
        counters = self.counters
        steps = self._timing.steps(count, self._first_rx)
        if steps == 0:
            counters.repeated += 1
            return
        if steps < 0:
            counters.restarts += 1
        counters.lost += max(steps - 1, 0)
        before = self._timing.restarts
        t_ns = self._timing.at(stamp, count, self._first_rx)
        counters.restarts += self._timing.restarts - before
        self._add(seq, t_ns, t_rx_ns, (*self._rate, *self._force))
