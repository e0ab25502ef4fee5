"""Options that several commands share, and what is made of them."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from rich.console import Console

if TYPE_CHECKING:
    from replay.window import Window

SolutionName = Annotated[
    Literal["forward", "smoothed"],
    typer.Option(help="As published at the time, or smoothed (made now where the log has none)."),
]
JsonFlag = Annotated[
    bool, typer.Option("--json", help="One JSON object on stdout; text for people on stderr.")
]
ConfigPath = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="FILE",
        help="Configuration (TOML). Without it: the one that came with the log, else defaults "
        "for its format. The output says which.",
    ),
]
EstimatorName = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Not what was published: the log replayed by this estimator alone, one of a bank or "
        "words as companion compare takes them, such as direct or error-state+none.",
    ),
]
VehicleName = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Only this vehicle of a log that holds several."),
]


def console_for(as_json: bool) -> Console:
    return Console(stderr=as_json, soft_wrap=True)


def emit(result: Mapping[str, Any]) -> None:
    sys.stdout.write(json.dumps(result, allow_nan=False) + "\n")


def windows_of(texts: Sequence[str], option: str) -> list[Window]:
    """``START+SECONDS[:LEFT]`` texts as windows; wrong ones are wrong usage."""
    from replay.window import parse_window

    windows = []
    for text in texts:
        try:
            windows.append(parse_window(text))
        except ValueError:
            raise typer.BadParameter(
                f"'{text}': START+SECONDS, both in seconds, such as 120+30, or 120+30:2",
                param_hint=f"'{option}'",
            ) from None
    return windows


def speed_of(text: str) -> float | None:
    if text == "max":
        return None
    try:
        speed = float(text)
    except ValueError:
        speed = 0.0
    if not 0 < speed < float("inf"):
        raise typer.BadParameter(
            f"'{text}': max, 1 (real time) or a factor on real time", param_hint="'--speed'"
        )
    return speed


def emit_if(as_json: bool, result: Mapping[str, Any]) -> None:
    if as_json:
        emit(result)
