"""The engine: samples in, in order of arrival; solution, reports and events out. Pure.

No clock, no socket, no thread: time is what the samples say. Live, replay and smoothing call the
same :meth:`Engine.step`. Aiding may arrive late and out of order inside the delay ring: the filter
goes back to a snapshot, takes it at its own time, and walks forward again. So there are two
solutions:

- *published*: each epoch when it was first reached, with all that had arrived by then;
- *settled*: each epoch once nothing inside the ring can change it, identical to the bit to what
  in-order arrival would have given.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np

from companion.config import DEG, Config
from companion.estimation import update as up
from companion.estimation import walk as w
from companion.estimation.buffers import SampleBuffer
from companion.estimation.digest import RowDigest
from companion.estimation.error_state import ErrorStateFilter
from companion.estimation.recording import Recording, Tape
from companion.measurements.barometer import pressure_height
from companion.measurements.magnetometer import declination
from companion.types import (
    F64,
    I64,
    NS,
    AidingReports,
    AidingSamples,
    AnySamples,
    BaroSamples,
    Event,
    GnssSamples,
    ImuSamples,
    MagSamples,
    Outputs,
    Solution,
    Verdict,
)

CLOCK_BACK_NS = NS
"""An IMU clock that goes back further than this has been restarted; less is a late sample."""
FUTURE_NS = NS
"""Aiding that claims to be valid this long after it arrived has a wrong clock."""
WAITING_NS = 60 * NS
"""Aids waiting for a silent IMU: older ones are forgotten."""
KEEP_NS = 6 * NS
"""Aids kept behind the ring, for realignment and relocking."""
EARLY_MAG = 4
"""Magnetometer arrivals kept until the first fix tells the place and so the declination."""
CHUNK = 20_000
"""Inertial samples walked between two drains of the outputs: bounds memory, not results."""

_KIND_OF_CHANNEL = np.array([0, 0, 0, 0, 1, 2, 0, -1, -1, -1])
"""Kind of aid (``walk.KIND_``) behind each channel; −1 for constraints."""
_NEVER = np.iinfo(np.int64).min


@dataclass(slots=True)
class Counters:
    """What the engine did with what came in."""

    imu: int = 0
    imu_not_finite: int = 0
    imu_out_of_order: int = 0
    aids: int = 0
    late_fused: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    rewinds: int = 0


class Engine:
    """One vehicle's estimator behind its delay ring."""

    def __init__(self, config: Config, record: Recording = "no") -> None:
        """A new estimator; with ``record`` it leaves tapes for a smoother.

        A recorded run must be given its aiding in order: a tape does not go back in time.
        """
        self.config = config
        self._record = record
        self._tapes: list[Tape] = []
        self.filter = ErrorStateFilter(config, record)
        self.counters = Counters()
        self._imu = SampleBuffer(7)
        self._aids = SampleBuffer(w.AID_SIZE, key_width=2)
        gnss = config.gnss
        self._gnss_sd = np.array(
            [
                *[gnss.sd_position_m] * 2,
                gnss.sd_height_m,
                *[gnss.sd_velocity_mps] * 2,
                gnss.sd_velocity_down_mps,
            ]
        )
        self._ring_ns = round(config.engine.delay_ring_s * NS)
        self._keep_imu_ns = self._ring_ns + round(config.alignment.window_s * NS) + 2 * NS
        self._axes = np.array(config.imu.axes, dtype=np.float64)
        self._identity = bool(np.array_equal(self._axes, np.eye(3)))
        self._sources: dict[str, dict[str, int]] = {}
        self._published_t = np.iinfo(np.int64).min
        self._said: dict[tuple[int, str], None] = {}
        self._settled = RowDigest()
        self._published = RowDigest()
        self._refusals: list[AidingReports] = []
        self._last_fix: tuple[float, float, float] | None = None
        self._declination: float | None = None
        self._early_mag: deque[MagSamples] = deque(maxlen=EARLY_MAG)

    # ------------------------------------------------------------------ in

    def step(self, samples: AnySamples) -> Outputs:
        """Take one arrival: a block of one sensor's samples, in order of arrival.

        Malformed samples are counted and dropped, never raised.
        """
        if len(samples) == 0:
            return _NOTHING
        if isinstance(samples, ImuSamples):
            return self._step_imu(samples)
        if (
            isinstance(samples, MagSamples)
            and self.config.mag.use
            and not self._know_declination(samples)
        ):
            self._early_mag.append(samples)
            return _NOTHING
        if isinstance(samples, GnssSamples) and self._early_mag:
            self._note_place(samples)
            if self._last_fix is not None:
                # Heading at the start comes from these: they go in before the fix does.
                early, self._early_mag = self._early_mag, deque(maxlen=EARLY_MAG)
                for mag in early:
                    self._know_declination(mag)
                    self._step_aids(mag)
        self._step_aids(samples)
        # Rows walked again settle with the next inertial samples; what is new is said at once.
        return Outputs(
            _NO_SOLUTION, _NO_SOLUTION, self._drain_reports(), self._drain_events(_NEVER)
        )

    def finish(self) -> Outputs:
        """Settle everything: the run has ended."""
        return self._drain(final=True)

    def tapes(self) -> list[Tape]:
        """What was recorded for a smoother, a tape for each stretch without a declared break.

        Once, after :meth:`finish`.
        """
        return [*self._tapes, *self.filter.tapes()]

    @property
    def digest(self) -> str:
        """Hash over the bits of the settled solution so far."""
        return self._settled.hexdigest()

    @property
    def digest_published(self) -> str:
        """Hash over everything published, in order."""
        return self._published.hexdigest()

    # ------------------------------------------------------------------ inertial samples

    def _step_imu(self, block: ImuSamples) -> Outputs:
        t = block.t_ns - round(self.config.imu.latency_ms * 1e6)
        rows = np.empty((len(t), 7))
        if self._identity:
            rows[:, :3], rows[:, 3:6] = block.gyro_b, block.accel_b
        else:
            rows[:, :3] = _turned(block.gyro_b, self._axes)
            rows[:, 3:6] = _turned(block.accel_b, self._axes)
        rows[:, 6] = np.where(block.interval_s > 0, block.interval_s, 0.0)
        self.counters.imu += len(t)
        if not np.isfinite(rows.sum()):
            good = np.isfinite(rows[:, :6]).all(axis=1)
            self.counters.imu_not_finite += len(t) - int(good.sum())
            t, rows = t[good], rows[good]
        parts: list[Outputs] = []
        head = self._head
        if 0 < len(t) <= CHUNK and (head is None or t[0] > head) and np.all(t[1:] > t[:-1]):
            self._imu.append(t, rows)
            self.filter.advance(self._imu, self._aids)
            return self._drain()
        while len(t):
            head = self._head
            peak = (
                np.maximum.accumulate(np.maximum(t, head))
                if head is not None
                else (np.maximum.accumulate(t))
            )
            before = np.concatenate([[head if head is not None else t[0] - 1], peak[:-1]])
            back = np.flatnonzero(before - t > CLOCK_BACK_NS)
            stop = int(back[0]) if len(back) else len(t)
            fresh = t[:stop] > before[:stop]
            self.counters.imu_out_of_order += int(stop - fresh.sum())
            new_t, new_rows = t[:stop][fresh], rows[:stop][fresh]
            for a in range(0, len(new_t), CHUNK):
                self._imu.append(new_t[a : a + CHUNK], new_rows[a : a + CHUNK])
                self.filter.advance(self._imu, self._aids)
                parts.append(self._drain())
            t, rows = t[stop:], rows[stop:]
            if len(t):
                parts.append(self._restart(int(before[stop]), int(t[0])))
        return _join(parts)

    @property
    def _head(self) -> int | None:
        return int(self._imu.t[self._imu.end - 1]) if len(self._imu) else None

    def _restart(self, last: int, now: int) -> Outputs:
        """The IMU's clock jumped back: settle what was, begin again on the new clock."""
        out = self._drain(final=True)
        resets = self.filter._resets(self.filter.phases[-1])
        self._tapes += self.filter.tapes()
        self.filter = ErrorStateFilter(self.config, self._record)
        self.filter.phases[0].resets = resets + 1
        self._imu.clear()
        self._aids.clear()
        self._published_t = np.iinfo(np.int64).min
        event = Event(
            now,
            "clock-back",
            f"IMU clock jumped back by {(last - now) / NS:.1f} s: estimator restarted",
            "warning",
        )
        return _join(
            [out, Outputs(Solution.empty(), Solution.empty(), AidingReports.empty(), (event,))]
        )

    # ------------------------------------------------------------------ aiding

    def _step_aids(self, samples: AidingSamples) -> None:
        self.counters.aids += len(samples)
        kind, rows, t, verdict = self._aid_rows(samples)
        if kind < 0:
            return
        index = self._sources.setdefault(type(samples).__name__, {})
        source = index.setdefault(samples.source, len(index))
        head = self._head
        if head is not None:
            verdict[(verdict == 0) & (t < head - self._ring_ns)] = Verdict.REFUSED_LATE
        verdict[(verdict == 0) & (t > samples.t_rx_ns + FUTURE_NS)] = Verdict.REFUSED_CLOCK
        bad = verdict != 0
        if bad.any():
            self._refuse(kind, source, t[bad], verdict[bad])
            rows, t = rows[~bad], t[~bad]
        if len(t) == 0:
            return
        key = np.empty((len(t), 2), np.int64)
        key[:, 0], key[:, 1] = kind, source
        last = self._aids.t[self._aids.end - 1] if len(self._aids) else np.iinfo(np.int64).min
        if t[0] > last and np.all(t[1:] > t[:-1]):
            self._aids.append(t, rows, key)
        else:
            for m in range(len(t)):
                self._aids.insert(int(t[m]), rows[m], key[m])
        # Late: the filter's clock has already passed its time of validity.
        late = t <= self.filter.now[0]
        if late.any():
            self.counters.late_fused += int(late.sum())
            self.counters.rewinds += 1
            first = int(t[late].min())
            mark = self.filter.reports.end
            until = self.filter.now[0]
            self.filter.rewind(first)
            self.filter.advance(self._imu, self._aids)
            self._keep_new_reports(mark, until, t[late], kind, source)

    def _keep_new_reports(self, mark: int, until: int, t: I64, kind: int, source: int) -> None:
        """Of the reports walked again, keep only those of the aids that are new."""
        reports = self.filter.reports
        times = reports.t[mark : reports.end]
        rows = reports.rows[mark : reports.end]
        channel = rows[:, up.R_CHANNEL].astype(np.int64)
        own = _KIND_OF_CHANNEL[channel] == kind
        own &= rows[:, up.R_SOURCE] == source
        own &= (times == t[0]) if len(t) == 1 else np.isin(times, t)
        keep = own | (times > until)
        n = int(keep.sum())
        reports.t[mark : mark + n] = times[keep]
        reports.rows[mark : mark + n] = rows[keep]
        reports.end = mark + n

    def _aid_rows(self, samples: AidingSamples) -> tuple[int, F64, I64, I64]:
        """Kind, rows of the aid table, time of validity, and verdict (0: usable) of samples."""
        rows = np.full((len(samples), w.AID_SIZE), np.nan)
        verdict = np.zeros(len(samples), np.int64)
        if isinstance(samples, GnssSamples):
            t = samples.t_ns - round(self.config.gnss.latency_ms * 1e6)
            self._gnss_rows(samples, rows, verdict)
            return w.KIND_GNSS, rows, t, verdict
        if isinstance(samples, BaroSamples):
            if not self.config.baro.use:
                return -1, rows, samples.t_ns, verdict
            t = samples.t_ns - round(self.config.baro.latency_ms * 1e6)
            rows[:, 0] = pressure_height(samples.pressure)
            rows[:, w.A_VAR] = self.config.baro.sd_m**2
            sane = np.isfinite(rows[:, 0]) & (samples.pressure > 1000) & (samples.pressure < 120000)
            verdict[~sane] = Verdict.REFUSED_INVALID
            return w.KIND_BARO, rows, t, verdict
        if not self.config.mag.use:
            return -1, rows, samples.t_ns, verdict
        t = samples.t_ns - round(self.config.mag.latency_ms * 1e6)
        rows[:, :3] = samples.field_b - np.array(self.config.mag.hard_iron_t)
        if not self._identity:
            rows[:, :3] = _turned(rows[:, :3], self._axes)
        rows[:, w.A_VAR] = (self.config.mag.sd_deg * DEG) ** 2
        rows[:, w.A_AZIMUTH] = self._declination
        strength = np.linalg.norm(rows[:, :3], axis=1)
        verdict[~(strength > 0)] = Verdict.REFUSED_INVALID
        return w.KIND_MAG, rows, t, verdict

    def _gnss_rows(self, g: GnssSamples, rows: F64, verdict: I64) -> None:
        cfg = self.config.gnss
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
        if not cfg.position:
            # The first fix still says where the start is.
            used = np.flatnonzero(verdict == 0)
            if self.filter.phases[-1].filters:
                rows[used, :3] = np.nan
        self._note_place(g)

    def _note_place(self, g: GnssSamples) -> None:
        """Remember where about the run is: rounded, so that it does not depend on which fix."""
        if self._last_fix is not None:
            return
        good = np.flatnonzero((g.fix_type >= 3) & np.isfinite(g.lat) & (np.abs(g.lat) < 1.56))
        if len(good):
            m = int(good[0])
            place = round(float(g.lat[m]), 3), round(float(g.lon[m]), 3), 0.0
            self._last_fix = place

    def _know_declination(self, samples: MagSamples) -> bool:
        """Whether declination is known: configured, or the model's at the first fix's place."""
        if self._declination is None:
            if self.config.mag.declination_deg is not None:
                self._declination = self.config.mag.declination_deg * DEG
            elif self._last_fix is not None:
                month = 30 * 86_400 * NS
                when = int(samples.t_ns[0]) // month * month
                self._declination = declination(*self._last_fix, when)
        return self._declination is not None

    def _refuse(self, kind: int, source: int, t: I64, verdict: I64) -> None:
        n = len(t)
        channel = {w.KIND_GNSS: 0, w.KIND_BARO: 4, w.KIND_MAG: 5}[kind]
        nan3, nan1 = np.full((n, 3), np.nan), np.full(n, np.nan)
        column = np.full(n, channel, np.int64)
        self._refusals.append(
            AidingReports(
                t,
                column,
                np.full(n, source, np.int64),
                np.zeros(n, np.int64),
                nan3,
                nan3,
                nan1,
                nan1,
                nan1,
                verdict,
            )
        )
        for value, count in zip(*np.unique(verdict, return_counts=True), strict=True):
            name = Verdict(int(value)).name.lower()
            self.counters.refused[name] = self.counters.refused.get(name, 0) + int(count)

    # ------------------------------------------------------------------ out

    def _drain(self, final: bool = False) -> Outputs:
        rows = self.filter.rows
        head = self._head
        horizon = (
            np.iinfo(np.int64).max
            if final
            else (head - self._ring_ns - 1 if head is not None else np.iinfo(np.int64).min)
        )
        a = rows.after(self._published_t)
        published = _solution(rows.t[a : rows.end], rows.rows[a : rows.end])
        if a < rows.end:
            self._published.update(rows.t[a : rows.end], rows.rows[a : rows.end])
            self._published_t = int(rows.t[rows.end - 1])
        b = rows.after(horizon)
        settled = _solution(rows.t[rows.start : b], rows.rows[rows.start : b])
        if b > rows.start:
            self._settled.update(rows.t[rows.start : b], rows.rows[rows.start : b])
            rows.start = b
        reports = self._drain_reports()
        events = self._drain_events(horizon)
        if head is not None:
            self._imu.forget(head - self._keep_imu_ns)
            self._aids.forget(head - self._ring_ns - KEEP_NS)
        if len(self._aids) > 1:
            self._aids.forget(int(self._aids.t[self._aids.end - 1]) - WAITING_NS)
        return Outputs(published, settled, reports, events)

    def _drain_reports(self) -> AidingReports:
        buffer = self.filter.reports
        parts = self._refusals
        if len(buffer):
            t, r = buffer.t[buffer.start : buffer.end], buffer.rows[buffer.start : buffer.end]
            parts = [
                *parts,
                AidingReports(
                    t.copy(),
                    r[:, up.R_CHANNEL].astype(np.int64),
                    r[:, up.R_SOURCE].astype(np.int64),
                    r[:, up.R_DOF].astype(np.int64),
                    r[:, up.R_INNOVATION : up.R_INNOVATION + 3].copy(),
                    r[:, up.R_SD : up.R_SD + 3].copy(),
                    r[:, up.R_NIS].copy(),
                    r[:, up.R_GATE].copy(),
                    r[:, up.R_SCALE_USED].copy(),
                    r[:, up.R_VERDICT].astype(np.int64),
                ),
            ]
            buffer.start = buffer.end = 0
        if not parts:
            return _NO_REPORTS
        self._refusals = []
        return AidingReports.concatenate(parts)

    def _drain_events(self, horizon: int) -> tuple[Event, ...]:
        if not self.filter.events:
            return ()
        fresh = [e for e in self.filter.events if (e.t_ns, e.kind) not in self._said]
        for e in fresh:
            self._said[(e.t_ns, e.kind)] = None
        self.filter.events = [e for e in self.filter.events if e.t_ns > horizon]
        for key in [key for key in self._said if key[0] <= horizon]:
            del self._said[key]
        return tuple(fresh)


