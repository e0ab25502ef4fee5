"""What a receiver's raw measurements give by themselves: a place an epoch, and of what.

Weighted least squares, the same corrections, satellite choice and test of faults that the filter
starts from and is compared with; no inertial unit in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np

from companion.config import Config
from companion.gnss.geometry import geodetic
from companion.gnss.systems import SYSTEM_NAMES
from companion.intake.ranges import RangeIntake
from companion.navigation.earth import ecef, ned_difference
from companion.types import (
    NS,
    Event,
    GnssSamples,
    LogFormatError,
    RawGnssSamples,
    Satellites,
)
from replay.raw_gnss.folder import RawFolder, read_raw_files, read_raw_folder
from replay.sensor_folder_writer import Column, gnss_columns, write_csv
from replay.streams import GnssClock


@dataclass(frozen=True, slots=True)
class Positions:
    """One receiver's recording, solved epoch by epoch."""

    raw: RawGnssSamples
    fixes: GnssSamples | None
    """Epochs that have a place, with the satellites that they are of; None where none has."""
    satellites: Satellites
    """One row an epoch."""
    events: tuple[Event, ...]
    notes: tuple[str, ...]


class System(msgspec.Struct, frozen=True):
    """What was measured of one satellite system."""

    name: str
    satellites: int
    """Different ones."""
    in_view_median: float
    with_ephemeris: int
    cn0_median_dbhz: float | None
    with_doppler: float
    """Part of its measurements."""


class Spread(msgspec.Struct, frozen=True):
    """The place in the mean, and how far epochs are from it: motion and error together."""

    lat_deg: float
    lon_deg: float
    alt_hae_m: float
    horizontal_rms_m: float
    height_rms_m: float
    stated_horizontal_m: float
    """1σ of itself, median."""
    stated_height_m: float
    fastest_mps: float | None


def read_receiver(paths: Sequence[Path], clock: GnssClock) -> RawFolder:
    """One receiver's files, a folder of them, or a sensor folder's ``raw_gnss/``.

    Raises :class:`LogFormatError` as :func:`read_raw_files` does, and for paths that are not there.
    """
    missing = [path for path in paths if not path.exists()]
    if missing:
        raise LogFormatError(f"{missing[0]}: no such file or folder")
    if len(paths) == 1 and paths[0].is_dir():
        inner = paths[0] / "raw_gnss"
        return read_raw_folder(inner if inner.is_dir() else paths[0], clock)
    folders = [path for path in paths if path.is_dir()]
    if folders:
        raise LogFormatError(f"{folders[0]}: one folder alone, or files")
    return read_raw_files(paths, " + ".join(path.name for path in paths), clock)


def solve(found: RawFolder, config: Config) -> Positions:
    """Every epoch of a recording by itself, with what ``config.raw_gnss`` says of satellites."""
    raw_gnss = msgspec.structs.replace(config.raw_gnss, coupling="loose")
    alone = msgspec.structs.replace(config.adaptation, method="none")
    intake = RangeIntake(msgspec.structs.replace(config, raw_gnss=raw_gnss, adaptation=alone))
    n = len(found.broadcast)
    # All that was broadcast is known from the start.
    raw = replace(found.raw, seq=found.raw.seq + n)
    made, said = intake.take([found.broadcast, raw])
    fixes = next((one for one in made if isinstance(one, GnssSamples)), None)
    if fixes is not None:
        at = np.searchsorted(said.satellites.t_ns, fixes.t_ns)
        fixes = replace(fixes, source=raw.source, num_sats=said.satellites.used[at])
    return Positions(raw, fixes, said.satellites, said.events, found.notes)


def systems(found: RawFolder) -> list[System]:
    """Satellite systems that were measured."""
    raw, known = found.raw, set(found.broadcast.sat.tolist())
    out = []
    for system, name in enumerate(SYSTEM_NAMES):
        mine = (raw.sat // 100 == system + 1) & np.isfinite(raw.pseudorange)
        if not mine.any():
            continue
        names, cn0 = np.unique(raw.sat[mine]), raw.cn0[mine]
        out.append(
            System(
                name=name,
                satellites=len(names),
                in_view_median=float(np.median(mine.sum(axis=1))),
                with_ephemeris=sum(int(one) in known for one in names),
                cn0_median_dbhz=float(np.nanmedian(cn0)) if np.isfinite(cn0).any() else None,
                with_doppler=float(np.isfinite(raw.rate[mine]).mean()),
            )
        )
    return out


def spread(fixes: GnssSamples) -> Spread:
    """Mean of at least one fix, and what they scatter about it."""
    middle, here = ecef(fixes.lat, fixes.lon, fixes.height).mean(axis=0), np.empty(3)
    geodetic(middle[0], middle[1], middle[2], here)
    here[2] = fixes.height.mean()
    about = ned_difference(fixes.lat, fixes.lon, fixes.height, here[:1], here[1:2], here[2:])
    speed = np.hypot(fixes.vel_n[:, 0], fixes.vel_n[:, 1])
    return Spread(
        lat_deg=float(np.degrees(here[0])),
        lon_deg=float(np.degrees(here[1])),
        alt_hae_m=float(here[2]),
        horizontal_rms_m=float(np.sqrt((about[:, :2] ** 2).sum(axis=1).mean())),
        height_rms_m=float(np.sqrt((about[:, 2] ** 2).mean())),
        stated_horizontal_m=float(np.median(np.hypot(fixes.sd_pos[:, 0], fixes.sd_pos[:, 1]))),
        stated_height_m=float(np.median(fixes.sd_pos[:, 2])),
        fastest_mps=float(np.nanmax(speed)) if np.isfinite(speed).any() else None,
    )


def write_fixes(path: Path, positions: Positions) -> None:
    """The fixes as ``gnss.csv`` of a sensor folder, with dilutions of precision beside.

    Raises :class:`~companion.types.CompanionError` if there is none, or the file cannot be written.
    """
    fixes = positions.fixes
    if fixes is None:
        raise LogFormatError(f"{path}: not one epoch has a place; nothing is written")
    at = np.searchsorted(positions.satellites.t_ns, fixes.t_ns)
    dop = positions.satellites.dop[at]
    names = ("gdop", "pdop", "hdop", "vdop", "tdop")
    more: list[Column] = [(name, "%.3f", dop[:, i]) for i, name in enumerate(names)]
    write_csv(path, [*gnss_columns(fixes), *more])


def seconds(raw: RawGnssSamples) -> float:
    """Length of a recording [s]."""
    return float(raw.t_ns[-1] - raw.t_ns[0]) / NS
