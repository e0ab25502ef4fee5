"""Clocks of real receivers: their noise as learned, and one foretold without satellites.

Run as ``python -m tests.benchmarks.clock_foretold``. Three recordings through the receiver's stream
alone: a u-blox in a walking hand, an Emlid Reach at rest, a phone between houses. Then windows of
30 s of ``rtk-walk`` without any satellite: the clock that the tightly coupled filter carries on
against the one that the withheld epochs say by themselves. What a single satellite could tell of
the place is lost in it where the clock is less known than the place is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.config import Config, RawGnss, parse
from companion.engine import Engine
from companion.gnss.single_point import P_CLOCK, P_RATE
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation import layout as lo
from companion.types import F64, I64, NS, VehicleRecording
from replay.player import blocks
from tests.benchmarks.single_point import cases
from tests.benchmarks.tight_coupling import (
    CONFIG,
    DATA,
    LENGTHS_S,
    NO_SATELLITE,
    STARTS_S,
    walk,
    withheld,
)

BLOCK_S = 0.25
AVERAGE_S = 0.6
"""A solution's own rate scatters by 0.2 m/s: the mean so far to both sides."""


class Foretold(NamedTuple):
    """One moment: errors, and what the filter says of them, 1σ."""

    bias_m: float
    bias_sd_m: float
    drift_mps: float
    drift_sd_mps: float
    place_sd_m: float
    """Horizontal."""


def clocks(vehicle: VehicleRecording, config: Config) -> tuple[I64, F64, F64]:
    """Times, clock [m] and its rate [m/s] by each epoch's own solution."""
    receiver, raw = Receiver(config.raw_gnss), vehicle.raw[0]
    receiver.listen(vehicle.broadcast[0])
    solved = [(int(raw.t_ns[i]), receiver.take(raw, i).point) for i in range(len(raw))]
    known = [(t, point[P_CLOCK], point[P_RATE]) for t, point in solved if point is not None]
    t, bias, rate = zip(*known, strict=True)
    assert receiver.clock.steps == receiver.clock.jumps == 0
    offset = receiver.clock.offset or 0.0
    return np.array(t), np.array(bias) - offset, np.array(rate)


def foretold(
    vehicle: VehicleRecording, config: Config, start: float, truth: tuple[I64, F64, F64]
) -> list[Foretold]:
    """The clock at the end of each of :data:`LENGTHS_S` after ``start`` [s]."""
    origin = int(vehicle.imu[0].t_ns[0])
    begin = origin + round(start * NS)
    part = withheld(vehicle, begin, begin + round(LENGTHS_S[-1] * NS), NO_SATELLITE)
    ends = [begin + round((length - BLOCK_S) * NS) for length in LENGTHS_S]
    engine, out = Engine(config), list[Foretold]()
    for imu, aids in blocks(part, config, BLOCK_S):
        engine.step_block(imu, aids)
        if len(out) < len(ends) and imu.t_ns[-1] >= ends[len(out)]:
            out.append(_now(engine, truth))
    return out


def _now(engine: Engine, truth: tuple[I64, F64, F64]) -> Foretold:
    f, setup = engine.filter.phases[-1].filters[0], engine.filter.setup
    now, at = int(f.k[lo.T_NOW]), setup.layout.clock
    t, bias, rate = truth
    near = np.abs(t - now) < AVERAGE_S * NS
    # The clock is carried with the covariance, which may be an interval behind the sample.
    here = f.s[lo.CLOCK] + f.s[lo.SUM_T] * f.s[lo.CLOCK + lo.DRIFT]
    sd = np.sqrt(np.diag(setup.covariance(f.s)))
    return Foretold(
        float(np.interp(now, t, bias)) - here, float(sd[at]),
        float(rate[near].mean()) - f.s[lo.CLOCK + lo.DRIFT], float(sd[at + lo.DRIFT]),
        float(np.hypot(sd[lo.POS], sd[lo.POS + 1])),
    )  # fmt: skip


def print_learned() -> None:
    """What is known of each clock at the end of its recording."""
    asked = RawGnss()
    configured = (asked.clock_walk_m_rts, asked.clock_drift_walk_mps_rts, asked.clock_ramp_mps2)
    print(f"{'recording':18}{'solved':>8}{'bias m/√s':>12}{'drift m/s/√s':>14}{'ramp m/s²':>11}")
    print(f"{'configured':26}" + "{:12.3f}{:14.3f}{:11.3f}".format(*configured))
    for case in cases():
        receiver = Receiver(asked)
        receiver.listen(case.broadcast)
        epochs = [receiver.take(case.raw, i) for i in range(len(case.raw))]
        solved = sum(epoch.point is not None for epoch in epochs)
        found = np.sqrt(epochs[-1].clock_scale) * configured
        print(f"{case.name:18}{solved:8d}" + "{:12.3f}{:14.3f}{:11.3f}".format(*found))


def main() -> None:
    print_learned()
    print()
    vehicle = walk(DATA)
    print(f"{'noise':>12}{'after s':>9}{'windows':>9}{'clock off m, RMS':>18}{'says':>7}"
          f"{'drift off m/s':>15}{'says':>7}{'place says m':>14}")  # fmt: skip
    for noise in ("configured", "learned"):
        config = parse(CONFIG.format(coupling="tight") + f'clock_noise = "{noise}"\n')
        truth = clocks(vehicle, config)
        windows = [foretold(vehicle, config, start, truth) for start in STARTS_S]
        for i, length in enumerate(LENGTHS_S):
            found = [window[i] for window in windows if len(window) > i]
            rms = np.sqrt(np.mean(np.square(found), axis=0))
            print(f"{noise:>12}{length:9.0f}{len(found):9d}{rms[0]:18.1f}{rms[1]:7.1f}"
                  f"{rms[2]:15.2f}{rms[3]:7.2f}{rms[4]:14.1f}")  # fmt: skip


if __name__ == "__main__":
    main()
