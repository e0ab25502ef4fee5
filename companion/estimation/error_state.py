"""The loosely coupled error-state filter through all its phases, in the order of validity.

Phases: *aligning* (no state yet), *heading unknown* (a bank of filters over headings), *running*
(one filter). A phase is entered at a time; going back in time leaves the phases entered after it
and restores a snapshot of the one before. What comes out depends on the sorted samples alone.

Kamil et al. 2014 (filter); Sasiadek & Hartana 2004 (feedforward, feedback).
"""

from __future__ import annotations

import numpy as np

from companion.config import Config
from companion.estimation import bank, recovery, start
from companion.estimation import parameters as par
from companion.estimation import walk as w
from companion.estimation.buffers import SampleBuffer
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.phases import Filter, Phase, Setup
from companion.estimation.recording import Recording, Tape, nothing
from companion.estimation.stretch import Stretch
from companion.estimation.update import REPORT_SIZE
from companion.navigation import layout as lo
from companion.types import F64, NS, Event, Mode


class ErrorStateFilter:
    """Walks sorted inertial samples and aids; can be taken back inside the delay ring."""

    def __init__(self, config: Config, record: Recording = "no") -> None:
        self.setup = Setup(config, record)
        self.phases = [Phase(np.iinfo(np.int64).min, Mode.ALIGNING)]
        self.rows = SampleBuffer(ROW_SIZE)
        self.reports = SampleBuffer(REPORT_SIZE)
        self._unread = SampleBuffer(ROW_SIZE), SampleBuffer(REPORT_SIZE)
        """What filters of the bank put out beside the one that is published."""
        self.events: list[Event] = []
        self.stretches: list[Stretch] = []
        """Inputs between declared breaks, where they are kept."""

    # ------------------------------------------------------------------ time

    @property
    def now(self) -> tuple[int, int]:
        """(time of the last inertial sample taken, time up to which aids are taken)."""
        phase = self.phases[-1]
        if not phase.filters:
            return phase.reached, phase.reached
        k = phase.filters[0].k
        return int(k[lo.T_IMU]), int(k[lo.T_NOW])

    @property
    def resets(self) -> int:
        """Declared resets so far."""
        phase = self.phases[-1]
        return int(phase.filters[0].k[lo.RESETS]) if phase.filters else phase.resets

    def rewind(self, t: int) -> None:
        """Forget everything that happened at ``t`` or later.

        Not in a recorded run: its tape goes one way.
        """
        if self.setup.recorded:
            raise AssertionError("late aiding in a recorded run")
        while len(self.phases) > 1 and self.phases[-1].start_ns >= t:
            self.phases.pop()
        phase = self.phases[-1]
        for f in phase.filters:
            f.restore(t)
        phase.reached = min(phase.reached, t - 1)
        imu_time = self.now[0]
        phase.checks = [c for c in phase.checks if c.t_ns <= imu_time] or phase.checks[:1]
        self.rows.end = self.rows.after(imu_time)
        self.events = [e for e in self.events if e.t_ns <= imu_time]

    def tapes(self) -> list[Tape]:
        """What was recorded, a tape for each stretch without a declared break; closes them."""
        found: list[Tape] = []
        for phase in self.phases:
            best = phase.checks[-1].best if phase.mode is Mode.HEADING_UNKNOWN else 0
            for f in phase.filters[best : best + 1]:
                if isinstance(f.tape, Tape):
                    f.tape.cut(f.s, f.k)
                    found.append(f.tape)
        return found

    # ------------------------------------------------------------------ walking

    def advance(self, imu: SampleBuffer, aids: SampleBuffer) -> None:
        """Take everything in ``imu`` that is new, and the aids up to its end."""
        while True:
            t_imu, t_aid = self.now
            i, j = imu.after(t_imu), aids.after(t_aid)
            if i >= imu.end:
                return
            phase = self.phases[-1]
            if phase.mode is Mode.ALIGNING:
                self._enter(start.align(self.setup, phase, imu, aids, j))
                continue
            # The bank takes turns of one cell of the grid; one filter walks to the end.
            stop = imu.end
            if phase.mode is Mode.HEADING_UNKNOWN:
                stop = imu.after((int(imu.t[i]) // w.CHECK_NS + 1) * w.CHECK_NS - 1)
            code = self._walk(phase, imu, aids, i, stop, j)
            if code == w.DONE and stop == imu.end:
                return
            if code == w.STOP_CHECK:
                # Between the last sample of a cell and the first of the next.
                t_imu = self.now[0]
                for f in phase.filters:
                    f.k[lo.T_CHECK] = t_imu
                self._decide(phase, t_imu, aids)
            elif code == w.STOP_GAP:
                t_imu = self.now[0]
                gap = (int(imu.t[imu.after(t_imu)]) - t_imu) / NS
                self._reset(
                    int(imu.t[imu.after(t_imu)]),
                    "imu-gap",
                    f"IMU silent for {gap:.2f} s, longer than can be bridged: realigning",
                )
            elif code == w.STOP_BROKEN:
                self._reset(
                    self.now[0] + 1,
                    "broken",
                    "state or covariance not finite: realigning",
                    drop=True,
                )

    def _walk(
        self, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, i: int, stop: int, j: int
    ) -> int:
        span = int(imu.t[stop - 1] - imu.t[i]) if stop > i else 0
        setup = self.setup
        many = phase.mode is Mode.HEADING_UNKNOWN
        ip = setup.ipar_bank if many else setup.ipar
        n_rows = min(stop - i, span // setup.output_ns + 2)
        m = aids.end - j
        constraints = 2 * (span // setup.still_ns + 2)
        if setup.constraint_ns:
            constraints += span // setup.constraint_ns + 2
        # At most three a sample, however far apart their stamps are.
        n_reports = 7 * m + min(constraints, 3 * (stop - i))
        n_steps = m + n_reports + span // setup.covariance_ns + 2
        best = phase.checks[-1].best
        since = int(phase.filters[best].k[lo.T_NOW])
        taken = i, j
        code = w.DONE
        told: list[F64] = []
        for index, f in enumerate(phase.filters):
            rows, reports = (self.rows, self.reports) if index == best else self._unread
            rows._room(n_rows)
            reports._room(n_reports)
            at = np.array([i, stop, j, aids.end, rows.end, reports.end], np.int64)
            tape = nothing(f.k)
            if f.tape is not None:
                tape = f.tape.recorder(f.k, min(n_steps, stop - i + m), 3 * n_reports, n_rows)
            c = w.walk(
                f.s, f.k, setup.lay, setup.par, ip,
                imu.t, imu.rows, aids.t, aids.key, aids.rows,
                rows.t, rows.rows, reports.t, reports.rows, f.snaps, f.snaps_k, at, tape,
            )  # fmt: skip
            if f.tape is not None:
                new = slice(rows.end, int(at[4]))
                f.tape.wrote(rows.t[new], rows.rows[new], f.s, f.k)
            first, rows.end, reports.end = rows.end, int(at[4]), int(at[5])
            code = max(code, int(c))
            if many:
                told.append(rows.rows[first : rows.end].copy())
            if index == best:
                taken = int(at[0]), int(at[2])
            else:
                rows.clear()
                reports.clear()
        if setup.keeps_inputs:
            self._keep(phase.filters[best], since, imu, (i, taken[0]), aids, (j, taken[1]), many)
        if many:
            published = self.rows.rows[self.rows.end - len(told[best]) : self.rows.end]
            bank.widen_heading(phase, published)
            bank.widen_rest(phase, published, told)
        return code

    def _keep(
        self,
        f: Filter,
        since: int,
        imu: SampleBuffer,
        samples: tuple[int, int],
        aids: SampleBuffer,
        aid: tuple[int, int],
        many: bool,
    ) -> None:
        """Keep what a walk from ``since`` on took; a filter of the bank may be the wrong one."""
        resets = int(f.k[lo.RESETS])
        if not self.stretches or self.stretches[-1].resets != resets:
            self.stretches.append(Stretch(since, resets))
        self.stretches[-1].took(imu, samples, aids, aid)
        if not many:
            self.stretches[-1].stands(f.s, f.k)

    # ------------------------------------------------------------------ phases

    def _reset(self, t: int, kind: str, text: str, *, drop: bool = False) -> None:
        """Declared reset: back to aligning from ``t`` on, keeping the biases unless ``drop``."""
        old = self.phases[-1]
        prior = None if drop or not old.filters else old.filters[0]
        self.phases.append(
            Phase(t, Mode.ALIGNING, prior=prior, resets=self.resets + 1, reached=t - 1)
        )
        self.events.append(Event(t, kind, text, "error" if drop else "warning"))

    def _enter(self, change: tuple[Phase, Event] | None) -> None:
        if change is not None:
            self.phases.append(change[0])
            self.events.append(change[1])

    def _decide(self, phase: Phase, t: int, aids: SampleBuffer) -> None:
        """Decisions on the grid: heading found, diverged, relock."""
        if phase.mode is Mode.HEADING_UNKNOWN:
            self._enter(bank.find_heading(self.setup, phase, t))
            return
        P = self.setup.covariance(phase.filters[0].s)
        if P[0, 0] + P[1, 1] > self.setup.par[par.DIVERGED_VAR]:
            self._reset(t + 1, "diverged", "position uncertainty beyond use: realigning")
        else:
            change, events = recovery.decide(self.setup, phase, t, aids)
            if change is not None:
                self.phases.append(change)
            self.events.extend(events)
