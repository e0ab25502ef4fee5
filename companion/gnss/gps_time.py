"""GPS time, the time of every ephemeris and raw measurement, against UTC and POSIX clocks."""

from __future__ import annotations

import bisect
from datetime import UTC, datetime

from companion.types import NS

WEEK_S = 604_800
WEEK_NS = WEEK_S * NS
GPS_EPOCH_POSIX_S = 315_964_800
"""1980-01-06 00:00:00 UTC."""

_LEAPS = [
    int(datetime(y, m, 1, tzinfo=UTC).timestamp()) - GPS_EPOCH_POSIX_S + k
    for k, (y, m) in enumerate(
        [(1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7),
         (1993, 7), (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7),
         (2015, 7), (2017, 1)], 1
    )
]  # fmt: skip
"""GPS seconds from which one leap second more counts (IERS Bulletin C)."""


MOST_WEEKS = 10_000
"""August 2171: what claims to be later is broken, and soon past what nanoseconds can count."""


def gps_ns(week: int, tow_s: float) -> int:
    """Nanoseconds since the GPS epoch."""
    return week * WEEK_NS + round(tow_s * NS)


def week_and_tow(ns: int) -> tuple[int, float]:
    """Week and second of week of nanoseconds since the GPS epoch."""
    week, rest = divmod(ns, WEEK_NS)
    return week, rest / NS


def leap_seconds(gps_s: float) -> int:
    """GPS − UTC [s], from the table; for times after its end the last known one."""
    return bisect.bisect_right(_LEAPS, gps_s)


def gps_from_calendar(year: int, month: int, day: int, second_of_day: float) -> tuple[int, float]:
    """Week and second of week of a date that is written in GPS time.

    Raises :class:`ValueError` for what is no date, or none that a measurement can have.
    """
    days = (datetime(year, month, day, tzinfo=UTC) - datetime(1980, 1, 6, tzinfo=UTC)).days
    week, day_of_week = divmod(days, 7)
    total = day_of_week * 86_400 + second_of_day
    extra = int(total // WEEK_S)
    if not 0 <= week + extra < MOST_WEEKS:
        raise ValueError(f"year {year}")
    return week + extra, total - extra * WEEK_S


def whole_week(truncated: int, modulus: int, near: int) -> int:
    """The week ≡ ``truncated`` (mod ``modulus``) that is nearest to week ``near``.

    Navigation messages carry weeks modulo 1024, 4096 or 8192: the receiver's own week says which.
    """
    return near + (truncated - near + modulus // 2) % modulus - modulus // 2
