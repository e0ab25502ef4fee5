"""Several inertial units behind the face of one: blocks of samples in, fused samples out. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from companion.config import DEG, Config
from companion.intake.counters import Counters
from companion.intake.fused import FusedImu
from companion.intake.fusion import layout as lo
from companion.intake.fusion.fuse import fuse
from companion.intake.fusion.judge import WINDOW_S
from companion.intake.fusion.resample import CLOCK_BACK_NS
from companion.intake.fusion.words import FAULTS, event
from companion.intake.inertial import turned
from companion.types import F64, I64, NS, Event, ImuSamples

FUTURE_NS = NS
"""A further unit's sample that is so far ahead of the first unit's clock has a wrong stamp."""


_COUNTED = {
    "exclusions": lo.EXCLUSIONS,
    "outlying_epochs": lo.OUTLIERS,
    "missing_epochs": lo.MISSED,
    "out_of_order": lo.OUT_OF_ORDER,
}


def fuses(config: Config) -> bool:
    """Whether a configuration asks for one increment made of several units."""
    return bool(config.further_imu) and config.engine.estimator != "direct"


class ImuFusion:
    """State of the fusion; ``further_imu`` beside the first unit, whatever its name is."""

    def __init__(self, config: Config, counters: Counters) -> None:
        self._config = config
        self._counters = counters
        self._further = {unit.source: at + 1 for at, unit in enumerate(config.further_imu)}
        self.units = 1 + len(self._further)
        self._parameters = _parameters(config)
        own = config.imu.latency_ms
        self._lag_ns = [0] + [
            0 if unit.latency_ms is None else round((unit.latency_ms - own) * 1e6)
            for unit in config.further_imu
        ]
        fusion = config.imu_fusion
        self._settings = np.zeros(lo.CONFIG_SIZE)
        self._settings[lo.C_WAIT_NS] = round(fusion.wait_ms * 1e6)
        self._settings[lo.C_PROOF_S] = fusion.proof_s
        self._settings[lo.C_EXCLUDE] = float(fusion.exclude)
        self._settings[lo.C_MISMATCH] = fusion.mismatch_percent / 100.0
        self._first = config.imu.source
        self._lead = 0
        self._restart()

    def _restart(self) -> None:
        n = self.units
        self.s = np.zeros((n, lo.STATE_SIZE))
        self.k = np.zeros((n, lo.COUNT_SIZE), np.int64)
        self.terms = np.zeros((n, 6, lo.TERMS))
        self._P = np.zeros((n, 6, lo.TERMS, lo.TERMS))
        mismatch = self._settings[lo.C_MISMATCH]
        for sensor in range(2):
            axes = slice(3 * sensor, 3 * sensor + 3)
            self.s[:, lo.WEIGHT + sensor] = 1.0 / self._parameters[:, lo.VAR_0 + sensor]
            self._P[:, axes, 0, 0] = self._parameters[:, lo.BIAS_VAR + sensor, None]
            for term in range(1, lo.TERMS):
                self._P[:, axes, term, term] = mismatch * mismatch
        self._pairs = np.zeros((2, 2, n, n))
        for sensor in range(2):
            self._pairs[sensor] = 2.0 * self._parameters[0, lo.VAR_0 + sensor]
        self._common = np.zeros(lo.COMMON_SIZE)
        self._clock = np.zeros(lo.CLOCK_SIZE, np.int64)
        self._T = np.zeros((n, lo.RING), np.int64)
        self._X = np.zeros((n, lo.RING, 7))
        self._sums = np.zeros((n, lo.RING, 6))
        self._gaps = np.zeros((n, lo.RING), np.int64)
        self._head: int | None = None

    def state_of(self, source: str) -> str:
        """What a unit is excluded for, ``ok``, or ``waiting`` before its first sample."""
        k = self.k[self._further.get(source, 0)]
        return FAULTS.get(int(k[lo.WHY]), "ok" if k[lo.END] else "waiting")

    def excluded(self) -> dict[str, str]:
        """Units that are done without, and what for."""
        sources = [self._first, *self._further]
        whys = self.k[:, lo.WHY].tolist()
        return {s: FAULTS[why] for s, why in zip(sources, whys, strict=True) if why != lo.TRUSTED}

    def counts(self) -> dict[str, int]:
        """What is counted of each unit, by a stable name."""
        sources = [self._first, *self._further]
        return {
            f"{source}.{name}": int(self.k[u, at])
            for u, source in enumerate(sources)
            for name, at in _COUNTED.items()
        }

    def take(self, blocks: Sequence[ImuSamples]) -> tuple[FusedImu, list[Event]]:
        """Take samples of any units, in their order of arrival; what came of them.

        Where numbers of arrival are equal, further units go before the first, in their order.
        """
        parts = [self._prepared(block) for block in blocks]
        of, t, x, seq, rx = (np.concatenate(column) for column in zip(*parts, strict=True))
        order = np.lexsort(((of - 1) % self.units, seq))
        order = order[~self._ahead(of[order], (t - rx)[order])]
        of, t, x, seq, rx = of[order], t[order], x[order], seq[order], rx[order]
        found: list[FusedImu] = []
        events: list[Event] = []
        begin = 0
        for end in (*self._restarts(of, t), len(t)):
            cut = slice(begin, end)
            one, told = self._fuse(of[cut], t[cut], x[cut], seq[cut], rx[cut])
            found.append(one)
            events += told
            if end < len(t):
                self._restart()
                self._head = int(t[end])
            begin = end
        return _joined(found), events

    def _prepared(self, block: ImuSamples) -> tuple[I64, I64, F64, I64, I64]:
        """Unit, time, values (N, 7), number and time of arrival, without what is no number."""
        u = self._further.get(block.source, 0)
        gyro, accel = block.gyro_b, block.accel_b
        if u == 0:
            self._first = block.source
        else:
            self._counters.further_imu += len(block)
            axes = self._config.further_imu[u - 1].axes
            gyro, accel = turned(gyro, axes), turned(accel, axes)
        x = np.empty((len(block), 7))
        x[:, :3], x[:, 3:6] = gyro, accel
        np.fmax(block.interval_s, 0.0, out=x[:, 6])
        good = np.isfinite(x[:, :6]).all(axis=1)
        self._counters.imu_not_finite += len(x) - int(good.sum())
        t = block.t_ns[good] - self._lag_ns[u]
        return np.full(len(t), u), t, x[good], block.seq[good], block.t_rx_ns[good]

    def _ahead(self, of: I64, lead: I64) -> NDArray[np.bool_]:
        """Which samples of further units are stamped far ahead of the first unit's clock.

        ``lead`` (N,): stamp − arrival [ns], to be held against that of the first unit's last one.
        """
        place = np.maximum.accumulate(np.where(of == 0, np.arange(len(of)), -1))
        own = np.where(place >= 0, lead[place], self._lead)
        if len(of) and place[-1] >= 0:
            self._lead = int(lead[place[-1]])
        ahead: NDArray[np.bool_] = (of > 0) & (lead - own > FUTURE_NS)
        self._counters.further_imu_refused += int(ahead.sum())
        return ahead

    def _restarts(self, of: I64, t: I64) -> list[int]:
        """Where the first unit's clock begins anew."""
        mine = np.flatnonzero(of == 0)
        if not len(mine):
            return []
        times = t[mine]
        head = int(times[0]) if self._head is None else self._head
        peak = np.maximum.accumulate(np.concatenate(([head], times)))
        self._head = int(peak[-1])
        if not np.any(peak[:-1] - times > CLOCK_BACK_NS):
            return []
        found: list[int] = []
        for at, now in zip(mine.tolist(), times.tolist(), strict=True):
            if head - now > CLOCK_BACK_NS:
                found.append(at)
                head = now
            head = max(head, now)
        self._head = head
        return found

    def _fuse(self, of: I64, t: I64, x: F64, seq: I64, rx: I64) -> tuple[FusedImu, list[Event]]:
        pending = int((self.k[:, lo.END] - self.k[:, lo.FIRST]).sum())
        room = len(t) + pending + 1
        out_t, out_of = np.zeros(room, np.int64), np.zeros(room, np.int64)
        out = np.zeros((room, lo.FUSED_SIZE))
        windows = room + 4 * self.units
        news_t, news = np.zeros(windows, np.int64), np.zeros((windows, lo.NEWS_SIZE))
        count = np.zeros(2, np.int64)
        fuse(
            of, t, x, count, self._settings, self._parameters, self.s, self.k, self.terms, self._P,
            self._pairs, self._common, self._clock, self._T, self._X, self._sums, self._gaps,
            out_t, out_of, out, news_t, news,
        )  # fmt: skip
        n, by = int(count[0]), out_of[: count[0]]
        fused = FusedImu(
            self._first, out_t[:n], rx[by], seq[by], out[:n, :3], out[:n, 3:6],
            np.where(out[:n, lo.ROW_INTERVAL] > 0, out[:n, lo.ROW_INTERVAL], math.nan),
            np.zeros(n), out[:n, lo.ROW_EXCESS :],
        )  # fmt: skip
        sources = [self._first, *self._further]
        told = [
            event(int(news_t[i]), news[i], sources, float(self.s[int(news[i, 1]), lo.PROOF]))
            for i in range(int(count[1]))
        ]
        return fused, told


