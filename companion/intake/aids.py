"""Aiding samples as rows of the aid table, without those that must not reach the filter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from companion.config import DEG, Config
from companion.estimation.aid_table import (
    A_AZIMUTH,
    A_CLOCK_SCALE,
    A_INTERFERENCE,
    A_LET_GO,
    A_SATELLITES,
    A_VAR,
    AID_SIZE,
    KIND_ATTITUDE,
    KIND_BARO,
    KIND_GNSS,
    KIND_IMU,
    KIND_MAG,
    KIND_RANGE,
)
from companion.estimation.buffers import SampleBuffer
from companion.gnss.corrected import ROW_SIZE
from companion.intake.counters import Counters
from companion.intake.inertial import Mounting, turned
from companion.intake.place import Place
from companion.intake.ranges import SINGLE_POINT, RangeSamples
from companion.measurements.barometer import pressure_height
from companion.types import (
    F64,
    I64,
    NS,
    AidingReports,
    AidingSamples,
    AttitudeSamples,
    BaroSamples,
    Channel,
    GnssSamples,
    ImuSamples,
    MagSamples,
    Verdict,
)

FUTURE_NS = NS
"""Aiding that claims to be valid this long after it arrived has a wrong clock."""
NEVER = int(np.iinfo(np.int64).min)
"""Time of the last inertial sample where there was none."""

_CHANNEL = {
    KIND_GNSS: Channel.GNSS_POSITION_H,
    KIND_BARO: Channel.BARO,
    KIND_MAG: Channel.MAG,
    KIND_ATTITUDE: Channel.ATTITUDE,
    KIND_IMU: Channel.GYRO,
    KIND_RANGE: Channel.RANGE_GPS,
}
"""Channel under which a refusal of a whole sample is reported, by kind of aid."""


@dataclass(frozen=True, slots=True)
class Admitted:
    """Samples of one sensor as rows of the aid table."""

    kind: int
    source: I64
    """(N,) index of the receiver or sensor; of a range, its satellite."""
    t: I64
    rows: F64
    heads: I64
    """(N,) how far the inertial samples had come when each arrived [ns]."""
    index: I64
    """(N,) which of the samples handed over it was."""

    def take(self, rows: slice | I64 | NDArray[np.bool_]) -> Admitted:
        t, heads, index = self.t[rows], self.heads[rows], self.index[rows]
        return Admitted(self.kind, self.source[rows], t, self.rows[rows], heads, index)

    @property
    def late(self) -> NDArray[np.bool_]:
        """(N,) whether the filter's clock had already passed its time of validity."""
        behind: NDArray[np.bool_] = self.t <= self.heads
        return behind

    def put(self, table: SampleBuffer) -> None:
        """Into the aid table, sorted by time and, where that is equal, kind and source."""
        if len(self.t) <= 1:
            if len(self.t):
                table.insert(int(self.t[0]), self.rows[0], np.array([self.kind, self.source[0]]))
            return
        last = table.t[table.end - 1] if len(table) else NEVER
        key = np.stack([np.full(len(self.t), self.kind), self.source], axis=1)
        ahead = np.diff(self.t) + (np.diff(self.source) > 0)
        if self.t[0] > last and np.all(ahead > 0):
            table.append(self.t, self.rows, key)
        else:
            table.merge(self.t, self.rows, key)


