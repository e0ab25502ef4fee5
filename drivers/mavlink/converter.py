"""Live messages to samples on the run's clock: one stream a sensor, no repeats, one datum.

What a message means is in :mod:`drivers.mavlink.samples`, which logs are read with too. Here is
what needs a memory: the clock, the last fix, the datum of heights, which message carries a sensor.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np

from companion.types import (
    F64,
    I64,
    NS,
    AnySamples,
    BaroSamples,
    GnssSamples,
    ImuSamples,
    MagSamples,
    ReferenceSamples,
    Samples,
)
from drivers.mavlink import samples as messages
from drivers.mavlink.boot_clock import BootClock
from drivers.mavlink.clipping import COUNTED, ClipCounters
from drivers.mavlink.counters import SessionCounters
from drivers.mavlink.readings import Readings
from drivers.mavlink.samples import Stamps, Table, triple

S = TypeVar("S", bound=Samples)
Sensor = ImuSamples | MagSamples | BaroSamples

_BETTER_NS = 3 * NS
"""A message stands in for a better one that has not come for this long."""
_FUTURE_NS = NS // 2
_OLD_FIX_NS = 5 * NS
"""No receiver takes this long: a fix that is so far behind the newest stamp is of another boot."""
_REFERENCE_GAP_NS = NS
"""Attitudes further apart are not interpolated."""
_REFERENCES = 64
"""Positions that wait for the next attitude."""

_WANTED = frozenset(
    {
        *messages.BOOT_STAMPED,
        *messages.IMU,
        *messages.GNSS,
        *messages.BARO,
        *messages.BARO_OTHERS,
        *messages.MAG,
        *messages.MAG_OTHERS,
        messages.VIBRATION,
    }
)


class Converter:
    """Samples of one autopilot, in the order of its messages."""

    def __init__(self, clock: BootClock, counters: SessionCounters) -> None:
        self.height_datum: Literal["hae", "msl"] | None = None
        self._clock = clock
        self._counters = counters
        self._geoid_m = 0.0
        self._begun_ns: int | None = None
        self._seen_ns: dict[str, int] = {}
        self._newest: dict[tuple[type, str], int] = {}
        self._fix: dict[str, Table] = {}
        self._readings: dict[tuple[type, str], Readings] = {}
        self._clipping = ClipCounters()
        self._gnss: list[AnySamples] = []
        self._baro: list[AnySamples] = []
        self._mag: list[AnySamples] = []
        self._imu: list[AnySamples] = []
        self._attitude: tuple[int, F64] | None = None
        self._positions: deque[ReferenceSamples] = deque(maxlen=_REFERENCES)
        self._references: list[ReferenceSamples] = []

    def restart(self) -> None:
        """The autopilot began anew: its fixes and attitudes have nothing to do with the old."""
        self._fix.clear()
        self._clipping = ClipCounters()
        self._attitude = None
        self._positions.clear()

    def wants(self, name: str) -> bool:
        """Whether a message is of any use here."""
        return name in _WANTED

    def observe(self, name: str, boot_us: I64, rx_ns: int) -> bool:
        """Give the clock the stamps of a message; True if the autopilot's clock began anew."""
        if self._begun_ns is None:
            self._begun_ns = rx_ns
        self._seen_ns[name] = rx_ns
        restarted = False
        if name in messages.BOOT_STAMPED:
            for stamp in boot_us.tolist():
                restarted |= bool(stamp) and self._clock.observe(stamp, rx_ns)
        return restarted

    def convert(self, name: str, table: Table, boot_us: I64, seq: int, rx_ns: int) -> None:
        """Take the rows of one message with their stamps; they come out of :meth:`take`."""
        if not self._clock.ready:
            self._counters.not_timed += table.shape[0]
        elif name in messages.GNSS:
            self._fixes(name, table, boot_us, seq, rx_ns)
        elif name == messages.VIBRATION:
            self._clipping.take(messages.clip_counts(table), rx_ns)
        elif name == "GLOBAL_POSITION_INT":
            self._position(table, boot_us, seq, rx_ns)
        elif name == "ATTITUDE":
            self._turn(table, self._stamps(boot_us, seq, rx_ns))
        else:
            self._sensors(name, table, self._stamps(boot_us, seq, rx_ns), rx_ns)

    def _sensors(self, name: str, table: Table, at: Stamps, rx_ns: int) -> None:
        """IMU, field and pressure of a message, as far as no better message carries them."""
        if name in messages.IMU:
            inertial = messages.imu(name, table, at)
            if inertial is not None and self._clipping.rising(name, rx_ns):
                inertial = replace(inertial, clipped=np.full(len(inertial), COUNTED))
            self._keep(self._imu, inertial)
        if name in messages.MAG_OTHERS or self._best(name, messages.MAG, rx_ns):
            field = messages.mag(name, table, at)
            if field is not None:
                self._keep(self._mag, self._read(field, field.field_b))
        if name in messages.BARO_OTHERS or self._best(name, messages.BARO, rx_ns):
            pressure = messages.baro(name, table, at)
            if pressure is not None:
                self._keep(self._baro, self._read(pressure, pressure.pressure[:, None]))

    def _best(self, name: str, carriers: tuple[str, ...], rx_ns: int) -> bool:
        """Whether ``name`` carries a sensor and no message better at it has come lately."""
        if name not in carriers or self._begun_ns is None:
            return False
        place = carriers.index(name)
        return all(
            rx_ns - self._seen_ns.get(better, self._begun_ns) > _BETTER_NS
            for better in carriers[:place]
        )

    def _read(self, samples: S, values: F64) -> S | None:
        """Without values held from the row before: the message is faster than its sensor."""
        readings = self._readings.setdefault((type(samples), samples.source), Readings())
        new = readings.new(values, samples.t_ns)
        if new.all():
            return samples
        return samples.take(new) if new.any() else None

    def _stamps(self, boot_us: I64, seq: int, rx_ns: int) -> Stamps:
        count = boot_us.shape[0]
        rx = np.full(count, rx_ns, np.int64)
        # Without a stamp of its own a sample is as old as its way here, which nobody knows.
        t_ns = np.where(boot_us > 0, self._clock.to_run(boot_us), rx)
        return Stamps(t_ns, rx, np.full(count, seq, np.int64))

    def _keep(
        self, out: list[AnySamples], samples: ImuSamples | MagSamples | BaroSamples | None
    ) -> None:
        """Append what is finite, timed and newer than what the stream had before."""
        if samples is None:
            return
        sane = self._timed(samples, _finite(samples))
        if sane is None:
            return
        key = type(sane), sane.source
        newest = self._newest.get(key, 0)
        count = len(sane)
        if count > 1:
            peak = np.maximum.accumulate(sane.t_ns)
            newer = sane.t_ns > np.maximum(np.concatenate([[newest], peak[:-1]]), newest)
            sane = sane if newer.all() else sane.take(newer)
        elif sane.t_ns[0] <= newest:
            sane = sane.take(slice(0, 0))
        self._counters.repeated += count - len(sane)
        if len(sane):
            self._newest[key] = int(sane.t_ns[-1])
            out.append(sane)
            self._counters.samples += len(sane)

    def _timed(self, samples: S, finite: messages.Rows) -> S | None:
        """Finite rows whose time can be right; the others are counted."""
        future = samples.t_ns > samples.t_rx_ns + _FUTURE_NS
        good = finite & ~future
        if good.all():
            return samples
        self._counters.unusable += int((~finite).sum())
        self._counters.not_timed += int((future & finite).sum())
        return samples.take(good) if good.any() else None

    # ------------------------------------------------------------------ fixes

    def _fixes(self, name: str, table: Table, boot_us: I64, seq: int, rx_ns: int) -> None:
        before = self._fix.get(name)
        joined = table if before is None else np.concatenate([before, table])
        new = messages.new_fixes(joined)[-table.shape[0] :]
        self._fix[name] = table[-1:]
        self._counters.repeated += int((~new).sum())
        if not new.any():
            return
        stamps = messages.fix_boot_us(table, boot_us)
        # After a reboot a fix may come before anything else tells of it.
        old = (stamps > 0) & (1000 * stamps < self._clock.newest_ns - _OLD_FIX_NS)
        self._counters.not_timed += int((new & old).sum())
        new &= ~old
        if not new.any():
            return
        table = table[new]
        at = self._stamps(stamps[new], seq, rx_ns)
        samples, undulation = messages.gnss(name, table, at)
        self._decide_datum(samples, undulation)
        fixes = self._timed(replace(samples, height=samples.height + self._geoid_m), _all(samples))
        if fixes is not None:
            self._gnss.append(fixes)
            self._counters.samples += len(fixes)

    def _decide_datum(self, samples: GnssSamples, undulation: F64) -> None:
        """The first fix decides, once: a constant, so that a coarse undulation adds no steps."""
        fixed = np.flatnonzero(samples.fix_type >= 3)
        if self.height_datum is None and fixed.shape[0]:
            geoid = float(undulation[fixed[0]])
            self.height_datum = "hae" if np.isfinite(geoid) else "msl"
            self._geoid_m = geoid if np.isfinite(geoid) else 0.0

    @property
    def undulation_m(self) -> float | None:
        """Height above mean sea level of the datum [m]; None before the first fix."""
        return self._geoid_m if self.height_datum is not None else None

    # ------------------------------------------------------------------ the autopilot's solution

    def _position(self, table: Table, boot_us: I64, seq: int, rx_ns: int) -> None:
        known = messages.known_position(table)
        table = table[known]
        if not table.shape[0]:
            return
        at = self._stamps(boot_us[known], seq, rx_ns)
        lat, lon, amsl, vel_n = messages.position(table)
        unknown = np.full((table.shape[0], 3), np.nan)
        height = amsl + self._geoid_m
        reference = ReferenceSamples(
            "GLOBAL_POSITION_INT", at.t_ns, at.rx_ns, at.seq, lat, lon, height, vel_n, unknown
        )
        self._positions.extend(reference.take(slice(i, i + 1)) for i in range(len(reference)))

    def _turn(self, table: Table, at: Stamps) -> None:
        """Give the positions before this attitude theirs, interpolated the short way round."""
        for now_ns, rpy in zip(
            at.t_ns.tolist(), triple(table, ("roll", "pitch", "yaw")), strict=True
        ):
            if not np.isfinite(rpy).all():
                continue
            while self._positions and int(self._positions[0].t_ns[0]) <= now_ns:
                position = self._positions.popleft()
                turned = self._between(int(position.t_ns[0]), now_ns, rpy)
                self._references.append(replace(position, rpy=turned[np.newaxis]))
            self._attitude = now_ns, rpy

    def _between(self, t_ns: int, now_ns: int, rpy: F64) -> F64:
        """(3,) attitude at ``t_ns`` from the one before and this one; NaN over a long gap."""
        if t_ns == now_ns:
            return rpy
        if self._attitude is None or now_ns - self._attitude[0] > _REFERENCE_GAP_NS:
            return np.full(3, np.nan)
        before_ns, before = self._attitude
        if t_ns < before_ns:
            return np.full(3, np.nan)
        share = (t_ns - before_ns) / (now_ns - before_ns)
        step = np.pi - np.mod(np.pi - (rpy - before), 2 * np.pi)
        out: F64 = np.pi - np.mod(np.pi - (before + share * step), 2 * np.pi)
        return out

    # ------------------------------------------------------------------ out

    def take(self) -> list[AnySamples]:
        """Fixes, pressure, field and inertial samples since the last call, in this order."""
        out = [*self._gnss, *self._baro, *self._mag, *self._imu]
        for kind in (self._gnss, self._baro, self._mag, self._imu):
            kind.clear()
        return out

    def references(self) -> list[ReferenceSamples]:
        """The autopilot's own solution since the last call."""
        out, self._references = self._references, []
        return out


def _finite(samples: Sensor) -> messages.Rows:
    """(N,) which rows hold numbers."""
    if isinstance(samples, ImuSamples):
        finite = np.isfinite(samples.gyro_b) & np.isfinite(samples.accel_b)
    elif isinstance(samples, MagSamples):
        finite = np.isfinite(samples.field_b)
    else:
        return np.isfinite(samples.pressure)
    return finite[:, 0] & finite[:, 1] & finite[:, 2]


def _all(samples: GnssSamples) -> messages.Rows:
    """Fixes come as integers: all of them are numbers."""
    return np.ones(len(samples), np.bool_)