def _parameters(config: Config) -> F64:
    """(U, PAR_SIZE): what is configured; biases and, unless said, noise as of the first."""
    imu = config.imu
    first = np.array(imu.axes)
    unit = np.zeros((1 + len(config.further_imu), lo.PAR_SIZE))
    for sensor, (noise, bias, walk) in enumerate(
        (
            (
                imu.gyro_noise_dps_rthz * DEG,
                imu.gyro_bias_sd_dps * DEG,
                imu.gyro_bias_walk_dps_rts * DEG,
            ),
            (imu.accel_noise_mps2_rthz, imu.accel_bias_sd_mps2, imu.accel_bias_walk_mps2_rts),
        )
    ):
        unit[:, lo.VAR_0 + sensor] = noise * noise / WINDOW_S
        # Against the centre of several: its own, and what the others' leave.
        unit[:, lo.BIAS_VAR + sensor] = 2.0 * bias * bias
        unit[:, lo.BIAS_STEP + sensor] = 2.0 * walk * walk * WINDOW_S
    ranges = [(imu.gyro_range_dps, imu.accel_range_mps2)]
    for at, further in enumerate(config.further_imu):
        # From body axes to those of the first unit.
        unit[at + 1, lo.LEVER : lo.LEVER + 3] = first.T @ np.array(further.lever_arm_b_m)
        ranges.append((further.gyro_range_dps, further.accel_range_mps2))
        own = (further.gyro_noise_dps_rthz, DEG), (further.accel_noise_mps2_rthz, 1.0)
        for sensor, (density, si) in enumerate(own):
            if density is not None:
                unit[at + 1, lo.VAR_0 + sensor] = (density * si) ** 2 / WINDOW_S
    for at, (gyro, accel) in enumerate(ranges):
        unit[at, lo.RANGE] = gyro * DEG if gyro > 0 else math.inf
        unit[at, lo.RANGE + 1] = accel if accel > 0 else math.inf
    return unit


def _joined(parts: Sequence[FusedImu]) -> FusedImu:
    """Several stretches as one, in order."""
    if len(parts) == 1:
        return parts[0]
    columns = ("t_ns", "t_rx_ns", "seq", "gyro_b", "accel_b", "interval_s", "clipped", "excess")
    joined = (np.concatenate([getattr(part, name) for part in parts]) for name in columns)
    return FusedImu(parts[-1].source, *joined)
