"""Satellites in use as protobuf messages, one an epoch of raw measurements: log and subscribers."""

from __future__ import annotations

from companion.logbook.rows import U8, RowTemplate, scalar
from companion.types import Satellites

_DOPS = ("gdop", "pdop", "hdop", "vdop", "tdop")
_ROW = RowTemplate(
    scalar(1, "sfixed64", "t_ns"),
    scalar(2, "sfixed32", "used"),
    scalar(3, "sfixed32", "excluded"),
    *(scalar(4 + i, "float", name) for i, name in enumerate(_DOPS)),
)


def encode_satellites(satellites: Satellites) -> U8:
    """One ``companion.Satellites`` an epoch: bytes (N, length)."""
    columns = {name: getattr(satellites, name) for name in ("t_ns", "used", "excluded")}
    columns |= {name: satellites.dop[:, i] for i, name in enumerate(_DOPS)}
    return _ROW.encode(columns, len(satellites))
