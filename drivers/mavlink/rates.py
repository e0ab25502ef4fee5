"""Asking the autopilot for its messages, one request at a time, and looking at what comes.

SET_MESSAGE_INTERVAL first; a refused rate is halved, a refused message replaced by the next that
carries the same, and where nothing is granted REQUEST_DATA_STREAM is tried, which older autopilots
know. An acknowledgement is not believed: the rate that comes is counted, and asked for again when
it is short. What cannot be had is an event, never a failure.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.types import NS, Event
from drivers.mavlink.dialect import message_id

_ANSWER_NS = NS
_TRIES = 3
_CHECK_NS = 5 * NS
_SHORT = 0.7
"""Below this share of the wish, a rate is short."""
_HALVINGS = 2
_LEAST_HALVED_HZ = 20.0
"""A refused rate above it may be beyond what the autopilot's loop allows."""
_ASK_AGAIN = 3
_PATIENT_NS = 60 * NS
"""Asked for so seldom, once asking again a few times has not helped."""

_STREAMS = {
    "HIGHRES_IMU": mavlink.MAV_DATA_STREAM_RAW_SENSORS,
    "RAW_IMU": mavlink.MAV_DATA_STREAM_RAW_SENSORS,
    "SCALED_IMU": mavlink.MAV_DATA_STREAM_RAW_SENSORS,
    "SCALED_IMU2": mavlink.MAV_DATA_STREAM_RAW_SENSORS,
    "SCALED_PRESSURE": mavlink.MAV_DATA_STREAM_RAW_SENSORS,
    "GPS_RAW_INT": mavlink.MAV_DATA_STREAM_EXTENDED_STATUS,
    "GPS2_RAW": mavlink.MAV_DATA_STREAM_EXTENDED_STATUS,
    "GLOBAL_POSITION_INT": mavlink.MAV_DATA_STREAM_POSITION,
    "ATTITUDE": mavlink.MAV_DATA_STREAM_EXTRA1,
    "SYSTEM_TIME": mavlink.MAV_DATA_STREAM_EXTRA3,
}
"""Stream of REQUEST_DATA_STREAM that ArduPilot sends each message in."""


@dataclass(frozen=True, slots=True)
class Wish:
    """One kind of data that we want, by the messages that carry it, the best first."""

    messages: tuple[str, ...]
    rate_hz: float
    needed: bool = True
    """Not having it is worth an event."""


@dataclass(frozen=True, slots=True)
class RateReport:
    """What became of a wish."""

    message: str
    asked_hz: float
    granted: bool
    measured_hz: float
    """Over the last check; NaN before the first."""


class _Standing:
    """Where one wish stands."""

    def __init__(self, wish: Wish) -> None:
        self.wish = wish
        self.measured_hz = float("nan")
        self.told = False
        self.base: dict[str, int] = {}
        self.restart()

    def restart(self) -> None:
        self.choice = self.patience = 0
        self.begin_message()
        self.open = True

    def begin_message(self) -> None:
        self.rate_hz = self.wish.rate_hz
        self.tries = self.halvings = self.repeats = 0
        self.granted = self.by_stream = False
        self.settled_ns = 0

    def settle(self, now_ns: int, counts: Counter[str]) -> None:
        """Nothing more to ask for now; the counting begins."""
        self.open = False
        self.settled_ns = now_ns
        self.base = {message: counts[message] for message in self.wish.messages}

    def measure(self, now_ns: int, counts: Counter[str]) -> None:
        """Take the rate since the counting began, and begin to count anew."""
        came = max(counts[m] - before for m, before in self.base.items())
        self.measured_hz = came * NS / (now_ns - self.settled_ns)
        self.settle(now_ns, counts)

    def next_message(self) -> bool:
        """Go on to the next message that carries the same; False if there is none."""
        if self.choice + 1 >= len(self.wish.messages):
            return False
        self.choice += 1
        self.begin_message()
        self.open = True
        return True

    @property
    def message(self) -> str:
        return self.wish.messages[self.choice]


