"""Layouts of MAVLink messages, taken from pymavlink's ``ardupilotmega`` dialect.

pymavlink's generated classes are the one source for ids, CRC seeds, wire order and types; they are
only read here for tables, never instantiated for a message.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega

_WIRE = {
    "char": "S1",
    "uint8_t": "u1",
    "uint8_t_mavlink_version": "u1",
    "int8_t": "i1",
    "uint16_t": "<u2",
    "int16_t": "<i2",
    "uint32_t": "<u4",
    "int32_t": "<i4",
    "uint64_t": "<u8",
    "int64_t": "<i8",
    "float": "<f4",
    "double": "<f8",
}

_MESSAGES: dict[int, Any] = dict(ardupilotmega.mavlink_map)
_IDS: dict[str, int] = {cls.msgname: msgid for msgid, cls in _MESSAGES.items()}


def message_id(name: str) -> int:
    """Number of a message by its name (``GPS_RAW_INT``); KeyError if the dialect has none."""
    return _IDS[name]


def message_name(msgid: int) -> str:
    """Name of a message by its number; ``UNKNOWN_<id>`` outside the dialect."""
    cls = _MESSAGES.get(msgid)
    return str(cls.msgname) if cls is not None else f"UNKNOWN_{msgid}"


@cache
def crc_table() -> NDArray[np.int16]:
    """(M, 2) per message id: CRC seed and longest payload [bytes]; (−1, −1) for unknown ids."""
    table = np.full((max(_MESSAGES) + 1, 2), -1, np.int16)
    for msgid, cls in _MESSAGES.items():
        table[msgid] = cls.crc_extra, cls.unpacker.size
    return table


@cache
def layout(msgid: int) -> np.dtype[Any]:
    """Packed little-endian structured dtype of a payload with all its extension fields."""
    cls = _MESSAGES[msgid]
    kinds = dict(zip(cls.fieldnames, cls.fieldtypes, strict=True))
    fields: list[Any] = []
    for name, count in zip(cls.ordered_fieldnames, cls.array_lengths, strict=True):
        wire = _WIRE[kinds[name]]
        if not count:
            fields.append((name, wire))
        elif wire == "S1":
            fields.append((name, f"S{count}"))
        else:
            fields.append((name, wire, (count,)))
    return np.dtype(fields)
