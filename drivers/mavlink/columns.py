"""The frames of one message as a structured array, without an object per message."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from companion._jit import njit
from drivers.mavlink.dialect import layout
from drivers.mavlink.framer import U8, FrameIndex


@njit(
    "void(Array(u1, 1, 'C', readonly=True), Array(i8, 1, 'C', readonly=True),"
    " Array(u1, 1, 'C', readonly=True), u1[:, ::1])",
    cache=True,
    entry=True,
)
def _gather(buf: U8, payload: NDArray[np.int64], length: U8, out: NDArray[np.uint8]) -> None:
    """Copy each payload to the front of its zeroed row, cut at the row's width."""
    for i in range(payload.shape[0]):
        for j in range(min(np.int64(length[i]), out.shape[1])):
            out[i, j] = buf[payload[i] + j]


def decode(
    buf: U8, index: FrameIndex, msgid: int, rows: NDArray[np.int64]
) -> np.ndarray[Any, np.dtype[Any]]:
    """(N,) structured array of the frames ``rows`` of message ``msgid``, fields as on the wire.

    ``rows`` are positions in ``index``. Fields that the sender left out (extensions, MAVLink 2's
    trailing zeros) read as zero.
    """
    kind = layout(msgid)
    out = np.zeros((rows.shape[0], kind.itemsize), np.uint8)
    _gather(buf, index.payload[rows], index.length[rows], out)
    return out.view(kind)[:, 0]