class RateKeeper:
    """The requests of one link. Pure: messages to send come out, time and counts go in."""

    def __init__(self, wishes: tuple[Wish, ...]) -> None:
        self._all = [_Standing(wish) for wish in wishes if wish.rate_hz > 0]
        self._waiting: _Standing | None = None
        self._sent_ns = 0
        self._counts: Counter[str] = Counter()
        self._events: list[Event] = []

    def restart(self) -> None:
        """Ask for everything again: the autopilot may have forgotten."""
        for standing in self._all:
            standing.restart()
        self._waiting = None

    def count(self, message: str, number: int = 1) -> None:
        """That many of a message came."""
        self._counts[message] += number

    def events(self) -> list[Event]:
        """What happened since the last call."""
        out, self._events = self._events, []
        return out

    def report(self) -> tuple[RateReport, ...]:
        """How each wish stands."""
        return tuple(RateReport(s.message, s.rate_hz, s.granted, s.measured_hz) for s in self._all)

    def acknowledge(self, command: int, result: int, now_ns: int) -> None:
        """Take a COMMAND_ACK that is addressed to us."""
        standing = self._waiting
        if command != mavlink.MAV_CMD_SET_MESSAGE_INTERVAL or standing is None:
            return
        if result in (mavlink.MAV_RESULT_IN_PROGRESS, mavlink.MAV_RESULT_TEMPORARILY_REJECTED):
            self._sent_ns = now_ns  # asked again in a while, as if there had been no answer
            return
        self._waiting = None
        if result == mavlink.MAV_RESULT_ACCEPTED:
            standing.granted = True
            standing.settle(now_ns, self._counts)
            if standing.halvings:
                text = f"{standing.message} granted at {standing.rate_hz:g} Hz"
                text += f", {standing.wish.rate_hz:g} Hz refused"
                self._events.append(Event(now_ns, "rate-lowered", text))
        else:
            self._refused(standing)

    def _refused(self, standing: _Standing) -> None:
        """Less, then another message, then the old way, then leave it to the counting."""
        standing.tries = 0
        if standing.halvings < _HALVINGS and standing.rate_hz / 2 >= _LEAST_HALVED_HZ:
            standing.halvings += 1
            standing.rate_hz /= 2
        elif not standing.next_message():
            standing.by_stream = True

    def tick(self, now_ns: int, system: int, component: int) -> list[Any]:
        """Messages to send now to that autopilot; called while it is there and ready."""
        for standing in self._all:
            if not standing.open and now_ns - standing.settled_ns >= _CHECK_NS:
                standing.measure(now_ns, self._counts)
                self._judge(standing, now_ns)
        if self._waiting is not None:
            if 0 <= now_ns - self._sent_ns < _ANSWER_NS:
                return []
            if self._waiting.tries >= _TRIES:
                # Not even a refusal: it does not know the command.
                self._waiting.by_stream = True
            self._waiting = None
        due = next((s for s in self._all if s.open), None)
        if due is None:
            return []
        if due.by_stream:
            due.settle(now_ns, self._counts)
            return [self._data_stream(due, system, component)]
        self._waiting, self._sent_ns = due, now_ns
        due.tries += 1
        return [_interval(due, system, component)]

    def _data_stream(self, standing: _Standing, system: int, component: int) -> Any:
        stream = _STREAMS[standing.message]
        same = [s.rate_hz for s in self._all if s.by_stream and _STREAMS[s.message] == stream]
        rate = max(1, round(max(same)))
        return mavlink.MAVLink_request_data_stream_message(system, component, stream, rate, 1)

    def _judge(self, standing: _Standing, now_ns: int) -> None:
        """Compare the rate that came with the wish."""
        if standing.measured_hz >= _SHORT * standing.rate_hz:
            standing.repeats = 0
            if standing.told:
                standing.told = False
                self._say(standing, now_ns, "rate-delivered", "info")
            return
        # What does not come at all will not come by asking often.
        if standing.repeats < (_ASK_AGAIN if standing.measured_hz else 1):
            standing.repeats += 1
            standing.tries, standing.open = 0, True
            return
        if standing.granted and standing.next_message():
            return
        if not standing.told and standing.wish.needed:
            standing.told = True
            self._say(standing, now_ns, "rate-not-delivered", "warning")
        standing.patience += 1
        if standing.patience * _CHECK_NS >= _PATIENT_NS:
            standing.restart()
            standing.repeats = _ASK_AGAIN

    def _say(self, standing: _Standing, now_ns: int, kind: str, level: Any) -> None:
        text = (
            f"{standing.message} comes at {standing.measured_hz:.1f} Hz, "
            f"asked for {standing.rate_hz:g} Hz"
        )
        if kind == "rate-not-delivered" and not standing.granted:
            text += ", not granted"
        self._events.append(Event(now_ns, kind, text, level))


def _interval(standing: _Standing, system: int, component: int) -> Any:
    interval_us = 1e6 / standing.rate_hz
    return mavlink.MAVLink_command_long_message(
        system,
        component,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        standing.tries - 1,
        message_id(standing.message),
        interval_us,
        0,
        0,
        0,
        0,
        0,
    )
