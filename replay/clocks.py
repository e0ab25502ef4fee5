"""Clock repair for logs: one steady nanosecond clock out of boot stamps and wall stamps.

Durations follow the autopilot's boot clock. One constant offset per boot session takes it to Unix
time: the lower envelope of wall minus boot, that is the fastest transport seen. Arrival times
follow the recorder's wall clock, with corrupt stamps replaced and clock steps taken out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from companion.types import F64, I64

US = 1000
"""Nanoseconds in a microsecond."""
_PLAUSIBLE_US = (946_684_800_000_000, 4_102_444_800_000_000)
"""Years 2000 to 2100: a wall stamp outside is corrupt."""
_SPIKE_US = 5_000_000
_BACKWARD_US = 500_000
"""Less is jitter of a threaded recorder, more is a clock that was set."""
_FORWARD_US = 5_000_000
"""Wall minus boot growing for good by more than any radio link buffers."""
_REBOOT_US = 2_000_000
_NEAR = 50
"""References on each side of a step that its size is taken from."""


def running_median(values: I64, width: int) -> I64:
    """(N,) medians of windows of odd ``width``, centred, the ends repeated."""
    half = width // 2
    padded = np.pad(values, half, mode="edge")
    return np.partition(sliding_window_view(padded, width), half, axis=1)[:, half]


def plausible_wall(stamp_us: I64) -> tuple[I64, int]:
    """Wall stamps [µs] with corrupt ones replaced by the next good one, and how many were.

    The stamp of a tlog is outside the CRC. It is corrupt when it is outside 2000-2100 or more
    than 5 s off the median of its seven neighbours; a real step of the clock survives that.
    """
    if stamp_us.shape[0] == 0:
        return stamp_us, 0
    good = (stamp_us > _PLAUSIBLE_US[0]) & (stamp_us < _PLAUSIBLE_US[1])
    if not good.any():
        return np.zeros_like(stamp_us), int(good.shape[0])
    centre = np.zeros_like(stamp_us)
    centre[good] = running_median(stamp_us[good], 7)
    good &= np.abs(stamp_us - centre) < _SPIKE_US
    if not good.any():
        return np.zeros_like(stamp_us), int(good.shape[0])
    # The next good stamp, never the one before: too early an arrival would pull the lower
    # envelope of wall minus boot, and with it the whole clock, early.
    count = good.shape[0]
    following = np.minimum.accumulate(np.where(good, np.arange(count), count)[::-1])[::-1]
    following[following == count] = int(np.flatnonzero(good)[-1])
    return stamp_us[following], int((~good).sum())


def boot_sessions(boot_us: I64) -> I64:
    """First index of each boot session in stamps [µs since boot] in stream order; starts with 0.

    A new session begins where the stamp falls by more than 2 s and stays down; a single stray
    value does not make one.
    """
    if boot_us.shape[0] < 2:
        return np.zeros(1, np.int64)
    starts = [0]
    for i in np.flatnonzero(np.diff(boot_us) < -_REBOOT_US) + 1:
        before = np.median(boot_us[max(starts[-1], i - 5) : i])
        after = np.median(boot_us[i : i + 5])
        if after < before - _REBOOT_US / 2:
            starts.append(int(i))
    return np.array(starts, np.int64)


def _envelope(delay: I64) -> int:
    """Lower envelope: the minimum, past one in a thousand that a corrupt stamp may have made."""
    k = delay.shape[0] // 1000
    return int(np.partition(delay, k)[k])


@dataclass(frozen=True, slots=True)
class Clock:
    """The repaired clock of one vehicle: arrival of every row of its stream, and boot → time."""

    rx_ns: I64
    """(F,) arrival of each frame, never decreasing."""
    boot_us: I64
    """(F,) latest boot stamp seen at each frame, for messages that carry none."""
    session_row: I64
    """(S,) first frame of each boot session."""
    offset_ns: I64
    """(S,) Unix time minus boot time."""
    notes: tuple[str, ...] = ()

    def at(self, rows: I64, boot_us: I64) -> I64:
        """(N,) time of validity [ns] of boot stamps [µs] that came with frames ``rows``."""
        session = np.searchsorted(self.session_row, rows, side="right") - 1
        out: I64 = boot_us * US + self.offset_ns[np.maximum(session, 0)]
        return out


def _forward_steps(delay: I64, session_of: I64) -> I64:
    """References at which wall − boot [µs] grows for good within one session."""
    found = []
    for i in np.flatnonzero(np.diff(delay) > _FORWARD_US) + 1:
        same = session_of[max(i - _NEAR, 0) : i + _NEAR] == session_of[i]
        window = delay[max(i - _NEAR, 0) : i + _NEAR]
        cut = min(i, _NEAR)
        before, after = window[:cut][same[:cut]], window[cut:][same[cut:]]
        if before.size and after.size and after.min() - before.min() > _FORWARD_US:
            found.append(int(i))
    return np.array(found, np.int64)


def _pairs(row: I64, after: I64) -> list[tuple[int, int]]:
    """Frames of each reference in ``after`` and of the reference before it."""
    return [(int(row[i - 1]), int(row[i])) for i in after]


def _without_steps(wall_us: I64, row: I64, boot_us: I64, session_of: I64) -> tuple[I64, list[str]]:
    """Wall stamps with the recorder's clock steps taken out, by the boot clock where it can."""
    delay = wall_us[row] - boot_us
    backward = np.flatnonzero(np.diff(wall_us) < -_BACKWARD_US) + 1
    after = _forward_steps(delay, session_of)
    # The step is at the frame where the wall clock jumped, not at the next one with a boot stamp.
    forward = np.array(
        [a + 1 + int(np.argmax(np.diff(wall_us[a : b + 1]))) for a, b in _pairs(row, after)],
        np.int64,
    )
    edges = np.union1d(backward, forward)
    if not edges.size:
        return wall_us, []
    shift = np.zeros(edges.size, np.int64)
    limits = np.concatenate([[0], edges, [wall_us.shape[0]]])
    for k, edge in enumerate(edges):
        lo, mid, hi = np.searchsorted(row, limits[k : k + 3])
        lo, hi = max(lo, mid - _NEAR), min(hi, mid + _NEAR)
        if lo < mid < hi and session_of[mid - 1] == session_of[mid]:
            same = session_of[lo:hi] == session_of[mid]
            pre, post = delay[lo:mid][same[: mid - lo]], delay[mid:hi][same[mid - lo :]]
            shift[k] = pre.min() - post.min()
        else:
            # Nothing links the two sides: go on from where the clock stood.
            shift[k] = max(int(wall_us[edge - 1] - wall_us[edge]), 0)
    steps = np.zeros_like(wall_us)
    steps[edges] = shift
    notes = []
    for kind, which in (("back", backward), ("forward", forward)):
        if which.size:
            largest = float(np.abs(shift[np.isin(edges, which)]).max()) * 1e-6
            times = "once" if which.size == 1 else f"{which.size} times"
            notes.append(
                f"recorder's clock stepped {kind} {times} (up to {largest:.1f} s); taken out"
            )
    return wall_us + np.cumsum(steps), notes


