"""What a run with raw GNSS tells of its sky: in the summary, from its log, and on the page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.config import RawGnss
from companion.gnss.corrected import S_SAT
from companion.intake.raw_gnss.receiver import Receiver
from companion.types import NS, Channel, Recording
from replay.assessment import outages_of
from replay.configuration import ChosenConfig
from replay.preparation import withhold_gnss
from replay.report.panels import panels
from replay.report.run_view import RunView
from replay.run_log import read_solution
from replay.session import run_log, run_session
from replay.sky import sky
from replay.summary import summarise
from replay.window import Window, parse_window, read_windows

from . import flights


def test_a_run_tells_how_many_satellites_and_how_well_they_stood(tmp_path: Path) -> None:
    # Two satellites left for the last of three parts, in blocks that end somewhere else.
    vehicle = flights.withheld(flights.flight().recording, 80.0, 200.0, 2)
    chosen = ChosenConfig(flights.config(), "test", "")
    path = tmp_path / "run.mcap"
    with run_log(path, Recording("flight", "test", (vehicle,)), chosen) as log:
        run = run_session(vehicle, chosen, writer=log)
    told = summarise(vehicle, run.solution, run.reports, run.events, None, run.satellites).sky
    assert told is not None
    t = flights.seconds(vehicle)
    few = int(np.count_nonzero(t >= 80.0))
    assert told.epochs == len(t)
    assert told.fewer_than_four == few
    assert told.satellites_least == 2
    assert 6 <= told.satellites_median <= told.satellites_most <= 20
    assert told.gdop_median is not None
    assert told.gdop_worst is not None
    assert 1.0 < told.gdop_median <= told.gdop_worst < 10.0
    stored = read_solution(path)
    again = sky(stored.satellites, stored.events)
    assert again is not None
    assert again.epochs == told.epochs
    assert abs((again.gdop_worst or 0.0) - told.gdop_worst) < 1e-5  # single precision in the log
    assert sky(stored.satellites.take(slice(0, 0)), stored.events) is None

    view = RunView(
        "test", vehicle, chosen.config, stored.solution, stored.reports, stored.events,
        satellites=stored.satellites,
    )  # fmt: skip
    drawn = {panel.id: panel for panel in panels(view)}
    assert [chart.title for chart in drawn["satellites"].charts] == [
        "Satellites", "Dilution of precision",
    ]  # fmt: skip
    titles = [chart.title for chart in drawn["innovations"].charts]
    assert "range GPS, worst satellite of each epoch" in titles
    ranges = next(c for c in drawn["innovations"].charts if c.title.startswith("range GPS"))
    # One row an epoch and a scale of ranges, not of a clock that is being found.
    mine = (stored.reports.channel == Channel.RANGE_GPS) & (stored.reports.dof > 0)
    assert np.count_nonzero(mine) > 3 * len(np.unique(stored.reports.t_ns[mine]))
    assert ranges.limit is not None
    assert ranges.limit < 60.0


def test_times_without_ranges_are_outages_of_a_run_on_ranges() -> None:
    """Two satellites are none on fixes made of them; no satellite is one for both."""
    vehicle = flights.withheld(flights.flight().recording, 20.0, 40.0, 2)
    vehicle = flights.withheld(vehicle, 60.0, 75.0, 0)
    vehicle = flights.withheld(vehicle, 100.0, 200.0, 0)
    origin = int(vehicle.imu[0].t_ns[0])

    def lost(coupling: str) -> list[tuple[float, float]]:
        config = flights.config(raw_gnss={"coupling": coupling})
        found = outages_of(vehicle, config, ())
        return [((o.start_ns - origin) / NS, (o.end_ns - o.start_ns) / NS) for o in found]

    # Epochs come five times a second: a gap is longer by up to one of them.
    assert lost("tight") == [pytest.approx((60.0, 15.0), abs=0.41)]
    assert lost("loose") == [
        pytest.approx((20.0, 20.0), abs=0.41),
        pytest.approx((60.0, 15.0), abs=0.41),
    ]
    run = run_session(vehicle, ChosenConfig(flights.config(), "test", ""))
    view = RunView("test", vehicle, flights.config(), run.solution, run.reports, run.events)
    # The one that the run ends in is told by the report.
    assert (view.outages()[-1].start_ns - origin) / NS == pytest.approx(100.0, abs=0.41)


def test_a_window_may_leave_the_highest_few() -> None:
    whole = flights.flight().recording
    [window] = read_windows(str(Window(40.0, 20.0, 2)))
    assert window == Window(40.0, 20.0, 2)
    few = withhold_gnss(whole, [window, Window(80.0, 5.0)])
    t, before, after = flights.seconds(few), whole.raw[0], few.raw[0]
    inside = (t >= 40.0) & (t < 60.0)
    left = [set(row[row > 0].tolist()) for row in after.sat[inside]]
    assert len(left[0]) == 2
    assert all(row == left[0] for row in left)
    assert not ((t >= 80.0) & (t < 85.0)).any()
    same = np.isin(before.t_ns, after.t_ns[~inside])
    assert np.array_equal(before.sat[same], after.sat[~inside])
    receiver = Receiver(RawGnss())
    receiver.listen(whole.broadcast[0])
    first = int(np.flatnonzero(inside)[0])
    seen = [receiver.take(before, i) for i in range(first - 2, first + 1)][-1]
    high = np.sort(seen.sky[:, 1])[-2:]
    mine = np.isin(seen.rows[:, S_SAT], list(left[0]))
    assert np.sort(seen.sky[mine, 1]) == pytest.approx(high)


@pytest.mark.parametrize("text", ["40+20:", "40+20:x", "40+20:-1", "40:2", "40+20:2:3"])
def test_windows_that_are_none(text: str) -> None:
    with pytest.raises(ValueError, match=r"convert|literal|\d"):
        parse_window(text)
