"""Growing, sliding column buffers: what the estimator may still have to walk again."""

from __future__ import annotations

import numpy as np

from companion.types import F64, I64


class SampleBuffer:
    """Times (N,) and rows (N, width) in time order, cut at the old end, contiguous for kernels.

    Valid entries are ``start`` to ``end`` of the arrays; indices stay valid until the next append
    or forget.
    """

    def __init__(self, width: int, key_width: int = 0, capacity: int = 4096) -> None:
        self.t: I64 = np.zeros(capacity, np.int64)
        self.key: I64 = np.zeros((capacity, key_width), np.int64)
        self.rows: F64 = np.zeros((capacity, width))
        self.start = 0
        self.end = 0

    def __len__(self) -> int:
        return self.end - self.start

    def _room(self, count: int) -> None:
        if self.end + count <= len(self.t):
            return
        used = self.end - self.start
        capacity = len(self.t)
        if used + count > capacity // 2:
            capacity = max(2 * capacity, 2 * (used + count))
        for name in ("t", "key", "rows"):
            old = getattr(self, name)
            new = np.zeros((capacity, *old.shape[1:]), old.dtype)
            new[:used] = old[self.start : self.end]
            setattr(self, name, new)
        self.start, self.end = 0, used

    def append(self, t: I64, rows: F64, key: I64 | None = None) -> None:
        """Add entries that are all later than those held."""
        n = len(t)
        self._room(n)
        self.t[self.end : self.end + n] = t
        self.rows[self.end : self.end + n] = rows
        if key is not None:
            self.key[self.end : self.end + n] = key
        self.end += n

    def insert(self, t: int, row: F64, key: I64) -> None:
        """Put one entry at its place by (time, key): the order of arrival leaves no trace."""
        self._room(1)
        # A late one has a whole block of others waiting behind it.
        at = self.after(t)
        k0, k1 = int(key[0]), int(key[1])
        while at > self.start and self.t[at - 1] == t:
            if (self.key[at - 1, 0], self.key[at - 1, 1]) <= (k0, k1):
                break
            at -= 1
        if at < self.end:
            for column in (self.t, self.key, self.rows):
                column[at + 1 : self.end + 1] = column[at : self.end].copy()
        self.t[at], self.key[at], self.rows[at] = t, key, row
        self.end += 1

    def merge(self, t: I64, rows: F64, key: I64) -> None:
        """Put entries at their places by (time, key), as :meth:`insert` does one by one."""
        self._room(len(t))
        first = self.after(int(t.min()) - 1)
        old = slice(first, self.end)
        every = np.concatenate((self.t[old], t))
        keys = np.concatenate((self.key[old], key))
        order = np.lexsort((keys[:, 1], keys[:, 0], every))
        self.end += len(t)
        new = slice(first, self.end)
        self.rows[new] = np.concatenate((self.rows[old], rows))[order]
        self.t[new], self.key[new] = every[order], keys[order]

    def after(self, t: int) -> int:
        """Index of the first entry later than ``t``."""
        # Live, it is nearly always one end or the other.
        if self.end == self.start or self.t[self.end - 1] <= t:
            return self.end
        if self.t[self.start] > t:
            return self.start
        return self.start + int(self.t[self.start : self.end].searchsorted(t, side="right"))

    def forget(self, before: int) -> None:
        """Drop entries older than ``before``."""
        if self.end > self.start and self.t[self.start] < before:
            self.start += int(self.t[self.start : self.end].searchsorted(before, side="left"))

    def clear(self) -> None:
        self.start = self.end = 0
