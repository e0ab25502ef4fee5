"""The batch on one page that opens without a network: what stands out first, each log one line."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from urllib.parse import quote

import numpy as np

from companion import __version__
from replay.batch.outcome import Outcome, Row
from replay.batch.outliers import FIGURES, LIMIT, Figure, Found

_REPORT_STYLE = resources.files("replay.report") / "assets" / "report.css"
_ASSETS = resources.files("replay.batch") / "assets"


@dataclass(frozen=True, slots=True)
class _Column:
    head: str
    name: str
    form: str
    """Format of the number."""
    tip: str


_COLUMNS = (
    _Column("Length s", "duration_s", ".0f", "Of the solution, from alignment on"),
    _Column("Distance m", "distance_m", ".0f", "Over the ground"),
    _Column("IMU Hz", "imu_rate_hz", ".4g", "Of the inertial stream that was used"),
    _Column("Horizontal m", "horizontal_rmse_m", ".2f", "RMS error against the reference"),
    _Column("Smoothed m", "smoothed_horizontal_rmse_m", ".2f", "The same of the smoothed track"),
    _Column("Velocity m/s", "velocity_rmse_mps", ".2f", "RMS, three axes"),
    _Column("Heading °", "yaw_rmse_deg", ".1f", "RMS"),
    _Column("NEES", "position_nees", ".1f", "3 where the stated deviations are honest"),
    _Column("σ m", "stated_sd_median_m", ".2f", "Stated horizontal deviation, median"),
    _Column("σ max m", "stated_sd_max_m", ".1f", "The largest"),
    _Column("Refused %", "refused_share", ".1%", "Of the measurements that the filter saw"),
    _Column("Outage s", "longest_outage_s", ".0f", "The longest time without GNSS"),
    _Column("Resets", "resets", "d", "Declared by the filter"),
)


def write_page(
    path: Path, found: Sequence[Found], outcomes: Sequence[Outcome], words: Sequence[str]
) -> None:
    """Write the page; ``words``: facts about the batch as a whole, a line each."""
    failed = [o for o in outcomes if o.ended == "failed"]
    refused = [o for o in outcomes if o.ended == "refused"]
    text = _PAGE.format(
        style=_REPORT_STYLE.read_text(encoding="utf-8") + _asset("batch.css"),
        counts=_counts(found, failed, refused),
        words="".join(f"<li>{html.escape(w)}</li>" for w in words),
        failed=_reasons("failed", "Did not come to an end", _FAILED, failed),
        spread=_spread(found),
        rows=_rows(found),
        refused=_reasons("refused", "Refused", _REFUSED, refused),
        version=html.escape(__version__),
        script=_asset("batch.js"),
    )
    path.write_text(text, encoding="utf-8")


def _asset(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _counts(found: Sequence[Found], failed: Sequence[Outcome], refused: Sequence[Outcome]) -> str:
    levels = {w: sum(f.row.verdict == w for f in found) for w in ("good", "degraded", "bad")}
    cells = [
        ("", "flights", len(found)),
        *((level, level, count) for level, count in levels.items()),
        ("", "stand out", sum(bool(f.words) for f in found)),
        ("bad" if failed else "", "failed", len(failed)),
        ("", "refused", len(refused)),
    ]
    return "".join(
        f'<div class="{style}"><dd>{count}</dd><dt>{words}</dt></div>'
        for style, words, count in cells
    )


def _rows(found: Sequence[Found]) -> str:
    if not found:
        return ""
    heads = "".join(
        f'<th class="number" title="{html.escape(c.tip)}">{html.escape(c.head)}</th>'
        for c in _COLUMNS
    )
    lines = "\n".join(_row(at, one) for at, one in enumerate(found))
    return (
        '<section id="flights"><h2>Flights</h2>'
        f"<p>Outliers first: what is beyond {LIMIT} robust deviations from this batch's median, "
        "compared as logarithms; then by verdict. Errors are against truth where the log has it, "
        "else (in italics) differences from the autopilot's own estimate. A click on a heading "
        "sorts, on a log opens its report.</p>"
        '<input id="filter" type="search" placeholder="Only logs with these words …">'
        '<div class="scroll wide"><table><thead><tr><th></th><th>Log</th>'
        f"<th>What stands out, or the verdict</th>{heads}</tr></thead><tbody>{lines}</tbody>"
        "</table></div></section>"
    )


def _row(at: int, one: Found) -> str:
    row = one.row
    several = len(one.outcome.rows) > 1
    name = f"{one.outcome.log} · {row.vehicle}" if several else one.outcome.log
    said = "; ".join(one.words) or row.headline.partition(": ")[2] or row.headline
    against = " against" if row.reference == "autopilot" else ""
    cells = "".join(_cell(getattr(row, c.name), c.form) for c in _COLUMNS)
    style = f"{row.verdict}{against}{' outlier' if one.words else ''}"
    return (
        f'<tr class="{style}" data-order="{at}">'
        f'<td class="mark" title="{html.escape(row.headline)}" data-v="{_RANK[row.verdict]}"></td>'
        f'<td><a href="{quote(row.report)}">{html.escape(name)}</a></td>'
        f"<td>{html.escape(said)}</td>{cells}</tr>"
    )


_RANK = {"bad": 0, "degraded": 1, "good": 2}


def _cell(value: float | None, form: str) -> str:
    if value is None:
        return '<td class="number"></td>'
    text = format(value, form).rstrip("%")
    return f'<td class="number" data-v="{value!r}">{text}</td>'


def _reasons(name: str, title: str, note: str, outcomes: Sequence[Outcome]) -> str:
    if not outcomes:
        return ""
    lines = "".join(
        f"<tr><td>{html.escape(o.log)}</td><td>{html.escape(o.reason)}</td></tr>"
        for o in sorted(outcomes, key=lambda o: o.log)
    )
    return (
        f'<section id="{name}"><h2>{title}</h2><p>{note}</p>'
        f'<div class="scroll"><table><tbody>{lines}</tbody></table></div></section>'
    )


def _spread(found: Sequence[Found]) -> str:
    """A strip for each figure: a dot a flight on a logarithmic axis."""
    strips = "".join(_strip(figure, [one.row for one in found]) for figure in FIGURES)
    if not strips:
        return ""
    return (
        '<section id="spread"><h2>The batch</h2><p>A dot a flight, logarithmic, the median as a '
        f"line; hollow: against the autopilot's estimate.</p>{strips}</section>"
    )


_WIDTH, _MARGIN = 700.0, 10.0


def _strip(figure: Figure, rows: Sequence[Row]) -> str:
    """One figure's strip; nothing where hardly anything is known, or all is the same."""
    known = [(float(v), row) for row in rows if (v := getattr(row, figure.name)) is not None]
    if len(known) < 3:
        return ""
    logs = np.log10(np.array([value for value, _ in known]) + figure.floor)
    low, high = float(logs.min()), float(logs.max())
    if high - low < 1e-9:
        return ""

    def x(log: float) -> float:
        return _MARGIN + (log - low) / (high - low) * (_WIDTH - 2 * _MARGIN)

    ticks = "".join(
        f'<line class="tick" x1="{x(at):.1f}" x2="{x(at):.1f}" y1="26" y2="30"/>'
        f'<text x="{x(at):.1f}" y="42">{value:g}</text>'
        for value, at in _ticks(low, high, figure.floor)
    )
    dots = "".join(
        f'<a href="{quote(row.report)}"><circle class="{row.verdict}'
        f'{" hollow" if row.reference == "autopilot" else ""}" cx="{x(float(log)):.1f}" '
        f'cy="{8 + 11 * (at % 3) / 2:.1f}" r="4">'
        f"<title>{html.escape(row.report)}: {value:.3g} {figure.unit}</title></circle></a>"
        for at, (log, (value, row)) in enumerate(zip(logs, known, strict=True))
    )
    middle = x(float(np.median(logs)))
    unit = f" {figure.unit}" if figure.unit else ""
    return (
        f'<div class="strip"><span>{html.escape(figure.words)}{html.escape(unit)}</span>'
        f'<svg viewBox="0 0 {_WIDTH:g} 46"><line class="axis" x1="0" x2="{_WIDTH:g}" y1="26" '
        f'y2="26"/><line class="median" x1="{middle:.1f}" x2="{middle:.1f}" y1="0" y2="26"/>'
        f"{ticks}{dots}</svg></div>"
    )


def _ticks(low: float, high: float, floor: float) -> list[tuple[float, float]]:
    """Round values in the range and where they stand; 0 too, where the axis begins with it."""
    found: list[tuple[float, float]] = []
    if low <= math.log10(floor) + 1e-9:
        found.append((0.0, math.log10(floor)))
    for decade in range(-3, 7):
        for first in (1, 3) if high - low < 3 else (1,):
            value = first * 10.0**decade
            at = math.log10(value + floor)
            if low <= at <= high and (not found or at - found[-1][1] > 0.07 * (high - low)):
                found.append((value, at))
    return found


_FAILED = (
    "Their process died, took too long, or met an error of ours. The next run tries them again."
)
_REFUSED = "What a filter cannot be run on. The next run takes that for done."

_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Batch</title>
<link rel="icon" href="data:,">
<style>{style}</style></head>
<body><main class="batch">
<h1>Batch</h1>
<dl class="counts">{counts}</dl>
<ul class="notes">{words}</ul>
{failed}
{rows}
{spread}
{refused}
<footer>companion {version}</footer>
</main>
<script>{script}</script>
</body></html>
"""
