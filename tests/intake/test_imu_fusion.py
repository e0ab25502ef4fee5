"""Several inertial units as one: what is fused, which unit is found to be wrong, and when."""

from __future__ import annotations

import math
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from companion.config import DEG, Config, FurtherImu
from companion.intake.counters import Counters
from companion.intake.fused import FusedImu
from companion.intake.fusion import layout as lo
from companion.intake.fusion.fusion import ImuFusion
from companion.intake.fusion.judge import noise_of, note_pull, undo
from companion.types import NS, Event, ImuSamples
from replay.simulator.simulation import run

from .flights import FAULTS, config, failure, flown, scenario

FOUND_S = {
    "drifting": 8.0,
    "frozen": 0.6,
    "saturated": 0.6,
    "silent": 0.6,
    "noisy": 2.5,
    "scaled": 1.0,
}
"""Longest time to detection: a drift of 0.03 deg/s and 0.03 m/s² a second has to outgrow noise, the
others show within one or two windows of a quarter second; noise is told over a few more."""


def _fused(units: list[ImuSamples], cfg: Config) -> tuple[FusedImu, list[Event], ImuFusion]:
    fusion = ImuFusion(cfg, Counters())
    out, events = fusion.take(units)
    return out, events, fusion


def _after(events: list[Event], t0: int) -> list[tuple[str, float]]:
    return [(e.kind, (e.t_ns - t0) / NS) for e in events]


def test_perfect_units_on_lever_arms_give_the_increments_of_the_first() -> None:
    of = scenario({}, duration_s=60.0, grade="perfect")
    of = msgspec.structs.replace(
        of, imu=tuple(msgspec.structs.replace(u, output="integral", rate_hz=200.0) for u in of.imu)
    )
    recording = run(of, 1).recording
    out, events, _ = _fused(list(recording.imu), config(of))
    first = recording.imu[0]
    assert np.array_equal(out.t_ns, first.t_ns)
    assert np.abs(out.gyro_b - first.gyro_b).max() < 1e-9
    off = np.abs(out.accel_b - first.accel_b)
    arm = recording.imu[1].accel_b - first.accel_b
    # What the arms add is gone but for the low pass on the rate's derivative, 20 ms behind.
    assert off.max() < 0.1 * np.abs(arm).max()
    assert np.sqrt((off**2).mean()) < 0.05 * np.sqrt((arm**2).mean())
    assert events == []


def test_units_of_other_rates_and_axes_are_brought_to_the_first() -> None:
    of = scenario({}, duration_s=40.0, grade="perfect")
    units = [
        msgspec.structs.replace(u, rate_hz=rate, lever_arm_b_m=(0.0, 0.0, 0.0))
        for u, rate in zip(of.imu, (100.0, 93.0, 250.0), strict=True)
    ]
    of = msgspec.structs.replace(of, imu=tuple(units))
    first, second, third = run(of, 1).recording.imu
    turned = replace(third, gyro_b=third.gyro_b[:, [1, 2, 0]], accel_b=third.accel_b[:, [1, 2, 0]])
    cfg = config(of)
    axes = ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    further = (FurtherImu(source="imu2"), FurtherImu(source="imu3", axes=axes))
    cfg = msgspec.structs.replace(cfg, further_imu=further)
    out, events, fusion = _fused([first, second, turned], cfg)
    mean = 0.5 * (first.gyro_b[1:] + first.gyro_b[:-1])
    # The epoch of the end has no later sample of the 93 Hz unit and is still due.
    mean = mean[: len(out) - 1]
    # Straight lines between samples 10 ms apart, of motions of a few tenths of a second.
    assert np.abs(out.gyro_b[1:] - mean).max() < 0.02 * np.abs(mean).max()
    assert events == []
    assert [fusion.state_of(name) for name in ("imu1", "imu2", "imu3")] == ["ok"] * 3


@pytest.mark.parametrize("kind", FAULTS)
def test_of_three_units_the_one_that_fails_is_found_and_named(kind: str) -> None:
    simulation, cfg = flown(kind)
    out, events, fusion = _fused(list(simulation.recording.imu), cfg)
    said = _after(events, simulation.t0_ns)
    assert [what for what, _ in said] == ["imu-excluded"]
    assert 40.0 <= said[0][1] < 40.0 + FOUND_S[kind]
    assert fusion.state_of("imu2") == kind
    assert "IMU imu2 excluded" in events[0].text
    assert np.array_equal(out.t_ns, simulation.recording.imu[0].t_ns)


