"""A DBC file and a mapping compiled to closures that read, and write, single signals."""

from __future__ import annotations

import difflib
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from companion.types import ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Database, Message, Signal

GYRO, ACCEL, TIME, COUNT = 0, 3, 6, 7
"""First slot of each quantity in a row of values."""

_GYRO_UNITS = {"rad/s": 1.0, "deg/s": math.radians(1.0), "mrad/s": 1e-3}
_ACCEL_UNITS = {"m/s2": 1.0, "g": 9.80665, "mg": 9.80665e-3}
_TIME_UNITS_NS = {"ns": 1.0, "us": 1e3, "100us": 1e5, "ms": 1e6, "s": 1e9}
_FLOATS = {16: ("<e", 2), 32: ("<f", 4), 64: ("<d", 8)}

Extract = Callable[[bytes], float]
Insert = Callable[[float], float]


class Mapping(Protocol):
    """How signals make a sample; ``companion.config.DbcMapping`` says what each key means."""

    @property
    def file(self) -> str: ...
    @property
    def gyro_signals(self) -> tuple[str, str, str]: ...
    @property
    def accel_signals(self) -> tuple[str, str, str]: ...
    @property
    def gyro_unit(self) -> str: ...
    @property
    def accel_unit(self) -> str: ...
    @property
    def gyro_scale(self) -> float: ...
    @property
    def accel_scale(self) -> float: ...
    @property
    def complete_on(self) -> str: ...
    @property
    def time_signal(self) -> str: ...
    @property
    def time_unit(self) -> str: ...
    @property
    def counter_signal(self) -> str: ...


@dataclass(slots=True)
class PlannedMessage:
    """A message that has mapped signals."""

    number: int
    definition: Message
    fields: list[tuple[int, Extract]] = field(default_factory=list)
    """Slot and reader of each mapped signal: SI, or raw for time and counter."""
    inverse: list[tuple[int, str, Insert]] = field(default_factory=list)
    """Slot, signal and what turns the value of the slot into the raw one."""
    selector: Extract | None = None
    """Reads the multiplexer, where the signals are there only for one value of it."""
    selected: float = 0.0

    @property
    def length(self) -> int:
        """Bytes."""
        return int(self.definition.length)


@dataclass(slots=True)
class DbcPlan:
    """A mapping, compiled."""

    messages: dict[tuple[int, bool], PlannedMessage]
    """By identifier and whether it is extended."""
    ends_on: int | None
    """Number of the message that completes a sample; None: whichever comes last."""
    full_scale: tuple[float, ...]
    steps: tuple[float, float]
    """Coarsest last place of angular rate and acceleration, SI; 0 for floats."""
    time_bits: int
    """0: no time signal."""
    tick_ns: float
    counter_bits: int


def load_database(path: str) -> Database:
    """A DBC file; :class:`ConfigError` with one line for one that cannot be read."""
    import cantools

    try:
        loaded = cantools.database.load_file(Path(path), strict=False)
    except Exception as error:  # the parser's own errors share no base
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise ConfigError(f"{path}: not a DBC file that can be used: {reason}") from None
    if not isinstance(loaded, cantools.database.can.Database):
        raise ConfigError(f"{path}: holds no CAN messages")
    return loaded


def compile_mapping(mapping: Mapping) -> DbcPlan:
    """Find the mapped signals in the file and compile them.

    Raises :class:`ConfigError`, naming key and signal, for what is missing, ambiguous or unusable.
    """
    database = load_database(mapping.file)
    plan = DbcPlan({}, None, (), (0.0, 0.0), 0, 1.0, 0)
    limits, steps = [], []
    vectors: tuple[tuple[str, Sequence[str], float, int], ...] = (
        ("gyro_signals", mapping.gyro_signals,
         _GYRO_UNITS[mapping.gyro_unit] * mapping.gyro_scale, GYRO),
        ("accel_signals", mapping.accel_signals,
         _ACCEL_UNITS[mapping.accel_unit] * mapping.accel_scale, ACCEL),
    )  # fmt: skip
    for key, names, factor, first in vectors:
        for i, name in enumerate(names):
            message, signal = _find(database, mapping, key, name)
            _plan(plan, message, signal, first + i, factor)
            limits.append(_full_scale(signal, factor))
            steps.append(0.0 if signal.is_float else abs(float(signal.scale) * factor))
    plan.full_scale = tuple(limits)
    plan.steps = max(steps[:3]), max(steps[3:])
    if mapping.time_signal:
        message, signal = _integer(database, mapping, "time_signal", mapping.time_signal)
        _plan(plan, message, signal, TIME, None)
        plan.time_bits = signal.length
        plan.tick_ns = float(signal.scale) * _TIME_UNITS_NS[mapping.time_unit]
    if mapping.counter_signal:
        message, signal = _integer(database, mapping, "counter_signal", mapping.counter_signal)
        _plan(plan, message, signal, COUNT, None)
        plan.counter_bits = signal.length
    if mapping.complete_on:
        ends = [
            m.number for m in plan.messages.values() if m.definition.name == mapping.complete_on
        ]
        if not ends:
            known = ", ".join(m.definition.name for m in plan.messages.values())
            raise ConfigError(
                f"complete_on: '{mapping.complete_on}' has none of the mapped signals; {known}"
            )
        plan.ends_on = ends[0]
    return plan


