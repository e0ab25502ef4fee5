"""``companion watch``: the live picture, until Ctrl-C or once."""

from __future__ import annotations

import time
from contextlib import closing
from pathlib import Path
from typing import Any, NoReturn

from rich.console import Console, RenderableType
from rich.live import Live

from companion.outputs.subscriber import Subscriber
from companion.outputs.zenoh_settings import client_settings, file_settings
from companion.types import CompanionError
from companion.watch.as_json import picture_json
from companion.watch.picture import Fleet, VehiclePicture
from companion.watch.view import fleet_view

FIND_S = 3.0
"""For --once: how long to wait for a vehicle."""
LOOK_S = 1.2
"""For --once: how long to look before the picture; health comes once a second."""
REFRESH_S = 0.25
PLAIN_S = 2.0
"""Between pictures where the output is no terminal."""
_OTHER_LINES = 32
"""Of the picture without events, about."""


def listen_to(
    vehicle: str | None, endpoint: str, zenoh_config: Path | None
) -> tuple[Subscriber, str]:
    """A subscriber of one vehicle or all, and its other end for people.

    Raises :class:`~companion.types.ConfigError` for an endpoint or a file that can never work.
    """

    def settings() -> Any:
        return file_settings(zenoh_config) if zenoh_config else client_settings(endpoint)

    settings()  # a wrong one fails here, in one line
    return Subscriber(settings, vehicle or "*"), str(zenoh_config or endpoint)


def watch(
    console: Console, vehicle: str | None, endpoint: str, zenoh_config: Path | None, once: bool
) -> dict[str, Any] | None:
    """Show what is published; with ``once``, one picture, which is also returned as an object."""
    subscriber, where = listen_to(vehicle, endpoint, zenoh_config)
    with closing(subscriber):
        if once:
            return _once(console, subscriber, where)
        try:
            _follow(console, subscriber, where)
        except KeyboardInterrupt:
            return None


def _once(console: Console, subscriber: Subscriber, where: str) -> dict[str, Any]:
    fleet = Fleet()
    begin = time.monotonic()
    until = begin + FIND_S
    found = False
    while time.monotonic() < until:
        _listen(fleet, subscriber, 0.1)
        if not found and any(v.state is not None for v in fleet.vehicles.values()):
            found, until = True, time.monotonic() + LOOK_S
    now_ns = time.monotonic_ns()
    shown = fleet.chosen(now_ns)
    if shown is None:
        raise CompanionError(_nobody(subscriber, where))
    console.print(fleet_view(fleet, shown, now_ns, last=8))
    return picture_json(shown, now_ns)


def _nobody(subscriber: Subscriber, where: str) -> str:
    if subscriber.link.live is None:
        return f"{where}: nobody listens there; is a companion running, or another --connect?"
    return f"{where}: connected, and no vehicle publishes"


def _follow(console: Console, subscriber: Subscriber, where: str) -> NoReturn:
    """Until Ctrl-C: in place on a terminal, else one picture after the other."""
    following = _Following(console, subscriber, where)
    if not console.is_terminal:
        while True:
            console.print(following.picture(PLAIN_S), "")
    with Live(console=console, auto_refresh=False, screen=True) as live:
        while True:
            live.update(following.picture(REFRESH_S), refresh=True)


class _Following:
    """The picture as it changes; stays with a vehicle as long as that speaks."""

    def __init__(self, console: Console, subscriber: Subscriber, where: str) -> None:
        self._console, self._subscriber, self._where = console, subscriber, where
        self._fleet = Fleet()
        self._shown: VehiclePicture | None = None

    def picture(self, seconds: float) -> RenderableType:
        """Listen for this long, then look."""
        _listen(self._fleet, self._subscriber, seconds)
        now_ns = time.monotonic_ns()
        if self._shown is None or self._shown.age_s(now_ns) > 1.0:
            self._shown = self._fleet.chosen(now_ns)
        if self._shown is None:
            return f"waiting: {_nobody(self._subscriber, self._where)}"
        room = max(3, self._console.height - _OTHER_LINES)
        return fleet_view(self._fleet, self._shown, now_ns, last=room)


def _listen(fleet: Fleet, subscriber: Subscriber, seconds: float) -> None:
    """Take messages for this long."""
    until = time.monotonic() + seconds
    while (left := until - time.monotonic()) > 0:
        for heard in subscriber.take(left):
            fleet.update(heard, time.monotonic_ns())
