"""How noisy a receiver's clock is, learned from the clock of each epoch's own solution.

What fewer than four satellites are worth depends on what is known of the receiver's clock, and that
is known least: quartzes differ a thousandfold, and one in a hand is another one than on a table.
The measure is how mean rates ȳ of intervals of T = 1, 2, 4, … s one behind the other differ: of
rates the Hadamard variance, of clocks without rates the Allan variance, but for their norm (Riley
2008, NIST SP 1065, chapter 5, in their overlapping forms):

    rates    D²(T) = ⟨(ȳ₂ − 2 ȳ₁ + ȳ₀)²⟩ = 6 B/T + q_d T + 11/20 q_a T³
    clocks   D²(T) = ⟨(ȳ₁ − ȳ₀)²⟩ = 6 A/T² + 2 B/T + 2/3 q_d T

A [m²] is white noise of the clock's reading, B [m²/s] that of its rate or the random walk of its
bias, q_d [m²/s³] the random walk of its drift, q_a [m²/s⁵] that of its ramp. A steady ramp has no
part in the first; of the second it is drift.

No term is negative, so each interval says how large a noise can be at most: the two outer ones are
given the least of these bounds, all that was seen being theirs there, and never more than is
configured. The one in between is given what it takes to cover what was seen at every interval: what
is no noise of these kinds (steps, a hand, reflections common to all satellites) makes it larger. So
a clock is trusted no further than it has shown. Of ν independent samples, ν/(ν − 2) D² is expected.

Means are over cells of a second; what is not without gaps is begun anew, what was learned is kept.
A clock that has clearly become noisier, being picked up, is another clock: what was learned is
forgotten, and it is as configured at least until enough was seen of it. Quieter, it is learned as
the memory fades.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.config import RawGnss
from companion.types import F64

OCTAVES = 9
"""1 to 256 s."""
ENOUGH = 3
"""This interval must have been seen: 8 s, so nothing is learned within half a minute."""
MEMORY_S = 1800.0
"""What was seen that long ago counts 1/e."""
REVIEW_CELLS = 8
"""How often noise is worked out anew."""
LEAST, MOST = 0.01, 10.0
"""Range about what is configured, of standard deviations."""
WILD = 100.0
"""Normalised square of a difference over 1 s that is a jump or a wrong solution, not noise…"""
_SPEAKS = 50.0
"""…and as what it counts among the recent ones: two of them are a change."""
_STILL = 1e-12
"""D² [m²/s²] below which a rate has not moved at all."""
RECENT_S, RECENT = 16.0, 3
"""Memory of what was seen recently, and at how many intervals: 1, 2 and 4 s."""
NOISIER = 6.0
"""Recent D² against all, of a clock that is another one: with four independent samples of 4 s,
noise does that once in days."""
_RING = 1024
_EDGE_S = 0.1
"""Cells begin this long before an epoch, so that one that comes a little early is no other's."""

# --- noises: psd of the bias [m²/s], psd of the drift [m²/s³], variance of the ramp [m²/s⁴]
Q_BIAS, Q_DRIFT, Q_RAMP, Q_SIZE = 0, 1, 2, 3
Q_TAU = 3  # configured only: how long a ramp lasts [s]

# --- offsets into the learner's state
SCALE = 0  # (3) factors on the configured noises, in force
ASKED = 3  # (4) configured
RATES = 7  # 1: of rates, 0: of clocks
ORIGIN = 8  # time at which cells are counted from; NaN before the first epoch
CELL = 9  # the running one: its number, sum and count of rates; time and clock of its first epoch
TOTAL = 10
COUNT = 11
FIRST_T = 12
FIRST = 13
HELD = 14  # phases in the ring, one more than cells without a gap
SINCE = 15  # cells since noise was worked out
SQUARES = 16  # (OCTAVES) sums of D², and how many
SEEN = SQUARES + OCTAVES
LATELY = SEEN + OCTAVES  # (RECENT) recent means of D²
PHASES = LATELY + RECENT  # (_RING) integral of the rate at the ends of cells, the newest at 0…
HEAD = PHASES + _RING  # …where that is in the ring
LEARNER_SIZE = HEAD + 1


