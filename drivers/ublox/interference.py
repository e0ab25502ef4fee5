"""What a u-blox receiver says of jamming and spoofing, as one share.

Interface descriptions M8 (MON-HW), F9 and M10 (MON-RF, NAV-STATUS, SEC-SIG). A state of *warning*
or *indicated* counts half, *critical* or *affirmed* wholly; the indicator of a continuous wave by
its part of full scale. The largest holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

MON_HW, MON_RF, NAV_STATUS, SEC_SIG = 0x0A09, 0x0A38, 0x0103, 0x2709
KINDS = frozenset((MON_HW, MON_RF, NAV_STATUS, SEC_SIG))
INDICATOR_FULL = 255.0
STATE_SHARE = (math.nan, 0.0, 0.5, 1.0)
"""By state: unknown, none, warning or indicated, critical or affirmed."""

_HW_SIZE, _HW_FLAGS, _HW_INDICATOR = 60, 22, 45
_RF_HEAD, _RF_BLOCK, _RF_INDICATOR = 4, 24, 16
_STATUS_SIZE, _STATUS_FLAGS = 16, 7
_SIG_SIZE, _SIG_SIZE_1 = 4, 12


@dataclass(slots=True)
class Interference:
    """The last word of each message."""

    _said: dict[int, float] = field(default_factory=dict)

    def take(self, kind: int, payload: bytes) -> bool:
        """Take a message of :data:`KINDS`; False where its length does not fit."""
        share = _READERS[kind](payload)
        if share is None:
            return False
        self._said[kind] = share
        return True

    @property
    def share(self) -> float:
        """0 none to 1; NaN where nothing is said."""
        return largest(*self._said.values())


def largest(*shares: float) -> float:
    """The largest of what is said; NaN where nothing is."""
    return max((s for s in shares if not math.isnan(s)), default=math.nan)


def _hardware(payload: bytes) -> float | None:
    if len(payload) != _HW_SIZE:
        return None
    state = payload[_HW_FLAGS] >> 2 & 3
    return largest(STATE_SHARE[state], payload[_HW_INDICATOR] / INDICATOR_FULL)


def _radio(payload: bytes) -> float | None:
    """One block a band."""
    if len(payload) < _RF_HEAD or len(payload) != _RF_HEAD + _RF_BLOCK * payload[1]:
        return None
    found = []
    for at in range(_RF_HEAD, len(payload), _RF_BLOCK):
        found += [STATE_SHARE[payload[at + 1] & 3], payload[at + _RF_INDICATOR] / INDICATOR_FULL]
    return largest(*found)


def _status(payload: bytes) -> float | None:
    if len(payload) != _STATUS_SIZE:
        return None
    return STATE_SHARE[payload[_STATUS_FLAGS] >> 3 & 3]


def _signals(payload: bytes) -> float | None:
    """Each detector's state behind the bit that says whether it is on."""
    if len(payload) < _SIG_SIZE or (payload[0] == 1 and len(payload) != _SIG_SIZE_1):
        return None
    if payload[0] == 1:
        jamming, spoofing = payload[4], payload[8]
        states = (jamming >> 1 & 3 if jamming & 1 else 0, spoofing >> 1 & 3 if spoofing & 1 else 0)
    else:
        states = (payload[1] >> 1 & 3 if payload[1] & 1 else 0, 0)
    return largest(*(STATE_SHARE[s] for s in states))


_READERS = {MON_HW: _hardware, MON_RF: _radio, NAV_STATUS: _status, SEC_SIG: _signals}