class AidIntake:
    """Rows of the aid table from samples; refusals reported by name."""

    def __init__(self, config: Config, counters: Counters) -> None:
        self.config = config
        self.place = Place(config)
        self._counters = counters
        self._mounting = Mounting(config)
        direct = config.engine.estimator == "direct"
        self._attitude = direct and config.direct.attitude
        self._further = {
            unit.source: index for index, unit in enumerate(config.further_imu if direct else ())
        }
        self._ring_ns = round(config.engine.delay_ring_s * NS)
        self._sources: dict[str, dict[str, int]] = {}
        self._refusals: list[AidingReports] = []
        self._gnss_sd = np.array(config.gnss.configured_sd)[[0, 0, 1, 2, 2, 3]]

    def further(self, samples: ImuSamples) -> bool:
        """Whether this unit is a measurement beside the first one, whose samples set the pace."""
        return samples.source in self._further

    def admit(
        self, samples: AidingSamples | RangeSamples, heads: I64, started: bool
    ) -> Admitted | None:
        """Samples in the aid table's terms, without those refused before the filter saw them.

        ``heads`` (N,): time of validity of the last inertial sample when each of them arrived;
        ``started``: there is a filter, so that a fix is no longer needed to begin at.
        """
        if isinstance(samples, GnssSamples):
            kind, latency_ms = KIND_GNSS, self.config.gnss.latency_ms
            if samples.source == SINGLE_POINT:
                latency_ms = self.config.raw_gnss.latency_ms
            rows, verdict = self._gnss(samples, started)
        elif isinstance(samples, RangeSamples):
            kind, latency_ms = KIND_RANGE, self.config.raw_gnss.latency_ms
            rows, verdict = _blank(len(samples))
            rows[:, :ROW_SIZE] = samples.rows
            rows[:, A_LET_GO] = samples.let_go
            rows[:, A_CLOCK_SCALE : A_CLOCK_SCALE + 3] = samples.clock_scale
        elif isinstance(samples, BaroSamples):
            if not self.config.baro.use:
                return None
            kind, latency_ms = KIND_BARO, self.config.baro.latency_ms
            rows, verdict = self._baro(samples)
        elif isinstance(samples, ImuSamples):
            kind, latency_ms = KIND_IMU, self.config.imu.latency_ms
            own = self.config.further_imu[self._further[samples.source]].latency_ms
            latency_ms = latency_ms if own is None else own
            rows, verdict = self._imu(samples)
        elif isinstance(samples, AttitudeSamples):
            if not self._attitude:
                return None
            kind, latency_ms = KIND_ATTITUDE, 0.0
            rows, verdict = self._rpy(samples)
        elif isinstance(samples, MagSamples):
            if not self.config.mag.use:
                return None
            kind, latency_ms = KIND_MAG, self.config.mag.latency_ms
            rows, verdict = self._mag(samples)
        else:
            raise AssertionError("raw measurements are prepared before they come here")
        source = self._source(samples)
        t = samples.t_ns - round(latency_ms * 1e6)
        behind = (heads != NEVER) & (t < heads - self._ring_ns)
        verdict[(verdict == 0) & behind] = Verdict.REFUSED_LATE
        verdict[(verdict == 0) & (t > samples.t_rx_ns + FUTURE_NS)] = Verdict.REFUSED_CLOCK
        used = np.flatnonzero(verdict == 0)
        if len(used) < len(t):
            bad = verdict != 0
            self._refuse(kind, source[bad], t[bad], verdict[bad])
        if len(used) == 0:
            return None
        return Admitted(kind, source, t, rows, heads, np.arange(len(t))).take(used)

    def _source(self, samples: AidingSamples | RangeSamples) -> I64:
        """(N,) which sensor each row is of or, of ranges, which satellite."""
        if isinstance(samples, RangeSamples):
            return samples.sat
        if isinstance(samples, ImuSamples):
            return np.full(len(samples), self._further[samples.source])
        known = self._sources.setdefault(type(samples).__name__, {})
        return np.full(len(samples), known.setdefault(samples.source, len(known)))

    def waits(self, samples: MagSamples) -> bool:
        """Whether magnetometer samples wait for a first fix, for want of a declination.

        The last few arrivals do; those before them are refused.
        """
        if not self.config.mag.use or self.place.ready(samples.t_ns):
            return False
        gone = self.place.hold(samples)
        if gone is not None:
            verdict = np.full(len(gone), Verdict.REFUSED_NOT_ALIGNED)
            self._refuse(KIND_MAG, np.zeros(len(gone), np.int64), gone.t_ns, verdict)
        return True

    @property
    def refused(self) -> bool:
        """Whether there are refusals to report."""
        return bool(self._refusals)

    def take_refusals(self) -> list[AidingReports]:
        """Reports of what was refused since the last call."""
        refusals, self._refusals = self._refusals, []
        return refusals

    def _gnss(self, g: GnssSamples, started: bool) -> tuple[F64, I64]:
        """Rows and verdicts (0: usable) of fixes."""
        cfg = self.config.gnss
        rows, verdict = _blank(len(g))
        rows[:, 0], rows[:, 1], rows[:, 2] = g.lat, g.lon, g.height
        rows[:, 3:6] = g.vel_n
        sd = np.concatenate((g.sd_pos, g.sd_vel), axis=1)
        if cfg.sd_reported == "ignore":
            sd = np.broadcast_to(self._gnss_sd, sd.shape)
        elif cfg.sd_reported == "use":
            sd = np.where(sd > 0, sd, self._gnss_sd)
        else:
            sd = np.fmax(sd, self._gnss_sd)  # where a report is missing, the configured one
        rows[:, 6:12] = sd * sd
        rows[:, A_SATELLITES] = np.where(g.num_sats > 0, g.num_sats, np.nan)
        rows[:, A_INTERFERENCE] = np.clip(g.interference, 0.0, 1.0)
        no_fix = (g.fix_type < cfg.min_fix_type) | (g.sd_pos[:, 0] > cfg.max_sd_position_m)
        no_fix |= g.sd_pos[:, 1] > cfg.max_sd_position_m
        # Written so that NaN counts as broken.
        sane = (np.abs(g.lat) < 1.5533) & (np.abs(g.lon) < 6.2832)
        sane &= (g.height > -1000) & (g.height < 100_000) & ((g.lat != 0) | (g.lon != 0))
        broken = ~sane | (np.abs(g.vel_n) > 1000).any(axis=1)
        verdict[broken] = Verdict.REFUSED_INVALID
        verdict[no_fix] = Verdict.REFUSED_NO_FIX
        if not cfg.velocity:
            rows[:, 3:6] = np.nan
        if not cfg.position and started:
            # The first fix still says where the start is.
            rows[verdict == 0, :3] = np.nan
        self.place.note(g)
        return rows, verdict

    def _baro(self, samples: BaroSamples) -> tuple[F64, I64]:
        rows, verdict = _blank(len(samples))
        rows[:, 0] = pressure_height(samples.pressure)
        rows[:, A_VAR] = self.config.baro.sd_m**2
        sane = np.isfinite(rows[:, 0]) & (samples.pressure > 1000) & (samples.pressure < 120000)
        verdict[~sane] = Verdict.REFUSED_INVALID
        return rows, verdict

    def _mag(self, samples: MagSamples) -> tuple[F64, I64]:
        rows, verdict = _blank(len(samples))
        rows[:, :3] = self._mounting.turn(samples.field_b - np.array(self.config.mag.hard_iron_t))
        rows[:, A_VAR] = (self.config.mag.sd_deg * DEG) ** 2
        rows[:, A_AZIMUTH] = self.place.declination
        # Written so that NaN counts as broken.
        verdict[~(np.abs(rows[:, :3]).max(axis=1) > 0)] = Verdict.REFUSED_INVALID
        return rows, verdict

    def _imu(self, samples: ImuSamples) -> tuple[F64, I64]:
        rows, verdict = _blank(len(samples))
        unit = self.config.further_imu[self._further[samples.source]]
        rows[:, :3] = self._mounting.turn(turned(samples.gyro_b, unit.axes))
        rows[:, 3:6] = self._mounting.turn(turned(samples.accel_b, unit.axes))
        rows[:, 6] = np.where(samples.interval_s > 0, samples.interval_s, 0.0)
        verdict[~np.isfinite(rows[:, :6]).all(axis=1)] = Verdict.REFUSED_INVALID
        return rows, verdict

    def _rpy(self, samples: AttitudeSamples) -> tuple[F64, I64]:
        rows, verdict = _blank(len(samples))
        rows[:, :3] = samples.rpy
        # Written so that NaN counts as broken.
        verdict[~(np.abs(samples.rpy) < 2.0 * np.pi).all(axis=1)] = Verdict.REFUSED_INVALID
        return rows, verdict

    def _refuse(self, kind: int, source: I64, t: I64, verdict: I64) -> None:
        n = len(t)
        nan3, nan1 = np.full((n, 3), np.nan), np.full(n, np.nan)
        self._refusals.append(
            AidingReports(
                t,
                np.full(n, _CHANNEL[kind], np.int64),
                source,
                np.zeros(n, np.int64),
                nan3,
                nan3,
                nan1,
                nan1,
                nan1,
                verdict,
            )
        )
        refused = self._counters.refused
        for value, count in zip(*np.unique(verdict, return_counts=True), strict=True):
            name = Verdict(int(value)).name.lower()
            refused[name] = refused.get(name, 0) + int(count)


def _blank(n: int) -> tuple[F64, I64]:
    """Rows of the aid table, all missing, and verdicts, all usable."""
    return np.full((n, AID_SIZE), np.nan), np.zeros(n, np.int64)


def together(seq: I64, t: I64) -> list[slice]:
    """Rows that arrived at once and are valid at once, in order: those of one epoch."""
    cuts = np.flatnonzero((np.diff(seq) != 0) | (np.diff(t) != 0)) + 1
    return [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), len(seq)]) if b > a]