def vehicle_clock(wall_us: I64, row: I64, boot_us: I64) -> Clock:
    """Clock of one vehicle from a recorder's stamps and the vehicle's own boot stamps.

    ``wall_us`` (F,) wall stamps of all frames of the stream, from :func:`plausible_wall`; all 0
    when there are none. ``row`` (R,) increasing frame numbers that carry a boot stamp, and
    ``boot_us`` (R,) those stamps.
    """
    total = wall_us.shape[0]
    if row.shape[0] == 0:
        rx = np.maximum.accumulate(wall_us) * US if total else wall_us
        note = ("no time since boot in the stream; times of arrival used",)
        return Clock(rx, wall_us, np.zeros(1, np.int64), np.zeros(1, np.int64), note)
    starts = boot_sessions(boot_us)
    session_of = np.searchsorted(starts, np.arange(row.shape[0]), side="right") - 1
    latest = np.searchsorted(row, np.arange(total), side="right") - 1
    boot_at = boot_us[np.maximum(latest, 0)]
    notes: list[str] = []
    if not wall_us.any():
        wall_us = np.maximum.accumulate(boot_at)
        notes.append("no usable wall-clock stamps; times count from the autopilot's boot")
    else:
        wall_us, notes = _without_steps(wall_us, row, boot_us, session_of)
    delay = wall_us[row] - boot_us
    limits = np.append(starts, row.shape[0])
    offset = np.zeros(starts.shape[0], np.int64)
    last = np.iinfo(np.int64).min
    for k in range(starts.shape[0]):
        part = slice(limits[k], limits[k + 1])
        offset[k] = _envelope(delay[part])
        # Time goes on after a reboot, whatever the wall clock says.
        offset[k] += max(0, last + US - int(boot_us[part].min() + offset[k])) if k else 0
        last = int(boot_us[part].max() + offset[k])
    if starts.shape[0] > 1:
        notes.append(f"autopilot's clock restarted {starts.shape[0] - 1} time(s)")
    session_row = row[starts].copy()
    session_row[0] = 0
    rx_ns = np.maximum.accumulate(wall_us) * US
    return Clock(rx_ns, boot_at, session_row, offset * US, tuple(notes))


def unwrapped_interpolation(t_ns: I64, at_ns: I64, angle: F64, max_gap_ns: int) -> F64:
    """(N,) angle [rad] at ``t_ns`` from samples at increasing ``at_ns``, taken the short way round.

    NaN outside the samples and inside gaps longer than ``max_gap_ns``. The result is in (−π, π].
    """
    smooth = np.unwrap(angle)
    out = interpolation(t_ns, at_ns, smooth, max_gap_ns)
    wrapped: F64 = np.pi - np.mod(np.pi - out, 2 * np.pi)
    return wrapped


def interpolation(t_ns: I64, at_ns: I64, values: F64, max_gap_ns: int) -> F64:
    """(N,) values at ``t_ns`` from samples at increasing ``at_ns``; NaN outside and in gaps."""
    if at_ns.shape[0] < 2:
        return np.full(t_ns.shape[0], np.nan)
    # Differences in integers first: Unix nanoseconds do not fit a float64.
    origin = at_ns[0]
    out: F64 = np.interp(
        (t_ns - origin).astype(np.float64), (at_ns - origin).astype(np.float64), values
    )
    right = np.clip(np.searchsorted(at_ns, t_ns), 1, at_ns.shape[0] - 1)
    gap = at_ns[right] - at_ns[right - 1] > max_gap_ns
    out[gap | (t_ns < at_ns[0]) | (t_ns > at_ns[-1])] = np.nan
    return out
