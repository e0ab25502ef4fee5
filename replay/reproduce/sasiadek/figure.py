"""The paper's figures 3 to 10, and the sky behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from replay.reproduce.figures import new_figure, save

if TYPE_CHECKING:
    from replay.reproduce.sasiadek.experiment import Run

_STYLE = {"feedforward": "--", "feedback": "k-"}


def draw(run: Run, out: Path) -> tuple[str, ...]:
    """Draw one flight; the files written."""
    minutes = run.seconds / 60.0
    written = []
    for name, values, unit in (
        ("position", run.errors, "m"),
        ("velocity", run.rates, "m/s"),
    ):
        figure = new_figure(9.0, 7.0)
        for k, axis in enumerate(("East", "North", "Vertical")):
            plot = figure.add_subplot(3, 1, k + 1)
            for mode, error in values.items():
                plot.plot(minutes, error[:, k], _STYLE[mode], linewidth=0.7, label=mode)
            limit = 5.0 * float(abs(values["feedback"][300:, k]).mean())
            plot.set_ylim(-limit, limit)
            plot.set_ylabel(f"{axis} {name} error, {unit}")
            for change in run.changes:
                plot.axvline(minutes[change], color="tab:blue", linewidth=0.3)
        plot.set_xlabel("minutes; blue: the set of four changes")
        plot.legend()
        written.append(save(figure, out, f"sasiadek-{name}-error"))
    figure = new_figure(9.0, 8.0)
    for k, (label, curves) in enumerate(
        (
            ("Stated 1σ of east velocity, m/s", run.sd),
            ("Norm of the gain on east position", run.gain),
        )
    ):
        plot = figure.add_subplot(3, 1, k + 1)
        for mode, values_ in curves.items():
            plot.plot(minutes[60:], values_[60:], _STYLE[mode], linewidth=0.7, label=mode)
        plot.set_ylabel(label)
        plot.legend()
    plot = figure.add_subplot(3, 1, 3)
    plot.plot(minutes, run.gdop, linewidth=0.7, label="GDOP of the best four")
    plot.plot(minutes, run.visible, linewidth=0.7, label="satellites in view")
    plot.set_xlabel("minutes")
    plot.legend()
    written.append(save(figure, out, "sasiadek-covariance-gain-gdop"))
    return tuple(written)
