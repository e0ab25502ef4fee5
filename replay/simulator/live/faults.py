"""Faults of the simulated vehicle: what can be broken, and the orders that break it.

An order is one JSON object on a line::

    {"fault": "gnss-silent", "for_s": 3.0}     mended by itself after 3 s
    {"fault": "imu-silent"}                    until {"fault": "imu-silent", "on": false}
    {"fault": "can-loss", "share": 0.01}       of the CAN frames
    {"ask": "counts"}                          answered with one line

Pure: time is passed in.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from companion.types import NS, CompanionError

FaultName = Literal[
    "imu-silent",
    "gnss-silent",
    "mavlink-down",
    "autopilot-reboot",
    "can-gone",
    "can-loss",
    "can-garbage",
    "mavlink-garbage",
]
"""``imu-silent``: the CAN unit sends nothing; ``gnss-silent``: no GPS_RAW_INT; ``mavlink-down``:
the autopilot's socket is closed; ``autopilot-reboot``: silent, then with a boot clock from zero and
its message intervals forgotten; ``can-gone``: the adapter is unplugged; ``…-garbage``: as many
malformed frames as good ones."""

REBOOT_S = 1.5
"""How long a rebooting autopilot is silent unless the order says otherwise."""


class Order(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of the control stream."""

    fault: FaultName | None = None
    on: bool = True
    for_s: float | None = None
    share: float = 0.01
    """With ``can-loss``."""
    ask: Literal["counts"] | None = None


def parse_order(line: bytes | str) -> Order:
    """An order from its line; :class:`CompanionError` says what is wrong with it."""
    try:
        order = msgspec.json.decode(line, type=Order)
    except msgspec.MsgspecError as error:
        raise CompanionError(f"not an order: {error}") from None
    if (order.fault is None) == (order.ask is None):
        raise CompanionError("an order has either 'fault' or 'ask'")
    if order.for_s is not None and not 0 < order.for_s < 1e6:
        raise CompanionError("for_s: seconds, above 0")
    if not 0 <= order.share <= 1:
        raise CompanionError("share: between 0 and 1")
    return order


class Faults:
    """Which faults are on, and until when."""

    def __init__(self) -> None:
        self._until: dict[FaultName, int | None] = {}
        self.can_loss_share = 0.0

    def take(self, order: Order, now_ns: int) -> None:
        """Switch the fault of ``order`` on or off."""
        if order.fault is None:
            return
        if not order.on:
            self._until.pop(order.fault, None)
            return
        for_s = order.for_s
        if for_s is None and order.fault == "autopilot-reboot":
            for_s = REBOOT_S
        self._until[order.fault] = None if for_s is None else now_ns + round(for_s * NS)
        if order.fault == "can-loss":
            self.can_loss_share = order.share

    def on(self, fault: FaultName) -> bool:
        """Whether ``fault`` is on, as of the last :meth:`mend`."""
        return fault in self._until

    def mend(self, now_ns: int) -> list[FaultName]:
        """Switch off what has run its time; returns what that was."""
        over = [f for f, until in self._until.items() if until is not None and until <= now_ns]
        for fault in over:
            del self._until[fault]
        return over

    @property
    def next_ns(self) -> int | None:
        """When the next fault mends itself; None if none will."""
        return min((until for until in self._until.values() if until is not None), default=None)
