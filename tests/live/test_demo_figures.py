"""Figures of the demo: columns to and from CSV, latency, errors against a known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.types import NS, CompanionError, Mode, ReferenceSamples
from replay.demo.figures import (
    LATENCY,
    Received,
    position_errors,
    read_received,
    spread,
    write_received,
)

T0 = 1_800_000_000 * NS
METRE = 1.0 / 6_371_000.0


def truth() -> ReferenceSamples:
    n = 11
    t = T0 + np.arange(n) * NS
    lat = 0.8 + np.arange(n) * 10 * METRE
    zero = np.zeros((n, 3))
    return ReferenceSamples("truth", t, t, t, lat, np.full(n, 0.1), np.full(n, 500.0), zero, zero)


def received(north_m: float, down_m: float, mode: Mode = Mode.NAVIGATING) -> Received:
    """States halfway between the truth's, off by known amounts."""
    rows = []
    for i in range(12):
        t = T0 + i * NS + NS // 2
        lat = 0.8 + (i + 0.5) * 10 * METRE - north_m / 6_370_000.0
        place = (lat, 0.1, 500.0 + down_m)
        rows.append((t, i * NS, i * NS + 2_000_000 + i, mode, *place, 1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    return Received.of_rows(rows)


def test_csv_gives_everything_back(tmp_path: Path) -> None:
    path = tmp_path / "received.csv"
    write_received(received(3.0, 1.0), path)
    back = read_received(path)
    assert np.array_equal(back.t_ns, received(3.0, 1.0).t_ns)
    assert np.array_equal(back.receipt_ns, received(3.0, 1.0).receipt_ns)
    assert back.lat == pytest.approx(received(3.0, 1.0).lat, abs=1e-11)  # ten decimals of a degree
    assert back.sd_pos.tolist() == received(3.0, 1.0).sd_pos.tolist()


@pytest.mark.parametrize("text", ["", "t_ns\n1,2\n", "t_ns\na,b,c\n"])
def test_a_file_that_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "received.csv"
    path.write_text(text, encoding="ascii")
    with pytest.raises(CompanionError, match="left no states"):
        read_received(path)


def test_nothing_received(tmp_path: Path) -> None:
    path = tmp_path / "received.csv"
    write_received(Received.of_rows([]), path)
    assert len(read_received(path)) == 0
    assert spread(read_received(path).latency_ms, LATENCY) == dict.fromkeys(LATENCY)
    assert position_errors(read_received(path), truth())["rms_3d_m"] is None


def test_latency_is_receipt_minus_arrival() -> None:
    ms = spread(received(0.0, 0.0).latency_ms, LATENCY)
    assert ms["p50"] == pytest.approx(2.0, abs=1e-4)
    assert ms["max"] == pytest.approx(2.000011)


def test_errors_are_those_put_in() -> None:
    errors = position_errors(received(3.0, -4.0), truth())
    # A degree of latitude is not quite that of a sphere: within 1 %.
    assert errors["horizontal_rms_m"] == pytest.approx(3.0, rel=0.01)
    assert errors["horizontal_max_m"] == pytest.approx(3.0, rel=0.01)
    assert errors["rms_3d_m"] == pytest.approx(5.0, rel=0.01)


def test_states_while_aligning_do_not_count() -> None:
    errors = position_errors(received(3.0, 0.0, Mode.ALIGNING), truth())
    assert errors["horizontal_rms_m"] is None
