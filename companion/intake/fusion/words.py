"""What the fusion has to tell, in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from companion.intake.fusion import layout as lo
from companion.types import F64, Event

FAULTS = {
    lo.SILENT: "silent",
    lo.FROZEN: "frozen",
    lo.SATURATED: "saturated",
    lo.NOISY_UNIT: "noisy",
    lo.SCALED: "scaled",
    lo.DRIFTING: "drifting",
    lo.STEPPED: "stepped",
}
"""Names of what a unit is excluded for."""
_SAID = {
    lo.SILENT: "silent",
    lo.FROZEN: "repeats the same values",
    lo.SATURATED: "at the end of its range",
    lo.NOISY_UNIT: "much noisier than it was and than the others",
}


def _where(row: F64) -> str:
    """``gyro z 0.31 deg/s``: the axis that is furthest off, and by how much."""
    axis, by = int(row[3]), abs(float(row[4]))
    name = "xyz"[axis % 3]
    if axis < 3:
        return f"gyro {name} {math.degrees(by):.2g} deg/s"
    return f"accelerometer {name} {by:.2g} m/s²"


def event(t: int, row: F64, sources: Sequence[str], proof_s: float) -> Event:
    """The event for a row of news (NEWS_SIZE,) at ``t``."""
    what, unit, why = int(row[0]), sources[int(row[1])], int(row[2])
    if what == lo.DISAGREED:
        text = (
            f"the two inertial units disagree: {_where(row)} apart; which one errs is not known, "
            "their mean is trusted less"
        )
        return Event(t, "imu-disagree", text, "warning")
    if what == lo.AGREED:
        return Event(t, "imu-agree", "the inertial units no longer disagree")
    if what == lo.RETURNED:
        text = f"IMU {unit} used again: it agreed with the others for {row[4]:.0f} s"
        return Event(t, "imu-returned", text)
    said = _SAID.get(why) or f"{FAULTS[why]}, {_where(row)} off the others"
    if what == lo.LAST_ONE:
        text = f"IMU {unit}, {said}, is the only one left: used all the same"
        return Event(t, "imu-last", text, "error")
    text = f"IMU {unit} excluded: {said}; used again when it has agreed for {proof_s:.0f} s or more"
    return Event(t, "imu-excluded", text, "warning")
