"""What a filter took between two declared breaks, and where it stood: to run over it once more."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.estimation.buffers import SampleBuffer
from companion.types import F64, I64


@dataclass(frozen=True, slots=True)
class Block:
    """Samples and aids of one walk, in order of validity, as the walk takes them."""

    imu_t: I64
    imu: F64
    aid_t: I64
    aid_key: I64
    aid: F64


@dataclass(frozen=True, slots=True)
class Mark:
    """The filter's state at the end of a block."""

    block: int
    """Index of that block."""
    s: F64
    k: I64


@dataclass(slots=True)
class Stretch:
    """The inputs of one filter, block by block."""

    start_ns: int
    """Where the filter began: nothing before it was taken."""
    resets: int
    blocks: list[Block] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    """One a block, from where its heading was known on."""

    def took(
        self, imu: SampleBuffer, samples: tuple[int, int], aids: SampleBuffer, aid: tuple[int, int]
    ) -> None:
        """Keep what a walk took: ranges of the two buffers."""
        a, b = slice(*samples), slice(*aid)
        self.blocks.append(
            Block(
                imu.t[a].copy(),
                imu.rows[a].copy(),
                aids.t[b].copy(),
                aids.key[b].copy(),
                aids.rows[b].copy(),
            )
        )

    def stands(self, s: F64, k: I64) -> None:
        """Mark the state after the last block, unless it has broken."""
        if np.isfinite(s).all():
            self.marks.append(Mark(len(self.blocks) - 1, s.copy(), k.copy()))

    @property
    def end_ns(self) -> int:
        """Time of the last sample taken."""
        return max((int(b.imu_t[-1]) for b in self.blocks if len(b.imu_t)), default=self.start_ns)

    @property
    def bytes(self) -> int:
        """Memory of the inputs and marks."""
        arrays = [(b.imu_t, b.imu, b.aid_t, b.aid_key, b.aid) for b in self.blocks]
        return sum(int(np.sum([x.nbytes for x in block])) for block in arrays) + sum(
            m.s.nbytes + m.k.nbytes for m in self.marks
        )