def test_a_fault_of_one_unit_hardly_moves_what_is_fused() -> None:
    good, cfg = flown()
    nominal, none, _ = _fused(list(good.recording.imu), cfg)
    assert none == []
    for kind in FAULTS:
        out, _, _ = _fused(list(flown(kind)[0].recording.imu), cfg)
        n = min(len(out), len(nominal))
        gyro = np.abs(out.gyro_b[:n] - nominal.gyro_b[:n]).max() / DEG
        turn = np.abs((out.gyro_b[:n] - nominal.gyro_b[:n]).sum(axis=0)).max() * 0.01 / DEG
        # One unit's noise more or less; 2000 deg/s at one unit, or a fifth of the rate, is nowhere.
        assert gyro < 1.0, kind
        assert turn < 0.3, kind


def test_a_unit_comes_back_after_proof_and_the_second_proof_is_longer() -> None:
    of = scenario({1: failure("silent", 20.0, 5.0)}, duration_s=90.0)
    unit = of.imu[1]
    again = (*unit.failures, failure("frozen", 40.0, 1.0))
    of = msgspec.structs.replace(
        of, imu=(of.imu[0], msgspec.structs.replace(unit, failures=again), of.imu[2])
    )
    simulation = run(of, 5)
    _, events, _ = _fused(list(simulation.recording.imu), config(of))
    said = _after(events, simulation.t0_ns)
    assert [what for what, _ in said] == ["imu-excluded", "imu-returned"] * 2
    assert said[1][1] == pytest.approx(35.0, abs=1.0)
    # The slow mean of the deviations forgets the fault within two seconds.
    assert said[3][1] == pytest.approx(62.0, abs=1.2)


def test_two_units_say_that_they_disagree_and_raise_the_noise() -> None:
    simulation, cfg = flown("drifting", units=2)
    out, events, fusion = _fused(list(simulation.recording.imu), cfg)
    said = _after(events, simulation.t0_ns)
    assert [what for what, _ in said] == ["imu-disagree"]
    assert 40.0 < said[0][1] < 55.0
    t = (out.t_ns - simulation.t0_ns) / NS
    assert not out.excess[t < 40.0].any()
    # At the end they are 1.5 deg/s apart: half of it for half a second.
    drift = 0.5 * 0.03 * DEG * 50.0
    assert out.excess[-1, 0] == pytest.approx(drift**2, rel=0.5)
    assert [fusion.state_of(name) for name in ("imu1", "imu2")] == ["ok", "ok"]


@pytest.mark.parametrize("kind", ["silent", "frozen", "saturated"])
def test_of_two_units_one_that_accuses_itself_is_left_out(kind: str) -> None:
    simulation, cfg = flown(kind, units=2, unit=0)
    out, events, _ = _fused(list(simulation.recording.imu), cfg)
    assert events[0].kind == "imu-excluded"
    assert "IMU imu1" in events[0].text
    # The first unit sets the epochs as long as it is there; then the second one does.
    assert np.diff(out.t_ns).max() < 0.05 * NS
    assert out.t_ns[-1] == simulation.recording.imu[1].t_ns[-1]


def test_the_last_unit_is_used_whatever_it_is() -> None:
    of = scenario({0: failure("frozen", 20.0), 1: failure("silent", 15.0)}, units=2, duration_s=40)
    simulation = run(of, 2)
    out, events, _ = _fused(list(simulation.recording.imu), config(of))
    assert [e.kind for e in events] == ["imu-excluded", "imu-last"]
    assert events[1].level == "error"
    assert out.t_ns[-1] == simulation.recording.imu[0].t_ns[-1]


def test_any_cut_of_the_arrivals_gives_the_same_bits() -> None:
    simulation, cfg = flown("scaled")
    units = list(simulation.recording.imu)
    whole, events, _ = _fused(units, cfg)
    rng = np.random.default_rng(4)
    last = int(max(u.seq[-1] for u in units))
    cuts = np.sort(rng.choice(last, 400, replace=False))
    fusion = ImuFusion(cfg, Counters())
    parts, told = [], []
    for low, high in zip([-1, *cuts.tolist()], [*cuts.tolist(), last], strict=True):
        out, said = fusion.take([u.take((u.seq > low) & (u.seq <= high)) for u in units])
        parts.append(out)
        told += said
    for name in ("t_ns", "t_rx_ns", "seq", "gyro_b", "accel_b", "interval_s", "excess"):
        cut = np.concatenate([getattr(p, name) for p in parts])
        assert np.array_equal(cut, getattr(whole, name), equal_nan=True), name
    assert told == events


