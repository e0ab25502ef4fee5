"""The direct kinematic filter through all its phases, behind the same calls as the error-state one.

Phases as there: *aligning*, *heading unknown* (a bank over headings), *running*. Nothing depends on
how the sorted samples are cut into calls, and going back restores a snapshot.
"""

from __future__ import annotations

import math

import numpy as np

from companion.config import DEG, Config
from companion.estimation import bank, recovery
from companion.estimation import parameters as common
from companion.estimation import walk as w
from companion.estimation.buffers import SampleBuffer
from companion.estimation.direct import layout as lo
from companion.estimation.direct import transitions
from companion.estimation.direct.start import Setup, align
from companion.estimation.direct.walk import walk
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.phases import Check, Phase
from companion.estimation.recording import Tape
from companion.estimation.stretch import Stretch
from companion.estimation.update import REPORT_SIZE
from companion.navigation.rotation import matrix_from_quat, rpy_from_quat
from companion.types import I64, NS, CompanionError, Event, Mode

_SWITCHES = {
    transitions.LINEAR: ("motion-linear", "step of forward specific force"),
    transitions.CIRCULAR_BEGINS: ("motion-circular", "step of lateral specific force: turning"),
    transitions.CIRCULAR_ENDS: ("motion-straight", "lateral specific force steps back: straight"),
}


