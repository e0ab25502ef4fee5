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

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True, slots=True)
class _Admitted:
    """Samples of one sensor as rows of the aid table."""

    kind: int
    source: int
    t: I64
    rows: F64
    heads: I64
    """(N,) how far the inertial samples had come when each arrived [ns]."""
    index: I64
    """(N,) which of the samples handed over it was."""

    def take(self, rows: slice | I64 | NDArray[np.bool_]) -> _Admitted:
        t, heads, index = self.t[rows], self.heads[rows], self.index[rows]
        return _Admitted(self.kind, self.source, t, self.rows[rows], heads, index)


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
        self._imu_latency_ns = round(config.imu.latency_ms * 1e6)
        self._identity = bool(np.array_equal(self._axes, np.eye(3)))
        self._sources: dict[str, dict[str, int]] = {}
        self._published_t = self._settled_t = _NEVER
        self._fresh: list[tuple[I64, F64]] = []
        self._said: dict[tuple[int, str], None] = {}
        self._unsaid: list[Event] = []
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
            return NOTHING
        if isinstance(samples, ImuSamples):
            return self._step_imu(samples)
        if (
            isinstance(samples, MagSamples)
            and self.config.mag.use
            and not self._know_declination(samples)
        ):
            self._early_mag.append(samples)
            return NOTHING
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

    def step_block(self, imu: ImuSamples, aids: Sequence[AidingSamples]) -> Outputs:
        """Take inertial samples and the aiding that arrived among them, as their ``seq`` says.

        The same bits as :meth:`step` of one arrival after the other, for a fraction of the time
        where much of the aiding is late.
        """
        t, rows = self._imu_rows(imu)
        head = self._head
        waiting = self.config.mag.use and self._declination is None
        plain = self.config.gnss.position and not (waiting or self._early_mag)
        if not (plain and _in_order(t, head) and math.isfinite(rows.sum())):
            return self._one_by_one(imu, aids)
        self.counters.imu += len(t)
        heads = np.concatenate(([_NEVER if head is None else head], t))
        late: list[tuple[int, int, _Admitted]] = []
        for samples in aids:
            place = np.searchsorted(imu.seq, samples.seq)
            admitted = self._admit(samples, heads[place])
            if admitted is None:
                continue
            behind = admitted.t <= admitted.heads
            self._put(admitted.take(~behind))
            at, seq = place[admitted.index].tolist(), samples.seq[admitted.index].tolist()
            late += [
                (seq[m], at[m], admitted.take(slice(m, m + 1))) for m in np.flatnonzero(behind)
            ]
        late.sort(key=lambda one: one[0])
        self._walk_between(t, rows, late)
        return self._drain()

    def _walk_between(self, t: I64, rows: F64, late: list[tuple[int, int, _Admitted]]) -> None:
        """Walk new inertial samples; at the place of each late aid, go back for it.

        ``late``: arrival number, place among the samples, and the aid; in order of arrival.
        """
        self._imu.append(t, rows)
        end = self._imu.end
        begin = end - len(t)
        back: _Admitted | None = None
        mark = until = 0
        for _, place, aid in late:
            if back is not None or place > 0:
                self._imu.end = begin + place
                self._advance(back, mark, until)
            back, mark, until = aid, self.filter.reports.end, self.filter.now[0]
            self._put(aid)
            # The way forward again is walked together with what comes next.
            self.filter.rewind(int(aid.t[0]))
        self._imu.end = end
        self._advance(back, mark, until)

    def _advance(self, back: _Admitted | None, mark: int, until: int) -> None:
        """Walk to the end of the samples and publish; after going back, drop repeated reports."""
        self.filter.advance(self._imu, self._aids)
        if back is not None:
            self.counters.late_fused += 1
            self.counters.rewinds += 1
            self._keep_new_reports(mark, until, back)
        self._publish()

    def _one_by_one(self, imu: ImuSamples, aids: Sequence[AidingSamples]) -> Outputs:
        queue = [(int(q), i, m) for i, a in enumerate(aids) for m, q in enumerate(a.seq)]
        parts: list[Outputs] = []
        sent = 0
        for seq, index, m in sorted(queue):
            place = int(np.searchsorted(imu.seq, seq))
            if place > sent:
                parts.append(self.step(imu.take(slice(sent, place))))
                sent = place
            parts.append(self.step(aids[index].take(slice(m, m + 1))))
        if sent < len(imu):
            parts.append(self.step(imu.take(slice(sent, None))))
        return _join(parts)

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

    def _imu_rows(self, block: ImuSamples) -> tuple[I64, F64]:
        """Times of validity, and rows (N, 7) in body axes as the walk takes them."""
        rows = np.empty((len(block), 7))
        if self._identity:
            rows[:, :3], rows[:, 3:6] = block.gyro_b, block.accel_b
        else:
            rows[:, :3] = _turned(block.gyro_b, self._axes)
            rows[:, 3:6] = _turned(block.accel_b, self._axes)
        rows[:, 6] = np.where(block.interval_s > 0, block.interval_s, 0.0)
        return block.t_ns - self._imu_latency_ns, rows

    def _step_imu(self, block: ImuSamples) -> Outputs:
        t, rows = self._imu_rows(block)
        self.counters.imu += len(t)
        if not math.isfinite(rows.sum()):
            good = np.isfinite(rows[:, :6]).all(axis=1)
            self.counters.imu_not_finite += len(t) - int(good.sum())
            t, rows = t[good], rows[good]
        parts: list[Outputs] = []
        head = self._head
        if _in_order(t, head):
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
        self._published_t = self._settled_t = _NEVER
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
        head = self._head
        heads = np.full(len(samples), _NEVER if head is None else head)
        admitted = self._admit(samples, heads)
        if admitted is None:
            return
        self._put(admitted)
        # Late: the filter's clock has already passed its time of validity.
        late = admitted.t <= admitted.heads
        if late.any():
            back = admitted.take(np.flatnonzero(late))
            mark, until = self.filter.reports.end, self.filter.now[0]
            self.counters.late_fused += len(back.t)
            self.counters.rewinds += 1
            self.filter.rewind(int(back.t.min()))
            self.filter.advance(self._imu, self._aids)
            self._keep_new_reports(mark, until, back)

    def _admit(self, samples: AidingSamples, heads: I64) -> _Admitted | None:
        """Samples in the aid table's terms, without those refused before the filter saw them.

        ``heads`` (N,): time of validity of the last inertial sample when each of them arrived.
        """
        self.counters.aids += len(samples)
        kind, rows, t, verdict = self._aid_rows(samples)
        if kind < 0:
            return None
        index = self._sources.setdefault(type(samples).__name__, {})
        source = index.setdefault(samples.source, len(index))
        behind = (heads != _NEVER) & (t < heads - self._ring_ns)
        verdict[(verdict == 0) & behind] = Verdict.REFUSED_LATE
        verdict[(verdict == 0) & (t > samples.t_rx_ns + FUTURE_NS)] = Verdict.REFUSED_CLOCK
        used = np.flatnonzero(verdict == 0)
        if len(used) < len(t):
            bad = verdict != 0
            self._refuse(kind, source, t[bad], verdict[bad])
        if len(used) == 0:
            return None
        return _Admitted(kind, source, t, rows, heads, np.arange(len(t))).take(used)

    def _put(self, aids: _Admitted) -> None:
        """Into the aid table, sorted by time and, where that is equal, kind and source."""
        n = len(aids.t)
        if n == 0:
            return
        last = self._aids.t[self._aids.end - 1] if len(self._aids) else _NEVER
        key = np.array([aids.kind, aids.source])
        if aids.t[0] > last and np.all(aids.t[1:] > aids.t[:-1]):
            self._aids.append(aids.t, aids.rows, key)
        else:
            for m in range(n):
                self._aids.insert(int(aids.t[m]), aids.rows[m], key)

    def _keep_new_reports(self, mark: int, until: int, new: _Admitted) -> None:
        """Of the reports walked again, keep only those of the aids that are new."""
        reports = self.filter.reports
        times = reports.t[mark : reports.end]
        rows = reports.rows[mark : reports.end]
        own = (times == new.t[0]) if len(new.t) == 1 else np.isin(times, new.t)
        if own.any():
            own &= _KIND_OF_CHANNEL[rows[:, up.R_CHANNEL].astype(np.int64)] == new.kind
            own &= rows[:, up.R_SOURCE] == new.source
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
        self._publish()
        published = _solution(self._fresh)
        self._fresh = []
        b = rows.after(horizon)
        settled = _NO_SOLUTION
        if b > rows.start:
            # A snapshot may lie before the ring: from there, settled epochs are walked once more.
            a = rows.after(self._settled_t)
            if a < b:
                self._settled.update(rows.t[a:b], rows.rows[a:b])
                self._settled_t = int(rows.t[b - 1])
                settled = _solution([(rows.t[a:b].copy(), rows.rows[a:b].copy())])
            rows.start = b
        reports = self._drain_reports()
        events = self._drain_events(horizon)
        if head is not None:
            self._imu.forget(head - self._keep_imu_ns)
            self._aids.forget(head - self._ring_ns - KEEP_NS)
        if len(self._aids) > 1:
            self._aids.forget(int(self._aids.t[self._aids.end - 1]) - WAITING_NS)
        return Outputs(published, settled, reports, events)

    def _publish(self) -> None:
        """Set aside the epochs reached for the first time: going back may rewrite them."""
        rows = self.filter.rows
        a, b = rows.after(self._published_t), rows.end
        if a < b:
            self._published.update(rows.t[a:b], rows.rows[a:b])
            self._published_t = int(rows.t[b - 1])
            self._fresh.append((rows.t[a:b].copy(), rows.rows[a:b].copy()))
        if self.filter.events:
            self._note_events()

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

    def _note_events(self) -> None:
        """Set aside events that were not said before: going back may take them back."""
        for event in self.filter.events:
            if (event.t_ns, event.kind) not in self._said:
                self._said[(event.t_ns, event.kind)] = None
                self._unsaid.append(event)

    def _drain_events(self, horizon: int) -> tuple[Event, ...]:
        self._note_events()
        fresh, self._unsaid = tuple(self._unsaid), []
        if self.filter.events:
            self.filter.events = [e for e in self.filter.events if e.t_ns > horizon]
        if self._said:
            for key in [key for key in self._said if key[0] <= horizon]:
                del self._said[key]
        return fresh


