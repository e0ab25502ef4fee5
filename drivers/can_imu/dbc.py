"""Any inertial unit that a DBC file describes: signals by name, compiled to shifts and masks.

cantools reads the file. Each mapped signal becomes one closure, which takes half the time of
decoding whole messages by cantools. A sample is complete when every message with a mapped signal
has come, or with the message that the mapping names.
"""

from __future__ import annotations

import math

from companion.types import ConfigError, ImuSamples
from drivers.can_imu.clock import Counter, Unwrapped
from drivers.can_imu.dbc_signals import COUNT, TIME, DbcPlan, Mapping, compile_mapping
from drivers.can_imu.decoder import CanFrame, CanImuDecoder, CanImuEncoder, Unit
from drivers.can_imu.grouping import CycleStart, Timing


class DbcDecoder(CanImuDecoder):
    """One unit by its DBC file and mapping."""

    def __init__(self, unit: Unit, mapping: Mapping) -> None:
        """Raises :class:`ConfigError` for a file, signal or message that cannot be used."""
        plan = compile_mapping(mapping)
        super().__init__(unit, plan.full_scale)
        self.steps = plan.steps
        self._messages = plan.messages
        self._all = (1 << len(plan.messages)) - 1
        self._ends = plan.ends_on
        # A named end, or a single message, leaves nothing to find out.
        self._order = CycleStart(len(plan.messages), None)
        self._learn = plan.ends_on is None and len(plan.messages) > 1
        clock = Unwrapped(plan.time_bits, plan.tick_ns) if plan.time_bits else None
        counter = Counter(plan.counter_bits, unit.rate_hz) if plan.counter_bits else None
        self._timed, self._counted = clock is not None, counter is not None
        self._timing = Timing(clock, counter)
        self._slots = [0.0] * 8
        self._latest = [b""] * len(plan.messages)
        self._have = 0
        self._first_rx = 0

    def wants(self, can_id: int, extended: bool) -> bool:
        """The messages with mapped signals."""
        return (can_id, extended) in self._messages

    def feed(self, seq: int, t_rx_ns: int, can_id: int, extended: bool, data: bytes) -> bool:
        """One frame; see :meth:`CanImuDecoder.feed`."""
        message = self._messages.get((can_id, extended))
        if message is None:
            return False
        if len(data) < message.length:
            self.counters.frames += 1
            self.counters.malformed += 1
            return True
        data = data[: message.length]
        if message.selector is not None and message.selector(data) != message.selected:
            return False
        self.counters.frames += 1
        number = message.number
        if self._learn:
            self._order.heard(number, t_rx_ns)
        bit = 1 << number
        if self._have & bit:
            if data == self._latest[number]:
                self.counters.repeated += 1
                return True
            self.counters.incomplete += 1
            self._have = 0
        if not self._have:
            if self._learn and self._order.first not in (None, number):
                self.counters.incomplete += 1
                return True
            self._first_rx = t_rx_ns
        self._have |= bit
        self._latest[number] = data
        slots = self._slots
        for slot, extract in message.fields:
            slots[slot] = extract(data)
        if self._have == self._all and self._ends in (None, number):
            self._complete(seq, t_rx_ns)
        elif self._ends == number:
            self.counters.incomplete += 1
            self._have = 0
        return True

    def _complete(self, seq: int, t_rx_ns: int) -> None:
        self._have = 0
        slots, counters = self._slots, self.counters
        stamp = int(slots[TIME]) if self._timed else None
        count = int(slots[COUNT]) if self._counted else None
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
        gx, gy, gz, ax, ay, az = slots[:6]
        self._add(seq, t_ns, t_rx_ns, (gx, gy, gz, ax, ay, az))


class DbcEncoder(CanImuEncoder):
    """The mapped messages in the order of their identifiers, the completing one last.

    Signals that are not mapped are 0.
    """

    def __init__(self, mapping: Mapping) -> None:
        self._plan: DbcPlan = compile_mapping(mapping)
        if any(message.selector is not None for message in self._plan.messages.values()):
            raise ConfigError(f"{mapping.file}: multiplexed messages can be read, not written")
        ends_on = self._plan.ends_on
        self._order = sorted(
            self._plan.messages.items(), key=lambda item: (item[1].number == ends_on, item[0])
        )
        self._count = 0

    def encode(self, samples: ImuSamples) -> list[CanFrame]:
        """One frame a message and sample."""
        plan = self._plan
        frames = []
        rows = zip(
            samples.t_ns.tolist(), samples.gyro_b.tolist(), samples.accel_b.tolist(), strict=True
        )
        for t_ns, gyro, accel in rows:
            tick = math.floor(t_ns / plan.tick_ns) if plan.time_bits else 0
            values = [*gyro, *accel, float(tick), float(self._count)]
            self._count += 1
            for (can_id, extended), message in self._order:
                raw = {name: insert(values[slot]) for slot, name, insert in message.inverse}
                signals = {s.name: raw.get(s.name, 0) for s in message.definition.signals}
                data = message.definition.encode(signals, scaling=False, strict=False)
                frames.append(CanFrame(can_id, extended, bytes(data)))
        return frames
