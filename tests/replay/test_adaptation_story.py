"""The trace of an adaptation: through protobuf and back, and told in episodes."""

from __future__ import annotations

import numpy as np

from companion.logbook.adaptation import decode_trace, encode_trace
from companion.proto.adaptation_pb2 import AdaptationTrace as Message
from companion.types import NS, AdaptationTrace, Channel, Rule
from replay.adaptation_story import episodes


def _trace(r_scale: list[float], q_scale: list[float], rule: Rule, model: float) -> AdaptationTrace:
    n = len(r_scale)
    firing = np.zeros((n, 9))
    firing[:, rule] = 0.75
    firing[:, Rule.SPREAD_USUAL_MEAN_ZERO] += 0.25
    column = np.linspace(0.5, 1.5, n)
    return AdaptationTrace(
        np.arange(n) * NS, np.full(n, Channel.GNSS_POSITION_H), np.zeros(n, np.int64),
        column, 2 * column, np.full(n, np.nan), np.full(n, model), np.zeros(n), firing,
        np.array(r_scale), np.array(q_scale), np.ones(n),
    )  # fmt: skip


def test_a_trace_is_the_same_after_the_log() -> None:
    trace = _trace([1.0, 9.5, 30.25], [1.0, 1.0, 2.5], Rule.SPREAD_HIGH_MEAN_ZERO, 0.25)
    rows = [row.tobytes() for row in encode_trace(trace)]
    back = decode_trace(rows)
    for name in ("t_ns", "channel", "source", "to_model", "firing", "r_scale", "q_scale", "alpha"):
        assert np.array_equal(getattr(back, name), getattr(trace, name))
    assert np.allclose(back.spread, trace.spread, rtol=1e-7)
    message = Message.FromString(rows[1])
    assert Message.Rule.Name(message.rule) == "SPREAD_HIGH_MEAN_ZERO"
    assert Message.Channel.Name(message.channel) == "GNSS_POSITION_H"


def test_no_rule_fires_where_a_method_has_none() -> None:
    trace = _trace([1.0], [1.0], Rule.SPREAD_HIGH_MEAN_ZERO, 0.0)
    trace.firing[:] = 0.0
    assert trace.rule.tolist() == [-1]
    assert Message.FromString(encode_trace(trace)[0].tobytes()).rule == Message.NO_RULE


def test_episodes_say_what_when_and_why() -> None:
    up = [1.0] * 10 + [4.0, 25.0, 16.0] + [1.0] * 3 + [4.0] + [1.0] * 20 + [3.0]
    trace = _trace(up, [1.0] * len(up), Rule.SPREAD_HIGH_MEAN_ZERO, 0.0)
    first, last = episodes(trace, 2 * NS)
    # three seconds of return do not end it, twenty do
    assert (first.what, first.channel) == ("R", "gnss_position_h")
    assert (first.start_s, first.end_s, first.greatest) == (8.0, 14.0, 25.0)
    assert first.because == "innovations scatter more than expected, about zero"
    assert last.start_s == last.end_s == 35.0


def test_a_cause_is_named_for_a_mean() -> None:
    trace = _trace([1.0] * 4, [1.0, 8.0, 8.0, 1.0], Rule.SPREAD_USUAL_MEAN_LARGE, 0.9)
    (told,) = episodes(trace, 0)
    assert told.what == "Q"
    assert told.because == (
        "innovations scatter as expected, far off zero: most of it taken for the inertial unit's "
        "error"
    )


def test_nothing_adapted_is_nothing_told() -> None:
    assert episodes(AdaptationTrace.empty(), 0) == []
    assert episodes(_trace([1.0, 1.9], [1.0, 1.0], Rule.SPREAD_HIGH_MEAN_ZERO, 0.0), 0) == []
