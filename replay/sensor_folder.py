"""Sensor folder: CSV files with fixed column names, for data from any other logger.

Columns, units and axes are those of the project's interface description: body FRD specific force,
SI units, ``t_ns`` on one clock. Empty cells are missing values; columns nobody knows are ignored.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.types import (
    F64,
    I64,
    BaroSamples,
    BroadcastSamples,
    GnssSamples,
    ImuSamples,
    LogFormatError,
    MagSamples,
    RawGnssSamples,
    Recording,
    ReferenceSamples,
)
from replay.configuration import stated_clock
from replay.streams import G, GnssClock, finish_vehicle, numbered

_DEG = np.pi / 180.0
_GYRO = ("gyro_x_radps", "gyro_y_radps", "gyro_z_radps")
_ACCEL = ("accel_x_mps2", "accel_y_mps2", "accel_z_mps2")
_VEL = ("vel_n_mps", "vel_e_mps", "vel_d_mps")
_PLACE = ("lat_deg", "lon_deg", "alt_hae_m")
_MAX_RATE = 35.0
"""Fastest rate of a common MEMS gyro, 2000 deg/s, in rad/s."""
_LIMIT_NS = 1 << 62


@dataclass(frozen=True, slots=True)
class Csv:
    """A CSV file's columns by header name; ``t_ns`` and ``t_rx_ns`` as whole nanoseconds."""

    path: Path
    times: dict[str, I64]
    values: dict[str, F64]
    count: int

    def optional(self, name: str) -> F64:
        """A column, or NaN throughout where the file has none."""
        return self.values.get(name, np.full(self.count, np.nan))

    def stack(self, *names: str) -> F64:
        """(N, k) of columns, NaN for those that are missing."""
        return np.stack([self.optional(name) for name in names], axis=1)

    def stamps(self) -> tuple[I64, I64, I64]:
        """(t_ns, t_rx_ns, seq); arrival is the time of validity where the file has no other."""
        t_ns = self.times["t_ns"]
        rx = self.times.get("t_rx_ns", t_ns)
        rx = np.where(rx == 0, t_ns, rx)  # an empty cell
        return t_ns, np.maximum.accumulate(rx), np.arange(self.count, dtype=np.int64)


def _header(path: Path, line: str, required: Sequence[str]) -> list[str]:
    """Column names; raises where one of ``required`` is missing, naming what may be meant."""
    names = [name.strip() for name in line.lstrip("\ufeff").split(",")]
    if len(set(names)) != len(names):
        raise LogFormatError(f"{path}:1: a column name appears twice")
    missing = [name for name in required if name not in names]
    if missing:
        stem = missing[0].rsplit("_", 1)[0]
        near = [name for name in names if name.startswith(stem)]
        hint = (
            f"; '{near[0]}' has another unit or name" if near else f"; there is {', '.join(names)}"
        )
        raise LogFormatError(f"{path}:1: column '{missing[0]}' is missing{hint[:200]}")
    return names


def _explain(path: Path, lines: Sequence[str], names: Sequence[str]) -> LogFormatError:
    """The first line that cannot be read, in words."""
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        cells = line.split(",")
        if len(cells) != len(names):
            return LogFormatError(
                f"{path}:{number}: {len(cells)} cells, the header has {len(names)}"
            )
        for name, cell in zip(names, cells, strict=True):
            try:
                value = float(cell) if cell.strip() else 0.0
                if name in ("t_ns", "t_rx_ns") and cell.strip():
                    value = int(cell)
                    if abs(value) > _LIMIT_NS:
                        raise ValueError
            except ValueError:
                shown = cell.strip()[:30]
                kind = "whole nanoseconds" if name.endswith("_ns") else "a number"
                return LogFormatError(f"{path}:{number}: {name} is '{shown}', not {kind}")
    return LogFormatError(f"{path}: cannot be read as numbers")


def _filled(text: str, names: Sequence[str]) -> str:
    """Rows with empty cells written out, since the fast parser knows no missing values."""
    if names[0] in ("t_ns", "t_rx_ns") and ",," not in text and not re.search(r",\s*(\n|$)", text):
        return text
    whole = {i for i, name in enumerate(names) if name in ("t_ns", "t_rx_ns")}
    if not whole - {0}:
        return re.sub(r",(?=\s*(?:,|\n|$))", ",nan", text)
    rows = []
    for line in text.split("\n"):
        if line.strip():
            cells = line.split(",")
            rows.append(
                ",".join(
                    c if c.strip() else ("0" if i in whole else "nan") for i, c in enumerate(cells)
                )
            )
    return "\n".join(rows)


