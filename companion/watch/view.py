"""A vehicle's picture as text.

Colours repeat what the words say: green is good, yellow is to look at, red is to act upon.
"""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

from rich.console import Group, RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from companion.types import NO_DOP, NS, Health, Verdict
from companion.watch.alarms import WIDE_MS
from companion.watch.picture import Fleet, VehiclePicture

OLD_S = 3.0
"""Satellites of longer ago are of another time: receivers measure once a second and more."""
_STANDING = {"navigating": "bold green", "heading unknown": "bold yellow",
             "aligning": "bold yellow", "coasting": "bold red", "silent": "bold red",
             "gone": "bold red", "waiting": "bold yellow"}  # fmt: skip
_STATE = {"ok": "green", "up": "green", "writing": "green", "back": "yellow", "slow": "yellow",
          "waiting": "yellow", "retrying": "yellow", "no-fix": "yellow", "silent": "red",
          "lost": "red", "stopped": "red", "off": "", "warning": "yellow", "error": "red",
          "info": ""}  # fmt: skip


def fleet_view(fleet: Fleet, vehicle: VehiclePicture | None, now_ns: int, last: int) -> Group:
    """All that is known; with several vehicles, a line for each, and one in full.

    ``last``: how many of the latest events to show.
    """
    parts: list[RenderableType] = []
    if len(fleet.vehicles) > 1:
        parts.append(_vehicles(fleet, now_ns))
    if vehicle is None:
        parts.append(Text("no vehicle yet", style="yellow"))
    else:
        parts.append(vehicle_view(vehicle, now_ns, last))
    return Group(*parts)


def vehicle_view(v: VehiclePicture, now_ns: int, last: int = 8) -> Group:
    """One vehicle in full."""
    parts: list[RenderableType] = [_head(v, now_ns)]
    if v.state is not None:
        parts.append(_navigation(v))
    if v.health is not None:
        parts += [_sensors(v.health), _process(v.health)]
    if v.gates:
        parts.append(_gates(v, now_ns))
    if v.satellites is not None:
        parts.append(_sky(v, now_ns))
    if v.events:
        parts.append(_events(v, last))
    if v.broken:
        parts.append(Text(f"{v.broken} messages could not be read", style="yellow"))
    return Group(*parts)


def _table(*columns: str, title: str = "") -> Table:
    table = Table(box=None, pad_edge=False, title=title or None, title_justify="left",
                  title_style="bold", header_style="dim")  # fmt: skip
    table.add_column(columns[0])
    for name in columns[1:]:
        table.add_column(name, justify="right")
    return table


def _vehicles(fleet: Fleet, now_ns: int) -> Table:
    table = _table("vehicle", "is", "health", "Hz", title="Vehicles")
    for v in fleet.vehicles.values():
        standing = v.standing(now_ns)
        level = v.health.level if v.health is not None else "-"
        table.add_row(
            escape(v.name),
            Text(standing, _STANDING[standing]),
            Text(level, _STATE.get(level, "")),
            f"{v.rate_hz(now_ns):.0f}",
        )
    return table


def _head(v: VehiclePicture, now_ns: int) -> Text:
    standing = v.standing(now_ns)
    line = Text.assemble(("Vehicle ", "bold"), (v.name, "bold"), "  ",
                         (standing.upper(), _STANDING[standing]))  # fmt: skip
    if standing == "silent":
        line.append(f" for {v.age_s(now_ns):.0f} s", "red")
    if v.state is not None:
        at = datetime.fromtimestamp(v.state.t_ns / NS, UTC)
        line.append(f"  {at:%Y-%m-%d %H:%M:%S}.{at.microsecond // 100_000} UTC", "dim")
        line.append(f"  {v.rate_hz(now_ns):.0f} Hz")
        if math.isfinite(v.latency_ms):
            line.append(f"  {v.latency_ms:.1f} ms old", "yellow" if v.latency_ms > WIDE_MS else "")
        if v.state.resets:
            line.append(f"  {v.state.resets} resets", "yellow")
    if v.health is not None:
        line.append("\n" + v.health.level, _STATE[v.health.level])
        line.append(f": {v.health.text}  (up {_span(v.health.uptime_s)})")
    return line


def _navigation(v: VehiclePicture) -> Table:
    s = v.state
    north, east, down = s.vel_n
    course = math.degrees(math.atan2(east, north)) % 360.0
    table = _table("", "", "", "", "1σ", "", "", title="Navigation")
    names = "north", "east", "down"
    place = (f"{math.degrees(s.lat):.7f}°", f"{math.degrees(s.lon):.7f}°", f"{s.height:.2f} m")
    table.add_row("position", *place, *_sd(s.sd_pos_m, names, " m", (2.0, 10.0)))
    velocity = (f"N {north:.2f}", f"E {east:.2f}", f"D {down:.2f} m/s")
    table.add_row("velocity", *velocity, *_sd(s.sd_vel_mps, names, " m/s", (0.5, 2.0)))
    angles = (f"roll {s.roll_deg:.1f}", f"pitch {s.pitch_deg:.1f}", f"yaw {s.yaw_deg % 360:.1f}°")
    table.add_row("attitude", *angles, *_sd(s.sd_att_deg, names, "°", (3.0, 10.0)))
    table.add_row("over ground", f"{math.hypot(north, east):.2f} m/s", f"course {course:.0f}°")
    return table


