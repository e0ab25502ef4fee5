"""One receiver's stream: ephemerides and raw epochs in, corrected satellites and points out.

Everything that a measurement needs before a filter may have it: its ephemeris, the correction of
satellite clock and ionosphere, elevation mask, choice of satellites, exclusion of faults, steps of
the receiver's clock. A pure function of the stream in its own order, however it is cut.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from companion.config import DEG, RawGnss
from companion.estimation.adaptation.constellations import CHANNELS, Constellations
from companion.estimation.adaptation.parameters import SIZE
from companion.gnss.broadcast import Ephemerides, Table, choice_of
from companion.gnss.clock_noise import new_learner
from companion.gnss.clock_steps import ClockSteps
from companion.gnss.corrected import S_SAT
from companion.gnss.correction import V_CN0, V_IONO, V_MASK, V_RANGE_SD, V_RATE_SD
from companion.gnss.gps_time import WEEK_S
from companion.gnss.scatter import trimmed_mean
from companion.gnss.single_point import P_POS, SOLVED, TOO_FEW
from companion.gnss.systems import SYSTEM_NAMES, SYSTEMS
from companion.intake.raw_gnss.epochs import Epochs, Prepared
from companion.intake.raw_gnss.news import News
from companion.intake.raw_gnss.run import run
from companion.intake.raw_gnss.state import (
    K_SIGN,
    K_UNSOLVED,
    MEMORY_SIZE,
    PLACE_SIZE,
    SETTINGS_SIZE,
    W_ADAPT,
    W_BEST,
    W_EXCLUDE,
    W_LEARN,
    W_MARGIN,
    W_OURS,
    W_SLOW,
    W_TAU,
    Z_CODE,
    Z_EXCLUDED,
    Z_LET_GO,
    Z_NEWS,
    Z_USED,
)
from companion.intake.raw_gnss.time_doubt import TimeDoubt
from companion.types import F64, I64, SATELLITES, BroadcastSamples, Event, RawGnssSamples

NAMES = tuple(name.lower() for name in SYSTEM_NAMES)
FAULT_PROBABILITY = 1e-4
"""That the test of an epoch's residuals cries fault where there is none."""
MOST_DOF = 64


@cache
def _residual_limits() -> F64:
    """(MOST_DOF,) sums of squared residuals that a good epoch exceeds by chance that rarely."""
    # Half a second of start-up, for runs with raw measurements only.
    from scipy.stats import chi2

    limits = chi2.ppf(1.0 - FAULT_PROBABILITY, np.arange(1, MOST_DOF + 1))
    return np.asarray(limits, np.float64)


def _settings(config: RawGnss, trust: Constellations | None) -> F64:
    """What the kernel is told, by the names of :mod:`companion.intake.raw_gnss.state`."""
    s = np.zeros(SETTINGS_SIZE)
    s[V_RANGE_SD] = math.hypot(config.sd_range_m, config.sd_multipath_m)
    s[V_RATE_SD] = config.sd_rate_mps
    s[V_CN0], s[V_IONO] = config.strong_cn0_dbhz, config.iono_residual
    s[V_MASK] = config.elevation_mask_deg * DEG
    s[W_EXCLUDE] = config.exclude
    s[W_BEST] = config.best_of if config.choice == "best" else 0
    s[W_MARGIN] = config.best_margin
    s[W_ADAPT] = trust is not None
    s[W_SLOW] = 0.0 if trust is None else trust.slow
    s[W_LEARN] = config.clock_noise == "learned"
    s[W_TAU] = config.multipath_tau_s
    for name in config.systems:
        s[W_OURS + NAMES.index(name)] = 1.0
    return s


class _NoTrust:
    """Stands where nothing is learned of the systems."""

    def __init__(self) -> None:
        self.factors, self.parameters = np.ones((2, SYSTEMS)), np.zeros(SIZE)
        self.rings, self.at = np.zeros((CHANNELS, 1, 2)), np.zeros((CHANNELS, 2), np.int64)
        self.last = np.zeros(2, np.int64)


