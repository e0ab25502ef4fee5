"""Read any log that this project understands: one door for all formats."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from companion.config import CanBus
from companion.types import (
    CompanionError,
    ImuTooSlowError,
    LogFormatError,
    Recording,
    VehicleRecording,
)
from replay.streams import SLOW_HZ, GnssClock, rate_hz

READABLE = (
    "a .tlog, DataFlash .BIN, PX4 .ulg, our own .mcap, a candump .log or .log.gz, "
    "or a sensor folder with imu.csv"
)

_RAW_GNSS = (
    "it belongs into raw_gnss/ of a sensor folder, beside imu.csv (companion satellites reads it "
    "alone)"
)
_MAGIC = (
    (b"\x89MCAP", "mcap"),
    (b"ULog\x01\x12\x35", "ulog"),
    (b"\xa3\x95", "dataflash"),
    (b"PK\x03\x04", "a zip archive; unpack it first"),
    (b"\x1f\x8b", "gzip-compressed data; unpack it first"),
    (b"MATLAB 5.0", "a MATLAB file"),
    (b"\x89HDF", "an HDF5 file"),
    (b"\xb5\x62", f"u-blox UBX data; {_RAW_GNSS}"),
    (b"\x89PNG", "an image"),
)
_SUFFIXES = {
    ".tlog": "tlog",
    ".bin": "dataflash",
    ".ulg": "ulog",
    ".mcap": "mcap",
    ".asc": "candump",
    ".blf": "candump",
    ".mf4": "candump",
    ".trc": "candump",
    ".mat": "a MATLAB file",
    ".csv": "a bare CSV file; give the sensor folder that holds it",
    ".zip": "a zip archive; unpack it first",
    ".ubx": f"u-blox UBX data; {_RAW_GNSS}",
    ".rtcm3": f"RTCM 3 data; {_RAW_GNSS}",
    ".rtcm": f"RTCM 3 data; {_RAW_GNSS}",
    ".rtc": f"RTCM 3 data; {_RAW_GNSS}",
    ".dbc": "a CAN database",
    ".log": "a text log",
    ".gz": "gzip-compressed data; unpack it first",
    ".toml": "a configuration",
    ".json": "a JSON file",
    ".md": "a text file",
}
_HEAD = 2048
_CANDUMP = (b"(", b"\x1f\x8b")
"""How a candump log begins, plain or packed."""
_FORMATS = ("tlog", "dataflash", "ulog", "mcap")


def _kind(path: Path) -> str:
    """Name of the format, or words for what the file looks like."""
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if not head:
        return "an empty file"
    if head.startswith(_CANDUMP):
        from replay.candump import looks_like_candump

        if looks_like_candump(head):
            return "candump"
    for magic, kind in _MAGIC:
        if head.startswith(magic):
            return kind
    if head[60:80] == b"RINEX VERSION / TYPE":
        return f"a RINEX file; {_RAW_GNSS}"
    if b"# Raw,utcTimeMillis," in head:
        return f"a GnssLogger file; {_RAW_GNSS}"
    suffix = _SUFFIXES.get(path.suffix.lower())
    if suffix is not None:
        return suffix
    # A tlog begins with the stamp of its first frame; years 2000-2100 start with 0x0003-0x000E.
    if len(head) > 8 and head[0] == 0 and head[8] in (0xFD, 0xFE):
        return "tlog"
    return "an unknown format"


def looks_readable(path: Path) -> bool:
    """Whether a file begins, or else is named, like a log that can be navigated with.

    CAN traffic alone cannot: it belongs to another log.
    """
    try:
        return _kind(path) in _FORMATS
    except OSError:
        return False


def _read(path: Path, can: Sequence[CanBus], clock: GnssClock | None) -> Recording:
    """One path of any readable format. The readers are imported when needed: start-up counts."""
    if path.is_dir():
        from replay.sensor_folder import read_folder

        return read_folder(path, clock)
    kind = _kind(path)
    if kind == "tlog":
        from replay.tlog import read_tlog

        return read_tlog(path)
    if kind == "dataflash":
        from replay.dataflash import read_dataflash

        return read_dataflash(path)
    if kind == "ulog":
        from replay.ulog import read_ulog

        return read_ulog(path)
    if kind == "mcap":
        from replay.run_log import read_run

        return read_run(path)
    if kind == "candump":
        from replay.can_recording import read_can

        return read_can(path, can)
    raise LogFormatError(f"{path}: {kind}; readable is {READABLE}")


def _merge(recordings: Sequence[Recording]) -> Recording:
    """Several files of one run as one recording; their vehicles must have different names."""
    if len(recordings) == 1:
        return recordings[0]
    owner: dict[str, str] = {}
    for recording in recordings:
        for vehicle in recording.vehicles:
            if vehicle.name in owner:
                raise LogFormatError(
                    f"{owner[vehicle.name]} and {recording.path} both hold vehicle "
                    f"'{vehicle.name}'; replay them one at a time"
                )
            owner[vehicle.name] = recording.path
    configs = [r.config_toml for r in recordings if r.config_toml is not None]
    if len(configs) > 1:
        raise LogFormatError("several of the paths bring a configuration; give one at a time")
    return Recording(
        " + ".join(r.path for r in recordings),
        recordings[0].format,
        tuple(v for r in recordings for v in r.vehicles),
        tuple(f"{Path(r.path).name}: {note}" for r in recordings for note in r.notes),
        configs[0] if configs else None,
        {key: value for r in recordings for key, value in r.metadata.items()},
    )


def read_log(
    paths: Sequence[Path],
    *,
    vehicle: str | None = None,
    can: Sequence[CanBus] = (),
    clock: GnssClock | None = None,
) -> Recording:
    """Read one run from one or more paths.

    Recorded CAN traffic beside another log becomes IMUs of that log's vehicle. ``vehicle``: keep
    only the vehicle of this name. ``can``: the configuration's buses, for units that a recording
    does not tell by itself. ``clock``: of a sensor folder's stamps, where the configuration says
    it (``raw_gnss.clock``); else its ``vehicle.toml`` does. Raises :class:`LogFormatError` with one
    line if a path cannot be read, is of no readable format, or lacks that vehicle.
    """
    if not paths:
        raise LogFormatError(f"no log given; readable is {READABLE}")
    recordings = []
    for path in paths:
        try:
            recordings.append(_read(Path(path), can, clock))
        except CompanionError:
            raise
        except (OSError, MemoryError) as error:
            reason = getattr(error, "strerror", None) or "too large for this machine's memory"
            raise LogFormatError(f"{path}: cannot be read: {reason}") from None
    inertial = [r for r in recordings if r.format == "candump"]
    others = [r for r in recordings if r.format != "candump"]
    if not (inertial and others):
        return _only(_merge(recordings), vehicle)
    from replay.joining import join_inertial

    return join_inertial(_only(_merge(others), vehicle), inertial)


def _only(recording: Recording, vehicle: str | None) -> Recording:
    """The recording, or what it has of one vehicle."""
    if vehicle is None:
        return recording
    chosen = tuple(v for v in recording.vehicles if v.name == vehicle)
    if not chosen:
        names = ", ".join(v.name for v in recording.vehicles) or "none"
        raise LogFormatError(f"{recording.path}: no vehicle '{vehicle}'; there is {names}")
    return replace(recording, vehicles=chosen)


def has_inputs(vehicle: VehicleRecording) -> bool:
    """Whether there is what any filter needs: an IMU and a fix."""
    return bool(vehicle.imu) and any((gnss.fix_type >= 2).any() for gnss in vehicle.gnss)


def require_inputs(
    vehicle: VehicleRecording, minimum_hz: float = SLOW_HZ, ranges: bool = True
) -> None:
    """Refuse what a filter cannot be run on; ``minimum_hz`` is that of a strapdown one.

    ``ranges``: whether raw GNSS is used. Raises :class:`LogFormatError` without an IMU or without
    any GNSS that is used, and
    :class:`ImuTooSlowError`, naming stream and rate, if the best IMU is below ``minimum_hz``.
    """
    if not vehicle.imu:
        raise LogFormatError(f"{vehicle.name}: no inertial measurements in the log")
    # First what no filter can do without: the hint to another one would lead nowhere.
    if not has_inputs(vehicle) and vehicle.raw and not ranges:
        raise LogFormatError(
            f'{vehicle.name}: raw GNSS is all there is, and raw_gnss.coupling is "off": set '
            '"tight" or "loose"'
        )
    if not vehicle.raw and not has_inputs(vehicle):
        raise LogFormatError(f"{vehicle.name}: no GNSS fix in the log")
    best = vehicle.imu[0]
    rate = rate_hz(best.t_ns)
    if rate < minimum_hz:
        raise ImuTooSlowError(
            f"{vehicle.name}: the best IMU stream, {best.source}, comes at {rate:.1f} Hz; "
            f'a strapdown filter needs at least {minimum_hz:g} Hz (engine.estimator = "direct")'
        )
