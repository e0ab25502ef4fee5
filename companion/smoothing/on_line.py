"""The smoother beside a filter that must outlive it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from companion.config import Config
from companion.estimation.phases import Phase
from companion.navigation import layout as lo
from companion.outlet import NO_REPORTS, NO_SOLUTION, NOTHING
from companion.types import Event, Outputs, Smoothed

if TYPE_CHECKING:
    from companion.smoothing.fixed_lag import FixedLag


class OnLine:
    """Hands a :class:`FixedLag` what has settled, where it is configured, and survives it."""

    def __init__(self, config: Config) -> None:
        self._lag: FixedLag | None = None
        self._kept: list[Smoothed] = []
        self._unsaid: list[Event] = []
        if config.smoothing.enabled:
            # Only here: its kernels are nobody else's business, and loading them takes time.
            from companion.smoothing.fixed_lag import FixedLag

            self._lag = FixedLag(config)

    @property
    def running(self) -> FixedLag | None:
        """The smoother; None where there is none, or none any more."""
        return self._lag

    @property
    def digest(self) -> str | None:
        """Hash over everything given out; None where there is no smoother."""
        return None if self._lag is None else self._lag.digest

    def keep(self, phases: Sequence[Phase], settled_ns: int) -> None:
        """Smooth now, to be given out by the next :meth:`take`: the phases are about to go."""
        if self._lag is None:
            return
        try:
            smoothed, events = self._lag.advance(phases, settled_ns)
        except Exception as error:  # whatever ails the smoother, the filter flies on
            self._lag = None
            text = f"smoothing stopped ({type(error).__name__}: {error}); the filter goes on"
            self._unsaid.append(Event(_newest(phases), "smoothing-stopped", text, "error"))
            return
        if len(smoothed):
            self._kept.append(smoothed)
        self._unsaid += events

    def take(self, phases: Sequence[Phase], settled_ns: int) -> Outputs:
        """What is due by now and was not given out before."""
        self.keep(phases, settled_ns)
        if not self._kept and not self._unsaid:
            return NOTHING
        smoothed, self._kept = Smoothed.concatenate(self._kept), []
        events, self._unsaid = tuple(self._unsaid), []
        return Outputs(NO_SOLUTION, NO_SOLUTION, NO_REPORTS, events, smoothed)


def _newest(phases: Sequence[Phase]) -> int:
    """Time of the last inertial sample that a filter took [ns]."""
    filters = phases[-1].filters
    return int(filters[0].k[lo.T_IMU]) if filters else phases[-1].reached
