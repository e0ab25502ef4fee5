"""What ``companion bench`` prints: speed beside a floor and a peer, memory, start-up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from replay.bench import memory, speed, start, telemetry, tight
from replay.bench.measuring import Progress, machine, pinned

Part = Literal["filter", "tight", "memory", "start", "tlog"]
PARTS: tuple[Part, ...] = get_args(Part)


def main(
    parts: Sequence[Part],
    *,
    duration_s: float = 3600.0,
    repeats: int = 5,
    tlog: Path | None = None,
    config: Path | None = None,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Measure ``parts``; ``tlog`` and ``config`` are for the part of that name, left out without.

    The result is plain types, ready for JSON, with one entry a part and the machine.
    """
    measure: dict[Part, Callable[[Progress], dict[str, Any]]] = {
        "filter": lambda p: speed.filter_figures(duration_s, repeats, p),
        "tight": lambda p: tight.tight_figures(repeats, p),
        "memory": memory.memory_figures,
        "start": lambda p: start.start_figures(repeats, p),
    }
    if tlog is not None:
        measure["tlog"] = lambda p: telemetry.telemetry_figures(tlog, config, repeats, p)
    chosen = [part for part in measure if part in parts]
    out: dict[str, Any] = {}
    with pinned():
        for k, part in enumerate(chosen):
            out[part] = measure[part](lambda done, k=k: progress((k + done) / len(chosen)))  # type: ignore[misc]
    out["machine"] = machine()
    return out


def lines(figures: dict[str, Any]) -> list[str]:
    """What :func:`main` measured, for people."""
    said = []
    for part, words in (
        ("filter", speed.filter_lines),
        ("tight", tight.tight_lines),
        ("memory", memory.memory_lines),
        ("start", start.start_lines),
        ("tlog", telemetry.telemetry_lines),
    ):
        if part in figures:
            said += words(figures[part])
    return [*said, "Machine: " + ", ".join(f"{k} {v}" for k, v in figures["machine"].items())]
