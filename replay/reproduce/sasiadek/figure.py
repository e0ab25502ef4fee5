"""The paper's figures 3 to 10, and the sky behind them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from replay.reproduce.figures import new_figure, save

if TYPE_CHECKING:
    from replay.reproduce.sasiadek.experiment import Run

_STYLE: dict[str, dict[str, Any]] = {
    "feedforward": {"color": "tab:cyan", "linewidth": 2.0},
    "feedback": {"color": "black", "linewidth": 0.7},
}
"""The wide line below: where both agree, one is seen inside the other."""
_FROM_S = 300
"""From here on the axes are made for what is drawn: the first minutes are the filter's start."""
_QUANTITIES = (("position", "m"), ("velocity", "m/s"))


def draw(run: Run, out: Path) -> tuple[str, ...]:
    """Draw one flight; the files written."""
    return (*(_errors(run, out, name, unit) for name, unit in _QUANTITIES), _inside(run, out))


def _errors(run: Run, out: Path, name: str, unit: str) -> str:
    """Error by axis and, below, how far it moves in an epoch: the spikes where the set changes."""
    values = run.errors if name == "position" else run.rates
    minutes, figure = run.seconds / 60.0, new_figure(9.0, 9.0)
    figure.suptitle(f"Best four satellites by GDOP: {name} error, feedforward and feedback")
    moved = {mode: np.linalg.norm(np.diff(error, axis=0), axis=1) for mode, error in values.items()}
    rows = [
        (f"{axis} error, {unit}", {mode: error[:, k] for mode, error in values.items()})
        for k, axis in enumerate(("East", "North", "Vertical"))
    ]
    rows.append((f"Step in an epoch, {unit}", {m: np.append(0.0, d) for m, d in moved.items()}))
    for k, (label, curves) in enumerate(rows):
        plot = figure.add_subplot(4, 1, k + 1)
        for change in run.changes:
            plot.axvline(minutes[change], color="tab:red", linewidth=0.4)
        for mode, curve in curves.items():
            plot.plot(minutes, curve, label=mode, **_STYLE[mode])
        limit = 1.05 * max(float(abs(curve[_FROM_S:]).max()) for curve in curves.values())
        plot.set_ylim(-limit if k < 3 else 0.0, limit)
        plot.set_ylabel(label)
    plot.set_xlabel("minutes; red: the set of four changes")
    plot.legend(loc="upper right")
    return save(figure, out, f"sasiadek-{name}-error")


def _inside(run: Run, out: Path) -> str:
    """What the filter states, its gain, and the sky."""
    minutes, figure = run.seconds / 60.0, new_figure(9.0, 8.0)
    figure.suptitle("Best four satellites by GDOP: stated deviation, gain and geometry")
    for k, (label, curves) in enumerate(
        (
            ("Stated 1σ of east velocity, m/s", run.sd),
            ("Norm of the gain on east position", run.gain),
        )
    ):
        plot = figure.add_subplot(3, 1, k + 1)
        for mode, values in curves.items():
            plot.plot(minutes[60:], values[60:], label=mode, **_STYLE[mode])
        plot.set_ylabel(label)
        plot.legend()
    plot = figure.add_subplot(3, 1, 3)
    plot.plot(minutes, run.gdop, linewidth=0.7, label="GDOP of the best four")
    plot.plot(minutes, run.visible, linewidth=0.7, label="satellites in view")
    plot.set_ylabel("GDOP; satellites")
    plot.set_xlabel("minutes")
    plot.legend()
    return save(figure, out, "sasiadek-covariance-gain-gdop")
