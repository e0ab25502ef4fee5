"""Who sends the MAVLink messages, and when: state machines over the pure encoders.

Both are a :class:`~companion.outputs.publisher.Publisher` and hand pymavlink messages to a link,
which packs and sends them: the autopilot's session, or a :class:`GroundLink` of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from companion.config import Ground, ToAutopilot
from companion.outputs import mavlink_autopilot as autopilot
from companion.outputs import mavlink_ground as ground
from companion.outputs.epoch import Before, Epoch, before_next, epoch_at
from companion.outputs.local_frames import Origin, px4_ne
from companion.outputs.pacing import Pacer
from companion.outputs.publisher import Notice
from companion.types import NS, Event, Health, Mode, Outputs, Solution

ORIGIN_INTERVAL_NS = NS
"""Between attempts to give the autopilot its origin."""
SAME_ORIGIN_M = 0.1
_E7 = math.degrees(1e7)
"""1e-7 degrees in a radian."""


class MessageLink(Protocol):
    """Takes messages; never blocks."""

    def send(self, message: Any) -> None:
        """Pack and send, or drop."""


class AutopilotLink(MessageLink, Protocol):
    """The autopilot's session, as far as it is needed here."""

    @property
    def system(self) -> int:
        """System id of the vehicle; 0 before it is known."""

    @property
    def undulation_m(self) -> float | None:
        """The datum of the run's heights above mean sea level [m]; None before it is known."""

    @property
    def origin(self) -> tuple[int, int, int] | None:
        """GPS_GLOBAL_ORIGIN as last heard: 1e-7 degrees twice, and mm above mean sea level."""


class _Epochs:
    """Epochs at a rate out of a stream of solutions, with differences to the ones before."""

    def __init__(self, rate_hz: float) -> None:
        self._pacer = Pacer(rate_hz)
        self._before: Before | None = None
        self.last: Epoch | None = None
        """The latest that was due."""

    def due(self, published: Solution) -> list[Epoch]:
        """Those to send. Rates are differences to the epoch just before, sent or not."""
        out = []
        for i, t_ns in enumerate(published.t_ns.tolist()):
            if self._pacer.due(t_ns):
                self.last = epoch_at(published, i, self._before)
                out.append(self.last)
            self._before = before_next(published, i)
        return out


class GroundFeed:
    """Navigation for a ground station; see :mod:`companion.outputs.mavlink_ground`.

    Position and attitude go out once there is a solution, at ``ground.rate_hz``; heartbeat and
    estimator status with each health report. Without a known height above mean sea level
    GLOBAL_POSITION_INT_COV is left out.
    """

    def __init__(
        self,
        settings: Ground,
        link: MessageLink,
        start_ns: int,
        undulation_m: Callable[[], float | None],
    ) -> None:
        """``start_ns``: the run's beginning, that boot times count from."""
        self._link = link
        self._start_ns = start_ns
        self._undulation_m = undulation_m
        self._epochs = _Epochs(settings.rate_hz)
        self._ratios = ground.TestRatios()
        self._origin: Origin | None = None
        self._texts = 0

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:  # noqa: ARG002 - of the protocol
        """Send what is due."""
        self._ratios.update(outputs.reports)
        for epoch in self._epochs.due(outputs.published):
            if epoch.mode != Mode.ALIGNING and epoch.usable:
                self._send(epoch)
        for event in outputs.events:
            self.event(event)

    def _send(self, epoch: Epoch) -> None:
        if self._origin is None:
            self._origin = Origin(epoch.lat, epoch.lon, epoch.height)
        origin = self._origin
        north, east = px4_ne(epoch.lat, epoch.lon, origin)
        ned = north, east, origin.height - epoch.height
        self._link.send(ground.attitude_quaternion(epoch, self._start_ns))
        self._link.send(ground.local_position_ned_cov(epoch, ned))
        undulation = self._undulation_m()
        if undulation is not None:
            message = ground.global_position_int_cov(epoch, undulation, origin.height)
            self._link.send(message)

    def event(self, event: Event) -> None:
        """Send an event as text."""
        for chunk in ground.statustext(event, self._texts):
            self._link.send(chunk)
        self._texts += 1

    def health(self, health: Health) -> None:
        """Heartbeat, and how the estimator is."""
        self._link.send(ground.heartbeat(health.mode))
        last = self._epochs.last
        if last is not None and last.usable:
            self._link.send(ground.estimator_status(last, self._ratios))

    def config(self, toml: str) -> None:
        """Not for ground stations."""

    def notices(self) -> list[Notice]:
        """Links speak for themselves."""
        return []

    def close(self) -> None:
        """Nothing to say."""


