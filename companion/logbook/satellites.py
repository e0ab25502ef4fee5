"""Satellites in use as protobuf messages, one an epoch of raw measurements: log and subscribers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from google.protobuf.message import DecodeError

from companion.logbook.rows import U8, RowTemplate, scalar
from companion.proto import navigation_pb2
from companion.types import LogFormatError, Satellites

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


def decode_satellites(payloads: Sequence[bytes]) -> Satellites:
    """The reverse, to single precision; raises :class:`LogFormatError` for other messages."""
    try:
        parsed = [navigation_pb2.Satellites.FromString(payload) for payload in payloads]
    except DecodeError:
        raise LogFormatError("not a companion.Satellites message") from None
    dop = [[getattr(message, name) for name in _DOPS] for message in parsed]
    return Satellites(
        np.array([message.t_ns for message in parsed], np.int64),
        np.array([message.used for message in parsed], np.int64),
        np.array([message.excluded for message in parsed], np.int64),
        np.array(dop, np.float64).reshape(len(parsed), len(_DOPS)),
    )
