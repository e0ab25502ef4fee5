"""The track over the ground, on a plane of north and east metres about the start."""

from __future__ import annotations

from typing import Any

import numpy as np

from companion.navigation.earth import ned_difference
from companion.types import F64, NS, Channel
from replay.report.run_view import STOPPED, RunView
from replay.report.series import pack, thin_track


def track(run: RunView) -> dict[str, Any] | None:
    """Every track that there is, fixes, refused fixes and where GNSS was away; None: no solution.

    ``tracks``: ``{"of", "t", "n", "e"}`` with packed columns; ``refused``: the same of fixes whose
    position was not used; ``origin``: latitude and longitude in degrees.
    """
    aligned = run.aligned()
    if not len(aligned):
        return None
    origin = float(aligned.lat[0]), float(aligned.lon[0])
    tracks = []
    for of, samples in (
        ("truth", run.vehicle.truth),
        ("autopilot", run.vehicle.autopilot),
        ("forward", aligned),
        ("smoothed", run.smoothed),
    ):
        if samples is None:
            continue
        t = samples.t_ns
        # A simulator's truth may go on behind the recording: what nobody flew is no track.
        flown = np.flatnonzero((t >= run.vehicle.imu[0].t_ns[0]) & (t <= aligned.t_ns[-1]))
        if len(flown):
            tracks.append(
                _columns(run, of, t[flown], samples.lat[flown], samples.lon[flown], origin)
            )
    fixes, refused = _fixes(run, origin)
    return {
        "origin": [float(np.degrees(x)) for x in origin],
        "tracks": tracks,
        "fixes": fixes,
        "refused": refused,
    }


def _columns(
    run: RunView, of: str, t_ns: Any, lat: F64, lon: F64, origin: tuple[float, float]
) -> dict[str, Any]:
    lat0, lon0 = (np.full(len(lat), x) for x in origin)
    zero = np.zeros(len(lat))
    ned = ned_difference(lat, lon, zero, lat0, lon0, zero)
    kept = thin_track(ned[:, 0], ned[:, 1])
    return {
        "of": of,
        "t": pack((t_ns[kept] - run.origin_ns) / NS),
        "n": pack(ned[kept, 0]),
        "e": pack(ned[kept, 1]),
    }


def _fixes(
    run: RunView, origin: tuple[float, float]
) -> tuple[dict[str, Any] | None, dict[str, Any] | None]:
    """Fixes of the first receiver, and those among them whose position was refused."""
    if not run.vehicle.gnss:
        return None, None
    gnss = run.vehicle.gnss[0]
    fixed = np.isfinite(gnss.lat) & (gnss.fix_type >= run.config.gnss.min_fix_type)
    fixes = gnss.take(np.flatnonzero(fixed))
    if not len(fixes):
        return None, None
    reports = run.reports
    stopped = (reports.channel == Channel.GNSS_POSITION_H) & np.isin(reports.verdict, STOPPED)
    # A report carries the time of validity; the fix was stamped later by its latency.
    latency = round(run.config.gnss.latency_ms * 1e6)
    away = np.isin(fixes.t_ns - latency, reports.t_ns[stopped])
    refused = fixes.take(np.flatnonzero(away))
    return (
        _columns(run, "gnss", fixes.t_ns, fixes.lat, fixes.lon, origin),
        _columns(run, "refused", refused.t_ns, refused.lat, refused.lon, origin)
        if len(refused)
        else None,
    )
