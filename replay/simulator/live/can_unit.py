"""The simulated vehicle's CAN IMU: frames of its samples when they are due. Pure."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

from companion.types import ImuSamples
from replay.simulator.live.slcan import Frame

Encoder = Callable[[ImuSamples], Sequence[Frame]]
"""Frames of the samples given, in the order of the wire."""


class SimulatedCanImu:
    """One inertial unit on the bus; times are those of the recording's clock."""

    def __init__(self, samples: ImuSamples, encode: Encoder, seed: int = 0) -> None:
        self.silent = False
        self.loss_share = 0.0
        """Of the frames, lost on the wire at random."""
        self.samples = self.frames = self.lost = 0
        self._samples, self._encode = samples, encode
        self._rx: list[int] = samples.t_rx_ns.tolist()
        self._next = 0
        self._rng = random.Random(seed)

    @property
    def next_ns(self) -> int | None:
        """When the next sample is there; None after the last one."""
        return self._rx[self._next] if self._next < len(self._rx) else None

    def advance(self, now_ns: int) -> list[Frame]:
        """Frames on the wire for the samples up to ``now_ns``; a silent unit skips its samples."""
        out: list[Frame] = []
        while (rx := self.next_ns) is not None and rx <= now_ns:
            at = self._next
            self._next += 1
            if self.silent:
                continue
            frames = self._encode(self._samples.take(slice(at, at + 1)))
            arrived = [f for f in frames if not self._rng.random() < self.loss_share]
            self.samples += 1
            self.frames += len(arrived)
            self.lost += len(frames) - len(arrived)
            out += arrived
        return out
