"""Judging what was heard: what is well, what is missing, and what to do about it. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterator

from companion.config import G0, CanBus, CanImu, Config
from companion.runtime.check.heard import (
    CanHeard,
    Finding,
    Heard,
    ImuHeard,
    MavlinkHeard,
    StreamHeard,
)
from companion.runtime.check.receiver import receiver_findings
from companion.types import GnssSamples

SLOW = 0.7
"""Below this share of what was asked for or configured, a rate is short."""
LEAST_IMU_HZ, GOOD_IMU_HZ = 20.0, 90.0
LOST_SHARE = 0.001
NOISE_FACTOR = 1.5
"""Measured noise above this much of the configured one deserves a word."""
REST_DPS, REST_MPS2 = 3.0, 0.6
"""A mean rate and a misfit of gravity above these: the vehicle moves, or a unit is wrong."""
_RAW_IMU = 1003


def findings(config: Config, heard: Heard) -> list[Finding]:
    """Everything worth saying, in the order of the data path."""
    out: list[Finding] = []
    for bus, bus_heard in zip(config.can, heard.buses, strict=True):
        out += _bus(bus, bus_heard, heard)
    if heard.mavlink is not None:
        out += _mavlink(config, heard.mavlink)
    if heard.receiver is not None:
        out += receiver_findings(config, heard.receiver, heard.seconds)
    out += _inertial(config, heard)
    out += _aiding(config, heard)
    for output in (heard.zenoh, heard.log):
        if output is not None and output.refused:
            out.append(Finding("error", output.name, output.refused, output.note))
        elif output is not None:
            out.append(Finding("ok", output.name, output.note))
    return out


# --------------------------------------------------------------------------- CAN


def _bus(bus: CanBus, heard: CanHeard, everything: Heard) -> Iterator[Finding]:
    if heard.refused:
        advice = (
            f"ip link set {bus.channel} up type can bitrate {bus.bitrate}"
            if bus.interface == "socketcan"
            else "is the adapter plugged in, and may this user open it (group dialout)?"
        )
        yield Finding("error", heard.name, heard.refused, advice)
        return
    if not heard.frames:
        text = f"no frame in {everything.seconds:g} s at {bus.bitrate} bit/s"
        advice = "bit rate, termination (60 Ω between CAN-H and CAN-L), power of the sensor"
        yield Finding("error", heard.name, text, advice)
        return
    rate = sum(heard.ids.values())
    text = f"{rate:.0f} frames/s with {len(heard.ids)} identifiers"
    yield Finding("ok", heard.name, text)
    if heard.malformed:
        text = f"{heard.malformed} malformed or error frames"
        yield Finding("warning", heard.name, text, "wiring, termination, bit rate of every node")
    names = {imu.source for imu in everything.imus}
    for unit in bus.imu:
        if unit.name not in names:
            yield _unit_missing(unit, heard)


def _unit_missing(unit: CanImu, heard: CanHeard) -> Finding:
    text = f"no sample decoded as {unit.protocol}"
    nodes = sorted({i & 0x7F for i, wide in heard.ids if wide and i >> 8 & 0xFFFF == _RAW_IMU})
    if unit.protocol == "dronecan" and nodes:
        found = ", ".join(str(node) for node in nodes)
        advice = f"RawIMU comes from node {found}: set node_id = {nodes[0]}"
    elif nodes:
        advice = f"node {nodes[0]} sends DroneCAN RawIMU: protocol = 'dronecan'?"
    else:
        shown = [f"{i:08X}" if wide else f"{i:03X}" for i, wide in sorted(heard.ids)]
        some = ", ".join(shown[:8]) + (", …" if len(shown) > 8 else "")
        advice = f"identifiers heard: {some}; switch on the unit's inertial messages"
    return Finding("error", unit.name, text, advice)


# --------------------------------------------------------------------------- inertial streams


def _inertial(config: Config, heard: Heard) -> Iterator[Finding]:
    own = {unit.name: unit for bus in config.can for unit in bus.imu}
    named = config.imu.source
    if named != "auto" and named not in {imu.source for imu in heard.imus}:
        have = ", ".join(imu.source for imu in heard.imus) or "none"
        text = f"inertial stream '{named}' is not there"
        yield Finding("error", "imu", text, f"imu.source: heard are {have}")
    elif not heard.imus:
        advice = "a [[can]] bus with a unit, or mavlink.imu and a rate of 50 Hz or more"
        yield Finding("error", "imu", "no inertial samples at all", advice)
    for imu in heard.imus:
        unit = own.get(imu.source)
        used = named == imu.source or (named == "auto" and (unit is not None or not own))
        yield from _imu(config, imu, unit, used)


def _imu(config: Config, imu: ImuHeard, unit: CanImu | None, used: bool) -> Iterator[Finding]:
    text = f"{imu.rate_hz:.1f} Hz"
    if math.isfinite(imu.gyro_noise_dps_rthz):
        text += f", noise {imu.gyro_noise_dps_rthz:.2g} deg/s/√Hz"
        text += f" and {imu.accel_noise_mps2_rthz:.2g} m/s²/√Hz"
    yield Finding("ok", imu.source, text)
    part = imu.source
    if used and imu.rate_hz < LEAST_IMU_HZ:
        text = f"{imu.rate_hz:.1f} Hz; a strapdown filter needs at least {LEAST_IMU_HZ:g}"
        yield Finding("error", part, text, "a faster link, a higher mavlink.imu_rate_hz")
    elif used and imu.rate_hz < GOOD_IMU_HZ:
        text = f"{imu.rate_hz:.0f} Hz is slow"
        yield Finding("warning", part, text, "100 Hz or more follow a multirotor's motion")
    if unit is not None and unit.rate_hz > 0 and imu.rate_hz < SLOW * unit.rate_hz:
        text = f"{imu.rate_hz:.0f} Hz of {unit.rate_hz:g} configured"
        yield Finding("warning", part, text, "can.imu.rate_hz, or the unit's output rate")
    if imu.lost + imu.malformed > LOST_SHARE * imu.samples:
        text = f"{imu.lost} samples lost, {imu.malformed} frames broken of {imu.samples} samples"
        yield Finding("warning", part, text, "bus load, wiring, the adapter's buffer")
    if imu.saturated:
        text = f"{imu.saturated} samples with an axis at the end of its range"
        yield Finding("warning", part, text, "full scale of the sensor, vibration damping")
    if used:
        yield from _rest(config, imu)


def _rest(config: Config, imu: ImuHeard) -> Iterator[Finding]:
    """At rest: is gravity where the axes say, and the noise what the filter is told?"""
    force = imu.accel_mean_mps2
    strength = math.hypot(*force)
    turning = max(abs(w) for w in imu.gyro_mean_dps) > REST_DPS
    shown = "({:.1f}, {:.1f}, {:.1f}) m/s²".format(*force)
    if abs(strength - G0) > REST_MPS2 and not turning:
        text = f"specific force {shown}, {strength:.2f} in all: not gravity's {G0:.2f}"
        yield Finding("warning", imu.source, text, "at rest: unit or scale of the accelerometer")
    elif force[2] > -0.5 * strength:
        text = f"specific force {shown}; level and at rest it is (0, 0, −9.8)"
        yield Finding("warning", imu.source, text, "imu.axes, unless the vehicle lies on its side")
    measured = (
        ("gyro_noise_dps_rthz", imu.gyro_noise_dps_rthz, config.imu.gyro_noise_dps_rthz),
        ("accel_noise_mps2_rthz", imu.accel_noise_mps2_rthz, config.imu.accel_noise_mps2_rthz),
    )
    for key, is_now, configured in measured:
        if is_now > NOISE_FACTOR * configured:
            text = f"noise {is_now:.2g}, configured {configured:.2g}"
            yield Finding("warning", imu.source, text, f"at rest: imu.{key} = {is_now:.2g} or more")


# --------------------------------------------------------------------------- MAVLink and aiding


def _mavlink(config: Config, heard: MavlinkHeard) -> Iterator[Finding]:
    if heard.refused:
        advice = "does the device exist, and may this user open it (group dialout)?"
        if not heard.name.startswith("/"):
            advice = "mavlink.endpoint: address and port"
        yield Finding("error", heard.name, heard.refused, advice)
        return
    if not heard.bytes:
        yield Finding("error", heard.name, "nothing came", _nothing_came(heard.name))
        return
    if heard.vehicle is None:
        yield _no_autopilot(config, heard)
        return
    kind = next((s.autopilot for s in heard.systems if s.autopilot), "autopilot")
    text = f"{kind}, system {heard.vehicle[0]}, component {heard.vehicle[1]}"
    if math.isfinite(heard.round_trip_ms):
        text += f"; clock by {heard.clock}, round trip {heard.round_trip_ms:.1f} ms"
    yield Finding("ok", heard.name, text)
    if heard.bad_bytes > 0.01 * heard.bytes:
        text = f"{heard.bad_bytes} of {heard.bytes} bytes belong to no frame"
        yield Finding("warning", heard.name, text, "baud rate, wiring, a console on the same line")
    if heard.unsigned:
        text = f"{heard.unsigned} frames refused: no valid signature"
        yield Finding("warning", heard.name, text, "the same key on both sides (signing_key_file)")
    for rate in heard.rates:
        if rate.needed and rate.heard_hz < SLOW * rate.asked_hz:
            said = "granted" if rate.granted else "not granted"
            text = f"{rate.message} at {rate.heard_hz:.1f} of {rate.asked_hz:g} Hz ({said})"
            advice = "the sensor may have no more; else the line's baud rate or the SR… parameters"
            yield Finding("warning", heard.name, text, advice)


def _nothing_came(name: str) -> str:
    if name.startswith("udpin:"):
        return "does the autopilot (or its router) send to this port?"
    if name.startswith(("udpout:", "tcp:")):
        return "is anybody listening there?"
    return "baud rate, TX and RX crossed, and SERIALn_PROTOCOL = 2 (PX4: MAV_1_CONFIG)"


def _no_autopilot(config: Config, heard: MavlinkHeard) -> Finding:
    if not heard.systems:
        text = f"{heard.bytes} bytes, none of them MAVLink that can be used"
        return Finding("error", heard.name, text, "baud rate; with a key: signing on both sides")
    senders = ", ".join(f"{s.system}/{s.component}" for s in heard.systems)
    wanted = f" of system {config.mavlink.system}" if config.mavlink.system else ""
    text = f"no heartbeat of an autopilot{wanted}; heard are {senders}"
    return Finding("error", heard.name, text, "mavlink.system = 0 takes the first that comes")


def _aiding(config: Config, heard: Heard) -> Iterator[Finding]:
    fixes = [s for s in heard.streams if s.kind == "gnss"]
    ranges = heard.receiver is not None and heard.receiver.epochs > 0
    if not fixes and not (ranges and config.raw_gnss.coupling != "off"):
        advice = "mavlink.gnss_rate_hz, a receiver on the autopilot"
        yield Finding("error", "gnss", "no GNSS messages", advice)
    for stream in fixes:
        yield _fix(stream)
    for kind, used in (("baro", config.baro.use), ("mag", config.mag.use)):
        found = [s for s in heard.streams if s.kind == kind]
        if used and not found:
            yield Finding("warning", kind, "configured and not heard", f"[{kind}] use = false?")
        for stream in found if used else []:
            yield Finding("ok", stream.source, f"{kind} at {stream.rate_hz:.1f} Hz")


def _fix(stream: StreamHeard) -> Finding:
    fix = stream.last
    assert isinstance(fix, GnssSamples)
    kind, sats = int(fix.fix_type[-1]), int(fix.num_sats[-1])
    if kind < 3:
        text = f"{stream.rate_hz:.1f} Hz, no 3-D fix (type {kind}, {sats} satellites)"
        return Finding("warning", stream.source, text, "open sky, antenna, a few minutes")
    sd = float(fix.sd_pos[-1, 0])
    says = f", says {sd:.1f} m" if math.isfinite(sd) else ""
    return Finding(
        "ok", stream.source, f"{stream.rate_hz:.1f} Hz, fix with {sats} satellites{says}"
    )
