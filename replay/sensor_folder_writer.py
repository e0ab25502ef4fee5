"""Writes a recording as a sensor folder: the CSV files that any other program can read and write.

Decimals are chosen below what any sensor resolves (1e-10° is 0.01 mm of latitude), not to keep
every bit: for that there is the run log. A missing value is an empty cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from companion.types import (
    F64,
    I64,
    CompanionError,
    GnssSamples,
    ImuSamples,
    ReferenceSamples,
    VehicleRecording,
)

Column = tuple[str, str, F64 | I64]
"""Header, printf format, values (N,)."""

_ROWS = 50_000
"""Rows formatted together: bounds memory, costs no time."""


def write_csv(path: Path, columns: Sequence[Column]) -> None:
    """Write ``columns``, all of one length, with their headers; NaN becomes an empty cell.

    Raises :class:`CompanionError` if the file cannot be written.
    """
    headers, formats, values = zip(*columns, strict=True)
    line = ",".join(formats) + "\n"
    try:
        with path.open("w", encoding="ascii", newline="") as file:
            file.write(",".join(headers) + "\n")
            for lo in range(0, len(values[0]), _ROWS):
                rows = zip(*(v[lo : lo + _ROWS].tolist() for v in values), strict=True)
                file.write("".join(map(line.__mod__, rows)).replace("nan", ""))
    except OSError as error:
        raise CompanionError(f"{path}: cannot be written: {error.strerror}") from None


def _axes(names: Iterable[str], form: str, values: F64) -> list[Column]:
    return [(name, form, column) for name, column in zip(names, values.T, strict=True)]


def _imu_columns(imu: ImuSamples) -> list[Column]:
    return [
        ("t_ns", "%d", imu.t_ns),
        *_axes((f"gyro_{a}_radps" for a in "xyz"), "%.9f", imu.gyro_b),
        *_axes((f"accel_{a}_mps2" for a in "xyz"), "%.7f", imu.accel_b),
    ]


def _place(t_ns: I64, lat: F64, lon: F64, height: F64, vel_n: F64) -> list[Column]:
    return [
        ("t_ns", "%d", t_ns),
        ("lat_deg", "%.10f", np.degrees(lat)),
        ("lon_deg", "%.10f", np.degrees(lon)),
        ("alt_hae_m", "%.5f", height),
        *_axes((f"vel_{a}_mps" for a in "ned"), "%.6f", vel_n),
    ]


def gnss_columns(gnss: GnssSamples) -> list[Column]:
    """The columns of ``gnss.csv``."""
    return [
        *_place(gnss.t_ns, gnss.lat, gnss.lon, gnss.height, gnss.vel_n),
        *_axes((f"sd_{a}_m" for a in "ned"), "%.4f", gnss.sd_pos),
        *_axes((f"sd_v{a}_mps" for a in "ned"), "%.4f", gnss.sd_vel),
        ("num_sats", "%d", gnss.num_sats),
        ("fix_type", "%d", gnss.fix_type),
        ("t_rx_ns", "%d", gnss.t_rx_ns),
    ]


def write_truth(truth: ReferenceSamples, path: Path) -> None:
    """Write ``truth.csv``; heights must be above the ellipsoid."""
    attitude = _axes(("roll_deg", "pitch_deg", "yaw_deg"), "%.7f", np.degrees(truth.rpy))
    place = _place(truth.t_ns, truth.lat, truth.lon, truth.height, truth.vel_n)
    write_csv(path, [*place, *attitude])


def write_folder(
    recording: VehicleRecording, directory: Path, config_toml: str | None = None
) -> list[Path]:
    """Write ``recording`` as a sensor folder and return the files; ``directory`` is made.

    ``config_toml`` goes to ``vehicle.toml``. Intervals of integrating IMUs and arrival times other
    than those of fixes have no place in the format. Raises :class:`CompanionError` for a recording
    the format cannot hold (heights not above the ellipsoid, several receivers) or a full disk.
    """
    if recording.height_datum != "hae":
        raise CompanionError("a sensor folder has heights above the ellipsoid, not mean sea level")
    if max(len(recording.gnss), len(recording.baro), len(recording.mag)) > 1:
        raise CompanionError("a sensor folder has one GNSS receiver, barometer and magnetometer")
    tables: dict[str, list[Column]] = {}
    for number, imu in enumerate(recording.imu, start=1):
        tables["imu.csv" if number == 1 else f"imu{number}.csv"] = _imu_columns(imu)
    for gnss in recording.gnss:
        tables["gnss.csv"] = gnss_columns(gnss)
    for baro in recording.baro:
        tables["baro.csv"] = [("t_ns", "%d", baro.t_ns), ("pressure_pa", "%.3f", baro.pressure)]
    for mag in recording.mag:
        field = _axes((f"mag_{a}_t" for a in "xyz"), "%.12f", mag.field_b)
        tables["mag.csv"] = [("t_ns", "%d", mag.t_ns), *field]
    try:
        directory.mkdir(parents=True, exist_ok=True)
        if config_toml is not None:
            (directory / "vehicle.toml").write_text(config_toml, encoding="utf-8")
    except OSError as error:
        raise CompanionError(f"{directory}: cannot be written: {error.strerror}") from None
    written = [directory / name for name in tables]
    for path, columns in zip(written, tables.values(), strict=True):
        write_csv(path, columns)
    if recording.truth is not None:
        written.append(directory / "truth.csv")
        write_truth(recording.truth, written[-1])
    return written + ([directory / "vehicle.toml"] if config_toml is not None else [])