_NO_REPORTS = AidingReports.empty()
_NO_SOLUTION = Solution.empty()
_NOTHING = Outputs(_NO_SOLUTION, _NO_SOLUTION, _NO_REPORTS, ())


def _turned(v: F64, axes: F64) -> F64:
    """Vectors (N, 3) turned by ``axes`` (3, 3), summed in one order.

    A matrix product may sum otherwise for another N or processor, and the bits with it.
    """
    return np.stack([v[:, 0] * a[0] + v[:, 1] * a[1] + v[:, 2] * a[2] for a in axes], axis=1)


def _solution(t: I64, rows: F64) -> Solution:
    """Output rows as columns, views of one copy: the buffers are reused."""
    if len(t) == 0:
        return _NO_SOLUTION
    r = rows.copy()
    return Solution(
        t.copy(),
        r[:, w.O_LAT],
        r[:, w.O_LAT + 1],
        r[:, w.O_LAT + 2],
        r[:, w.O_VEL : w.O_VEL + 3],
        r[:, w.O_Q : w.O_Q + 4],
        r[:, w.O_ACCEL_BIAS : w.O_ACCEL_BIAS + 3],
        r[:, w.O_GYRO_BIAS : w.O_GYRO_BIAS + 3],
        r[:, w.O_COV : w.O_COV + 30].reshape(-1, 5, 6),
        r[:, w.O_MODE].astype(np.int64),
        r[:, w.O_RESETS].astype(np.int64),
    )


def _join(parts: list[Outputs]) -> Outputs:
    if len(parts) == 1:
        return parts[0]
    return Outputs(
        Solution.concatenate([p.published for p in parts]),
        Solution.concatenate([p.settled for p in parts]),
        AidingReports.concatenate([p.reports for p in parts]),
        tuple(e for p in parts for e in p.events),
    )
