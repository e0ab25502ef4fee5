"""The report: decimation that loses no extreme, a verdict that follows the evidence, one page."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.types import NS, AidingReports, Event, Solution, VehicleRecording
from replay.configuration import ChosenConfig
from replay.preparation import start_ns
from replay.report.page import page
from replay.report.panels import panels
from replay.report.run_view import RunView
from replay.report.series import Spans, pack, thin_track
from replay.report.verdict import judge
from replay.session import run_session
from replay.simulator import Scenario, load_scenario, matching_config, simulate
from replay.window import Window


def unpack(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


# ----------------------------------------------------------------- decimation


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=300),
    st.integers(2, 40),
)
@settings(max_examples=100, deadline=None)
def test_smallest_and_largest_value_of_a_series_survive(values: list[float], buckets: int) -> None:
    column = np.array(values)
    t_ns = np.arange(len(column), dtype=np.int64) * 10_000_000
    spans = Spans(t_ns, 0, buckets)
    drawn = spans.values(column)
    known = drawn[np.isfinite(drawn)]
    assert known.min() == column.min()
    assert known.max() == column.max()
    assert len(known) <= max(2 * buckets, 1)
    assert np.all(np.diff(spans.times()) >= 0)
    assert len(spans.times()) == len(drawn)


def test_a_band_encloses_every_value_of_its_span() -> None:
    rng = np.random.default_rng(3)
    t_ns = np.arange(20_000, dtype=np.int64) * 5_000_000
    low = rng.normal(size=20_000)
    high = low + rng.uniform(0.1, 1.0, 20_000)
    spans = Spans(t_ns, 0, 50)
    bottom, top = spans.envelope(low, high)
    at = np.searchsorted(spans.times(), t_ns / NS, side="right") - 1
    assert np.all(bottom[at] <= low)
    assert np.all(top[at] >= high)


def test_a_line_breaks_at_a_gap_and_nowhere_else() -> None:
    t = np.concatenate([np.arange(0, 50, 0.1), np.arange(80, 120, 0.1)])
    for buckets in (40, 4000):
        spans = Spans((t * NS).astype(np.int64), 0, buckets)
        broken = np.flatnonzero(np.isnan(spans.values(np.ones(len(t)))))
        assert len(broken) == 1
        assert 50 < spans.times()[broken[0]] < 80


def test_a_thinned_track_keeps_its_corners() -> None:
    n = np.cumsum(np.random.default_rng(0).normal(size=50_000))
    e = np.cumsum(np.random.default_rng(1).normal(size=50_000))
    kept = thin_track(n, e, 1000)
    assert len(kept) <= 1002
    for column in (n, e):
        assert column[kept].min() == column.min()
        assert column[kept].max() == column.max()


def test_packed_columns_come_back_as_float32() -> None:
    assert list(unpack(pack([1.5, -2.25, float("nan")]))[:2]) == [1.5, -2.25]


# ----------------------------------------------------------------- verdict and page


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """Two minutes of a mission, sensors as their datasheet says."""
    mission = load_scenario("multirotor-mission")
    brief = msgspec.structs.replace(mission.trajectory, duration_s=120.0)
    return msgspec.structs.replace(mission, trajectory=brief)


@pytest.fixture(scope="module")
def vehicle(scenario: Scenario) -> VehicleRecording:
    return simulate(scenario, seed=5)


@pytest.fixture(scope="module")
def nominal(scenario: Scenario, vehicle: VehicleRecording) -> RunView:
    return view(scenario, vehicle)


def view(
    scenario: Scenario, vehicle: VehicleRecording, *windows: Window, method: str = "none"
) -> RunView:
    config = matching_config(scenario)
    adaptation = msgspec.structs.replace(config.adaptation, method=method)
    config = msgspec.structs.replace(config, adaptation=adaptation)
    run = run_session(vehicle, ChosenConfig(config, "of the scenario", ""), outages=windows)
    return RunView(
        name="a <flight>.tlog",
        vehicle=run.vehicle,
        config=config,
        solution=run.solution,
        reports=run.reports,
        events=run.events,
        withheld=windows,
        digest=run.digest,
        adaptation=run.adaptation,
    )


def test_a_nominal_flight_is_good(nominal: RunView) -> None:
    judgement = judge(nominal)
    assert judgement.level == "good", judgement
    assert all(e.level == "good" for e in judgement.evidence)


def test_an_outage_degrades_and_is_named(scenario: Scenario, vehicle: VehicleRecording) -> None:
    run = view(scenario, vehicle, Window(60.0, 30.0))
    judgement = judge(run)
    assert judgement.level != "good"
    (named,) = [e for e in judgement.evidence if "without GNSS" in e.text]
    assert named.level == "degraded"
    assert named.text.startswith("1 time without GNSS, 30 s")
    shown = data_of(page(run, judgement))
    ((begin, end),) = shown["outages"]
    assert (begin, end) == pytest.approx((60.0, 90.0), abs=0.5)


def test_a_glitching_receiver_is_refused_and_both_say_so(
    scenario: Scenario, vehicle: VehicleRecording
) -> None:
    gnss = vehicle.gnss[0]
    t = (gnss.t_ns - start_ns(vehicle)) / NS
    lat = gnss.lat + np.where((t > 70) & (t % 4 < 1), 80.0 / 6.4e6, 0.0)
    run = view(scenario, replace(vehicle, gnss=(replace(gnss, lat=lat),)))
    judgement = judge(run)
    assert judgement.level != "good"
    assert any("GNSS position" in e.text and "refused" in e.text for e in judgement.evidence)
    shown = data_of(page(run, judgement))
    glitches = np.count_nonzero(lat != gnss.lat)
    assert len(unpack(shown["track"]["refused"]["t"])) == pytest.approx(glitches, abs=2)
    (chart,) = [
        c
        for p in shown["panels"]
        if p["id"] == "innovations"
        for c in p["charts"]
        if c["title"] == "GNSS position, north"
    ]
    refused = [x for t in chart["tables"] for x in t["lines"] if x["of"] == "refused"]
    assert np.nanmax(unpack(refused[0]["values"])) > 70.0


def test_no_solution_is_bad_and_still_a_page(nominal: RunView) -> None:
    none = replace(nominal, solution=Solution.empty(), reports=AidingReports.empty(), events=())
    judgement = judge(none)
    assert judgement.level == "bad"
    shown = data_of(page(none, judgement))
    assert shown["track"] is None
    assert {p["id"] for p in shown["panels"]} <= {"height", "velocity", "attitude", "rates"}


def test_an_error_that_was_not_stated_is_seen_against_truth(nominal: RunView) -> None:
    lat = nominal.solution.lat.copy()
    lat[len(lat) // 2 :] += 15.0 / 6.4e6
    judgement = judge(replace(nominal, solution=replace(nominal.solution, lat=lat)))
    assert judgement.level == "bad"
    assert "beyond three stated" in judgement.headline


def data_of(text: str) -> dict[str, Any]:
    found = re.search(r"const RUN = (.*?);</script>", text, re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def test_the_page_needs_nothing_else_and_escapes_what_it_is_given(nominal: RunView) -> None:
    event = Event(nominal.origin_ns, "odd", "</script><b>&", "warning")
    run = replace(nominal, events=(*nominal.events, event), notes=("<i>",))
    text = page(run, judge(run))
    assert "a &lt;flight&gt;.tlog" in text
    assert "<b>&" not in text
    assert "<i>" not in text.split("<script>")[0]
    assert not re.search(r'(src|href)="(?!data:)', text)
    assert len(text) < 5_000_000
    assert data_of(text)["events"][-1]["text"] == "</script><b>&"


def test_only_what_happened_has_a_panel(nominal: RunView) -> None:
    def ids(run: RunView) -> set[str]:
        return {panel.id for panel in panels(run)}

    assert "adaptation" not in ids(nominal)
    scaled = replace(nominal.reports, scale=np.full(len(nominal.reports), 2.0))
    assert "adaptation" in ids(replace(nominal, reports=scaled))
    without = replace(nominal.vehicle, truth=None, autopilot=None)
    assert "errors" in ids(nominal)
    assert "errors" not in ids(replace(nominal, vehicle=without))


def test_a_receiver_that_becomes_noisy_is_told_in_words_with_its_rule(
    scenario: Scenario, vehicle: VehicleRecording
) -> None:
    gnss = vehicle.gnss[0]
    t = (gnss.t_ns - start_ns(vehicle)) / NS
    worse = np.where(t > 60, 4.0, 0.0) * np.random.default_rng(2).normal(size=len(t)) / 6.4e6
    noisy = replace(vehicle, gnss=(replace(gnss, lat=gnss.lat + worse),))
    run = view(scenario, noisy, method="fuzzy")
    (panel,) = [p for p in panels(run) if p.id == "adaptation"]
    assert panel.charts[0].logarithmic
    series = {x.label: np.array(unpack(x.values)) for t in panel.charts[0].tables for x in t.lines}
    assert np.nanmax(series["GNSS position"]) > 4.0
    assert panel.told is not None
    words = [cells for begin, cells in panel.told.rows if 55 < begin < 75]
    assert ("R of GNSS position", "innovations scatter more than expected, about zero") in [
        (cells[2], cells[4]) for cells in words
    ]
    judgement = judge(run)
    assert judgement.level == "degraded"
    assert "GNSS position was believed less" in judgement.headline
    assert 'data-t="' in page(run, judgement).split('id="adaptation"')[1].split("</section>")[0]


def test_a_source_fault_is_a_span_a_row_and_evidence(
    scenario: Scenario, vehicle: VehicleRecording
) -> None:
    gnss = vehicle.gnss[0]
    t = (gnss.t_ns - start_ns(vehicle)) / NS
    ramp = np.clip(t - 60, 0, 25) * (t < 85) * 2.0 / 6.4e6
    run = view(scenario, replace(vehicle, gnss=(replace(gnss, lat=gnss.lat + ramp),)))
    faults = run.source_faults()
    assert faults
    begin = (faults[0].start_ns - run.origin_ns) / NS
    end = (faults[-1].end_ns - run.origin_ns) / NS
    assert 60 < begin < 80
    assert 80 < end < 92  # back within seconds of the ramp's end
    judgement = judge(run)
    assert judgement.level == "degraded"
    assert any("held for faulty" in e.text for e in judgement.evidence)
    shown = data_of(page(run, judgement))
    assert shown["faults"][0][0] == pytest.approx(begin)
    (panel,) = [p for p in panels(run) if p.id == "adaptation"]
    assert panel.told is not None
    assert any("drifts from its own velocity" in cells[4] for _, cells in panel.told.rows)
    refused = np.array(unpack(shown["track"]["refused"]["t"]))
    assert np.all((refused > 60) & (refused < end + 1))  # by the gate first


def test_a_receiver_lost_until_the_end_is_an_outage(
    scenario: Scenario, vehicle: VehicleRecording
) -> None:
    gnss = vehicle.gnss[0]
    t = (gnss.t_ns - start_ns(vehicle)) / NS
    lost = replace(gnss, fix_type=np.where(t > 90, 1, gnss.fix_type))
    run = view(scenario, replace(vehicle, gnss=(lost,)))
    (outage,) = run.outages()
    assert (outage.start_ns - run.origin_ns) / NS == pytest.approx(90, abs=0.5)
    assert outage.end_ns == run.solution.t_ns[-1]
    assert any("1 time without GNSS, 30 s" in e.text for e in judge(run).evidence)


@pytest.mark.parametrize("whose", ["ours", "theirs"])
def test_where_the_autopilot_disagrees_the_fixes_say_who_is_off(
    nominal: RunView, whose: str
) -> None:
    vehicle = replace(nominal.vehicle, autopilot=nominal.vehicle.truth, truth=None)
    assert vehicle.autopilot is not None
    moved = replace(nominal, vehicle=vehicle)
    agreed = judge(moved)
    assert agreed.level == "good"
    away = np.where(vehicle.autopilot.t_ns > moved.origin_ns + 80 * NS, 60.0 / 6.4e6, 0.0)
    if whose == "theirs":
        off = replace(vehicle.autopilot, lat=vehicle.autopilot.lat + away)
        judgement = judge(replace(moved, vehicle=replace(vehicle, autopilot=off)))
        assert judgement.level == "good"
    else:
        late = moved.solution.t_ns > moved.origin_ns + 80 * NS
        lat = moved.solution.lat + np.where(late, 60.0 / 6.4e6, 0.0)
        judgement = judge(replace(moved, solution=replace(moved.solution, lat=lat)))
        assert judgement.level == "degraded"
    (said,) = [e.text for e in judgement.evidence if "from the fixes there" in e.text]
    far, near = (r"[56]\d\.\d m", r"[0-4]\.\d m")
    first, second = (near, far) if whose == "theirs" else (far, near)
    assert re.search(rf"this solution is {first} .* autopilot's {second}", said), said


def test_a_heading_that_was_not_found_is_seen_against_truth(nominal: RunView) -> None:
    half = np.radians(40.0) / 2
    w, x, y, z = nominal.solution.q_nb.T
    c, s = np.cos(half), np.sin(half)
    turned = np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
    judgement = judge(replace(nominal, solution=replace(nominal.solution, q_nb=turned)))
    assert judgement.level == "bad"
    assert "heading is 40° from the truth's" in judgement.headline