def read_csv(path: Path, required: Sequence[str]) -> Csv:
    """Read a CSV file with a header and columns of numbers; empty cells become NaN.

    Raises :class:`LogFormatError` with the line number for a missing column, a row of the wrong
    length or a cell that is no number.
    """
    try:
        text = path.read_text(encoding="utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise LogFormatError(f"{path}: not a text file") from None
    head, _, body = text.partition("\n")
    names = _header(path, head, required)
    kinds = [np.int64 if name in ("t_ns", "t_rx_ns") else np.float64 for name in names]
    dtype = np.dtype([(f"c{i}", kind) for i, kind in enumerate(kinds)])
    lines = body.split("\n")
    table = np.empty(0, dtype)
    if body.strip():
        rows = _filled(body, names).split("\n")
        try:
            table = np.loadtxt(rows, dtype, delimiter=",", comments=None, ndmin=1)
        except (ValueError, OverflowError):
            raise _explain(path, lines, names) from None
    columns = {name: table[f"c{i}"] for i, name in enumerate(names)}
    times: dict[str, I64] = {}
    for name in ("t_ns", "t_rx_ns"):
        if name in columns:
            times[name] = np.ascontiguousarray(columns.pop(name))
    for name, stamp in times.items():
        if (np.abs(stamp) > _LIMIT_NS).any():
            raise LogFormatError(f"{path}: {name} beyond any date; nanoseconds are expected")
    values = {name: np.ascontiguousarray(column) for name, column in columns.items()}
    return Csv(path, times, values, table.shape[0])


def _imu(path: Path) -> ImuSamples:
    """One inertial unit; refuses units that are plainly wrong."""
    csv = read_csv(path, ("t_ns", *_GYRO, *_ACCEL))
    gyro, accel = csv.stack(*_GYRO), csv.stack(*_ACCEL)
    if csv.count:
        with np.errstate(over="ignore"):
            norms = np.linalg.norm(accel, axis=1)
            rates = np.linalg.norm(gyro, axis=1)
        norm = float(np.median(norms[np.isfinite(norms)])) if np.isfinite(norms).any() else G
        if 0.8 < norm < 1.2:
            raise LogFormatError(
                f"{path}: specific force is about {norm:.2f}: in g? accel_*_mps2 is in m/s²"
            )
        if np.isfinite(rates).any():
            fast = float(np.percentile(rates[np.isfinite(rates)], 99))
            if fast > _MAX_RATE:
                raise LogFormatError(
                    f"{path}: angular rates to {fast:.3g}: in deg/s? gyro_*_radps is in rad/s"
                )
    return ImuSamples(path.stem, *csv.stamps(), gyro, accel, np.full(csv.count, np.nan))


def _place(csv: Csv) -> tuple[F64, F64, F64]:
    """Latitude, longitude [rad], height [m]; refuses what is not in degrees."""
    lat, lon = csv.values["lat_deg"], csv.values["lon_deg"]
    wrong = (np.abs(lat) > 90) | (np.abs(lon) > 360)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise LogFormatError(
            f"{csv.path}: lat_deg, lon_deg = {lat[row]:.9g}, {lon[row]:.9g} at t_ns "
            f"{csv.times['t_ns'][row]}: not degrees"
        )
    return lat * _DEG, lon * _DEG, csv.values["alt_hae_m"]


def _whole(values: F64, missing: int) -> I64:
    """Small whole numbers; ``missing`` for NaN and anything out of range."""
    known = np.isfinite(values) & (values >= 0) & (values < 1000)
    return np.where(known, values, missing).astype(np.int64)


def _gnss(path: Path) -> GnssSamples:
    """Fixes; a row without a position keeps its time and says that there was no fix."""
    csv = read_csv(path, ("t_ns", *_PLACE))
    lat, lon, height = _place(csv)
    known = np.isfinite(lat + lon)
    kind = np.where(known, _whole(csv.optional("fix_type"), 3), 0)
    return GnssSamples(
        path.stem,
        *csv.stamps(),
        np.where(known, lat, 0.0),
        np.where(known, lon, 0.0),
        height,
        csv.stack(*_VEL),
        csv.stack("sd_n_m", "sd_e_m", "sd_d_m"),
        csv.stack("sd_vn_mps", "sd_ve_mps", "sd_vd_mps"),
        _whole(csv.optional("num_sats"), -1),
        kind,
    )


def read_reference(path: Path) -> ReferenceSamples:
    """Truth or an exported solution, ``truth.csv`` layout; velocity and angles may be missing.

    Raises :class:`LogFormatError` as :func:`read_csv` does.
    """
    csv = read_csv(path, ("t_ns", *_PLACE))
    lat, lon, height = _place(csv)
    rpy = csv.stack("roll_deg", "pitch_deg", "yaw_deg") * _DEG
    reference = ReferenceSamples(path.stem, *csv.stamps(), lat, lon, height, csv.stack(*_VEL), rpy)
    return reference.take(np.isfinite(lat + lon + height))


def _text(path: Path) -> str | None:
    """The configuration beside the data; checked by whoever uses it."""
    if not path.is_file():
        return None
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise LogFormatError(f"{path}: not a text file") from None


def _name(config: str | None) -> str:
    """The vehicle's name from its configuration, or ``vehicle``."""
    try:
        section = tomllib.loads(config or "").get("vehicle", {})
    except (tomllib.TOMLDecodeError, RecursionError):
        return "vehicle"
    name = section.get("name") if isinstance(section, dict) else None
    return name if isinstance(name, str) and name else "vehicle"


def _units(folder: Path, stem: str) -> list[Path]:
    """``imu.csv``, ``imu2.csv``, … in order."""
    numbered_files = [
        (int(match.group(1) or 1), path)
        for path in folder.glob(f"{stem}*.csv")
        if (match := re.fullmatch(rf"{stem}(\d{{0,3}})", path.stem))
    ]
    return [path for _, path in sorted(numbered_files)]


def read_folder(folder: Path, clock: GnssClock | None = None) -> Recording:
    """Read a sensor folder. ``clock``: of its stamps; None: as its ``vehicle.toml`` says, or UTC.

    Raises :class:`LogFormatError` if it has neither ``imu.csv`` nor ``gnss.csv``, or if a file in
    it is not what its name says, with file and line.
    """
    imus = [_imu(path) for path in _units(folder, "imu")]
    fixes = [_gnss(path) for path in _units(folder, "gnss")]
    if not imus and not fixes:
        raise LogFormatError(f"{folder}: no imu.csv and no gnss.csv; not a sensor folder")
    notes: list[str] = []
    baros: list[BaroSamples] = []
    for path in _units(folder, "baro")[:1]:
        csv = read_csv(path, ("t_ns", "pressure_pa"))
        baros.append(BaroSamples(path.stem, *csv.stamps(), csv.values["pressure_pa"]))
    mags: list[MagSamples] = []
    for path in _units(folder, "mag"):
        csv = read_csv(path, ("t_ns", "mag_x_t", "mag_y_t", "mag_z_t"))
        mags.append(
            MagSamples(path.stem, *csv.stamps(), csv.stack("mag_x_t", "mag_y_t", "mag_z_t"))
        )
    truths = [read_reference(folder / "truth.csv")] if (folder / "truth.csv").is_file() else []
    config = _text(folder / "vehicle.toml")
    raws: list[RawGnssSamples] = []
    broadcasts: list[BroadcastSamples] = []
    if (folder / "raw_gnss").is_dir():
        from replay.raw_gnss.folder import doubted_clock, read_raw_folder

        first = (imus or fixes)[0]
        begins = int(first.t_ns[0]) if len(first) else None
        clock = clock or stated_clock(config) or "utc"
        found = read_raw_folder(folder / "raw_gnss", clock, begins)
        raws, broadcasts = [found.raw], [found.broadcast]
        notes += found.notes
        doubt = doubted_clock(found.raw, first, clock)
        notes += [doubt] if doubt else []
    imus, fixes, baros, mags, broadcasts, raws, truths = numbered(
        [imus, fixes, baros, mags, broadcasts, raws, truths]
    )
    vehicle, odd = finish_vehicle(
        _name(config), imus, fixes, baros, mags, truths[0] if truths else None, None, datum="hae",
        raw=raws, broadcast=broadcasts,
    )  # fmt: skip
    return Recording(str(folder), "folder", (vehicle,), tuple(notes + odd), config)
