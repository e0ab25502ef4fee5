"""Satellites in use over a run with raw GNSS, and what their geometry was worth."""

from __future__ import annotations

import numpy as np

from companion.gnss.geometry import GDOP, HDOP, VDOP
from companion.types import NO_DOP
from replay.report.charts import Chart, Panel, Table
from replay.report.run_view import RunView


def satellites(run: RunView) -> Panel | None:
    """How many and how well placed; None without raw GNSS."""
    sky = run.satellites.take(np.argsort(run.satellites.t_ns, kind="stable"))
    if not len(sky):
        return None
    table = Table(sky.t_ns, run)
    counts = [table.line("in use", "satellites", sky.used.astype(np.float64))]
    if sky.excluded.any():
        excluded = np.where(sky.excluded > 0, sky.excluded, np.nan)
        counts.append(table.line("contradicting the others", "refused", excluded, "dots"))
    known = np.where(sky.dop < NO_DOP, sky.dop, np.nan)
    dops = (("GDOP", GDOP), ("HDOP", HDOP), ("VDOP", VDOP))
    lines = [table.line(name, name, known[:, column]) for name, column in dops]
    charts = [Chart("Satellites", "", (table.of(counts),))]
    if np.isfinite(known).any():
        charts.append(Chart("Dilution of precision", "", (table.of(lines),), logarithmic=True))
    note = (
        "Of each epoch of raw measurements, as it arrived. Geometry: error of the place (horizontal"
        ", vertical, with the clock) over that of one range; none with too few satellites."
    )
    return Panel("satellites", "Satellites", note, tuple(charts))
