"""The loosely coupled error-state filter through all its phases, in the order of validity.

Phases: *aligning* (no state yet), *heading unknown* (a bank of filters over headings), *running*
(one filter). A phase is entered at a time; going back in time leaves the phases entered after it
and restores a snapshot of the one before. What comes out depends on the sorted samples alone.

Kamil et al. 2014 (filter); Sasiadek & Hartana 2004 (feedforward, feedback).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from companion.config import DEG, Config
from companion.estimation import parameters as par
from companion.estimation import walk as w
from companion.estimation.buffers import SampleBuffer
from companion.estimation.recording import Recording, Tape, nothing
from companion.estimation.update import REPORT_SIZE
from companion.navigation import layout as lo
from companion.navigation.alignment import (
    Level,
    attitude_covariance,
    heading_from_field,
    level,
)
from companion.navigation.earth import RATE, earth_rate_n, gravity, ned_difference
from companion.navigation.rotation import matrix_from_quat, quat_from_rpy, rotate_nav, rpy_from_quat
from companion.types import F64, I64, NS, Event, Mode

MAG_AGE_NS = NS
RELOCK_FIXES = 4
LOST_TILT_SD = math.radians(3.0)
OVERLAP = 2.0
"""Neighbouring innovations share errors: half of their evidence on the heading is repetition."""


@dataclass(slots=True)
class Filter:
    """One error-state filter: state, its snapshots, and the state it began with."""

    s: F64
    k: I64
    snaps: F64
    snaps_k: I64
    first: tuple[F64, I64]
    tape: Tape | None = None
    """What a smoother reads; only in a run without late aiding, which would have to rewind it."""

    @classmethod
    def start(cls, s: F64, k: I64, slots: int, tape: Tape | None = None) -> Filter:
        if tape is not None:
            tape.begin(s, k)
        return cls(
            s,
            k,
            np.zeros((slots, len(s))),
            np.full((slots, len(k)), np.iinfo(np.int64).min),
            (s.copy(), k.copy()),
            tape,
        )

    def restore(self, before: int) -> None:
        """Back to the newest snapshot older than ``before``, or to the beginning."""
        times = self.snaps_k[:, lo.T_NOW]
        good = np.flatnonzero(times < before)
        slot = int(good[np.argmax(times[good])]) if len(good) else -1
        if slot >= 0 and times[slot] > np.iinfo(np.int64).min:
            self.s[:], self.k[:] = self.snaps[slot], self.snaps_k[slot]
        else:
            self.s[:], self.k[:] = self.first
        self.snaps_k[times >= before] = np.iinfo(np.int64).min


@dataclass(frozen=True, slots=True)
class Check:
    """A decision on the grid and, in the bank, what it published from then on."""

    t_ns: int
    best: int = 0
    """Likeliest hypothesis."""
    heading_sd: float = 0.0
    """Standard deviation of the heading over all hypotheses [rad]."""


@dataclass(slots=True)
class Phase:
    """A stretch of time in one mode; ``filters`` is empty while aligning, several in the bank."""

    start_ns: int
    mode: Mode
    filters: list[Filter] = field(default_factory=list)
    prior: Filter | None = None
    """The filter before a declared reset: its biases are still the best known."""
    resets: int = 0
    checks: list[Check] = field(default_factory=list)
    """Decisions taken so far, newest last; the first is the start of the phase."""
    reached: int = 0
    """Aligning only: time of the last sample taken."""


class ErrorStateFilter:
    """Walks sorted inertial samples and aids; can be taken back inside the delay ring."""

    def __init__(self, config: Config, record: Recording = "no") -> None:
        self.config = config
        self._record = record
        self.layout = par.layout(config)
        self._lay = self.layout.vector()
        self._par = par.parameter_vector(config)
        self._ipar = par.integer_vector(config)
        bank = self._ipar.copy()
        bank[par.BANK] = 1
        bank[par.BASE_MODE] = Mode.HEADING_UNKNOWN
        self._ipar[par.BASE_MODE] = Mode.NAVIGATING
        self._ipar_bank = bank
        ring_ns = round(config.engine.delay_ring_s * NS)
        self._slots = ring_ns // int(self._ipar[par.SNAPSHOT_NS]) + 3
        self.phases = [Phase(np.iinfo(np.int64).min, Mode.ALIGNING)]
        self.rows = SampleBuffer(w.ROW_SIZE)
        self.reports = SampleBuffer(REPORT_SIZE)
        self.events: list[Event] = []

    # ------------------------------------------------------------------ time

    @property
    def now(self) -> tuple[int, int]:
        """(time of the last inertial sample taken, time up to which aids are taken)."""
        phase = self.phases[-1]
        if not phase.filters:
            return phase.reached, phase.reached
        k = phase.filters[0].k
        return int(k[lo.T_IMU]), int(k[lo.T_NOW])

    def rewind(self, t: int) -> None:
        """Forget everything that happened at ``t`` or later."""
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
                self._align(phase, imu, aids, j)
                continue
            # The bank takes turns of one cell of the grid; one filter walks to the end.
            stop = imu.end
            if phase.mode is Mode.HEADING_UNKNOWN:
                stop = imu.after((int(imu.t[i]) // w.CHECK_NS + 1) * w.CHECK_NS - 1)
            code = self._walk(phase, imu, aids, i, stop, j)
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
        ip = self._ipar
        n_rows = min(stop - i, span // int(ip[par.OUTPUT_NS]) + 2)
        m = aids.end - j
        constraints = 2 * (span // int(ip[par.STILL_NS]) + 2)
        if ip[par.CONSTRAINT_NS]:
            constraints += span // int(ip[par.CONSTRAINT_NS]) + 2
        # At most three a sample, however far apart their stamps are.
        n_reports = 5 * m + min(constraints, 3 * (stop - i))
        n_steps = m + n_reports + span // int(ip[par.COVARIANCE_NS]) + 2
        bank = phase.mode is Mode.HEADING_UNKNOWN
        best = phase.checks[-1].best
        code, new_rows = w.DONE, 0
        for index, f in enumerate(phase.filters):
            rows = self.rows if index == best else SampleBuffer(w.ROW_SIZE, capacity=n_rows)
            reports = (
                self.reports if index == best else SampleBuffer(REPORT_SIZE, capacity=n_reports)
            )
            rows._room(n_rows)
            reports._room(n_reports)
            at = np.array([i, stop, j, aids.end, rows.end, reports.end], np.int64)
            tape = nothing(f.k)
            if f.tape is not None:
                tape = f.tape.recorder(f.k, min(n_steps, stop - i + m), 3 * n_reports, n_rows)
            c = w.walk(
                f.s, f.k, self._lay, self._par, self._ipar_bank if bank else ip,
                imu.t, imu.rows, aids.t, aids.key, aids.rows,
                rows.t, rows.rows, reports.t, reports.rows, f.snaps, f.snaps_k, at, tape,
            )  # fmt: skip
            if f.tape is not None:
                new = slice(rows.end, int(at[4]))
                f.tape.wrote(rows.t[new], rows.rows[new], f.s, f.k)
            new_rows = int(at[4]) - rows.end if index == best else new_rows
            rows.end, reports.end = int(at[4]), int(at[5])
            code = max(code, int(c))
        if bank:
            self._widen_heading(phase, self.rows.end - new_rows)
        return code

    # ------------------------------------------------------------------ phases

    def _filter(self, s: F64, k: I64) -> Filter:
        """A new filter, with a tape of its own where the run is recorded."""
        tape = None
        if self._record != "no":
            tape = Tape(self.layout.n, self._record == "covariance")
        return Filter.start(s, k, self._slots, tape)

    def _say(self, t: int, kind: str, text: str, level: str = "info") -> None:
        self.events.append(Event(t, kind, text, level))  # type: ignore[arg-type]

    def _reset(self, t: int, kind: str, text: str, *, drop: bool = False) -> None:
        """Declared reset: back to aligning from ``t`` on, keeping the biases unless ``drop``."""
        old = self.phases[-1]
        prior = None if drop or not old.filters else old.filters[0]
        self.phases.append(
            Phase(t, Mode.ALIGNING, prior=prior, resets=self._resets(old) + 1, reached=t - 1)
        )
        self._say(t, kind, text, "error" if drop else "warning")

    @staticmethod
    def _resets(phase: Phase) -> int:
        return int(phase.filters[0].k[lo.RESETS]) if phase.filters else phase.resets

    def _align(self, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, j: int) -> None:
        """Look for the first fix that a solution can start from; move on to the end otherwise."""
        last = int(imu.t[imu.end - 1])
        window_ns = round(self.config.alignment.window_s * NS)
        while j < aids.end and aids.t[j] <= last:
            t = int(aids.t[j])
            if aids.key[j, 0] == w.KIND_GNSS and np.all(np.isfinite(aids.rows[j, :3])):
                begin = max(t - window_ns, phase.start_ns)
                a, b = imu.after(begin - 1), imu.after(t)
                full = b > a and imu.t[a] <= t - int(0.9 * window_ns)
                if full and b - a >= 8 and t - int(imu.t[b - 1]) <= int(self._ipar[par.GAP_NS]):
                    self._begin(phase, imu, aids, a, b, j)
                    return
            j += 1
        phase.reached = last

    def _begin(
        self, phase: Phase, imu: SampleBuffer, aids: SampleBuffer, a: int, b: int, j: int
    ) -> None:
        """Start the filter or the bank at fix ``j``, levelled on samples ``a`` to ``b``."""
        cfg, t, fix = self.config, int(aids.t[j]), aids.rows[j]
        prior_var = par.initial_variances(cfg, self.layout)
        accel_bias, gyro_bias = self._known_biases(phase, prior_var)
        speed = math.hypot(fix[3], fix[4]) if np.isfinite(fix[3]) else math.nan
        slow = not speed > cfg.constraints.standstill_speed_mps + 2 * math.sqrt(fix[9])
        lev = level(
            imu.t[a:b],
            imu.rows[a:b],
            spread_gyro=self._par[par.STILL_GYRO],
            spread_accel=self._par[par.STILL_ACCEL],
            may_be_static=slow,
            gyro_psd=self._par[par.GYRO_PSD],
            accel_psd=self._par[par.ACCEL_PSD],
            prior_bias=gyro_bias,
            prior_var=prior_var[lo.GYRO_BIAS : lo.GYRO_BIAS + 3],
            accel_bias=accel_bias,
        )
        yaw, yaw_sd, slope, how = self._heading(lev, aids, j, speed)
        headings = [yaw]
        if how == "unknown":
            count = cfg.alignment.hypotheses
            headings = [2 * math.pi * m / count - math.pi for m in range(count)]
            yaw_sd = math.pi / count
        filters = [
            self._initial(
                lev, h, yaw_sd, slope, fix, imu, b, t, phase, prior_var, accel_bias, gyro_bias
            )
            for h in headings
        ]
        mode = Mode.HEADING_UNKNOWN if how == "unknown" else Mode.NAVIGATING
        new = Phase(t, mode, filters, resets=phase.resets)
        new.checks = [Check(t, 0, math.pi)]
        self.phases.append(new)
        state = "at rest" if lev.static else "in motion"
        heading = (
            "heading unknown, to be found from motion"
            if how == "unknown"
            else f"heading {math.degrees(yaw) % 360:.0f}° ± {math.degrees(yaw_sd):.0f}° from {how}"
        )
        self._say(
            t,
            "aligned",
            f"levelled {state}: roll {math.degrees(lev.roll):.1f}°, pitch "
            f"{math.degrees(lev.pitch):.1f}°; {heading}",
        )

    def _known_biases(self, phase: Phase, var: F64) -> tuple[F64, F64]:
        """Accelerometer and gyro bias before levelling; their variances in ``var`` (n,) follow.

        Configured at the first start, the old filter's after a declared reset.
        """
        old = phase.prior
        if old is None:
            return par.initial_biases(self.config)
        n = self.layout.n
        old_var = np.diag(old.s[lo.P :].reshape(n, n))
        # Its deviation doubled, for what a reset may hide; the turn-on one bounds it from above for
        # the accelerometer, whose bias is slow to find, and from below for the gyro.
        var[9:12] = np.minimum(np.maximum(var[9:12], old_var[9:12]), 4.0 * old_var[9:12])
        var[12:15] = np.maximum(var[12:15], 4.0 * old_var[12:15])
        # In feedforward mode the estimate is beside the nominal state.
        bias = old.s[lo.ACCEL_BIAS_B : lo.GYRO_BIAS_B + 3] + old.s[lo.DX + 9 : lo.DX + 15]
        return bias[:3], bias[3:]

    def _heading(
        self, lev: Level, aids: SampleBuffer, j: int, speed: float
    ) -> tuple[float, float, tuple[float, float], str]:
        """Heading [rad], its standard deviation, slope with tilt, and origin, at fix ``j``."""
        cfg = self.config
        wish = cfg.alignment.heading
        fix, t = aids.rows[j], int(aids.t[j])
        if wish == "fixed":
            fixed = cfg.alignment.fixed_heading_deg * DEG
            return fixed, cfg.mag.sd_deg * DEG, (0.0, 0.0), "configuration"
        if wish == "magnetometer" or (wish == "auto" and cfg.mag.use):
            for m in range(j, aids.start - 1, -1):
                if t - int(aids.t[m]) > MAG_AGE_NS:
                    break
                if aids.key[m, 0] == w.KIND_MAG:
                    row = aids.rows[m]
                    yaw, slope = heading_from_field(lev.roll, lev.pitch, row[:3], row[w.A_AZIMUTH])
                    return yaw, 2.0 * cfg.mag.sd_deg * DEG, slope, "magnetometer"
        if (wish == "course" or (wish == "auto" and cfg.constraints.course)) and (
            speed > cfg.constraints.course_min_speed_mps
        ):
            sd = math.hypot(cfg.constraints.course_sd_deg * DEG, math.sqrt(fix[9]) / speed)
            return math.atan2(fix[4], fix[3]), 2.0 * sd, (0.0, 0.0), "course"
        return 0.0, math.pi, (0.0, 0.0), "unknown"

    def _initial(
        self,
        lev: Level,
        yaw: float,
        yaw_sd: float,
        yaw_slope: tuple[float, float],
        fix: F64,
        imu: SampleBuffer,
        b: int,
        t: int,
        phase: Phase,
        prior_var: F64,
        accel_bias: F64,
        gyro_bias: F64,
    ) -> Filter:
        """The filter's first state at fix time ``t``."""
        n = self.layout.n
        s, k = np.zeros(self.layout.size), np.zeros(lo.INT_SIZE, np.int64)
        s[lo.Q : lo.Q + 4] = quat_from_rpy(lev.roll, lev.pitch, yaw)
        s[lo.LAT : lo.LAT + 3] = fix[:3]
        lever = np.array(self.config.gnss.lever_arm_b_m)
        s[lo.LEVER_B : lo.LEVER_B + 3] = lever
        s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = accel_bias
        s[lo.R_SCALE : lo.R_SCALE + lo.CHANNELS] = 1.0
        s[lo.EARTH_RATE] = RATE
        P = s[lo.P :].reshape(n, n)
        P[np.diag_indices(n)] = prior_var
        old = phase.prior
        if old is not None:
            for source, size in ((lo.BARO_BIAS, 1), (lo.STILL_LEARNED, 7)):
                s[source : source + size] = old.s[source : source + size]
        velocity = np.where(np.isfinite(fix[3:6]), fix[3:6], 0.0)
        still = lev.static and not np.isfinite(fix[3])
        unknown = (0.3 if still else 10.0, 0.3 if still else 10.0, 0.3 if lev.static else 3.0)
        s[lo.VEL_N : lo.VEL_N + 3] = velocity
        velocity_var = np.where(np.isfinite(fix[3:6]), fix[9:12], np.square(unknown))
        reach = float(lever @ lever)
        for m in range(3):
            P[m, m] = fix[6 + m] + reach
            P[3 + m, 3 + m] = velocity_var[m]
        g = gravity(float(fix[0]), float(fix[2]))
        attitude, cross = attitude_covariance(
            s[:4], prior_var[9:12], lev.tilt_var, yaw_sd * yaw_sd, g, yaw_slope
        )
        P[6:9, 6:9] = attitude
        P[6:9, 9:12] = cross
        P[9:12, 6:9] = cross.T
        bias, bias_var = lev.gyro_bias_b, lev.gyro_bias_var
        if lev.static:
            # Each heading says what of the mean rate is Earth's, as far as it is right itself.
            earth = earth_rate_n(float(fix[0]))
            bias = bias - (matrix_from_quat(s[:4]) * earth[:, None]).sum(axis=0)
            bias_var = bias_var + (RATE * min(yaw_sd, 1.0)) ** 2
            # What was known before counts by its variance.
            known = prior_var[12:15]
            bias = bias + bias_var / (bias_var + known) * (gyro_bias - bias)
            bias_var = bias_var * known / (bias_var + known)
        s[lo.GYRO_BIAS_B : lo.GYRO_BIAS_B + 3] = bias
        P[range(12, 15), range(12, 15)] = bias_var
        # rate and force at the fix, between the samples around it
        t0 = int(imu.t[b - 1])
        s[lo.LAST_GYRO : lo.LAST_GYRO + 6] = imu.rows[b - 1, :6]
        if b < imu.end and imu.rows[b, 6] == 0.0:
            part = (t - t0) / max(int(imu.t[b]) - t0, 1)
            s[lo.LAST_GYRO : lo.LAST_GYRO + 6] += part * (imu.rows[b, :6] - imu.rows[b - 1, :6])
        k[lo.T_NOW], k[lo.T_IMU], k[lo.HAVE_IMU] = t, t0, 1
        k[lo.T_POSITION_AID] = k[lo.T_VELOCITY_AID] = t
        if np.isfinite(fix[3]):
            s[lo.GNSS_SPEED] = math.hypot(fix[3], fix[4])
            s[lo.GNSS_SPEED_SD] = math.sqrt(fix[9])
            k[lo.T_GNSS_SPEED] = t
        k[lo.RESETS] = phase.resets
        for cell, period in (
            (lo.T_OUTPUT, par.OUTPUT_NS),
            (lo.T_COVARIANCE, par.COVARIANCE_NS),
            (lo.T_SNAPSHOT, par.SNAPSHOT_NS),
            (lo.STILL_CELL, par.STILL_NS),
        ):
            k[cell] = t // int(self._ipar[period])
        return self._filter(s, k)

    # ------------------------------------------------------------------ decisions on the grid

    def _decide(self, phase: Phase, t: int, aids: SampleBuffer) -> bool:
        """Heading found, relock, divergence; True when the phase changed."""
        if phase.mode is Mode.HEADING_UNKNOWN:
            return self._heading_found(phase, t)
        f = phase.filters[0]
        n = self.layout.n
        P = f.s[lo.P :].reshape(n, n)
        if P[0, 0] + P[1, 1] > self._par[par.DIVERGED_VAR]:
            self._reset(t + 1, "diverged", "position uncertainty beyond use: realigning")
            return True
        since = int(f.k[lo.T_REJECT])
        relock = bool(since) and t - since > self._ipar[par.RELOCK_NS]
        lost = f.s[lo.VELOCITY_FIT] > w.LOST_FIT and f.s[lo.GNSS_SPEED] > w.LOST_SPEED
        if not (relock or lost):
            return False
        fixes = self._agreeing_fixes(aids, t)
        if len(fixes) == 0:
            return False
        # Position alone can be off for long where a receiver erred; velocity that never fits means
        # that the attitude is wrong, and of the attitude it is the heading that nothing holds.
        if lost and self.config.alignment.heading != "fixed":
            self._relearn_heading(f, t, aids, fixes)
        else:
            self._relock(f, t, aids, fixes)
        return True

    def _mixture(self, phase: Phase) -> tuple[int, float]:
        """Likeliest hypothesis and the heading's standard deviation over all of them [rad]."""
        n = self.layout.n
        ll = np.array([f.s[lo.LOG_LIKELIHOOD] for f in phase.filters])
        likeliest = phase.filters[int(np.argmax(ll))].s
        # Evidence counts less where even the best hypothesis fits worse than its covariance says.
        misfit = max(1.0, likeliest[lo.BANK_NIS] / max(likeliest[lo.BANK_DOF], 1.0))
        weight = np.exp((ll - ll.max()) / (OVERLAP * misfit))
        weight /= weight.sum()
        yaw = np.array([rpy_from_quat(f.s[:4])[2] for f in phase.filters])
        var = np.array([f.s[lo.P :].reshape(n, n)[8, 8] for f in phase.filters])
        best = int(np.argmax(weight))
        off = np.remainder(yaw - yaw[best] + math.pi, 2 * math.pi) - math.pi
        mean = float(weight @ off)
        spread = float(weight @ (np.minimum(misfit * var, math.pi**2) + (off - mean) ** 2))
        return best, math.sqrt(spread)

    def _widen_heading(self, phase: Phase, first_row: int) -> None:
        """Publish the bank's heading uncertainty rather than one hypothesis' own."""
        column = w.O_COV + 2 * 6 + 5
        var = self.rows.rows[first_row : self.rows.end, column]
        np.maximum(var, phase.checks[-1].heading_sd ** 2, out=var)

    def _heading_found(self, phase: Phase, t: int) -> bool:
        best, sd = self._mixture(phase)
        phase.checks = [*phase.checks[-8:], Check(t, best, sd)]
        if sd > self.config.alignment.heading_found_sd_deg * DEG:
            return False
        n = self.layout.n
        f = phase.filters[best]
        s, k = f.s.copy(), f.k.copy()
        P = s[lo.P :].reshape(n, n)
        P[8, 8] = max(P[8, 8], sd * sd)
        s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = s[lo.VELOCITY_FIT] = 0.0
        found = Filter.start(s, k, self._slots)
        if f.tape is not None:
            # A smoother goes on through the hypothesis that won; P was widened: a new chunk.
            f.tape.cut(s, k)
            found.tape = f.tape
        new = Phase(t + 1, Mode.NAVIGATING, [found], resets=phase.resets)
        new.checks = [Check(t)]
        self.phases.append(new)
        yaw = math.degrees(rpy_from_quat(s[:4])[2]) % 360
        self._say(
            t,
            "heading-found",
            f"heading {yaw:.0f}° ± {math.degrees(sd):.1f}° found from motion "
            f"{(t - phase.start_ns) / NS:.1f} s after the start",
        )
        return True

    def _agreeing_fixes(self, aids: SampleBuffer, t: int) -> list[int]:
        """The last few fixes where each foresees the next by its velocity; else none."""
        fixes = [
            m
            for m in range(aids.start, aids.after(t))
            if aids.key[m, 0] == w.KIND_GNSS
            and np.all(np.isfinite(aids.rows[m, :5]))
            and aids.t[m] > t - 5 * NS
        ][-RELOCK_FIXES:]
        if len(fixes) < RELOCK_FIXES:
            return []
        rows, times = aids.rows[fixes], aids.t[fixes]
        step = ned_difference(
            rows[1:, 0], rows[1:, 1], rows[1:, 2], rows[:-1, 0], rows[:-1, 1], rows[:-1, 2]
        )
        dt = np.diff(times)[:, None] / NS
        expected = 0.5 * (rows[1:, 3:5] + rows[:-1, 3:5]) * dt
        allowed = 3.0 * np.sqrt(rows[1:, 6:8] + rows[:-1, 6:8] + rows[1:, 9:11] * dt**2)
        return fixes if np.all(np.abs(step[:, :2] - expected) < allowed) else []

    def _restarted(
        self, f: Filter, t: int, aids: SampleBuffer, fixes: list[int]
    ) -> tuple[F64, I64]:
        """The state with position and velocity taken anew from the last agreeing fix."""
        n = self.layout.n
        s, k = f.s.copy(), f.k.copy()
        last = aids.rows[fixes[-1]]
        s[lo.LAT : lo.LAT + 3] = last[:3]
        ahead = (t - int(aids.t[fixes[-1]])) / NS
        velocity = np.where(np.isfinite(last[3:6]), last[3:6], s[lo.VEL_N : lo.VEL_N + 3])
        s[lo.VEL_N : lo.VEL_N + 3] = velocity
        P = s[lo.P :].reshape(n, n)
        P[:6, :], P[:, :6] = 0.0, 0.0
        for m in range(3):
            var = last[9 + m] if np.isfinite(last[3 + m]) else 9.0
            P[3 + m, 3 + m] = 4.0 * var + ahead**2
            P[m, m] = 4.0 * last[6 + m] + (1.0 + float(velocity @ velocity)) * ahead**2
        s[lo.VELOCITY_FIT] = s[lo.LOG_LIKELIHOOD] = s[lo.BANK_NIS] = s[lo.BANK_DOF] = 0.0
        k[lo.T_REJECT], k[lo.RESETS] = 0, k[lo.RESETS] + 1
        return s, k

    def _relock(self, f: Filter, t: int, aids: SampleBuffer, fixes: list[int]) -> None:
        """Position aiding was rejected for long, and the fixes agree: believe them."""
        s, k = self._restarted(f, t, aids, fixes)
        new = Phase(t + 1, Mode.NAVIGATING, [self._filter(s, k)])
        new.checks = [Check(t)]
        self.phases.append(new)
        self._say(
            t,
            "relocked",
            f"position reset to {RELOCK_FIXES} mutually consistent GNSS fixes after "
            f"{self.config.engine.gate_relock_s:.0f} s of rejections",
            "warning",
        )

    def _relearn_heading(self, f: Filter, t: int, aids: SampleBuffer, fixes: list[int]) -> None:
        """Velocity never fits: back to the bank over headings, level and gyro bias kept roughly."""
        s, k = self._restarted(f, t, aids, fixes)
        n, count = self.layout.n, self.config.alignment.hypotheses
        P = s[lo.P :].reshape(n, n)
        P[6:, :], P[:, 6:] = 0.0, 0.0
        P[range(6, n), range(6, n)] = par.initial_variances(self.config, self.layout)[6:]
        P[6, 6] = P[7, 7] = LOST_TILT_SD**2
        P[8, 8] = (math.pi / count) ** 2
        s[lo.ACCEL_BIAS_B : lo.ACCEL_BIAS_B + 3] = 0.0
        filters = []
        for m in range(count):
            turned = s.copy()
            rotate_nav(turned, 0.0, 0.0, 2.0 * math.pi * m / count)
            filters.append(self._filter(turned, k.copy()))
        new = Phase(t + 1, Mode.HEADING_UNKNOWN, filters)
        new.checks = [Check(t, 0, math.pi)]
        self.phases.append(new)
        self._say(
            t,
            "heading-lost",
            "velocity does not fit GNSS for seconds: heading is searched for again",
            "warning",
        )
