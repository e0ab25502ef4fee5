"""Publication over zenoh: the keys, encodings and manners that subscribers rely on.

========================  =========================  ========================================
``companion/<vehicle>/``  message                    how
========================  =========================  ========================================
``nav/state``             companion.NavState         ``zenoh.state_rate_hz`` at most; queryable
``nav/fix``               foxglove.LocationFix       10 Hz at most
``nav/odometry``          foxglove.Odometry          10 Hz at most, east-north-up of the first fix
``nav/smoothed``          companion.NavState         with its lag; where ``[smoothing]`` is on
``nav/estimators/<name>`` companion.NavState         of a bank: each estimator's own
``nav/aiding``            companion.AidingReport     one a measurement
``nav/adaptation``        companion.AdaptationTrace  one an adapted measurement
``nav/satellites``        companion.Satellites       one an epoch of raw GNSS: in use, DOPs
``events``                foxglove.Log               cached: who comes late gets the last 64
``health``                companion.Health           cached: who comes late gets the last one
``config``                companion.Config           queryable only
``@alive``                –                          liveliness token
========================  =========================  ========================================

A congested link drops; nothing waits. Events and health carry numbers and a heartbeat, so that an
advanced subscriber asks for what it missed, from the cache.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import zenoh

from companion.config import Zenoh
from companion.logbook import messages
from companion.logbook.adaptation import encode_trace
from companion.logbook.health import encode_health
from companion.logbook.satellites import encode_satellites
from companion.logbook.schemas import member_topic, topic
from companion.outputs import payloads
from companion.outputs.pacing import Pacer
from companion.outputs.publisher import Notice
from companion.outputs.zenoh_link import ZenohLink
from companion.outputs.zenoh_settings import session_settings
from companion.types import NS, AidingReports, Event, Health, Outputs, Solution

DRAW_HZ = 10.0
"""Maps and 3-D views get this rate, as in the log."""
EVENTS_CACHED = 64
HEARTBEAT_S = 1.0
_NEVER = -1


@dataclass(frozen=True, slots=True)
class _Declared:
    """What hangs on one open session; held so that it is not undeclared."""

    session: zenoh.Session
    publishers: dict[str, Any]
    others: tuple[Any, ...]


class ZenohPublisher:
    """Publishes one vehicle; see :class:`companion.outputs.publisher.Publisher`."""

    def __init__(self, settings: Zenoh, vehicle: str) -> None:
        """Begin to open a session; nothing waits for it.

        Raises :class:`companion.types.ConfigError` for settings that can never work. A port that is
        taken or a router that is absent is a notice, and tried again.
        """
        session_settings(settings)
        self._vehicle = vehicle
        self._state_rate_hz = settings.state_rate_hz
        self._state_pacer = Pacer(settings.state_rate_hz)
        self._member_pacers: dict[str, Pacer] = {}
        self._drawn_slot = _NEVER
        self._origin: tuple[float, float, float] | None = None
        self._latest: dict[str, bytes] = {}
        self._unsent: deque[bytes] = deque(maxlen=EVENTS_CACHED)
        self.link = ZenohLink(lambda: session_settings(settings), self._declare)

    # ------------------------------------------------------------------ Publisher

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:
        """States first: what is aiding and drawn may come a moment later."""
        if len(outputs.published):
            self._states(outputs.published, arrival_monotonic_ns)
            self._drawn(outputs.published)
        for name, published in outputs.members:
            self._member(name, published)
        if len(outputs.reports):
            self._reports(outputs.reports)
        if len(outputs.smoothed):
            for row in messages.encode_smoothed(outputs.smoothed):
                self._put(payloads.SMOOTHED, row.tobytes())
        if len(outputs.adaptation):
            for row in encode_trace(outputs.adaptation):
                self._put(payloads.ADAPTATION, row.tobytes())
        if len(outputs.satellites):
            for row in encode_satellites(outputs.satellites):
                self._put(payloads.SATELLITES, row.tobytes())
        for event in outputs.events:
            self.event(event)

    def event(self, event: Event) -> None:
        """Publish an event; kept for subscribers that come later, and until a session is open."""
        self._unsent.append(payloads.event_message(event))
        self._send_events()

    def health(self, health: Health) -> None:
        """Publish the state of the process; the last one is kept."""
        self._send_events()
        self._put(payloads.HEALTH, encode_health(health))

    def config(self, toml: str) -> None:
        """Answer queries of ``config`` with this."""
        self._latest[payloads.CONFIG] = payloads.config_message(toml)

    def notices(self) -> list[Notice]:
        """Sessions that did not open, were lost, or are there again."""
        return self.link.notices()

    def close(self) -> None:
        """Undeclare everything; subscribers see the vehicle vanish."""
        self.link.close()

    def _send_events(self) -> None:
        while self._unsent and self.link.live is not None:
            self._put(payloads.EVENTS, self._unsent.popleft())

    # ------------------------------------------------------------------ navigation

    def _states(self, published: Solution, arrival_monotonic_ns: int) -> None:
        due = [i for i, t in enumerate(published.t_ns.tolist()) if self._state_pacer.due(t)]
        if not due:
            return
        cut = published if len(due) == len(published) else published.take(due)
        for row in messages.encode_states(cut):
            state = payloads.with_arrival(row.tobytes(), arrival_monotonic_ns)
            self._latest[payloads.STATE] = state
            self._put(payloads.STATE, state)

    def _member(self, name: str, published: Solution) -> None:
        """One estimator of a bank; its key is declared when it first has something to say."""
        pacer = self._member_pacers.setdefault(name, Pacer(self._state_rate_hz))
        due = [i for i, t in enumerate(published.t_ns.tolist()) if pacer.due(t)]
        live = self.link.live
        if not due or live is None:
            return
        member = member_topic(name)
        if member not in live.publishers:
            live.publishers[member] = live.session.declare_publisher(
                topic(self._vehicle, member),
                encoding=payloads.encoding(payloads.STATE),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA,
            )
        for row in messages.encode_states(published.take(due)):
            self._put(member, row.tobytes())

    def _drawn(self, published: Solution) -> None:
        drawn, self._drawn_slot = messages.drawable(
            published, round(NS / DRAW_HZ), self._drawn_slot
        )
        if not len(drawn):
            return
        if self._origin is None:
            self._origin = float(drawn.lat[0]), float(drawn.lon[0]), float(drawn.height[0])
        for row in messages.encode_fixes(drawn):
            self._put(payloads.FIX, row.tobytes())
        for row in messages.encode_odometry(drawn, self._origin):
            self._put(payloads.ODOMETRY, row.tobytes())

    def _reports(self, reports: AidingReports) -> None:
        for row in messages.encode_reports(reports):
            self._put(payloads.AIDING, row.tobytes())

    def _put(self, name: str, payload: bytes) -> None:
        live = self.link.live
        if live is None:
            return
        try:
            live.publishers[name].put(payload)
        except zenoh.ZError as error:
            self.link.lost(error)

    # ------------------------------------------------------------------ a new session

    def _declare(self, session: zenoh.Session) -> _Declared:
        key = {name: topic(self._vehicle, name) for name in (*payloads.SCHEMAS, payloads.ALIVE)}
        publishers: dict[str, Any] = {
            name: session.declare_publisher(
                key[name],
                encoding=payloads.encoding(name),
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_HIGH if first else zenoh.Priority.DATA,
                express=first,
            )
            for name, first in (
                (payloads.STATE, True),
                (payloads.FIX, False),
                (payloads.ODOMETRY, False),
                (payloads.SMOOTHED, False),
                (payloads.AIDING, False),
                (payloads.ADAPTATION, False),
                (payloads.SATELLITES, False),
            )
        }
        for name, kept in ((payloads.EVENTS, EVENTS_CACHED), (payloads.HEALTH, 1)):
            publishers[name] = zenoh.ext.declare_advanced_publisher(
                session,
                key[name],
                encoding=payloads.encoding(name),
                congestion_control=zenoh.CongestionControl.DROP,
                cache=zenoh.ext.CacheConfig(kept),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=HEARTBEAT_S, sporadic_heartbeat=None
                ),
                publisher_detection=True,
            )
        queryables = [
            session.declare_queryable(key[name], self._answer(name, key[name]), complete=True)
            for name in (payloads.STATE, payloads.CONFIG)
        ]
        token = session.liveliness().declare_token(key[payloads.ALIVE])
        return _Declared(session, publishers, (*queryables, token))

    def _answer(self, name: str, key: str) -> Any:
        """Callback of a queryable: the latest payload, or no answer while there is none."""

        def reply(query: zenoh.Query) -> None:
            payload = self._latest.get(name)
            with query:
                if payload is not None:
                    query.reply(key, payload, encoding=payloads.encoding(name))

        return reply
