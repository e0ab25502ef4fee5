"""Smoothing on line: after every fix, the oldest of the last few update intervals is smoothed.

It works on what has settled, which nothing late can change any more: so its bits depend on what was
measured alone, not on when it arrived or how it was handed over. It has no clock either: whoever
has one may tell it to give way for a while, by the times of the data.

Duong & Chiang 2012, section 3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.config import Config
from companion.estimation import parameters as par
from companion.estimation.digest import RowDigest
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.phases import Filter, Phase
from companion.estimation.recording import position
from companion.estimation.running_tape import RunningTape
from companion.navigation import layout as lo
from companion.outlet import solution_of
from companion.smoothing import intervals as iv
from companion.smoothing.composite import scratch
from companion.types import F64, I64, NS, Event, Flags, Smoothed

ROOM = 512
"""Rows that are fetched at once."""
END_OF_TIME = int(np.iinfo(np.int64).max)


class FixedLag:
    """Reads the tapes of one estimator's phases behind its delay ring."""

    def __init__(self, config: Config) -> None:
        smoothing = config.smoothing
        self._lay = par.layout(config).vector()
        self._par = par.parameter_vector(config)
        self._scratch = scratch()
        self._window = smoothing.window
        self._longest_ns = round(smoothing.longest_interval_s * NS)
        self._ring_ns = round(config.engine.delay_ring_s * NS)
        self._gaps: I64 = np.zeros((0, 2), np.int64)
        self._digest = RowDigest()
        self._broken = False
        self.smoothed = self.filtered = self.failures = self.intervals = 0
        """Epochs given out, smoothed and as the filter had them; windows that failed; update
        intervals given out."""
        self.covered_ns = 0
        """Time that those intervals cover."""
        self._last_ns: int | None = None
        self._room(ROOM)
        self._look_at(None)

    @property
    def digest(self) -> str:
        """Hash over everything given out, in order."""
        return self._digest.hexdigest()

    def give_way(self, since_ns: int, until_ns: int = END_OF_TIME) -> None:
        """Leave windows whose youngest data are in this span to the filter.

        It may begin at any time that the inertial samples have not reached yet; replaying with the
        same spans gives the same bits. A span without an end is ended by :meth:`resume`.
        """
        self._gaps = np.vstack([self._gaps, [[since_ns, until_ns]]])

    def resume(self, at_ns: int) -> None:
        """Smooth again what ends at ``at_ns`` or later."""
        if len(self._gaps):
            self._gaps[-1, 1] = min(self._gaps[-1, 1], at_ns)

    def advance(self, phases: Sequence[Phase], settled_ns: int) -> tuple[Smoothed, list[Event]]:
        """Smooth what has settled up to ``settled_ns`` and was not given out before."""
        parts: list[Smoothed] = []
        events: list[Event] = []
        for phase, after in zip(phases, [*phases[1:], None], strict=True):
            f = phase.filters[0] if len(phase.filters) == 1 else None
            if f is None or not isinstance(f.tape, RunningTape) or f.tape.read:
                continue
            last = settled_ns == END_OF_TIME if after is None else after.start_ns <= settled_ns
            if f.tape is not self._tape:
                self._look_at(f.tape)
            self._read(f, f.tape, settled_ns, last, parts, events)
            if not last:
                break
            f.tape.read = True
        return Smoothed.concatenate(parts), events

    # ------------------------------------------------------------------ one tape

    def _look_at(self, tape: RunningTape | None) -> None:
        """Begin a tape at its start."""
        self._tape = tape
        self._marks: I64 = np.zeros((self._window + 2, iv.MARK), np.int64)
        self._marks[0, iv.TIME] = -1
        self._scan: I64 = np.zeros(iv.MARK, np.int64)
        self._progress: I64 = np.zeros(iv.PROGRESS, np.int64)
        self._progress[iv.KNOWN] = 1

    def _room(self, rows: int) -> None:
        self._t, self._until = np.zeros(rows, np.int64), np.zeros(rows, np.int64)
        self._rows: F64 = np.zeros((rows, ROW_SIZE))
        self._smoothed: Flags = np.zeros(rows, np.bool_)

    def _read(
        self,
        f: Filter,
        tape: RunningTape,
        settled_ns: int,
        last: bool,
        parts: list[Smoothed],
        events: list[Event],
    ) -> None:
        s = np.zeros(lo.P)
        s[lo.EARTH_RATE] = f.s[lo.EARTH_RATE]
        wanted = 1
        while wanted:
            count = iv.give_out(
                tape.kinds, tape.coarse, tape.fine, position(f.k), settled_ns, last,
                self._longest_ns, self._gaps, self._marks, self._scan, self._progress,
                self._lay, self._par, s, self._scratch,
                self._t, self._until, self._rows, self._smoothed,
            )  # fmt: skip
            wanted = int(self._progress[iv.WANTED])
            if count:
                parts.append(self._taken(count, events))
            if wanted > len(self._t):
                self._room(2 * wanted)
        cut = tape.forget(self._marks[0], f.k, f.snaps_k, settled_ns)
        if cut.any():
            self._marks[:, :3] -= cut
            self._scan[:3] -= cut

    def _taken(self, count: int, events: list[Event]) -> Smoothed:
        """The first ``count`` rows, and an event where the smoother began to fail or is well."""
        t, rows = self._t[:count].copy(), self._rows[:count].copy()
        smoothed = self._smoothed[:count].copy()
        self._digest.update(t, rows)
        well = int(np.count_nonzero(smoothed))
        self.smoothed += well
        self.filtered += count - well
        failed = int(self._progress[iv.FAILED])
        self.intervals += int(self._progress[iv.GIVEN])
        self._progress[iv.FAILED] = self._progress[iv.GIVEN] = 0
        if self._last_ns is not None:
            self.covered_ns += int(t[-1]) - self._last_ns
        self._last_ns = int(t[-1])
        self.failures += failed
        if failed and not self._broken:
            text = "smoothing failed: a smoothed state or variance is not sound; the filter stands"
            events.append(Event(int(t[0]), "smoothing-failed", text, "warning"))
        elif self._broken and well and not failed:
            events.append(Event(int(t[0]), "smoothing-works", "smoothing works again"))
        self._broken = bool(failed) or (self._broken and not well)
        lag = self._until[:count] - t + self._ring_ns
        return Smoothed(solution_of([(t, rows)]), lag, smoothed)
