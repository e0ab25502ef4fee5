"""Traces of the adaptation as protobuf messages, one an adapted update: log and subscribers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from google.protobuf.message import DecodeError

from companion.logbook.rows import U8, RowTemplate, packed, scalar
from companion.proto.adaptation_pb2 import AdaptationTrace as Message
from companion.types import AdaptationTrace, LogFormatError

_INTEGERS = ("t_ns", "channel", "source")
_FLOATS = ("mean", "spread", "correlation", "to_model", "to_source", "r_scale", "q_scale", "alpha")

_TRACE = RowTemplate(
    scalar(1, "sfixed64", "t_ns"),
    scalar(2, "enum", "channel"),
    scalar(3, "sfixed32", "source"),
    scalar(4, "enum", "rule"),
    *(scalar(5 + i, "float", name) for i, name in enumerate(_FLOATS[:5])),
    packed(10, "float", "firing", 9),
    *(scalar(11 + i, "double", name) for i, name in enumerate(_FLOATS[5:])),
)


def encode_trace(trace: AdaptationTrace) -> U8:
    """One ``AdaptationTrace`` an update: bytes (N, length)."""
    columns = {name: getattr(trace, name) for name in (*_INTEGERS, *_FLOATS, "firing")}
    return _TRACE.encode({**columns, "rule": trace.rule + 1}, len(trace))


def decode_trace(payloads: Sequence[bytes]) -> AdaptationTrace:
    """The rows of ``AdaptationTrace`` messages, in the order given; inputs in single precision.

    Raises :class:`LogFormatError` when one is not an AdaptationTrace.
    """
    if not payloads:
        return AdaptationTrace.empty()
    try:
        parsed = [Message.FromString(p) for p in payloads]
        firing = np.array([list(m.firing) for m in parsed], np.float64).reshape(len(parsed), 9)
    except (DecodeError, ValueError):
        raise LogFormatError("not a companion.AdaptationTrace message") from None
    columns: dict[str, Any] = {"firing": firing}
    for names, kind in ((_INTEGERS, np.int64), (_FLOATS, np.float64)):
        columns |= {n: np.array([getattr(m, n) for m in parsed], kind) for n in names}
    return AdaptationTrace(**columns)