_NO_REPORTS = AidingReports.empty()
_NO_SOLUTION = Solution.empty()
NOTHING = Outputs(_NO_SOLUTION, _NO_SOLUTION, _NO_REPORTS, ())
"""What a step gives out that leaves nothing to say."""


def _turned(v: F64, axes: F64) -> F64:
    """Vectors (N, 3) turned by ``axes`` (3, 3), summed in one order.

    A matrix product may sum otherwise for another N or processor, and the bits with it.
    """
    return np.stack([v[:, 0] * a[0] + v[:, 1] * a[1] + v[:, 2] * a[2] for a in axes], axis=1)


def _in_order(t: I64, head: int | None) -> bool:
    """Whether inertial samples can be taken as they are: some, not too many, each later."""
    if not 0 < len(t) <= CHUNK or (head is not None and t[0] <= head):
        return False
    return len(t) == 1 or bool(np.all(t[1:] > t[:-1]))


def _solution(parts: list[tuple[I64, F64]]) -> Solution:
    """Output rows, times and values of their own, as columns that are views of them."""
    if not parts:
        return _NO_SOLUTION
    t, r = parts[0]
    if len(parts) > 1:
        t = np.concatenate([part[0] for part in parts])
        r = np.concatenate([part[1] for part in parts])
    return Solution(
        t,
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
