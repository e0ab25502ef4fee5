"""Solutions for maps: KML with times and outages in another colour, GPX, GeoJSON.

A track is cut into stretches where GNSS was there and where it was not, and where the solution
itself has a gap; stretches touch, so that the drawn line has no holes. Heights go out as they
are, in the recording's datum: none of these formats can say which it is, so the description does.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal
from xml.sax.saxutils import escape, quoteattr

import numpy as np

from companion import __version__
from companion.types import NS, CompanionError, Mode, Solution
from replay.evaluation import Outage
from replay.summary import EARLIEST_DATE_NS

MapFormat = Literal["kml", "gpx", "geojson"]
GAP_S = 2.0
"""A solution silent for longer is not joined by a line."""
# KML colours are alpha, blue, green, red.
_STYLES = {"aided": "ffc06515", "outage": "ff4370ff"}


@dataclass(frozen=True, slots=True)
class Stretch:
    """Consecutive epochs of one kind."""

    kind: Literal["aided", "outage"]
    solution: Solution

    @property
    def points(self) -> list[tuple[float, float, float]]:
        """Longitude and latitude [deg], height [m]."""
        s = self.solution
        lon = np.degrees(np.remainder(s.lon + np.pi, 2 * np.pi) - np.pi)
        columns = np.column_stack([lon.round(8), np.degrees(s.lat).round(8), s.height.round(3)])
        return [(float(x), float(y), float(z)) for x, y, z in columns]

    @property
    def times(self) -> list[str] | None:
        """UTC in ISO 8601 with milliseconds; None for a clock that does not know the date."""
        t = self.solution.t_ns
        if not len(t) or t[0] < EARLIEST_DATE_NS:
            return None
        return [
            datetime.fromtimestamp(int(x) / NS, UTC).isoformat(timespec="milliseconds")[:-6] + "Z"
            for x in t
        ]


def write_map(
    solution: Solution,
    path: Path,
    file_format: MapFormat,
    *,
    name: str,
    height_datum: str,
    outages: Sequence[Outage] = (),
    rate_hz: float | None = None,
) -> int:
    """Write the epochs that have a solution, at most ``rate_hz`` of them a second; how many.

    Raises :class:`~companion.types.CompanionError` when there are none, or the file cannot be
    written.
    """
    kept = thin(solution, rate_hz)
    if not len(kept):
        raise CompanionError("there is no solution to draw: alignment never finished")
    about = f"companion {__version__}; heights above {_DATUM[height_datum]}"
    text = _WRITERS[file_format](name, about, list(stretches(kept, outages)))
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CompanionError(f"{path}: {error.strerror or error}") from None
    return len(kept)


_DATUM = {"hae": "the WGS-84 ellipsoid", "msl": "mean sea level"}


def thin(solution: Solution, rate_hz: float | None) -> Solution:
    """Epochs with a position, the first of each interval of 1/rate; all for None."""
    index = np.flatnonzero((solution.mode != Mode.ALIGNING) & np.isfinite(solution.lat))
    if rate_hz is not None and len(index):
        since = solution.t_ns[index] - solution.t_ns[index[0]]
        cell = np.floor(since * (rate_hz / NS) + 1e-6)
        index = index[np.concatenate([[True], np.diff(cell) > 0])]
    return solution.take(index)


def stretches(solution: Solution, outages: Sequence[Outage]) -> Iterator[Stretch]:
    """Cut at the ends of outages and in gaps, and at the date line where a map would cross it."""
    t = solution.t_ns
    away = np.zeros(len(t), bool)
    for outage in outages:
        away |= (t >= outage.start_ns) & (t < outage.end_ns)
    apart = np.diff(t) > GAP_S * NS
    apart |= np.abs(np.diff(np.remainder(solution.lon + np.pi, 2 * np.pi))) > np.pi
    changes = np.diff(away) | apart
    begin = 0
    for end in (*(np.flatnonzero(changes) + 1), len(t)):
        joined = end < len(t) and not apart[end - 1]
        yield Stretch(
            "outage" if away[begin] else "aided", solution.take(slice(begin, end + int(joined)))
        )
        begin = end


def _kml(name: str, about: str, parts: Sequence[Stretch]) -> str:
    styles = "".join(
        f'<Style id="{kind}"><IconStyle><scale>0.5</scale></IconStyle>'
        f"<LineStyle><color>{colour}</color><width>3</width></LineStyle></Style>\n"
        for kind, colour in _STYLES.items()
    )
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        '<kml xmlns="http://www.opengis.net/kml/2.2" '
        'xmlns:gx="http://www.google.com/kml/ext/2.2">\n'
        f"<Document><name>{escape(name)}</name><description>{escape(about)}</description>\n"
        + styles
        + "".join(_placemark(i, part) for i, part in enumerate(parts, 1))
        + "</Document></kml>\n"
    )


def _placemark(number: int, part: Stretch) -> str:
    label = f"{number}: {'without GNSS' if part.kind == 'outage' else 'aided'}"
    head = f"<Placemark><name>{label}</name><styleUrl>#{part.kind}</styleUrl>"
    mode = "<altitudeMode>absolute</altitudeMode>"
    times = part.times
    if times is None:
        line = " ".join(f"{x},{y},{z}" for x, y, z in part.points)
        body = f"<LineString>{mode}<coordinates>{line}</coordinates></LineString>"
    else:
        when = "".join(f"<when>{t}</when>" for t in times)
        where = "".join(f"<gx:coord>{x} {y} {z}</gx:coord>" for x, y, z in part.points)
        body = f"<gx:Track>{mode}\n{when}\n{where}</gx:Track>"
    return f"{head}{body}</Placemark>\n"


def _gpx(name: str, about: str, parts: Sequence[Stretch]) -> str:
    segments = []
    for part in parts:
        times = part.times
        points = "".join(
            f'<trkpt lat="{y}" lon="{x}"><ele>{z}</ele>'
            + (f"<time>{times[i]}</time>" if times else "")
            + "</trkpt>\n"
            for i, (x, y, z) in enumerate(part.points)
        )
        segments.append(f"<trkseg>\n{points}</trkseg>\n")
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<gpx version="1.1" creator={quoteattr("companion " + __version__)} '
        'xmlns="http://www.topografix.com/GPX/1/1">\n'
        f"<metadata><name>{escape(name)}</name><desc>{escape(about)}</desc></metadata>\n"
        f"<trk><name>{escape(name)}</name>\n{''.join(segments)}</trk></gpx>\n"
    )


def _geojson(name: str, about: str, parts: Sequence[Stretch]) -> str:
    features = [_feature(part) for part in parts if len(part.solution) > 1]
    whole = {"type": "FeatureCollection", "name": name, "description": about, "features": features}
    return json.dumps(whole, allow_nan=False) + "\n"


def _feature(part: Stretch) -> dict[str, Any]:
    times = part.times
    return {
        "type": "Feature",
        "geometry": {"type": "LineString", "coordinates": part.points},
        "properties": {
            "kind": part.kind,
            "begin": times[0] if times else None,
            "end": times[-1] if times else None,
            "seconds": (int(part.solution.t_ns[-1]) - int(part.solution.t_ns[0])) / NS,
        },
    }


_WRITERS = {"kml": _kml, "gpx": _gpx, "geojson": _geojson}
