"""What is told of a position source in words."""

from __future__ import annotations

import math

from companion.estimation import source_faults as sf
from companion.estimation.phases import Setup
from companion.types import F64, I64, NS, Event

_WHAT = ("position", "height")


def declared(setup: Setup, t: int, part: int, q: I64, x: F64) -> Event:
    """That a source is a fault or latched off, and why; ``q``, ``x`` its integers and floats."""
    what, state = _WHAT[part], int(q[sf.STATE])
    axes = 2 - part
    off = math.sqrt(sum((x[sf.LAST + i] - x[sf.BASE + i]) ** 2 for i in range(axes)))
    if state == sf.DRIFTS:
        misfit, usual = math.sqrt(x[sf.MISFIT]), sf.LIMIT * math.sqrt(x[sf.MISFIT_VAR])
        text = (
            f"GNSS {what} drifts from its own velocity: {misfit:.1f} m off within the last minute, "
            f"at most {usual:.1f} m is usual; not used until it agrees again"
        )
        return Event(t, "source-fault", text, "warning")
    if state == sf.STEPPED:
        text = (
            f"GNSS {what} is {off:.1f} m off while its velocity fits; not used until it agrees "
            f"again or has told one place for {setup.config.source_faults.patience_s:.0f} s"
        )
        return Event(t, "source-fault", text, "warning")
    text = (
        f"GNSS {what} is {off:.1f} m off and no velocity says who errs; not used until it agrees "
        f"again or has told one place for {setup.config.engine.gate_relock_s:.0f} s"
    )
    return Event(t, "source-latched", text, "warning")


def taken_back(t: int, part: int, way: F64) -> Event:
    """That the filter had followed a drift and does so no more."""
    pulled = math.sqrt(float(way @ way))
    text = f"{_WHAT[part]} taken back by {pulled:.1f} m that GNSS had pulled it"
    return Event(t, "source-pull", text, "warning")


def returned(t: int, part: int, q: I64) -> Event:
    """That a source agrees again."""
    text = (
        f"GNSS {_WHAT[part]} agrees again after {(t - int(q[sf.T_FAULT])) / NS:.1f} s, "
        f"{sf.AGREEING_FIXES:.0f} fixes in a row: used"
    )
    return Event(t, "source-returned", text)


def rejoined(t: int, part: int) -> Event:
    """That a source agrees with what it was before its fault, and the filter does not."""
    text = (
        f"{_WHAT[part]} reset to GNSS, which is back where it was before its fault: the filter had "
        "followed it further than it knew"
    )
    return Event(t, "relocked", text, "warning")


def begun_anew(t: int, q: I64) -> Event:
    """That the filter begins anew at a receiver without velocity, which it refused for long."""
    since = int(q[sf.T_FAULT]) if q[sf.STATE] != sf.TRUSTED else int(q[sf.T_REFUSED])
    text = (
        f"positions without velocity were refused for {(t - since) / NS:.0f} s, and nothing else "
        "says where it goes: beginning anew at them"
    )
    return Event(t, "relocked", text, "warning")


def relocked(t: int, part: int, q: I64) -> Event:
    """That the source is believed after all, ``q`` saying since when it was not."""
    since = int(q[sf.T_FAULT]) if q[sf.STATE] != sf.TRUSTED else int(q[sf.T_REFUSED])
    text = (
        f"{_WHAT[part]} reset to GNSS, which has told one place for long: refused for "
        f"{(t - since) / NS:.0f} s"
    )
    return Event(t, "relocked", text, "warning")
