"""The engine: samples in, in order of arrival; solution, reports and events out. Pure.

No clock, no socket, no thread: time is what the samples say. Live, replay and smoothing call the
same :meth:`Engine.step`. Aiding may arrive late and out of order inside the delay ring: the filter
goes back to a snapshot, takes it at its own time, and walks forward again. So there are two
solutions:

- *published*: each epoch when it was first reached, with all that had arrived by then;
- *settled*: each epoch once nothing inside the ring can change it, identical to the bit to what
  in-order arrival would have given.

The story of an arrival: ``intake`` puts it in the estimator's terms, or refuses it by name; the
estimator walks, from where it stands or from a snapshot before a late aid; ``outlet`` says what is
new.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.config import Config
from companion.estimation import update as up
from companion.estimation.aid_table import (
    AID_SIZE,
    KIND_ATTITUDE,
    KIND_BARO,
    KIND_GNSS,
    KIND_IMU,
    KIND_MAG,
    KIND_RANGE,
)
from companion.estimation.buffers import SampleBuffer
from companion.estimation.choice import new_estimator
from companion.estimation.recording import Recording, Tape
from companion.estimation.stretch import Stretch
from companion.intake.aids import NEVER, Admitted, AidIntake, together
from companion.intake.counters import Counters
from companion.intake.fused import FusedImu
from companion.intake.fusion.fusion import ImuFusion, fuses
from companion.intake.inertial import (
    CHUNK,
    CLOCK_BACK_NS,
    IMU_SIZE,
    InertialIntake,
    in_order,
)
from companion.intake.ranges import SILENT, RangeIntake, RangeSamples, Said
from companion.outlet import NO_SOLUTION, NOTHING, Outlet, also, join, reports, trace
from companion.smoothing.on_line import OnLine
from companion.types import (
    F64,
    I64,
    NS,
    AdaptationTrace,
    AidingReports,
    AidingSamples,
    AnySamples,
    Channel,
    Event,
    GnssSamples,
    ImuSamples,
    MagSamples,
    Outputs,
    Solution,
)

__all__ = ["CLOCK_BACK_NS", "NOTHING", "Counters", "Engine"]

WAITING_NS = 60 * NS
"""Aids waiting for a silent IMU: older ones are forgotten."""
KEEP_NS = 6 * NS
"""Aids kept behind the ring, for realignment and relocking."""
FORGET_NS = NS // 4
"""How often that is looked at."""


def _kinds() -> list[int]:
    """Kind of aid (``walk.KIND_``) behind each channel; −1 for constraints."""
    kinds = [-1] * (max(Channel) + 1)
    kinds[:7] = 0, 0, 0, 0, KIND_BARO, KIND_MAG, KIND_GNSS
    kinds[Channel.ATTITUDE] = KIND_ATTITUDE
    kinds[Channel.GYRO] = kinds[Channel.ACCELEROMETER] = KIND_IMU
    kinds[Channel.SOURCE_H] = kinds[Channel.SOURCE_V] = KIND_GNSS
    for channel in range(Channel.RANGE_GPS, Channel.RATE_BEIDOU + 1):
        kinds[channel] = KIND_RANGE
    return kinds


_KIND_OF_CHANNEL = _kinds()


class Engine:
    """One vehicle's estimator behind its delay ring."""

    def __init__(self, config: Config, record: Recording = "no") -> None:
        """A new estimator; with ``record`` it leaves tapes for a smoother.

        A recorded run must be given its aiding in order: a tape does not go back in time.
        """
        self.config = config
        self.counters = Counters()
        self.filter = new_estimator(config, record)
        self._record = record
        self._tapes: list[Tape] = []
        self._stretches: list[Stretch] = []
        self._inertial = InertialIntake(config, self.counters)
        self.fusion = ImuFusion(config, self.counters) if fuses(config) else None
        self._aiding = AidIntake(config, self.counters)
        self._ranges = RangeIntake(config)
        self._outlet = Outlet()
        self._imu = SampleBuffer(IMU_SIZE)
        self._aids = SampleBuffer(AID_SIZE, key_width=2)
        self.on_line = OnLine(config)
        self._finished = False
        self._ring_ns = round(config.engine.delay_ring_s * NS)
        self._forgot_ns = NEVER
        self._keep_imu_ns = self._ring_ns + round(config.alignment.window_s * NS) + 2 * NS

    def step(self, samples: AnySamples) -> Outputs:
        """Take one arrival: a block of one sensor's samples, in order of arrival.

        Malformed samples are counted and dropped, never raised.
        """
        if len(samples) == 0:
            return NOTHING
        if isinstance(samples, ImuSamples) and not self._aiding.further(samples):
            if self.fusion is not None and not isinstance(samples, FusedImu):
                fused, told = self.fusion.take([samples])
                return also(self._step_imu(fused) if len(fused) else NOTHING, told)
            return self._step_imu(samples)
        self.counters.aids += len(samples)
        prepared, sky = self._ranges.take([samples])
        for made in prepared:
            self._step_sensor(made)
        # Rows walked again settle with the next inertial samples; what is new is said at once.
        said, traced = self._reports()
        every = tuple(self._outlet.events(self.filter))
        return _with_sky(Outputs(NO_SOLUTION, NO_SOLUTION, said, every, adaptation=traced), sky)

    def _step_sensor(self, samples: AidingSamples | RangeSamples) -> None:
        """One sensor's arrival, behind what waits for it."""
        place = self._aiding.place
        if isinstance(samples, MagSamples) and self._aiding.waits(samples):
            return
        if isinstance(samples, GnssSamples) and place.waiting:
            # Heading at the start comes from these: they go in before the fix does.
            for mag in place.released(samples):
                self._step_aids(mag)
        self._step_aids(samples)

    def step_block(self, imu: ImuSamples, aids: Sequence[AidingSamples]) -> Outputs:
        """Take inertial samples and the aiding that arrived among them, as their ``seq`` says.

        Samples of units beside the first are among ``aids``. The same bits as :meth:`step` of one
        arrival after the other, for a fraction of the time where much of the aiding is late.
        """
        if self.fusion is not None and not isinstance(imu, FusedImu):
            units = [imu, *(a for a in aids if isinstance(a, ImuSamples))]
            fused, told = self.fusion.take(units)
            others = [a for a in aids if not isinstance(a, ImuSamples)]
            return also(self.step_block(fused, others), told)
        t, rows = self._inertial.rows(imu)
        head = self._head
        place = self._aiding.place
        waiting = place.waiting or (self.config.mag.use and place.declination is None)
        plain = self.config.gnss.position and not waiting
        if not (plain and in_order(t, head) and math.isfinite(rows.sum())):
            return self._one_by_one(imu, aids)
        self.counters.imu += len(t)
        self._inertial.watch(t, rows)
        heads = np.concatenate(([NEVER if head is None else head], t))
        late: list[tuple[int, int, Admitted]] = []
        self.counters.aids += sum(len(samples) for samples in aids)
        prepared, sky = self._ranges.take(aids)
        for samples in prepared:
            at = np.searchsorted(imu.seq, samples.seq)
            admitted = self._admit(samples, heads[at])
            if admitted is None:
                continue
            behind = admitted.late
            admitted.take(~behind).put(self._aids)
            back = admitted.take(behind)
            at, seq = at[back.index], samples.seq[back.index]
            late += [
                (int(seq[part.start]), int(at[part.start]), back.take(part))
                for part in together(seq, back.t)
            ]
        late.sort(key=lambda one: one[0])
        self._walk_between(t, rows, late)
        return _with_sky(self._drain(), sky)

    def finish(self) -> Outputs:
        """Settle everything: the run has ended."""
        self._finished = True
        return self._drain(final=True)

    def smooth(self) -> Outputs:
        """Smoothed epochs that are due by now, where ``[smoothing]`` is on; and nothing else.

        To be called after a step, when its outputs are on their way, and after :meth:`finish`. How
        often changes nothing of what comes out.
        """
        return self.on_line.take(self.filter.phases, self._horizon(self._finished))

    def tapes(self) -> list[Tape]:
        """What was recorded for a smoother, a tape for each stretch without a declared break.

        Once, after :meth:`finish`.
        """
        return [*self._tapes, *self.filter.tapes()]

    def stretches(self) -> list[Stretch]:
        """The inputs that were kept, a stretch between two declared breaks each."""
        return [*self._stretches, *self.filter.stretches]

    @property
    def digest(self) -> str:
        """Hash over the bits of the settled solution so far."""
        return self._outlet.digest(self.filter.rows, self._horizon(self._finished))

    @property
    def digest_published(self) -> str:
        """Hash over everything published, in order."""
        return self._outlet.digest_published

    @property
    def digest_smoothed(self) -> str | None:
        """Hash over everything smoothed on line, in order; None without a smoother."""
        return self.on_line.digest

    @property
    def reached_ns(self) -> int | None:
        """Time of validity of the last inertial sample taken; None before the first."""
        return self._head

    # ------------------------------------------------------------------ inertial samples

    @property
    def _head(self) -> int | None:
        return int(self._imu.t[self._imu.end - 1]) if len(self._imu) else None

    def _step_imu(self, block: ImuSamples) -> Outputs:
        t, rows = self._inertial.rows(block)
        self.counters.imu += len(t)
        self._inertial.watch(t, rows)
        t, rows = self._inertial.finite(t, rows)
        if in_order(t, self._head):
            self._imu.append(t, rows)
            self.filter.advance(self._imu, self._aids)
            return self._drain()
        parts: list[Outputs] = []
        while len(t):
            good, t, rows = self._inertial.stretch(t, rows, self._head)
            for a in range(0, len(good.t), CHUNK):
                self._imu.append(good.t[a : a + CHUNK], good.rows[a : a + CHUNK])
                self.filter.advance(self._imu, self._aids)
                parts.append(self._drain())
            if good.restart is not None:
                parts.append(self._restart(*good.restart))
        return join(parts)

    def _restart(self, last: int, now: int) -> Outputs:
        """The IMU's clock jumped back: settle what was, begin again on the new clock."""
        out = self._drain(final=True)
        self.on_line.keep(self.filter.phases, self._horizon(final=True))
        resets = self.filter.resets
        self._tapes += self.filter.tapes()
        self._stretches += self.filter.stretches
        self.filter = new_estimator(self.config, self._record)
        self.filter.phases[0].resets = resets + 1
        self._imu.clear()
        self._aids.clear()
        self._outlet.restart()
        event = Event(
            now,
            "clock-back",
            f"IMU clock jumped back by {(last - now) / NS:.1f} s: estimator restarted",
            "warning",
        )
        return join(
            [out, Outputs(Solution.empty(), Solution.empty(), AidingReports.empty(), (event,))]
        )

    # ------------------------------------------------------------------ aiding

    def _admit(self, samples: AidingSamples | RangeSamples, heads: I64) -> Admitted | None:
        return self._aiding.admit(samples, heads, started=bool(self.filter.phases[-1].filters))

    def _step_aids(self, samples: AidingSamples | RangeSamples) -> None:
        head = self._head
        admitted = self._admit(samples, np.full(len(samples), NEVER if head is None else head))
        if admitted is None:
            return
        admitted.put(self._aids)
        late = admitted.late
        if late.any():
            back = admitted.take(np.flatnonzero(late))
            mark, until = self.filter.reports.end, self.filter.now[0]
            self.counters.late_fused += len(back.t)
            self.counters.rewinds += 1
            self.filter.rewind(int(back.t.min()))
            self.filter.advance(self._imu, self._aids)
            self._keep_new_reports(mark, until, back)
            # A late first fix begins in the past: what that reaches is published as of now, and not
            # as of the next aid that comes before an inertial sample does.
            self._outlet.publish(self.filter)

    def _walk_between(self, t: I64, rows: F64, late: list[tuple[int, int, Admitted]]) -> None:
        """Walk new inertial samples; at the place of each late aid, go back for it.

        ``late``: arrival number, place among the samples, and the aid; in order of arrival.
        """
        self._imu.append(t, rows)
        end = self._imu.end
        begin = end - len(t)
        back: Admitted | None = None
        mark = until = 0
        for _, place, aid in late:
            if back is not None or place > 0:
                self._imu.end = begin + place
                self._advance(back, mark, until)
            back, mark, until = aid, self.filter.reports.end, self.filter.now[0]
            aid.put(self._aids)
            # The way forward again is walked together with what comes next.
            self.filter.rewind(int(aid.t[0]))
        self._imu.end = end
        self._advance(back, mark, until)

    def _advance(self, back: Admitted | None, mark: int, until: int) -> None:
        """Walk to the end of the samples and publish; after going back, drop repeated reports."""
        self.filter.advance(self._imu, self._aids)
        if back is not None:
            self.counters.late_fused += 1
            self.counters.rewinds += 1
            self._keep_new_reports(mark, until, back)
        self._outlet.publish(self.filter)

    def _keep_new_reports(self, mark: int, until: int, new: Admitted) -> None:
        """Of the reports walked again, keep only those of the aids that are new.

        Reports stand in order of time: those later than ``until`` are new, and stay.
        """
        buffer = self.filter.reports
        t = buffer.t[mark : buffer.end]
        count = int(t.searchsorted(until, side="right"))
        if count == 0:
            return
        rows = buffer.rows[mark : mark + count]
        channels = map(int, rows[:, up.R_CHANNEL].tolist())
        said = zip(channels, t[:count].tolist(), rows[:, up.R_SOURCE].tolist(), strict=True)
        times, sources = set(new.t.tolist()), set(new.source.tolist())
        # A handful, hundreds of times a minute: lists are faster than columns here.
        kept = [
            at
            for at, (channel, when, source) in enumerate(said)
            if _KIND_OF_CHANNEL[channel] == new.kind and when in times and source in sources
        ]
        if len(kept) == count:
            return
        stay = [*kept, *range(count, len(t))]
        end = mark + len(stay)
        buffer.t[mark:end] = t[stay]
        buffer.rows[mark:end] = buffer.rows[mark : buffer.end][stay]
        buffer.end = end

    def _one_by_one(self, imu: ImuSamples, aids: Sequence[AidingSamples]) -> Outputs:
        """A block's arrivals each in a step of its own."""
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
        return join(parts)

    # ------------------------------------------------------------------ out

    def _horizon(self, final: bool) -> int:
        """Nothing valid up to this time [ns] can change any more."""
        if final:
            return int(np.iinfo(np.int64).max)
        head = self._head
        return NEVER if head is None else head - self._ring_ns - 1

    @property
    def _nothing_to_report(self) -> bool:
        return not (self._aiding.refused or len(self.filter.reports))

    def _reports(self) -> tuple[AidingReports, AdaptationTrace]:
        traced = trace(self.filter.reports)
        return reports(self.filter.reports, self._aiding.take_refusals()), traced

    def _drain(self, final: bool = False) -> Outputs:
        """What is new and, behind the delay ring or at the end, what is settled."""
        self._outlet.publish(self.filter)
        head = self._head
        if head is None or abs(head - self._forgot_ns) > FORGET_NS:
            self._forget(head)
        if not final and self._outlet.silent and self._nothing_to_report:
            # One sample a call: most calls end here. What has settled comes with the next epoch.
            return NOTHING
        horizon = self._horizon(final)
        said, traced = self._reports()
        return Outputs(
            self._outlet.published(),
            self._outlet.settled(self.filter.rows, horizon),
            said,
            (*self._outlet.events(self.filter, horizon), *self._inertial.events(final)),
            adaptation=traced,
        )

    def _forget(self, head: int | None) -> None:
        """Let go of what nothing will need again."""
        if head is not None:
            self._forgot_ns = head
            self._imu.forget(head - self._keep_imu_ns)
            self._aids.forget(head - self._ring_ns - KEEP_NS)
        if len(self._aids) > 1:
            self._aids.forget(int(self._aids.t[self._aids.end - 1]) - WAITING_NS)


def _with_sky(out: Outputs, sky: Said) -> Outputs:
    """What a step gave out, and what the stream of raw measurements had to say."""
    if sky is SILENT:
        return out
    return replace(
        out,
        events=(*out.events, *sky.events),
        adaptation=AdaptationTrace.concatenate([out.adaptation, sky.adaptation]),
        satellites=sky.satellites,
    )
