"""The paper's Fig. 5: the track through an outage of 30 s, forward, backward and smoothed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from companion.navigation.earth import ned_difference
from companion.types import F64, NS, Solution
from replay.preparation import start_ns
from replay.reproduce import figures
from replay.reproduce.kamil.drives import Drive
from replay.window import Window

_LOOKS = {
    "forward": ("tab:blue", 1.6),
    "backward": ("tab:purple", 1.2),
    "straight (the paper's)": ("tab:red", 1.8),
    "consistent": ("tab:orange", 1.4),
    "optimal": ("tab:green", 1.2),
}


def draw(out: Path, drive: Drive, window: Window, tracks: dict[str, Solution]) -> str:
    """Write the figure; the file."""
    figure = figures.new_figure(11.0, 5.0)
    plan, error = figure.subplots(1, 2)
    truth = drive.vehicle.truth
    assert truth is not None
    first = (truth.lat[:1], truth.lon[:1], truth.height[:1])

    def place(lat: F64, lon: F64, height: F64) -> F64:
        return ned_difference(lat, lon, height, *(np.repeat(x, len(lat)) for x in first))

    way = place(truth.lat, truth.lon, truth.height)
    plan.plot(way[:, 1], way[:, 0], color="0.75", linewidth=4, label="driven")
    begin = start_ns(drive.vehicle) + round(window.start_s * NS)
    end = begin + round(window.seconds * NS)
    fixes = drive.vehicle.gnss[0]
    seen = (fixes.t_ns < begin) | (fixes.t_ns >= end)
    marks = place(fixes.lat, fixes.lon, fixes.height)
    plan.plot(*marks[seen][:, 1::-1].T, "k.", markersize=3, label="GPS")
    plan.plot(*marks[~seen][:, 1::-1].T, "ks", markersize=3, fillstyle="none", label="GPS withheld")
    for name, track in tracks.items():
        colour, width = _LOOKS[name]
        t, off = drive.errors(track)
        error.plot(t, np.hypot(off[:, 0], off[:, 1]), color=colour, linewidth=width, label=name)
        shown = (track.t_ns >= begin) & (track.t_ns <= end)
        path = place(track.lat, track.lon, track.height)[shown]
        plan.plot(path[:, 1], path[:, 0], color=colour, linewidth=width, label=name)
    plan.set_aspect("equal")
    plan.set_xlabel("east [m]")
    plan.set_ylabel("north [m]")
    plan.set_title(f"Route '{drive.route.name}', the outage")
    plan.legend(fontsize="x-small")
    error.axvspan(window.start_s, window.start_s + window.seconds, color="0.92")
    error.set_yscale("log")
    error.set_ylim(0.05, None)
    error.set_xlabel("time [s]")
    error.set_ylabel("horizontal error [m]")
    error.set_title(f"No GPS from {window.start_s:.0f} to {window.start_s + window.seconds:.0f} s")
    return figures.save(figure, out, "kamil-outage")