def _sd(values: Any, names: tuple[str, ...], unit: str, limits: tuple[float, float]) -> list[Text]:
    """Standard deviations of three axes, coloured by how wide they are."""
    out = []
    for name, value in zip(names, values, strict=True):
        wide = "green" if value <= limits[0] else "yellow" if value <= limits[1] else "red"
        shown = f"{value:.2f}" if value < 100 else f"{value:.3g}"
        out.append(Text(f"{name[0].upper()} ±{shown}{unit}", wide))
    return out


def _sensors(health: Health) -> Table:
    table = _table("sensor", "kind", "state", "Hz", "age s", "samples", "lost", "saturated", "",
                   title="Sensors")  # fmt: skip
    for s in health.sensors:
        table.add_row(
            escape(s.source),
            s.kind,
            Text(s.state, _STATE[s.state]),
            f"{s.rate_hz:.1f}",
            "-" if math.isnan(s.age_s) else f"{s.age_s:.2f}",
            str(s.samples),
            Text(str(s.lost), "yellow" if s.lost else ""),
            Text(str(s.saturated), "yellow" if s.saturated else ""),
            "used" if s.used else "logged only",
        )
    return table


def _process(health: Health) -> Text:
    """Links, load and log, a line each; what a replay does not have is left out."""
    lines: list[Text] = []
    if health.links:
        lines.append(_links(health))
    loop, log = health.loop, health.log
    if math.isfinite(loop.latency_p50_ms):
        p50, p99 = loop.latency_p50_ms, loop.latency_p99_ms
        lines.append(
            Text.assemble(
                ("Loop   ", "bold"),
                (f"{100 * loop.load:.0f} % of a core", "yellow" if loop.load > 0.8 else ""),
                f", sample to output p50 {p50:.2f}, p99 {p99:.2f} ms",
            )
        )
    if log.state != "off":
        lines.append(
            Text.assemble(
                ("Log    ", "bold"),
                (log.state, _STATE[log.state]),
                f" {log.written_bytes / 1e6:.1f} MB",
                (f", {log.dropped_bytes} bytes dropped" if log.dropped_bytes else "", "red"),
            )
        )
    return Text("\n").join(lines)


def _links(health: Health) -> Text:
    line = Text.assemble(("Links  ", "bold"))
    for link in health.links:
        line.append(f"{link.name} ")
        line.append(link.state, _STATE[link.state])
        said = f" {link.received} in"
        said += f", {link.malformed} malformed" if link.malformed else ""
        said += f", reopened {link.reopened}×" if link.reopened else ""
        line.append(said + (f" ({link.note})" if link.note else "") + "   ")
    return line


def _gates(v: VehiclePicture, now_ns: int) -> Table:
    table = _table("channel", "accepted", "rejected", "refused", "NIS/gate", "latest",
                   title="Aiding, last 30 s")  # fmt: skip
    for channel in sorted(v.gates):
        gate = v.gates[channel]
        accepted, rejected, refused = gate.counts(now_ns)
        latest = gate.last
        word = latest.name.lower().replace("_", " ") if latest is not None else "silent"
        style = {Verdict.ACCEPTED: "green", Verdict.REJECTED_GATE: "red", None: "red"}
        table.add_row(
            channel.name.lower().replace("_", " "),
            str(accepted),
            Text(str(rejected), "red" if rejected > accepted else "yellow" if rejected else ""),
            Text(str(refused), "yellow" if refused else ""),
            "-" if math.isnan(gate.ratio) else f"{gate.ratio:.2f}",
            Text(word, style.get(latest, "yellow")),
        )
    return table


def _sky(v: VehiclePicture, now_ns: int) -> Text:
    """Satellites of the latest epoch of raw GNSS, and their geometry."""
    sky, age_s = v.satellites, (now_ns - v.satellites_ns) / NS
    line = Text.assemble(
        ("Sky    ", "bold"),
        (f"{sky.used} satellites", "red" if not sky.used else "yellow" if sky.used < 4 else ""),
        f", {sky.excluded} contradicting them" if sky.excluded else "",
    )
    if sky.gdop < NO_DOP:
        line.append(f", GDOP {sky.gdop:.1f}, HDOP {sky.hdop:.1f}, VDOP {sky.vdop:.1f}")
    if age_s > OLD_S:
        line.append(f", {age_s:.0f} s ago", "red")
    return line


def _events(v: VehiclePicture, last: int) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False, title="Events",
                  title_justify="left", title_style="bold")  # fmt: skip
    for event in list(v.events)[-last:] if last else []:
        at = datetime.fromtimestamp(event.t_ns / NS, UTC)
        table.add_row(
            Text(f"{at:%H:%M:%S}", "dim"),
            Text(event.level if event.level != "info" else "", _STATE[event.level]),
            Text(f"{event.kind}: {event.text}", _STATE[event.level]),
        )
    return table


def _span(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
