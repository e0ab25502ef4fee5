"""Keeps what a run has learned: every second where a killed process leaves it, every minute safely.

Written in a thread: a disk that is slow must not hold up the loop.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from pathlib import Path

from companion.config import DEG, LastHeading
from companion.navigation.rotation import rpy_from_quat
from companion.runtime import saved_state
from companion.runtime.core import Core
from companion.runtime.saved_state import SavedState, StateError
from companion.runtime.start import known_imu
from companion.types import COV_ATT, NS, Event, Mode, Solution

DURABLE_NS = 60 * NS
"""Flushed to the disk this often; a card does not want it more often."""
TURNS, AT_LEAST = 60, 10
"""Seconds for which the fastest turn is remembered, and without which it is not known."""


class Turning:
    """The heading of a run and the fastest that it turned of late. Pure."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque(maxlen=TURNS)
        self._last: tuple[int, float] | None = None

    def heading(self, last: Solution) -> LastHeading | None:
        """Heading at the newest epoch; to be asked about once a second.

        None without one, and before it is known how the vehicle turns.
        """
        if not len(last) or last.mode[-1] not in (Mode.NAVIGATING, Mode.COASTING):
            self._last = None
            return None
        t_ns, yaw = int(last.t_ns[-1]), float(rpy_from_quat(last.q_nb[-1])[2])
        sd = math.sqrt(max(float(last.cov[-1, COV_ATT, 5]), 0.0))
        if not (math.isfinite(yaw) and math.isfinite(sd)):
            return None
        if self._last is not None and t_ns > self._last[0]:
            turned = abs(math.remainder(yaw - self._last[1], 2.0 * math.pi))
            self._turns.append(turned * NS / (t_ns - self._last[0]))
        self._last = t_ns, yaw
        if len(self._turns) < AT_LEAST or sd == 0.0:
            return None
        return LastHeading(
            heading_deg=yaw / DEG, sd_deg=sd / DEG, t_ns=t_ns, turn_dps=max(self._turns) / DEG
        )


class Keeper:
    """Writes the state file of a run, and the one of its last second."""

    def __init__(self, path: Path, before: SavedState | None) -> None:
        """``before``: what the run began with; its biases are kept until there are better ones."""
        self._path = path
        self._biases = before.biases if before is not None else None
        self._turning = Turning()
        self._safe_ns: int | None = None
        self._thread: threading.Thread | None = None
        self._trouble = ""
        self._said = False

    def keep(self, core: Core, *, last: bool = False) -> None:
        """Keep what the run has learned, if anything; once a second, and at its end (``last``)."""
        if self._trouble and not self._said:
            self._said = True
            core.event(Event(core.now_ns, "state-not-kept", self._trouble, "warning"))
        if self._safe_ns is None:
            self._safe_ns = core.now_ns
        state = self._state(core)
        if last and self._thread is not None:
            self._thread.join(5.0)
        if state is None or (self._thread is not None and self._thread.is_alive()):
            return
        durable = last or core.now_ns - self._safe_ns >= DURABLE_NS
        if durable:
            self._safe_ns = core.now_ns
        self._thread = threading.Thread(target=self._write, args=(state, durable), daemon=True)
        self._thread.start()
        if last:
            self._thread.join(5.0)

    def _state(self, core: Core) -> SavedState | None:
        heading = self._turning.heading(core.last)
        source = known_imu(core.config)
        if source:
            self._biases = saved_state.learned(core.config, source, core.last) or self._biases
        if core.mode not in (Mode.NAVIGATING, Mode.COASTING):
            return None
        return SavedState(
            saved_ns=core.now_ns,
            axes=core.config.imu.axes,
            biases=self._biases,
            heading=heading,
            inputs={chosen.kind: chosen.source for chosen in core.selection.chosen},
            autopilot=core.autopilot,
        )

    def _write(self, state: SavedState, durable: bool) -> None:
        try:
            saved_state.save(self._path, state, durable=durable)
        except StateError as error:
            self._trouble = str(error)
