"""Maps that other programs' readers take: what comes back is what was flown."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import fastkml
import geojson
import gpxpy
import numpy as np
import pytest
from fastkml.utils import find_all

from companion.types import NS, CompanionError, Mode, Solution
from replay.evaluation import Outage
from replay.maps import stretches, thin, write_map

BEGIN_NS = 1_748_779_200 * NS


def flown(count: int = 1000, begin_ns: int = BEGIN_NS, lon_deg: float = 8.5) -> Solution:
    """A straight line eastwards at 50 Hz, the first ten epochs aligning."""
    t = begin_ns + np.arange(count, dtype=np.int64) * 20_000_000
    empty = Solution.empty()
    columns = {
        name: np.zeros((count, *getattr(empty, name).shape[1:]))
        for name in ("vel_n", "accel_bias_b", "gyro_bias_b", "cov")
    }
    mode = np.full(count, int(Mode.NAVIGATING), np.int64)
    mode[:10] = Mode.ALIGNING
    return Solution(
        t_ns=t,
        lat=np.full(count, np.radians(47.25)),
        lon=np.radians(lon_deg + 1e-5 * np.arange(count)),
        height=np.linspace(400.0, 500.0, count),
        q_nb=np.tile([1.0, 0, 0, 0], (count, 1)),
        mode=mode,
        resets=np.zeros(count, np.int64),
        **columns,
    )


OUTAGE = (Outage(BEGIN_NS + 5 * NS, BEGIN_NS + 10 * NS),)


def write(solution: Solution, path: Path, file_format: str, **more: object) -> int:
    return write_map(
        solution, path, file_format, name="a & b", height_datum="hae", outages=OUTAGE, **more
    )


def test_gpx_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    count = write(flown(), path, "gpx", rate_hz=5.0)
    (track,) = gpxpy.parse(path.read_text()).tracks
    assert track.name == "a & b"
    assert len(track.segments) == 3
    points = [p for s in track.segments for p in s.points]
    # A stretch ends where the next one begins.
    assert len(points) == count + 2
    first = points[0]
    assert first.time == datetime(2025, 6, 1, 12, 0, 0, 200_000, tzinfo=UTC)
    assert (first.latitude, first.longitude) == pytest.approx((47.25, 8.5001), abs=1e-7)
    assert first.elevation == pytest.approx(400 + 100 * 10 / 999, abs=1e-3)


def test_kml_has_times_and_another_style_in_the_outage(tmp_path: Path) -> None:
    path = tmp_path / "a.kml"
    write(flown(), path, "kml", rate_hz=5.0)
    document = fastkml.KML.parse(path)
    marks = list(find_all(document, of_type=fastkml.Placemark))
    assert [m.style_url.url for m in marks] == ["#aided", "#outage", "#aided"]
    track = marks[1].kml_geometry
    assert isinstance(track, fastkml.gx.Track)
    times = [item.when.dt for item in track.track_items]
    begin = datetime.fromtimestamp(BEGIN_NS // NS, UTC)
    assert (times[0] - begin).total_seconds() == pytest.approx(5.0, abs=0.2)
    assert (times[-1] - begin).total_seconds() == pytest.approx(10.0, abs=0.2)
    assert track.track_items[0].coord.x == pytest.approx(8.5 + 250e-5, abs=2e-4)


def test_geojson_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "a.geojson"
    write(flown(), path, "geojson")
    read = geojson.loads(path.read_text())
    assert read.is_valid
    assert [f.properties["kind"] for f in read.features] == ["aided", "outage", "aided"]
    lon, lat, height = read.features[0].geometry.coordinates[0]
    assert (lon, lat) == pytest.approx((8.5001, 47.25), abs=1e-7)
    assert height == pytest.approx(401.0, abs=0.01)


def test_a_clock_without_a_date_gives_no_times(tmp_path: Path) -> None:
    path = tmp_path / "a.gpx"
    write(flown(begin_ns=0), path, "gpx")
    assert all(
        p.time is None for s in gpxpy.parse(path.read_text()).tracks[0].segments for p in s.points
    )
    write(flown(begin_ns=0), tmp_path / "a.kml", "kml")
    assert "<when>" not in (tmp_path / "a.kml").read_text()


def test_a_line_is_cut_in_a_gap_and_at_the_date_line() -> None:
    gap = flown().take(np.r_[0:400, 700:1000])
    assert [len(s.solution) for s in stretches(thin(gap, None), ())] == [390, 300]
    around = list(stretches(thin(flown(lon_deg=179.995), None), ()))
    assert len(around) == 2
    assert around[0].points[-1][0] > 179.9
    assert around[1].points[0][0] < -179.9


def test_thinning_takes_the_first_of_each_interval() -> None:
    kept = thin(flown(), 4.0)
    assert len(kept) == pytest.approx(990 / 12.5, abs=1)
    steps = np.diff(kept.t_ns) / NS
    assert steps.min() >= 0.23
    assert steps.max() <= 0.27


def test_nothing_to_draw_is_said(tmp_path: Path) -> None:
    with pytest.raises(CompanionError, match="no solution"):
        write(flown(10), tmp_path / "a.kml", "kml")
    with pytest.raises(CompanionError, match="No such file"):
        write(flown(), tmp_path / "no" / "a.kml", "kml")