def new_learner(config: RawGnss) -> F64:
    """(LEARNER_SIZE,) a learner that has seen nothing: noise is as configured."""
    s = np.zeros(LEARNER_SIZE)
    s[ASKED + Q_BIAS] = config.clock_walk_m_rts**2
    s[ASKED + Q_DRIFT] = config.clock_drift_walk_mps_rts**2
    s[ASKED + Q_RAMP] = config.clock_ramp_mps2**2
    s[ASKED + Q_TAU] = config.clock_ramp_tau_s
    s[SCALE : SCALE + Q_SIZE] = 1.0
    s[ORIGIN] = np.nan
    return s


@njit("void(f8[::1])", cache=True)
def interrupt(s: F64) -> None:
    """The clock jumped, or an epoch is missing: what comes next is no continuation."""
    s[HELD] = 0.0


@njit("f8(f8[::1], i8, i8)", cache=True)
def _difference(s: F64, order: int, n: int) -> float:
    """Second or third difference of the newest phases, ``n`` cells apart [m]."""
    head = int(s[HEAD]) + _RING
    x0, x1 = s[PHASES + head % _RING], s[PHASES + (head - n) % _RING]
    x2 = s[PHASES + (head - 2 * n) % _RING]
    if order == 2:
        return float(x0 - 2.0 * x1 + x2)
    return float(x0 - 3.0 * x1 + 3.0 * x2 - s[PHASES + (head - 3 * n) % _RING])


@njit("f8(f8[::1], i8)", cache=True)
def _independent(s: F64, j: int) -> float:
    """ν: about how many of the overlapping samples of octave ``j`` stand for themselves."""
    return float(1.0 + (s[SEEN + j] - 1.0) / (1 << j))


@njit("f8(f8[::1], i8, f8, f8)", cache=True)
def _least(s: F64, power: int, factor: float, most: float) -> float:
    """Largest noise that all octaves leave room for whose part in D² is ``factor`` T^``power``."""
    least = most
    for j in range(OCTAVES):
        nu = _independent(s, j)
        if nu > 2.0:
            seen = s[SQUARES + j] / s[SEEN + j] * nu / (nu - 2.0)
            least = min(least, seen / (factor * float(1 << j) ** power))
    return float(least)


@njit("void(f8[::1])", cache=True)
def _review(s: F64) -> None:
    """Work the noise out anew, where enough was seen."""
    if _independent(s, ENOUGH) <= 2.0:
        return
    asked, noise = s[ASKED : ASKED + Q_SIZE + 1], np.zeros(Q_SIZE)
    rates = s[RATES] == 1.0
    walk = 2.0 * asked[Q_RAMP] / asked[Q_TAU]
    if rates:
        short_power, short_factor, own_power, own_factor, own = -1, 6.0, 1, 1.0, Q_DRIFT
        long_power, long_factor, long_most = 3, 0.55, walk
    else:
        short_power, short_factor, own_power, own_factor, own = -2, 6.0, -1, 2.0, Q_BIAS
        long_power, long_factor, long_most = 1, 2.0 / 3.0, asked[Q_DRIFT]
    short = _least(s, short_power, short_factor, np.inf)
    long = _least(s, long_power, long_factor, long_most)
    between = 0.0
    for j in range(OCTAVES):
        if _independent(s, j) > 2.0:
            T = float(1 << j)
            rest = s[SQUARES + j] / s[SEEN + j]
            rest -= short * short_factor * T**short_power + long * long_factor * T**long_power
            between = max(between, rest / (own_factor * T**own_power))
    noise[own] = between
    if rates:
        noise[Q_BIAS] = min(short, asked[Q_BIAS])
        noise[Q_RAMP] = 0.5 * long * asked[Q_TAU]
    else:
        noise[Q_DRIFT] = long  # what a ramp did is in it
    for i in range(Q_SIZE):
        # Single precision, as a smoother's tape keeps it.
        s[SCALE + i] = np.float32(min(max(noise[i] / asked[i], LEAST * LEAST), MOST * MOST))