class AutopilotFeed:
    """Our solution for the autopilot's estimator; see :mod:`companion.outputs.mavlink_autopilot`.

    For ODOMETRY the autopilot needs an origin: ours, the first position that can be trusted, is
    repeated every second until the autopilot tells its own. If that is another (it had one
    already), positions count from there on, and the reset counter goes up.
    """

    def __init__(self, settings: ToAutopilot, link: AutopilotLink) -> None:
        """Raises nothing; ``message = "off"`` is the caller's to leave out."""
        self._settings = settings
        self._link = link
        self._epochs = _Epochs(settings.rate_hz)
        self._origin: Origin | None = None
        self._agreed: tuple[int, int, int] | None = None
        self._asked_ns: int | None = None
        self._moves = 0
        self._sending = False
        self._notices: list[Notice] = []

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:  # noqa: ARG002 - of the protocol
        """Send what is due and can be trusted."""
        for epoch in self._epochs.due(outputs.published):
            said = autopilot.trust(epoch, self._settings.max_sd_m)
            undulation = self._link.undulation_m
            if undulation is None or not epoch.usable:
                continue
            if self._settings.message == "gps-input":
                self._gps_input(epoch, said, undulation)
            else:
                self._odometry(epoch, said, undulation)

    def _gps_input(self, epoch: Epoch, said: autopilot.Trust, undulation_m: float) -> None:
        if said.position or self._sending:
            gps_id = self._settings.gps_id
            self._link.send(autopilot.gps_input(epoch, said, gps_id, undulation_m))
            self._note(said.position)

    def _odometry(self, epoch: Epoch, said: autopilot.Trust, undulation_m: float) -> None:
        self._note(said.heading)
        if not said.heading:
            return
        origin = self._agree(epoch, undulation_m)
        encode = (
            autopilot.odometry_px4
            if self._settings.message == "odometry-px4"
            else autopilot.odometry_ardupilot
        )
        self._link.send(encode(epoch, origin, said.quality, epoch.resets + self._moves))

    def _note(self, sending: bool) -> None:
        if sending == self._sending:
            return
        self._sending = sending
        self._notices.append(
            Notice("feed-started", f"{self._settings.message} goes to the autopilot")
            if sending
            else Notice(
                "feed-stopped",
                f"{self._settings.message} is withheld: 1σ of position above "
                f"{self._settings.max_sd_m:g} m, or no solution",
                "warning",
            )
        )

    def _agree(self, epoch: Epoch, undulation_m: float) -> Origin:
        """The origin that positions count from: the autopilot's, ours until it tells one."""
        if self._origin is None:
            # As the message carries it, so that both sides count from the same place.
            lat, lon = (round(a * _E7) / _E7 for a in (epoch.lat, epoch.lon))
            self._origin = Origin(lat, lon, epoch.height)
        heard = self._link.origin
        if heard is not None and heard != self._agreed:
            self._adopt(heard, undulation_m)
        due = self._asked_ns is None or not 0 <= epoch.t_ns - self._asked_ns < ORIGIN_INTERVAL_NS
        if heard is None and due and self._link.system:
            self._asked_ns = epoch.t_ns
            message = autopilot.set_gps_global_origin(
                epoch.t_ns, self._link.system, self._origin, undulation_m
            )
            self._link.send(message)
            self._link.send(autopilot.request_origin(self._link.system))
        return self._origin

    def _adopt(self, heard: tuple[int, int, int], undulation_m: float) -> None:
        assert self._origin is not None
        self._agreed = heard
        told = Origin(heard[0] / _E7, heard[1] / _E7, heard[2] * 1e-3 + undulation_m)
        north, east = px4_ne(told.lat, told.lon, self._origin)
        moved = max(abs(north), abs(east), abs(told.height - self._origin.height))
        # An echo comes back rounded to a centimetre, which is no move.
        if moved > SAME_ORIGIN_M:
            self._moves += 1
            self._notices.append(
                Notice(
                    "feed-origin",
                    f"positions count from the autopilot's origin, {moved:.1f} m from ours",
                )
            )
        self._origin = told

    def event(self, event: Event) -> None:
        """Events are for people."""

    def health(self, health: Health) -> None:
        """The session's heartbeat says it."""

    def config(self, toml: str) -> None:
        """Not for autopilots."""

    def notices(self) -> list[Notice]:
        """Beginning and end of the feed, and whose origin it counts from."""
        said, self._notices = self._notices, []
        return said

    def close(self) -> None:
        """The autopilot notices by itself that nothing comes."""
