"""What the accuracy benchmarks share: the data, one replay, errors over chosen epochs, tables."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from companion.config import Config
from companion.types import I64, NS, VehicleRecording
from replay.configuration import ChosenConfig
from replay.evaluation import Errors, errors_against
from replay.preparation import start_ns
from replay.session import SessionResult, run_session
from replay.window import Window

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"

Mask = NDArray[np.bool_]


def need_data(*parts: str) -> Path:
    """A path under the data directory; ends the program in one line where it is absent."""
    path = DATA.joinpath(*parts)
    if not path.exists():
        sys.exit(f"{Path('..', 'shared', 'data', *parts)} is not there: nothing to measure")
    return path


def solve(
    vehicle: VehicleRecording, config: Config, outages: Sequence[Window] = ()
) -> SessionResult:
    """One replay without a log; its solution is the published one."""
    return run_session(vehicle, ChosenConfig(config, "benchmark", ""), outages=outages)


@dataclass(frozen=True, slots=True)
class Rmse:
    """Root mean squares over chosen epochs: metres, m/s, degrees."""

    position_h: float
    position_v: float
    position_v_sd: float
    """Vertical without its mean: what remains when the datums differ by a constant."""
    velocity_h: float
    velocity_v: float
    rpy_deg: tuple[float, float, float]


def rmse(errors: Errors, used: Mask) -> Rmse:
    """Over the epochs of ``used`` that the reference knows."""
    p, v, a = (x[used] for x in (errors.position_n, errors.velocity_n, errors.attitude))

    def rms(x: NDArray[np.float64]) -> float:
        known = x[np.isfinite(x)]
        return math.sqrt(float(np.mean(known**2))) if len(known) else math.nan

    return Rmse(
        math.hypot(rms(p[:, 0]), rms(p[:, 1])),
        rms(p[:, 2]),
        float(np.nanstd(p[:, 2])),
        math.hypot(rms(v[:, 0]), rms(v[:, 1])),
        rms(v[:, 2]),
        tuple(math.degrees(rms(a[:, i])) for i in range(3)),  # type: ignore[arg-type]
    )


def horizontal_at(errors: Errors, t_ns: int) -> float:
    """Horizontal error [m] of the last epoch before ``t_ns``; NaN before the first."""
    at = int(np.searchsorted(errors.t_ns, t_ns, side="left")) - 1
    return math.hypot(*errors.position_n[at, :2]) if at >= 0 else math.nan


def next_fix_ns(fixes_ns: I64, after_ns: int) -> int:
    """Time of the first fix at or after ``after_ns``."""
    return int(fixes_ns[np.searchsorted(fixes_ns, after_ns)])


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Plain columns, the first to the left and the others to the right."""
    cells = [list(head), *map(list, rows)]
    width = [max(len(row[i]) for row in cells) for i in range(len(head))]
    return "\n".join(
        "  ".join(
            c.ljust(w) if i == 0 else c.rjust(w)
            for i, (c, w) in enumerate(zip(row, width, strict=True))
        ).rstrip()
        for row in cells
    )


__all__ = [
    "DATA", "NS", "ROOT", "Errors", "Mask", "Rmse", "errors_against",
    "horizontal_at", "need_data", "next_fix_ns", "rmse", "solve", "start_ns", "table",
]  # fmt: skip
