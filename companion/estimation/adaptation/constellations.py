"""Adaptation of ranges: each satellite system's range and rate has a window and a factor on its R.

What goes in is how far the satellites of a system scatter about each epoch's own solution
(:mod:`companion.gnss.scatter`); of the rules of :mod:`fuzzy`, those for a mean of zero say what R
does: what moves all satellites of an epoch at once is in its solution, and not in what is left.
The factor is in force from the epoch on that it was learned of, for the test of faults as well.
"""

from __future__ import annotations

import math

import numpy as np

from companion._jit import njit
from companion.config import Config
from companion.estimation.adaptation.fuzzy import conclude, fire, slew
from companion.estimation.adaptation.layout import (
    FIRING,
    IN_SPREAD,
    OUT_R,
    TRACE_SIZE,
    TRACED,
)
from companion.estimation.adaptation.parameters import (
    LENGTH,
    R_MAX,
    R_MIN,
    R_TABLE,
    adaptation_vector,
)
from companion.estimation.adaptation.window import FEWEST, deviate_of_chi2
from companion.gnss.systems import SYSTEMS
from companion.types import F64, I64, NS, AdaptationTrace, Channel

CHANNELS = 2 * SYSTEMS
_EVERY = np.array([*range(Channel.RANGE_GPS, Channel.RANGE_GPS + CHANNELS)])
_LONE_S = 1.0
"""Taken for the interval in front of the first epoch."""


@njit(
    "void(f8[:, :, ::1], f8[:, :, ::1], i8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8[:, ::1])",
    cache=True,
    entry=True,
)
def judge(
    found: F64, rings: F64, at: I64, fresh: F64, a: F64, factors: F64, traces: F64
) -> None:  # fmt: skip
    """Take one epoch into the windows, and move the ``factors`` (2, SYSTEMS) on R.

    ``found`` as of :func:`companion.gnss.scatter.scatter`, measured with R as it is scaled;
    ``rings`` (6, window, 2) the same as said of R unscaled; ``at`` (6, 2): filled, next;
    ``fresh`` (2,): share of an epoch's redundancy that the one before did not tell already; ``a``:
    :mod:`parameters`. ``traces`` (6, TRACE_SIZE): row by row why, TRACED 0 where nothing came in.
    """
    length, shares = int(a[LENGTH]), np.ones(3)
    for c in range(rings.shape[0]):
        kind, system = c // SYSTEMS, c % SYSTEMS
        trace, ring = traces[c], rings[c]
        trace[TRACED] = 0.0
        if not found[kind, system, 1] > 0.0:
            continue
        now = factors[kind, system]
        ring[at[c, 1], 0] = min(now * found[kind, system, 0], a[R_MAX] * found[kind, system, 1])
        ring[at[c, 1], 1] = found[kind, system, 1]
        at[c, 0], at[c, 1] = min(at[c, 0] + 1, length), (at[c, 1] + 1) % length
        if at[c, 0] < FEWEST:
            continue
        total, dof, largest, second = 0.0, 0.0, 0.0, 0.0
        for k in range(at[c, 0]):
            total += ring[k, 0]
            dof += ring[k, 1]
            if ring[k, 0] > largest:
                largest, second = ring[k, 0], largest
            elif ring[k, 0] > second:
                second = ring[k, 0]
        # No single epoch decides either.
        v = (total - largest + second) / dof
        spread = deviate_of_chi2(v, max(dof * fresh[kind], 1.0))
        weights = trace[FIRING : FIRING + 9]
        fire(a, 0.0, spread, weights)
        match = min(max(v, a[R_MIN]), a[R_MAX])
        target = conclude(a, R_TABLE, weights, shares, now, match, now)
        factors[kind, system] = slew(now, target, a, a[R_MIN], a[R_MAX])
        trace[TRACED], trace[IN_SPREAD], trace[OUT_R] = 1.0, spread, factors[kind, system]


def fresh_share(slow: float, phi: float, length: int) -> float:
    """Effective part of ``length`` squares of an error with autocorrelation ``slow``·``phi``^k.

    1 / (1 + 2 Σ (1 − k/n) ρ_k²): the variance of their mean against that of independent ones.
    """
    k = np.arange(1, length)
    rho = slow * phi**k
    return float(1.0 / (1.0 + 2.0 * np.sum((1.0 - k / length) * rho * rho)))


class Constellations:
    """How far the ranges and rates of each system are trusted, epoch by epoch in their order."""

    def __init__(self, config: Config) -> None:
        raw = config.raw_gnss
        self.factors: F64 = np.ones((2, SYSTEMS))
        """On R of ranges and of rates, system by system."""
        self._a = adaptation_vector(config.adaptation)
        self._length = config.adaptation.window
        self._slow = raw.sd_multipath_m**2 / (raw.sd_range_m**2 + raw.sd_multipath_m**2)
        self._tau_s = raw.multipath_tau_s
        self._rings = np.zeros((CHANNELS, self._length, 2))
        self._at = np.zeros((CHANNELS, 2), np.int64)
        self._fresh: dict[int, F64] = {}
        self._last_ns: int | None = None
        self._told: list[tuple[int, F64]] = []

    def learn(self, t_ns: int, found: F64) -> None:
        """Take in one epoch's scatter (2, SYSTEMS, 2), valid at ``t_ns``."""
        traces = np.zeros((CHANNELS, TRACE_SIZE))
        judge(found, self._rings, self._at, self._share(t_ns), self._a, self.factors, traces)
        self._told.append((t_ns, traces))

    def _share(self, t_ns: int) -> F64:
        """(2,) what of range and of rate is news, an interval after the epoch before."""
        apart = round(_LONE_S * 1e3)
        if self._last_ns is not None:
            apart = max(round(abs(t_ns - self._last_ns) * 1e3 / NS), 1)
        self._last_ns = t_ns
        known = self._fresh.get(apart)
        if known is None:
            phi = math.exp(-1e-3 * apart / self._tau_s)
            known = np.array([fresh_share(self._slow, phi, self._length), 1.0])
            # Few intervals occur; a receiver whose clock wanders has no more than a hundred.
            if len(self._fresh) < 1000:
                self._fresh[apart] = known
        return known

    def take_trace(self) -> AdaptationTrace:
        """What was learned since the last call, for people: one row an epoch and channel."""
        told, self._told = self._told, []
        if not told:
            return AdaptationTrace.empty()
        t = np.repeat(np.array([t_ns for t_ns, _ in told]), CHANNELS)
        rows = np.concatenate([rows for _, rows in told])
        some = rows[:, TRACED] == 1.0
        t, rows, n = t[some], rows[some], int(some.sum())
        none, zero = np.full(n, np.nan), np.zeros(n)
        return AdaptationTrace(
            t_ns=t, channel=np.tile(_EVERY, len(told))[some], source=np.zeros(n, np.int64),
            mean=none, spread=rows[:, IN_SPREAD].copy(), correlation=none, to_model=zero,
            to_source=zero, firing=rows[:, FIRING : FIRING + 9].copy(),
            r_scale=rows[:, OUT_R].copy(), q_scale=none, alpha=none,
        )  # fmt: skip
