"""Keeps what a run has learned: every second where a killed process leaves it, every minute safely.

Written in a thread: a disk that is slow must not hold up the loop.
"""

from __future__ import annotations

import math
import threading
from pathlib import Path

import numpy as np

from companion.config import DEG, Config, LastHeading
from companion.navigation.rotation import rpy_from_quat
from companion.runtime import saved_state
from companion.runtime.core import Core
from companion.runtime.saved_state import SavedState, StateError
from companion.runtime.start import known_imu
from companion.types import COV_ATT, NS, Event, Mode, Solution

DURABLE_NS = 60 * NS
"""Flushed to the disk this often; a card does not want it more often."""


def standing_heading(config: Config, last: Solution) -> LastHeading | None:
    """Heading at the newest epoch of a vehicle that stands; None for one that moves, or without.

    In motion it would be worth nothing: simulated vehicles that had flown straight for a minute
    turned by 30 of the standard deviations that this minute promised, within three seconds.
    """
    if not len(last) or last.mode[-1] != Mode.NAVIGATING:
        return None
    yaw = float(rpy_from_quat(last.q_nb[-1])[2])
    sd = math.sqrt(max(float(last.cov[-1, COV_ATT, 5]), 0.0))
    stands = float(np.linalg.norm(last.vel_n[-1])) < config.constraints.standstill_speed_mps
    if not (stands and math.isfinite(yaw) and 0.0 < sd < math.inf):
        return None
    return LastHeading(heading_deg=yaw / DEG, sd_deg=sd / DEG, t_ns=int(last.t_ns[-1]))


class Keeper:
    """Writes the state file of a run, and the one of its last second."""

    def __init__(self, path: Path, before: SavedState | None) -> None:
        """``before``: what the run began with; its biases are kept until there are better ones."""
        self._path = path
        self._biases = before.biases if before is not None else None
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
        source = known_imu(core.config)
        if source:
            self._biases = saved_state.learned(core.config, source, core.last) or self._biases
        if core.mode not in (Mode.NAVIGATING, Mode.COASTING):
            return None
        return SavedState(
            saved_ns=core.now_ns,
            axes=core.config.imu.axes,
            biases=self._biases,
            heading=standing_heading(core.config, core.last),
            inputs={chosen.kind: chosen.source for chosen in core.selection.chosen},
            autopilot=core.autopilot,
        )

    def _write(self, state: SavedState, durable: bool) -> None:
        try:
            saved_state.save(self._path, state, durable=durable)
        except StateError as error:
            self._trouble = str(error)