def _find(database: Database, mapping: Mapping, key: str, name: str) -> tuple[Message, Signal]:
    """The one signal called ``name``, or ``MESSAGE.SIGNAL`` where several are."""
    message_name, _, signal_name = name.rpartition(".")
    found = [
        (message, signal)
        for message in database.messages
        for signal in message.signals
        if signal.name == signal_name and message_name in ("", message.name)
    ]
    if len(found) == 1:
        return found[0]
    if found:
        where = ", ".join(f"{m.name}.{signal_name}" for m, _ in found)
        raise ConfigError(f"{key}: '{name}' is in several messages of {mapping.file}: {where}")
    names = {signal.name for message in database.messages for signal in message.signals}
    near = difflib.get_close_matches(signal_name, names, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise ConfigError(f"{key}: no signal '{name}' in {mapping.file}{hint}")


def _integer(database: Database, mapping: Mapping, key: str, name: str) -> tuple[Message, Signal]:
    message, signal = _find(database, mapping, key, name)
    if signal.is_float or signal.scale <= 0:
        raise ConfigError(f"{key}: '{name}' must be an integer that counts up")
    return message, signal


def _plan(plan: DbcPlan, message: Message, signal: Signal, slot: int, factor: float | None) -> None:
    """Add a signal to the plan; ``factor`` None: the raw value is wanted."""
    key = (message.frame_id, bool(message.is_extended_frame))
    planned = plan.messages.get(key)
    if planned is None:
        planned = plan.messages[key] = PlannedMessage(len(plan.messages), message)
    if signal.multiplexer_signal is not None:
        _select(planned, message, signal)
    planned.fields.append((slot, _extractor(signal, message.length, factor)))
    planned.inverse.append((slot, signal.name, _inserter(signal, factor)))


def _select(planned: PlannedMessage, message: Message, signal: Signal) -> None:
    wanted = float((signal.multiplexer_ids or [0])[0])
    if planned.selector is not None and planned.selected != wanted:
        raise ConfigError(f"{message.name}: mapped signals come under different multiplexers")
    multiplexer = message.get_signal_by_name(str(signal.multiplexer_signal))
    planned.selector = _extractor(multiplexer, message.length, None)
    planned.selected = wanted


def _shift(signal: Signal, length: int) -> tuple[bool, int]:
    """Whether the signal is little-endian, and the place of its last bit in the whole message."""
    if signal.byte_order == "little_endian":
        return True, int(signal.start)
    # Big-endian signals are given by their first bit, in the file's numbering of bits in a byte.
    first = 8 * (signal.start // 8) + 7 - signal.start % 8
    return False, 8 * length - first - int(signal.length)


def _extractor(signal: Signal, length: int, factor: float | None) -> Extract:
    """Reads the signal from a message of ``length`` bytes: times ``factor``, or raw."""
    little, shift = _shift(signal, length)
    order: str = "little" if little else "big"
    bits = int(signal.length)
    mask = (1 << bits) - 1
    sign = 1 << (bits - 1) if signal.is_signed else 0
    if factor is None:
        return lambda data: (int.from_bytes(data, order) >> shift) & mask  # type: ignore[arg-type]
    scale, offset = float(signal.scale) * factor, float(signal.offset) * factor
    if signal.is_float:
        form, size = _FLOATS[bits]

        def real(data: bytes) -> float:
            raw = (int.from_bytes(data, order) >> shift) & mask  # type: ignore[arg-type]
            value: float = struct.unpack(form, raw.to_bytes(size, "little"))[0]
            return value * scale + offset

        return real

    def whole(data: bytes) -> float:
        raw = (int.from_bytes(data, order) >> shift) & mask  # type: ignore[arg-type]
        return (raw - ((raw & sign) << 1)) * scale + offset

    return whole


def _raw_range(signal: Signal) -> tuple[int, int]:
    bits = int(signal.length)
    return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signal.is_signed else (0, (1 << bits) - 1)


def _inserter(signal: Signal, factor: float | None) -> Insert:
    """The raw value of a value in SI, rounded and kept in range; raw ones wrap as counters do."""
    low, high = _raw_range(signal)
    if factor is None:
        return lambda value: int(value) % (high + 1)
    scale, offset = float(signal.scale) * factor, float(signal.offset) * factor
    if signal.is_float:
        return lambda value: (value - offset) / scale
    return lambda value: max(low, min(high, round((value - offset) / scale)))


def _full_scale(signal: Signal, factor: float) -> float:
    """Where the signal ends, in SI; the nearer end, unless that is zero."""
    if signal.is_float:
        return math.inf
    ends = [abs((raw * signal.scale + signal.offset) * factor) for raw in _raw_range(signal)]
    return float(min(ends) or max(ends))
