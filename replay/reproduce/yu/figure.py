"""Figures in kind: 4 to 7 with the mechanisms, 8 to 10 with and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from replay.reproduce import figures
from replay.reproduce.yu.experiment import Pair, stacked
from replay.reproduce.yu.track import STEPS

_PANELS = (
    ("position", "m", ("north", "east", "down")),
    ("velocity", "m/s", ("north", "east", "down")),
    ("acceleration", "m/s²", ("north", "east", "down")),
    ("attitude_deg", "°", ("roll", "pitch", "heading")),
)


def draw(runs: Pair, out: Path) -> tuple[str, ...]:
    """Write both figures; their files."""
    return _with_mechanisms(runs, out), _compared(runs, out)


def _with_mechanisms(runs: Pair, out: Path) -> str:
    """One run in colour over the 5 to 95 % band of all of them."""
    figure = figures.new_figure(9.0, 10.0)
    t = runs[0][0].t
    for index, (kind, unit, axes) in enumerate(_PANELS):
        ax = figure.add_subplot(4, 1, index + 1)
        errors = stacked(runs[0], kind)
        for axis, name in enumerate(axes):
            low, high = np.percentile(errors[:, :, axis], (5, 95), axis=0)
            line = ax.plot(t, errors[0, :, axis], linewidth=0.9, label=name)[0]
            ax.fill_between(t, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        ax.set_ylabel(f"{kind.removesuffix('_deg')} {unit}")
        ax.legend(loc="upper left", ncols=3, fontsize=8)
        for start, *_ in STEPS[1:]:
            ax.axvline(start, color="0.6", linewidth=0.6)
    ax.set_xlabel("s")
    figure.suptitle("With the mechanisms (figures 4-7): one run, and 90 % of all")
    return figures.save(figure, out, "yu-with-mechanisms")


def _compared(runs: Pair, out: Path) -> str:
    """Root mean square over the runs, with and without."""
    figure = figures.new_figure(9.0, 8.0)
    t = runs[0][0].t
    for index, (kind, unit, _) in enumerate(_PANELS[:3]):
        ax = figure.add_subplot(3, 1, index + 1)
        for pair, name in zip(runs, ("with mechanisms", "without"), strict=True):
            error = np.sqrt(np.mean(np.sum(stacked(pair, kind) ** 2, axis=2), axis=0))
            ax.plot(t, error, linewidth=1.2, label=name)
        ax.set_ylabel(f"3-D {kind} {unit}")
        ax.legend(loc="upper left", fontsize=8)
        for start, *_ in STEPS[1:]:
            ax.axvline(start, color="0.6", linewidth=0.6)
    ax.set_xlabel("s")
    figure.suptitle("With and without the mechanisms (figures 8-10): RMS over the runs")
    return figures.save(figure, out, "yu-comparison")
