"""Errors against a reference, on cases whose answer is known without the code."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from companion.navigation.earth import ecef
from companion.navigation.rotation import quat_from_rpy
from companion.types import (
    NS,
    AidingReports,
    Channel,
    GnssSamples,
    Mode,
    ReferenceSamples,
    Solution,
    Verdict,
)
from replay.evaluation import (
    EvaluationError,
    Outage,
    describe,
    errors_against,
    evaluate,
    find_outages,
    position_nees,
)

T0 = 1_700_000_000 * NS
LAT, LON = np.radians(47.0), np.radians(11.0)


def seconds(start: float, stop: float, step: float) -> Any:
    return T0 + np.round(np.arange(start, stop, step) * NS).astype(np.int64)


def solution_at(t: Any, rpy: Any = None) -> Solution:
    n = len(t)
    rpy = np.zeros((n, 3)) if rpy is None else rpy
    cov = np.zeros((n, 5, 6))
    cov[:, :, [0, 3, 5]] = 1.0
    return Solution(
        t,
        np.full(n, LAT),
        np.full(n, LON),
        np.full(n, 500.0),
        np.zeros((n, 3)),
        np.array([quat_from_rpy(*angles) for angles in rpy]).reshape(n, 4),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
        cov,
        np.full(n, Mode.NAVIGATING, dtype=np.int64),
        np.zeros(n, np.int64),
    )


def reference_at(t: Any) -> ReferenceSamples:
    n = len(t)
    return ReferenceSamples(
        "truth",
        t,
        t,
        np.arange(n),
        np.full(n, LAT),
        np.full(n, LON),
        np.full(n, 500.0),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
    )


def test_a_constant_offset_is_the_error() -> None:
    sol, ref = solution_at(seconds(0, 10, 0.02)), reference_at(seconds(-1, 11, 0.5))
    sol = replace(sol, lat=sol.lat + 1e-6, lon=sol.lon + 2e-6, height=sol.height + 3.0)
    sol = replace(sol, vel_n=sol.vel_n + np.array([0.1, 0.2, 0.2]))
    result = evaluate(sol, ref, reference_kind="truth", digest="d", digest_published="p")
    # The same offset by way of ECEF: chord and arc differ by 1e-12 at ten metres.
    a = ecef(sol.lat[:1], sol.lon[:1], sol.height[:1])[0]
    b = ecef(ref.lat[:1], ref.lon[:1], ref.height[:1])[0]
    p = result.position_rmse_m
    assert p["3d"] == pytest.approx(np.linalg.norm(a - b), abs=1e-4)
    assert p["d"] == pytest.approx(3.0, abs=1e-9)
    assert p["horizontal"] == pytest.approx(np.hypot(p["n"], p["e"]))
    assert result.velocity_rmse_mps == pytest.approx({"n": 0.1, "e": 0.2, "d": 0.2, "3d": 0.3})
    assert result.samples == len(sol)
    assert result.duration_s == pytest.approx(9.98)
    assert result.position_nees_mean == pytest.approx(p["3d"] ** 2)  # unit covariance


def test_json_has_exactly_the_published_shape() -> None:
    sol, ref = solution_at(seconds(0, 10, 0.1)), reference_at(seconds(-1, 11, 0.1))
    ref = replace(ref, rpy=np.full_like(ref.rpy, np.nan))
    result = evaluate(sol, ref, reference_kind="truth", outages=[Outage(T0 + 2 * NS, T0 + 4 * NS)])
    found = json.loads(result.json_text())
    assert list(found) == [
        "solution", "reference", "duration_s", "samples", "position_rmse_m", "velocity_rmse_mps",
        "attitude_rmse_deg", "position_nees_mean", "outages", "digest", "digest_published",
    ]  # fmt: skip
    assert list(found["position_rmse_m"]) == ["n", "e", "d", "horizontal", "3d"]
    assert list(found["velocity_rmse_mps"]) == ["n", "e", "d", "3d"]
    assert found["attitude_rmse_deg"] == {"roll": None, "pitch": None, "yaw": None}
    assert found["digest"] is None
    assert found["outages"] == [
        {"start_s": 2.0, "seconds": 2.0, "max_horizontal_error_m": 0.0,
         "end_horizontal_error_m": 0.0}
    ]  # fmt: skip


def test_reference_is_interpolated_and_never_extended() -> None:
    ref = reference_at(seconds(0, 10, 1.0))  # 0 .. 9 s, moving north at 1e-7 rad/s
    ref = replace(ref, lat=LAT + 1e-7 * (ref.t_ns - T0) / NS)
    sol = solution_at(seconds(-2, 12, 0.25))
    sol = replace(sol, lat=LAT + 1e-7 * (sol.t_ns - T0) / NS)
    errors = errors_against(sol, ref)
    covered = (sol.t_ns >= T0) & (sol.t_ns <= T0 + 9 * NS)
    assert np.array_equal(np.isfinite(errors.position_n[:, 0]), covered)
    assert np.abs(errors.position_n[covered]).max() < 1e-6  # rounding of a latitude: 1e-9 m


def test_gaps_of_the_reference_are_not_bridged() -> None:
    t = np.concatenate([seconds(0, 4, 0.1), seconds(7, 10, 0.1)])
    errors = errors_against(solution_at(seconds(0, 9.9, 0.05)), reference_at(t))
    since = (errors.t_ns - T0) / NS
    known = np.isfinite(errors.position_n[:, 0])
    assert known[since <= 3.9].all()
    assert known[since >= 7].all()
    assert not known[(since > 3.9) & (since < 7)].any()


def test_reference_that_steps_back_or_repeats_is_put_right() -> None:
    ref = reference_at(seconds(0, 10, 0.5))
    t = ref.t_ns.copy()
    t[5] = t[4]
    t[9] = t[2]
    errors = errors_against(solution_at(seconds(0, 9, 0.1)), replace(ref, t_ns=t))
    assert np.isfinite(errors.position_n).sum() > 0
    assert np.nanmax(np.abs(errors.position_n)) == 0.0


def test_longitude_and_yaw_wrap() -> None:
    t = seconds(0, 10, 0.5)
    angle = np.radians(175) + np.radians(2) * np.arange(len(t))  # crosses 180°
    wrapped = np.remainder(angle + np.pi, 2 * np.pi) - np.pi
    ref = reference_at(t)
    rpy = np.stack([np.full(len(t), 0.1), np.full(len(t), -0.2), wrapped], axis=1)
    ref = replace(ref, lon=wrapped, rpy=rpy)
    ts = seconds(0, 9.4, 0.1)
    exact = np.radians(175) + np.radians(4) * (ts - T0) / NS
    angles = np.stack([np.full(len(ts), 0.1), np.full(len(ts), -0.2), exact], axis=1)
    sol = replace(solution_at(ts, angles), lon=exact)
    errors = errors_against(sol, ref)
    assert np.abs(errors.position_n).max() < 1e-2  # 1e-9 rad of longitude
    # Slerp at a pitch of 0.2 is not linear in yaw: within 2° of arc that is below 0.01°.
    assert np.degrees(np.abs(errors.attitude)).max() < 0.01


def test_known_yaw_is_compared_where_roll_and_pitch_are_not() -> None:
    t = seconds(0, 10, 0.2)
    ref = reference_at(t)
    rpy = ref.rpy.copy()
    rpy[:, :2] = np.nan
    rpy[:, 2] = -3.1
    sol = solution_at(t, np.tile([0.0, 0.0, 3.1], (len(t), 1)))
    result = evaluate(sol, replace(ref, rpy=rpy), reference_kind="autopilot")
    assert np.isnan(result.attitude_rmse_deg["roll"])
    assert result.attitude_rmse_deg["yaw"] == pytest.approx(np.degrees(2 * np.pi - 6.2))
    assert result.reference == "autopilot"


def test_lever_arm_moves_the_solution_to_the_antenna() -> None:
    t = seconds(0, 5, 0.1)
    sol = solution_at(t, np.tile([0.0, 0.0, np.pi / 2], (len(t), 1)))  # nose to the east
    errors = errors_against(sol, reference_at(t), (1.0, 2.0, -0.5))
    assert np.allclose(errors.position_n, [-2.0, 1.0, -0.5], atol=1e-12)


def test_only_what_follows_alignment_counts() -> None:
    t = seconds(0, 10, 0.1)
    sol = solution_at(t)
    mode = sol.mode.copy()
    mode[:20] = Mode.ALIGNING
    mode[20:40] = Mode.HEADING_UNKNOWN
    mode[60:70] = Mode.ALIGNING  # a reset
    height = np.where(mode == Mode.NAVIGATING, 500.0, 900.0)
    result = evaluate(
        replace(sol, mode=mode, height=height), reference_at(t), reference_kind="truth"
    )
    assert result.samples == 50
    assert result.position_rmse_m["3d"] == 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": np.zeros(100, np.int64)}, "alignment never finished"),
        ({"t_ns": seconds(100, 110, 0.1)}, "no time in common"),
    ],
)
def test_nothing_to_compare_is_said(change: dict[str, Any], message: str) -> None:
    sol = replace(solution_at(seconds(0, 10, 0.1)), **change)
    with pytest.raises(EvaluationError, match=message):
        evaluate(sol, reference_at(seconds(0, 10, 0.1)), reference_kind="truth")


def test_window_counts_from_the_origin() -> None:
    sol, ref = solution_at(seconds(5, 15, 0.1)), reference_at(seconds(0, 20, 0.1))
    result = evaluate(sol, ref, reference_kind="truth", window_s=(7.0, 9.0), origin_ns=T0)
    assert result.samples == 21
    assert result.duration_s == pytest.approx(2.0)


def test_outage_errors_are_the_largest_and_the_last() -> None:
    t = seconds(0, 20, 0.1)
    sol = solution_at(t)
    since = (t - T0) / NS
    drift = np.where((since >= 5) & (since <= 10), np.interp(since, [5, 8, 10], [0, 12, 4]), 50.0)
    scale = 4.0 / (evaluate(
        replace(sol, lat=sol.lat + 4e-6), reference_at(t), reference_kind="truth"
    ).position_rmse_m["n"])  # fmt: skip
    sol = replace(sol, lat=sol.lat + drift * scale * 1e-6)
    result = evaluate(
        sol,
        reference_at(t),
        reference_kind="truth",
        outages=[Outage(T0 + 5 * NS, T0 + 10 * NS), Outage(T0 + 40 * NS, T0 + 50 * NS)],
    )
    first, second = result.outages
    assert first.max_horizontal_error_m == pytest.approx(12.0, rel=1e-6)
    assert first.end_horizontal_error_m == pytest.approx(4.0, rel=1e-6)
    assert (second.start_s, second.seconds) == (40.0, 10.0)
    assert second.max_horizontal_error_m is None
    assert second.end_horizontal_error_m is None


def test_nees_is_the_quadratic_form() -> None:
    rng = np.random.default_rng(7)
    root = rng.normal(size=(200, 3, 3))
    P = root @ root.swapaxes(1, 2) + 0.1 * np.eye(3)
    error = rng.normal(size=(200, 3))
    cov = np.zeros((200, 5, 6))
    cov[:, 0] = P[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    expected = np.einsum("ni,nij,nj->n", error, np.linalg.inv(P), error)
    assert np.allclose(position_nees(error, cov), expected, rtol=1e-9)


def test_nees_of_honest_errors_is_three() -> None:
    rng = np.random.default_rng(8)
    root = np.array([[2.0, 0, 0], [0.5, 1.0, 0], [-1.0, 0.3, 0.7]])
    n = 20_000
    error = rng.normal(size=(n, 3)) @ root.T
    P = root @ root.T
    cov = np.zeros((n, 5, 6))
    cov[:, 0] = P[[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    # variance of chi-square with three degrees is 6: four standard errors of the mean
    assert abs(position_nees(error, cov).mean() - 3.0) < 4.0 * np.sqrt(6.0 / n)


def test_covariance_that_is_none_is_left_out() -> None:
    cov = np.zeros((2, 5, 6))
    cov[0, 0] = [1, 2, 0, 1, 0, 1]  # indefinite
    assert np.isnan(position_nees(np.ones((2, 3)), cov)).all()


def fixes(t: Any, fix_type: Any) -> GnssSamples:
    n = len(t)
    none = np.full((n, 3), np.nan)
    return GnssSamples(
        "gps", t, t, np.arange(n), *(np.zeros(n) for _ in range(3)), none, none, none,
        np.full(n, 8), np.broadcast_to(fix_type, n).astype(np.int64),
    )  # fmt: skip


def test_outages_are_silence_or_lost_fixes() -> None:
    t = np.concatenate([seconds(0, 20, 0.2), seconds(25, 60, 0.2)])
    since = (t - T0) / NS
    kind = np.where((since >= 40) & (since < 50), 1, 3)
    first, second = find_outages(fixes(t, kind))
    assert ((first.start_ns - T0) / NS, (first.end_ns - T0) / NS) == pytest.approx((19.8, 25.0))
    assert ((second.start_ns - T0) / NS, (second.end_ns - T0) / NS) == pytest.approx((39.8, 50.0))
    assert len(find_outages(fixes(t, kind), minimum_s=8.0)) == 1


def test_a_slow_receiver_has_no_outage() -> None:
    assert find_outages(fixes(seconds(0, 200, 10.0), 3)) == ()
    assert find_outages(fixes(seconds(0, 10, 1.0), 1)) == ()


def test_nis_is_per_degree_of_freedom_and_accepted_only() -> None:
    n = 4
    reports = AidingReports(
        np.zeros(n, np.int64),
        np.array([Channel.BARO, Channel.BARO, Channel.GNSS_POSITION_H, Channel.BARO]),
        np.zeros(n, np.int64),
        np.array([1, 1, 2, 1]),
        np.zeros((n, 3)),
        np.ones((n, 3)),
        np.array([0.5, 1.5, 6.0, 1e6]),
        np.ones(n),
        np.ones(n),
        np.array([0, 0, 0, Verdict.REJECTED_GATE]),
    )
    sol, ref = solution_at(seconds(0, 10, 0.1)), reference_at(seconds(0, 10, 0.1))
    result = evaluate(sol, ref, reference_kind="truth", reports=reports)
    assert result.nis_mean == {"gnss_position_h": 3.0, "baro": 1.0}
    text = "\n".join(describe(result))
    assert "baro 1.00" in text
    assert "gnss_position_h 3.00" in text


def test_summary_names_what_the_reference_lacks() -> None:
    t = seconds(0, 10, 0.1)
    ref = replace(reference_at(t), rpy=np.full((len(t), 3), np.nan))
    lines = describe(
        evaluate(
            solution_at(t),
            ref,
            reference_kind="truth",
            outages=[Outage(T0 + NS, T0 + 3 * NS), Outage(T0 + 40 * NS, T0 + 50 * NS)],
        )
    )
    assert "attitude RMSE not in the reference" in lines
    assert any("outage at 40.0 s for 10.0 s: not covered" in line for line in lines)


def test_solution_without_epochs_is_refused() -> None:
    sol = solution_at(seconds(0, 1, 0.1))
    empty = Solution(*(getattr(sol, f.name)[:0] for f in fields(sol)))
    with pytest.raises(EvaluationError, match="no epochs"):
        evaluate(empty, reference_at(seconds(0, 1, 0.1)), reference_kind="truth")
