"""``companion check``: listens to what a configuration names, and says what is missing."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import compile_kernels, plain
from companion.config import load
from companion.runtime.check.findings import findings
from companion.runtime.check.heard import Finding, Heard
from companion.types import ConfigError
from replay.kernels import parts_of

_COLOURS = {"ok": "green", "warning": "yellow", "error": "red"}
_SHOWN_IDS = 16


def check_config(console: Console, path: Path, seconds: float) -> dict[str, Any]:
    """Validate, open, listen, judge; what ``--json`` prints, with ``ok`` for the exit status."""
    config = load(path)
    if not config.can and not config.mavlink.endpoint and not config.raw_gnss.endpoint:
        raise ConfigError(
            f"{path}: no link to listen to; it needs [[can]], mavlink.endpoint or raw_gnss.endpoint"
        )
    compile_kernels(parts_of(config))
    with present.notice_if_slow(console, "Loading …"):
        from companion.runtime.check.listen import listen
        from companion.runtime.start import hear_an_autopilot

        # What is loaded when the first message comes is not there to listen.
        hear_an_autopilot()
    with present.progress(console, f"Listening for {seconds:g} s") as update:
        heard = listen(config, path.parent, seconds, update)
    found = findings(config, heard)
    _show(console, heard, found)
    return {
        "ok": not any(f.level == "error" for f in found),
        "config": str(path),
        **_described(heard),
        "findings": [asdict(f) for f in found],
    }


def _described(heard: Heard) -> dict[str, Any]:
    """What was heard, for ``--json``."""
    streams = [
        {"kind": s.kind, "source": s.source, "samples": s.samples, "rate_hz": s.rate_hz}
        for s in heard.streams
    ]
    buses = [
        {
            **{k: v for k, v in asdict(bus).items() if k != "ids"},
            "ids": [
                {"id": can_id, "extended": extended, "rate_hz": rate}
                for (can_id, extended), rate in bus.ids.items()
            ],
        }
        for bus in heard.buses
    ]
    return plain(
        {
            "seconds": heard.seconds,
            "can": buses,
            "imus": heard.imus,
            "mavlink": heard.mavlink,
            "receiver": heard.receiver,
            "streams": streams,
            "zenoh": heard.zenoh,
            "log": heard.log,
        }
    )


def _show(console: Console, heard: Heard, found: list[Finding]) -> None:
    for bus in heard.buses:
        _show_ids(console, bus.name, bus.ids)
    if heard.mavlink is not None:
        for system in heard.mavlink.systems:
            name = system.autopilot or "no autopilot"
            console.print(
                f"[bold]MAVLink {system.system}/{system.component}[/bold] {escape(name)}: "
                + ", ".join(f"{m} {hz:.3g}" for m, hz in system.messages.items())
                + " a second",
                highlight=False,
            )
    width = max(len(f.part) for f in found)
    for finding in found:
        colour = _COLOURS[finding.level]
        console.print(
            f"[{colour}]{finding.level:8s}[/{colour}]{escape(finding.part.ljust(width))}  "
            + escape(finding.text),
            highlight=False,
        )
        if finding.advice:
            console.print(f"{'':8s}{'':{width}s}  → {escape(finding.advice)}", highlight=False)


def _show_ids(console: Console, name: str, ids: dict[tuple[int, bool], float]) -> None:
    if not ids:
        return
    most = sorted(ids.items(), key=lambda item: -item[1])
    shown = ", ".join(
        f"{can_id:08X} {rate:.4g}" if extended else f"{can_id:03X} {rate:.4g}"
        for (can_id, extended), rate in most[:_SHOWN_IDS]
    )
    rest = f" and {len(most) - _SHOWN_IDS} more" if len(most) > _SHOWN_IDS else ""
    console.print(f"[bold]CAN {escape(name)}[/bold] {shown}{rest} frames a second", highlight=False)