@njit("b1(f8[::1], i8, f8)", cache=True)
def _changed(s: F64, j: int, square: float) -> bool:
    """Whether the clock is noisier than what was learned, with ``square`` its newest D²."""
    if j >= RECENT:
        return False
    fade = math.exp(-1.0 / RECENT_S)
    s[LATELY + j] = s[LATELY + j] * fade + square * (1.0 - fade)
    enough = s[SEEN + j] >= RECENT_S
    return bool(enough and s[LATELY + j] * s[SEEN + j] > NOISIER * s[SQUARES + j])


@njit("void(f8[::1])", cache=True)
def _forget(s: F64) -> None:
    """Begin anew; until enough is seen, the clock is taken for no better than configured."""
    s[SQUARES:PHASES] = 0.0
    s[HELD] = s[SINCE] = 0.0
    for i in range(Q_SIZE):
        s[SCALE + i] = max(s[SCALE + i], 1.0)


@njit("void(f8[::1], f8)", cache=True)
def _take_cell(s: F64, rate: float) -> None:
    """Take in the mean rate of a cell that has ended."""
    held, head = int(s[HELD]), int(s[HEAD])
    if held == 0:
        s[PHASES + head] = 0.0
        held = 1
    s[HEAD] = (head + 1) % _RING
    s[PHASES + int(s[HEAD])] = s[PHASES + head] + rate
    held = min(held + 1, _RING)
    s[HELD] = held
    fade = math.exp(-1.0 / MEMORY_S)
    order = 3 if s[RATES] == 1.0 else 2
    for j in range(OCTAVES):
        n = 1 << j
        if held <= order * n:
            break
        d = _difference(s, order, n) / n
        known = j == 0 and s[SEEN] >= REVIEW_CELLS
        wild = known and d * d > _STILL + WILD * s[SQUARES] / s[SEEN]
        if _changed(s, j, _STILL + _SPEAKS * s[SQUARES] / s[SEEN] if wild else d * d):
            _forget(s)
            return
        if wild:
            s[HELD] = 0.0
            return
        s[SQUARES + j] = s[SQUARES + j] * fade + d * d
        s[SEEN + j] = s[SEEN + j] * fade + 1.0
    s[SINCE] += 1.0
    if s[SINCE] >= REVIEW_CELLS:
        s[SINCE] = 0.0
        _review(s)


@njit("void(f8[::1], f8, f8, f8)", cache=True)
def _begin_cell(s: F64, cell: float, t: float, clock: float) -> None:
    s[CELL], s[TOTAL], s[COUNT] = cell, 0.0, 0.0
    s[FIRST_T], s[FIRST] = t, clock


@njit("void(f8[::1], f8, f8, f8)", cache=True)
def learn_clock(s: F64, t: float, clock: float, rate: float) -> None:
    """Take in an epoch's own ``clock`` [m], without steps, and ``rate`` [m/s] at ``t`` [s].

    ``rate`` is NaN where there are no rates. A stream that has had any is judged by rates alone.
    """
    rates = rate == rate
    if not rates and s[RATES] == 1.0:
        return
    if s[ORIGIN] != s[ORIGIN] or (rates and s[RATES] == 0.0):
        s[RATES] = 1.0 if rates else 0.0
        _forget(s)
        s[ORIGIN] = t - _EDGE_S
        _begin_cell(s, 0.0, t, clock)
    cell = math.floor(t - s[ORIGIN])
    if cell != s[CELL]:
        whole = cell == s[CELL] + 1.0
        if rates:
            _take_cell(s, s[TOTAL] / s[COUNT])
        elif whole:
            _take_cell(s, (clock - s[FIRST]) / (t - s[FIRST_T]))
        if not whole:
            interrupt(s)
        _begin_cell(s, cell, t, clock)
    if rates:
        s[TOTAL] += rate
        s[COUNT] += 1.0