class Receiver:
    """State of one stream of raw measurements."""

    def __init__(self, config: RawGnss, trust: Constellations | None = None) -> None:
        self.config = config
        self._trust = trust
        self._systems = trust or _NoTrust()
        self.ephemerides = Ephemerides()
        self.clock = ClockSteps()
        self._learner = new_learner(config)
        self._news = News()
        self._time = TimeDoubt()
        self._ours = [NAMES.index(name) for name in config.systems]
        self._settings = _settings(config, trust)
        self._place = np.zeros(PLACE_SIZE)
        self._memory = np.zeros(MEMORY_SIZE, np.int64)
        self._memory[K_SIGN] = -1

    @property
    def unsolved(self) -> int:
        """Epochs of four satellites and more whose ranges fit no place."""
        return int(self._memory[K_UNSOLVED])

    def listen(self, messages: BroadcastSamples) -> None:
        """Take navigation messages."""
        self.ephemerides.take(messages)

    def repeats(self, messages: BroadcastSamples) -> bool:
        """Whether messages change nothing, so that it does not matter when they are heard."""
        said = zip(messages.sat.tolist(), messages.values, strict=True)
        return all(self.ephemerides.repeats(sat, values) for sat, values in said)

    def take(self, raw: RawGnssSamples, i: int) -> Prepared:
        """Prepare epoch ``i`` of a block by itself."""
        epoch = raw.take(slice(i, i + 1))
        made = self.prepare(epoch)
        table = self.ephemerides.table(int(choice_of(_gps_seconds(epoch))[0]))
        return made.one(0, self._without(epoch.sat[0], table))

    def prepare(self, raw: RawGnssSamples) -> Epochs:
        """Prepare the epochs of a block, one after the other."""
        sat, observed = _arranged(raw)
        now = _gps_seconds(raw)
        made = Epochs.blank(raw, sat.shape[1], self._trust is not None)
        choice, n = choice_of(now), len(raw)
        if n:
            self._news.begin(float(now[0]))
        begin = filled = 0
        while begin < n:
            table = self.ephemerides.table(int(choice[begin]))
            beyond = (choice[begin:] < table.begin) | (choice[begin:] >= table.end)
            end = begin + int(beyond.argmax()) if beyond.any() else n
            part = slice(begin, end)
            first, filled = filled, self._run(raw, part, sat, observed, table, made, filled)
            made.events.extend(self._said(made, part, first, sat, now, table))
            begin = end
        if self._trust is not None and n:
            self._trust.tell(raw.t_ns, made.traces)
        return made.up_to(filled)

    def _run(
        self, raw: RawGnssSamples, part: slice, sat: I64, observed: F64, table: Table, made: Epochs,
        filled: int,
    ) -> int:  # fmt: skip
        """Epochs with one table of ephemerides; returns how many rows are filled."""
        trust, K = self._systems, sat.shape[1]
        return run(
            np.ascontiguousarray(raw.t_ns[part]), raw.week[part].astype(np.float64),
            raw.tow[part].astype(np.float64), sat[part], observed[part], table.row_of, table.rows,
            table.knots, self.ephemerides.ionosphere, self._settings, _residual_limits(),
            trimmed_mean(), trust.parameters, self._place, self.clock.known, self._learner,
            self._memory, trust.factors, trust.rings, trust.at, trust.last, filled, made.rows,
            made.lines, made.excluded.reshape(-1)[part.start * K : part.stop * K], made.state[part],
            made.points[part], made.figures[part], made.found[part], made.traces[part],
        )  # fmt: skip

    def _without(self, sats: I64, table: Table) -> dict[str, list[int]]:
        """Which of an epoch's satellites could not be used, by reason."""
        return table.without([sat for sat in sats.tolist() if sat // 100 - 1 in self._ours])

    def _said(
        self, made: Epochs, part: slice, first: int, sat: I64, now: F64, table: Table
    ) -> list[Event]:
        """Events of a run's epochs, whose rows begin at ``first``."""
        state = made.state[part]
        lost = (state[:, Z_CODE] != SOLVED) & (state[:, Z_CODE] != TOO_FEW)
        asked = lost | (state[:, Z_NEWS] == 1) | (state[:, Z_LET_GO] == 1)
        asked |= self.ephemerides.empty
        due = self._time.due(now[part]) & (state[:, Z_CODE] == SOLVED)
        ends = first + np.cumsum(state[:, Z_USED])
        said: list[Event] = []
        for k in np.flatnonzero(asked | due).tolist():
            i, rows = part.start + k, made.rows[ends[k] - state[k, Z_USED] : ends[k]]
            t_ns, without = int(made.t_ns[i]), self._without(sat[i], table)
            said += self._troubles(t_ns, float(now[i]), state[k], without)
            if due[k]:
                said += self._time.look(t_ns, rows, made.points[i, P_POS : P_POS + 3])
            used = rows[:, S_SAT].astype(np.int64).tolist()
            excluded = made.excluded[i, : state[k, Z_EXCLUDED]].tolist()
            said += self._news.satellites(t_ns, used, float(made.dops[i, 0]), excluded, without)
        return said

    def _troubles(
        self, t_ns: int, now: float, state: I64, without: dict[str, list[int]]
    ) -> list[Event]:
        """What keeps an epoch's ranges as a whole from being used as they are."""
        said: list[Event] = []
        if state[Z_LET_GO]:
            text = "the receiver's clock jumped: it is found again"
            said.append(Event(t_ns, "receiver-clock", text))
        if state[Z_CODE] not in (SOLVED, TOO_FEW):
            said += self._news.contradiction(t_ns, now)
        if self.ephemerides.empty and "missing" in without:
            said += self._news.nothing_known(t_ns, now)
        return said


def _gps_seconds(raw: RawGnssSamples) -> F64:
    """(N,) times of reception since the GPS epoch [s]."""
    return np.asarray(raw.week.astype(np.float64) * WEEK_S + raw.tow)


def _arranged(raw: RawGnssSamples) -> tuple[I64, F64]:
    """A block's satellites (N, K) and observations (N, K, ·) as the kernel takes them.

    Columns behind the last one with a satellite are left out.
    """
    some = np.flatnonzero((raw.sat[:, :SATELLITES] > 0).any(axis=0))
    K = int(some[-1]) + 1 if len(some) else 1
    columns = (raw.pseudorange, raw.rate, raw.cn0, raw.sd_range, raw.sd_rate, raw.signal)
    observed: F64 = np.stack([c[:, :K] for c in columns], axis=2, dtype=np.float64)
    return np.ascontiguousarray(raw.sat[:, :K], np.int64), observed
