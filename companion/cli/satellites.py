"""What ``companion satellites`` does: one receiver's raw measurements, an epoch at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from companion import present
from companion.cli.commands import LOADING, compile_kernels, plain
from companion.config import Config, load
from companion.types import NS
from replay import kernels


def solve_receiver(
    console: Console, paths: Sequence[Path], config_path: Path | None, output: Path | None
) -> dict[str, Any]:
    """Read, solve and describe a receiver's recording; fixes into ``output`` where it is given."""
    config = load(config_path) if config_path is not None else Config()
    used = msgspec.structs.replace(config.raw_gnss, coupling="loose")
    compile_kernels(kernels.parts_of(msgspec.structs.replace(config, raw_gnss=used)))
    with present.notice_if_slow(console, LOADING):
        from replay.raw_gnss import positions as p
        from replay.sky import sky
    with present.notice_if_slow(console, "Reading …"):
        found = p.read_receiver(paths, config.raw_gnss.clock)
    for note in found.notes:
        console.print(f"Note      {escape(note)}")
    with present.notice_if_slow(console, "Solving …"):
        solved = p.solve(found, config)
    raw = solved.raw
    told = plain(
        {
            "paths": [str(path) for path in paths],
            "notes": list(solved.notes),
            "receiver": raw.source,
            "epochs": len(raw),
            "duration_s": p.seconds(raw),
            "start_utc": datetime.fromtimestamp(int(raw.t_ns[0]) / NS, UTC).isoformat(),
            "systems": p.systems(found),
            "sky": sky(solved.satellites, solved.events),
            "solved": 0 if solved.fixes is None else len(solved.fixes),
            "place": None if solved.fixes is None else p.spread(solved.fixes),
            "events": [
                {"time_s": (e.t_ns - int(raw.t_ns[0])) / NS, "kind": e.kind, "level": e.level,
                 "text": e.text}
                for e in solved.events
            ],
        }
    )  # fmt: skip
    _show(console, told)
    if output is not None:
        p.write_fixes(output, solved)
        console.print(f"Fixes     {escape(str(output))}")
    return {**told, "out": None if output is None else str(output)}


def _show(console: Console, told: Mapping[str, Any]) -> None:
    length = told["duration_s"]
    rate = f" at {(told['epochs'] - 1) / length:.4g} Hz" if length > 0 else ""
    console.print(
        f"[bold]Receiver  {escape(told['receiver'])}[/bold]: {told['epochs']} epochs{rate}, "
        f"{present.span(length)}, from {told['start_utc'][:19]}",
        highlight=False,
    )
    table = Table(box=None, pad_edge=False)
    table.add_column("system")
    for name in ("satellites", "in view", "with ephemeris", "C/N0 dB-Hz", "with Doppler"):
        table.add_column(name, justify="right")
    for s in told["systems"]:
        cn0 = s["cn0_median_dbhz"]
        table.add_row(
            s["name"], str(s["satellites"]), f"{s['in_view_median']:.0f}", str(s["with_ephemeris"]),
            "-" if cn0 is None else f"{cn0:.0f}", f"{s['with_doppler']:.0%}",
        )  # fmt: skip
    console.print(table)
    present.show_sky(console, told["sky"])
    place = told["place"]
    console.print(f"Solved    {told['solved']} of {told['epochs']} epochs")
    if place is not None:
        console.print(
            f"Place     {place['lat_deg']:.7f}° {place['lon_deg']:.7f}°, "
            f"{place['alt_hae_m']:.1f} m above the ellipsoid, in the mean\n"
            f"          about it {place['horizontal_rms_m']:.2f} m horizontally and "
            f"{place['height_rms_m']:.2f} m in height (RMS, motion and error); it says "
            f"{place['stated_horizontal_m']:.2f} and {place['stated_height_m']:.2f} m",
            highlight=False,
        )
        if place["fastest_mps"] is not None:
            console.print(f"Velocity  at most {place['fastest_mps']:.1f} m/s", highlight=False)
    present.show_events(console, told["events"])
