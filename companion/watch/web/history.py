"""What a page draws over time and ground, with a limit on everything that is kept. Pure."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from typing import Any

from companion.outputs import payloads
from companion.types import NS
from companion.watch.picture import VehiclePicture

ROWS = 900
"""Three minutes at five rows a second."""
POINTS = 4000
SPACING_M = 0.1
"""Of a track's points, until there are too many."""
_RADIUS_M = 6_378_137.0
_ECCENTRICITY2 = 6.694_379_990_14e-3
LatLon = tuple[float, float]


def plane_m(place: LatLon, origin: LatLon) -> tuple[float, float]:
    """North and east [m] of ``place`` from ``origin``, both latitude and longitude [rad].

    Radii of curvature of WGS 84 halfway: for pictures, within 1e-4 of the distance up to 100 km.
    """
    sin_mid = math.sin(0.5 * (place[0] + origin[0]))
    w2 = 1.0 - _ECCENTRICITY2 * sin_mid**2
    prime = _RADIUS_M / math.sqrt(w2)
    meridian = prime * (1.0 - _ECCENTRICITY2) / w2
    east = math.remainder(place[1] - origin[1], 2.0 * math.pi)
    return meridian * (place[0] - origin[0]), prime * math.sqrt(1.0 - sin_mid**2) * east


class Track:
    """Where a vehicle was: every point while there is room, then every other, and so on."""

    def __init__(self) -> None:
        self.generation = 0
        """Counts the thinnings: earlier indices then mean nothing."""
        self.points: list[tuple[float, float, float, int]] = []
        """(time [s], north [m], east [m], mode)."""
        self._spacing_m = SPACING_M

    def add(self, t_s: float, north: float, east: float, mode: int) -> None:
        """Note a place; one too near to the last is left out, unless the mode is another."""
        if self.points:
            _, n, e, before = self.points[-1]
            if before == mode and math.hypot(north - n, east - e) < self._spacing_m:
                return
        self.points.append((round(t_s, 2), round(north, 2), round(east, 2), mode))
        if len(self.points) > POINTS:
            self.points = self.points[::2]
            length = sum(math.dist(a[1:3], b[1:3]) for a, b in pairwise(self.points))
            # New points as far apart as those that are left, however fast it goes.
            self._spacing_m = max(2.0 * self._spacing_m, length / len(self.points))
            self.generation += 1


class History:
    """One vehicle's track, and a row of numbers for each tick."""

    def __init__(self) -> None:
        self.track = Track()
        self.rows: deque[tuple[int, dict[str, float]]] = deque(maxlen=ROWS)
        """(number of the tick, values by name)."""
        self._latencies: list[float] = []

    def note(self, name: str, v: VehiclePicture, origin: LatLon | None, now_s: float) -> None:
        """Take what the message ``name``, which ``v`` has just read, adds to the pictures."""
        if name == payloads.STATE and v.state is not None:
            s = v.state
            if not math.isnan(v.latency_ms):
                self._latencies.append(v.latency_ms)
            if origin is not None and v.mode is not None and v.mode > 0:
                self.track.add(now_s, *plane_m((s.lat, s.lon), origin), int(v.mode))

    def tick(self, number: int, v: VehiclePicture, now_ns: int) -> None:
        """Close a row; what did not come since the last one is not in it.

        Of latencies and of innovations over their gates, the largest since then.
        """
        row = {"rate": v.rate_hz(now_ns)}
        for channel, gate in v.gates.items():
            if (peak := gate.take_peak()) is not None:
                row[f"gate.{channel.name.lower()}"] = peak
        if self._latencies:
            row["latency"] = max(self._latencies)
            self._latencies.clear()
        if v.state is not None and v.age_s(now_ns) < 1.0:
            row |= _numbers(v.state)
        for channel, adapted in v.adaptation.items():
            if now_ns - adapted.last_ns < 3 * NS:
                row[f"r.{channel.name.lower()}"] = adapted.r_scale
                if math.isfinite(adapted.q_scale):
                    row["q"] = adapted.q_scale
        self.rows.append((number, {k: _short(x) for k, x in row.items() if math.isfinite(x)}))


def _numbers(s: Any) -> dict[str, float]:
    return {
        "height": s.height,
        "speed": math.hypot(s.vel_n[0], s.vel_n[1]),
        "climb": -s.vel_n[2],
        "sd_h": math.hypot(s.sd_pos_m[0], s.sd_pos_m[1]),
        "sd_v": s.sd_pos_m[2],
        "roll": s.roll_deg,
        "pitch": s.pitch_deg,
        "yaw": s.yaw_deg,
    }


def _short(x: float) -> float:
    """Six figures: what a picture can show, in half of the bytes."""
    return float(f"{x:.6g}")