class DirectFilter:
    """Walks sorted inertial samples and aids; can be taken back inside the delay ring."""

    def __init__(self, config: Config, record: str = "no") -> None:
        if record != "no":
            raise CompanionError(
                "the smoother needs the error-state filter; this run uses the direct one "
                "(engine.estimator, or an IMU below 20 Hz)"
            )
        self.setup = Setup(config)
        self.phases = [Phase(np.iinfo(np.int64).min, Mode.ALIGNING)]
        self.rows = SampleBuffer(ROW_SIZE)
        self.reports = SampleBuffer(REPORT_SIZE)
        self.events: list[Event] = []
        self.stretches: list[Stretch] = []
        """None: a smoother has no use for this filter's steps."""

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
    def started(self) -> bool:
        """Whether there is a state."""
        return bool(self.phases[-1].filters)

    @property
    def resets(self) -> int:
        """Declared resets so far."""
        phase = self.phases[-1]
        return int(phase.filters[0].k[lo.RESETS]) if phase.filters else phase.resets

    def tapes(self) -> list[Tape]:
        """None: a smoother has no use for this filter's steps."""
        return []

    def rewind(self, t: int) -> None:
        """Forget everything that happened at ``t`` or later."""
        while len(self.phases) > 1 and self.phases[-1].start_ns >= t:
            self.phases.pop()
        phase = self.phases[-1]
        for f in phase.filters:
            f.restore(t)
        phase.reached = min(phase.reached, t - 1)
        reached = max(self.now)
        phase.checks = [c for c in phase.checks if c.t_ns <= reached] or phase.checks[:1]
        self.rows.end = self.rows.after(reached)
        self.events = [e for e in self.events if e.t_ns <= reached]

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
                self._enter(align(self.setup, phase, imu, aids, j))
                continue
            stop = imu.end
            if phase.mode is Mode.HEADING_UNKNOWN:
                stop = imu.after((int(imu.t[i]) // w.CHECK_NS + 1) * w.CHECK_NS - 1)
            code = self._walk(phase, imu, aids, i, stop, j)
            t_imu = self.now[0]
            if code == w.STOP_CHECK:
                for f in phase.filters:
                    f.k[lo.T_CHECK] = t_imu
                self._decide(phase, t_imu, aids)
            elif code == w.STOP_GAP:
                back = int(imu.t[imu.after(t_imu)])
                gap = (back - t_imu) / NS
                text = f"IMU silent for {gap:.1f} s, longer than can be bridged: beginning anew"
                self._reset(back, "imu-gap", text)
            elif code == w.STOP_BROKEN:
                text = "state or covariance not finite: beginning anew"
                self._reset(t_imu + 1, "broken", text, drop=True)

    def _walk(
        self, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, i: int, stop: int, j: int
    ) -> int:
        setup = self.setup
        many = phase.mode is Mode.HEADING_UNKNOWN
        ip = setup.ipar_bank if many else setup.ipar
        span = int(imu.t[stop - 1]) - self.now[1] if stop > i else 0
        n_rows = max(span, 0) // int(ip[common.OUTPUT_NS]) + 2 + (stop - i)
        n_reports = 5 * (aids.end - j) + 3 * (stop - i)
        best = phase.checks[-1].best
        switches = np.zeros((stop - i, 2), np.int64)
        code, first = w.DONE, self.rows.end
        for index, f in enumerate(phase.filters):
            mine = index == best
            rows = self.rows if mine else SampleBuffer(ROW_SIZE, capacity=n_rows)
            reports = self.reports if mine else SampleBuffer(REPORT_SIZE, capacity=n_reports)
            rows._room(n_rows)
            reports._room(n_reports)
            if mine:
                first = rows.end
            at = np.array([i, stop, j, aids.end, rows.end, reports.end, 0], np.int64)
            c = walk(
                f.s, f.k, setup.lay, setup.par, ip, setup.units, setup.slow,
                imu.t, imu.rows, aids.t, aids.key, aids.rows,
                rows.t, rows.rows, reports.t, reports.rows, f.snaps, f.snaps_k, switches, at,
            )  # fmt: skip
            rows.end, reports.end = int(at[4]), int(at[5])
            code = max(code, int(c))
            if mine:
                self._note_switches(switches[: int(at[6])])
        if many:
            bank.widen_heading(phase, self.rows.rows[first : self.rows.end])
        return code

    def _note_switches(self, switches: I64) -> None:
        for t, which in switches.tolist():
            kind, text = _SWITCHES[which]
            self.events.append(Event(t, kind, text + "; acceleration taken anew from the IMU"))

    # ------------------------------------------------------------------ phases

    def _reset(self, t: int, kind: str, text: str, *, drop: bool = False) -> None:
        """Declared reset: back to aligning from ``t`` on, keeping the biases unless ``drop``."""
        old = self.phases[-1]
        prior = None if drop or not old.filters else old.filters[0]
        resets = self.resets + 1
        self.phases.append(Phase(t, Mode.ALIGNING, prior=prior, resets=resets, reached=t - 1))
        self.events.append(Event(t, kind, text, "error" if drop else "warning"))

    def _enter(self, change: tuple[Phase, Event] | None) -> None:
        if change is not None:
            self.phases.append(change[0])
            self.events.append(change[1])

    def _decide(self, phase: Phase, t: int, aids: SampleBuffer) -> None:
        """Decisions on the grid: heading found, diverged, relock."""
        if phase.mode is Mode.HEADING_UNKNOWN:
            self._enter(self._find_heading(phase, t))
            return
        f = phase.filters[0]
        P = self.setup.covariance(f.s)
        if P[0, 0] + P[1, 1] > self.setup.par[common.DIVERGED_VAR]:
            self._reset(t + 1, "diverged", "position uncertainty beyond use: beginning anew")
        elif len(recovery.agreeing_fixes(aids, t)):
            seconds = self.setup.config.engine.gate_relock_s
            text = f"fixes that agree among themselves were refused for {seconds:.0f} s"
            self._reset(t + 1, "relocked", f"{text}: beginning anew at them")

    def _find_heading(self, phase: Phase, t: int) -> tuple[Phase, Event] | None:
        """Judge the bank at ``t``: the phase of its likeliest filter once the heading is known."""
        states = [f.s for f in phase.filters]
        best, sd, _ = bank.mixture(
            np.array([s[lo.LOG_LIKELIHOOD] for s in states]),
            np.array([s[lo.BANK_NIS] / max(s[lo.BANK_DOF], 1.0) for s in states]),
            np.array([rpy_from_quat(s[:4])[2] for s in states]),
            np.array([self.setup.yaw_variance(s) for s in states]),
        )
        phase.checks = [*phase.checks[-8:], Check(t, best, sd)]
        if sd > self.setup.config.alignment.heading_found_sd_deg * DEG:
            return None
        f = phase.filters[best]
        s, k = f.s.copy(), f.k.copy()
        widened = max(sd * sd - self.setup.yaw_variance(s), 0.0)
        down = matrix_from_quat(s[:4])[2]
        P = self.setup.covariance(s)
        P[lo.ATT : lo.ATT + 3, lo.ATT : lo.ATT + 3] += widened * down[:, None] * down[None, :]
        s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = 0.0
        new = Phase(t + 1, Mode.NAVIGATING, [self.setup.new_filter(s, k)], resets=phase.resets)
        new.checks = [Check(t)]
        yaw = math.degrees(rpy_from_quat(s[:4])[2]) % 360
        text = (
            f"heading {yaw:.0f}° ± {math.degrees(sd):.1f}° found from motion "
            f"{(t - phase.start_ns) / NS:.1f} s after the start"
        )
        return new, Event(t, "heading-found", text)
