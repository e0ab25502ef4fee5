"""A vehicle's picture as one JSON object."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from companion.watch.picture import VehiclePicture


def picture_json(v: VehiclePicture, now_ns: int) -> dict[str, Any]:
    """Plain types; degrees, metres, m/s; None for what is not known."""
    picture: dict[str, Any] = {
        "vehicle": v.name,
        "is": v.standing(now_ns),
        "state": _state(v) if v.state is not None else None,
        "state_rate_hz": v.rate_hz(now_ns),
        "state_age_s": v.age_s(now_ns),
        "latency_ms": v.latency_ms,
        "health": v.health,
        "gates": {
            channel.name.lower(): dict(
                zip(("accepted", "rejected", "refused"), gate.counts(now_ns), strict=True),
                nis_over_gate=gate.ratio,
            )
            for channel, gate in sorted(v.gates.items())
        },
        "events": list(v.events),
        "unreadable": v.broken,
    }
    plain: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(picture))
    return plain


def _state(v: VehiclePicture) -> dict[str, Any]:
    s = v.state
    return {
        "t_ns": s.t_ns,
        "mode": v.mode.name.lower() if v.mode is not None else None,
        "resets": s.resets,
        "lat_deg": math.degrees(s.lat),
        "lon_deg": math.degrees(s.lon),
        "height_m": s.height,
        "vel_n_mps": list(s.vel_n),
        "rpy_deg": [s.roll_deg, s.pitch_deg, s.yaw_deg],
        "sd_pos_m": list(s.sd_pos_m),
        "sd_vel_mps": list(s.sd_vel_mps),
        "sd_att_deg": list(s.sd_att_deg),
    }
