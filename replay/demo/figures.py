"""Numbers of a demo: what a subscriber received, how late, and how far from the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Self

import numpy as np

from companion.navigation import earth
from companion.types import F64, I64, CompanionError, Mode, ReferenceSamples
from replay.sensor_folder_writer import Column, write_csv

LATENCY: Mapping[str, float] = {"p50": 50.0, "p99": 99.0, "max": 100.0}


@dataclass(frozen=True, slots=True)
class Received:
    """States as a subscriber had them, in columns."""

    t_ns: I64
    arrival_ns: I64
    """(N,) CLOCK_MONOTONIC at the arrival of the newest sample behind the state."""
    receipt_ns: I64
    """(N,) CLOCK_MONOTONIC at the subscriber."""
    mode: I64
    lat: F64
    """(N,) [rad]."""
    lon: F64
    height: F64
    """(N,) [m] above the ellipsoid."""
    vel_n: F64
    """(N, 3) [m/s]."""
    sd_pos: F64
    """(N, 3) NED [m]."""

    @classmethod
    def of_rows(cls, rows: Sequence[Sequence[float]]) -> Self:
        """From rows of the columns above, in order; times must be whole numbers."""
        t, arrival, receipt, mode = (
            np.array([int(row[i]) for row in rows], np.int64) for i in range(4)
        )
        rest = np.array([row[4:] for row in rows], np.float64).reshape(len(rows), 9)
        lat, lon, height = np.ascontiguousarray(rest[:, :3].T)
        return cls(t, arrival, receipt, mode, lat, lon, height, rest[:, 3:6], rest[:, 6:9])

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def latency_ms(self) -> F64:
        """(N,) from arrival to receipt."""
        return np.asarray((self.receipt_ns - self.arrival_ns) * 1e-6, np.float64)

    def take(self, index: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Self:
        """Only the rows of ``index``."""
        return type(self)(*(getattr(self, f.name)[index] for f in fields(self)))


def write_received(received: Received, path: Path) -> None:
    """Write as CSV: times in ns, degrees, metres, m/s."""
    columns: list[Column] = [
        ("t_ns", "%d", received.t_ns),
        ("arrival_monotonic_ns", "%d", received.arrival_ns),
        ("receipt_monotonic_ns", "%d", received.receipt_ns),
        ("mode", "%d", received.mode),
        ("lat_deg", "%.10f", np.degrees(received.lat)),
        ("lon_deg", "%.10f", np.degrees(received.lon)),
        ("alt_hae_m", "%.5f", received.height),
    ]
    columns += [(f"vel_{a}_mps", "%.6f", received.vel_n[:, i]) for i, a in enumerate("ned")]
    columns += [(f"sd_{a}_m", "%.4f", received.sd_pos[:, i]) for i, a in enumerate("ned")]
    write_csv(path, columns)


def read_received(path: Path) -> Received:
    """What :func:`write_received` wrote."""
    try:
        with path.open(encoding="ascii") as file:
            next(file)
            rows = [
                [*map(int, cells[:4]), *map(float, cells[4:])]
                for cells in (line.rstrip("\n").split(",") for line in file)
            ]
        for row in rows:
            row[4:6] = np.radians(row[4:6]).tolist()
        return Received.of_rows(rows)
    except (OSError, StopIteration, ValueError, IndexError):
        raise CompanionError(f"{path}: the subscriber left no states") from None


def spread(values: F64, wanted: Mapping[str, float]) -> dict[str, float | None]:
    """Named percentiles; None where there are no values."""
    if not len(values):
        return dict.fromkeys(wanted)
    return {name: float(np.percentile(values, share)) for name, share in wanted.items()}


def position_error_n(received: Received, truth: ReferenceSamples) -> F64:
    """(N, 3) truth − received, NED [m], for the states within the truth's span."""
    t0 = int(truth.t_ns[0])
    t, at = (truth.t_ns - t0) * 1e-9, (received.t_ns - t0) * 1e-9
    lat, lon, height = (np.interp(at, t, c) for c in (truth.lat, truth.lon, truth.height))
    return earth.ned_difference(lat, lon, height, received.lat, received.lon, received.height)


def position_errors(received: Received, truth: ReferenceSamples) -> dict[str, float | None]:
    """Horizontal and 3-D position error of all states but aligning ones [m]: RMS and largest."""
    inside = (received.t_ns >= truth.t_ns[0]) & (received.t_ns <= truth.t_ns[-1])
    used = received.take(inside & (received.mode > Mode.ALIGNING))
    if not len(used):
        return {"horizontal_rms_m": None, "horizontal_max_m": None, "rms_3d_m": None}
    error = position_error_n(used, truth)
    horizontal = np.hypot(error[:, 0], error[:, 1])
    return {
        "horizontal_rms_m": float(np.sqrt(np.mean(horizontal**2))),
        "horizontal_max_m": float(horizontal.max()),
        "rms_3d_m": float(np.sqrt(np.mean(np.sum(error**2, axis=1)))),
    }