def test_a_late_unit_is_waited_for_and_a_later_one_is_not() -> None:
    simulation, cfg = flown()
    first, second, third = simulation.recording.imu

    def delayed(samples: ImuSamples, by_ms: float) -> ImuSamples:
        """From five seconds on: nobody waits for a unit that has not been heard yet."""
        later = samples.t_ns > simulation.t0_ns + 5 * NS
        return replace(samples, t_rx_ns=samples.t_rx_ns + later * round(by_ms * 1e6))

    def numbered(units: list[ImuSamples]) -> list[ImuSamples]:
        order = np.argsort(np.concatenate([u.t_rx_ns for u in units]), kind="stable")
        seq = np.empty(len(order), np.int64)
        seq[order] = np.arange(len(order))
        ends = np.cumsum([len(u) for u in units])[:-1]
        return [replace(u, seq=s) for u, s in zip(units, np.split(seq, ends), strict=True)]

    in_time, _, _ = _fused([first, second, third], cfg)
    late, _, _ = _fused(numbered([first, delayed(second, 20.0), third]), cfg)
    n = min(len(late), len(in_time))
    assert np.array_equal(late.gyro_b[:n], in_time.gyro_b[:n])
    assert np.median(late.t_rx_ns[:n] - late.t_ns[:n]) == pytest.approx(22e6, abs=1.1e7)
    without, events, fusion = _fused(numbered([first, delayed(second, 400.0), third]), cfg)
    assert np.median(without.t_rx_ns - without.t_ns) < 1.5e7
    assert [e.kind for e in events] == ["imu-excluded"]
    assert fusion.state_of("imu2") == "silent"


def test_broken_samples_and_stamps_are_counted_and_dropped() -> None:
    simulation, cfg = flown()
    first, second, third = simulation.recording.imu
    gyro, stamps = second.gyro_b.copy(), third.t_ns.copy()
    gyro[500:510] = np.nan
    stamps[700] += 10_000 * NS
    stamps[800:] += 3 * NS
    counters = Counters()
    fusion = ImuFusion(cfg, counters)
    units = [first, replace(second, gyro_b=gyro), replace(third, t_ns=stamps)]
    out, events = fusion.take(units)
    assert counters.imu_not_finite == 10
    assert counters.further_imu_refused == 1 + len(third) - 800
    assert np.array_equal(out.t_ns, first.t_ns)
    assert math.isfinite(out.gyro_b.sum() + out.accel_b.sum())
    assert {e.kind for e in events} == {"imu-excluded"}
    assert fusion.state_of("imu3") == "silent"


def test_a_clock_that_begins_anew_begins_the_fusion_anew() -> None:
    simulation, cfg = flown()
    cut = int(simulation.recording.imu[0].seq[4000])
    again = []
    for unit in simulation.recording.imu:
        t = np.where(unit.seq >= cut, unit.t_ns - 20 * NS, unit.t_ns)
        again.append(replace(unit, t_ns=t))
    out, events, _ = _fused(again, cfg)
    back = np.flatnonzero(np.diff(out.t_ns) < 0)
    assert len(back) == 1
    assert len(out) == len(again[0])
    assert events == []


def test_what_an_excluded_unit_did_to_the_mean_is_taken_back() -> None:
    """0.1 rad/s of the mean for two windows is 0.05 rad; 0.02 of its bias had been learned."""
    s, terms, common = (
        np.zeros((3, lo.STATE_SIZE)),
        np.zeros((3, 6, lo.TERMS)),
        np.zeros(lo.COMMON_SIZE),
    )
    for _ in range(2):
        s[1, lo.TOOK + 2] = 0.1 * 25
        note_pull(25, s)
    s[1, lo.MOVED + 2] = 0.02
    terms[:, 2, 0] = -0.02
    undo(1, s, terms, common)
    # The first of the two windows has begun to be forgotten.
    assert math.sqrt(common[lo.PULLED]) == pytest.approx(0.05, rel=0.02)
    assert common[lo.PULLED + 1] == 0.0
    assert terms[:, 2, 0].tolist() == [0.0, -0.02, 0.0]
    assert not s[1, lo.PULL : lo.MOVED + 6].any()


def test_two_units_are_weighed_as_their_datasheets_say() -> None:
    """What both share in noise is 4; claimed as 1 to 3, so 1 and 3 it is."""
    pairs = np.zeros((2, 2, 2, 2))
    pairs[0, 0] = [[0.0, 4.0], [4.0, 0.0]]
    unit, out = np.zeros((2, lo.PAR_SIZE)), np.empty(2)
    unit[:, lo.VAR_0] = 1.0, 3.0
    noise_of(np.ones(2, np.int64), unit, 0, 0, pairs, out)
    assert out.tolist() == [1.0, 3.0]
    said = FurtherImu(source="imu2", gyro_noise_dps_rthz=0.5)
    base = Config(further_imu=(said,))
    ours = ImuFusion(base, Counters())._parameters[:, lo.VAR_0 : lo.VAR_0 + 2]
    assert ours[1, 0] / ours[0, 0] == pytest.approx((0.5 / base.imu.gyro_noise_dps_rthz) ** 2)
    assert ours[1, 1] == ours[0, 1]
