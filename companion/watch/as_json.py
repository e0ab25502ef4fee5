"""A vehicle's picture as one JSON object."""

from __future__ import annotations

import math
from typing import Any

import msgspec

from companion.types import NO_DOP, NS
from companion.watch.alarms import alarms
from companion.watch.picture import SENSOR_KINDS, VehiclePicture


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
                latest=gate.last.name.lower() if gate.last is not None else None,
                sensor=SENSOR_KINDS.get(channel),
                age_s=(now_ns - gate.last_ns) / NS,
                overdue=channel in SENSOR_KINDS and gate.overdue(now_ns),
            )
            for channel, gate in sorted(v.gates.items())
        },
        "adaptation": {
            channel.name.lower(): {
                "r_scale": adapted.r_scale,
                "q_scale": adapted.q_scale,
                "alpha": adapted.alpha,
                "because": adapted.because,
                "age_s": (now_ns - adapted.last_ns) / NS,
            }
            for channel, adapted in sorted(v.adaptation.items())
        },
        "satellites": _satellites(v, now_ns) if v.satellites is not None else None,
        "alarms": alarms(v, now_ns),
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


def _satellites(v: VehiclePicture, now_ns: int) -> dict[str, Any]:
    sky = v.satellites
    dops = {name: getattr(sky, name) for name in ("gdop", "pdop", "hdop", "vdop", "tdop")}
    return {
        "used": sky.used,
        "excluded": sky.excluded,
        **{name: dop if dop < NO_DOP else None for name, dop in dops.items()},
        "age_s": (now_ns - v.satellites_ns) / NS,
    }
