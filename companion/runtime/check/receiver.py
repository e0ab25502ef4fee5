"""A satellite receiver's own line during a check: what comes, and what to say of it. Pure."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator

import numpy as np

from companion.config import Config, RawGnss
from companion.gnss.gps_time import GPS_EPOCH_POSIX_S, WEEK_S, leap_seconds
from companion.gnss.systems import LETTERS, SYSTEM_NAMES, satellite_name
from companion.runtime.check.heard import Finding, ReceiverHeard
from companion.types import NS, BroadcastSamples, GnssSamples, RawGnssSamples
from drivers.receiver_session import receiver_session
from drivers.rtcm.framer import Framer as RtcmFramer
from drivers.ublox.framer import Framer as UbxFramer

PROTOCOLS = {"ublox": "UBX", "rtcm3": "RTCM 3"}
_OF_A_BASE = {"1005", "1006"}
_FEW = 4
_BROKEN_SHARE = 0.01
_ANOTHER_TIME_S = 2.0
"""Further off than a line is late and a computer without a network drifts in a day."""


class ReceiverTally:
    """Collects what a receiver's line says, whether it is what was configured or not."""

    def __init__(self, config: RawGnss) -> None:
        self._config = config
        self._session = receiver_session(config.protocol)
        self._ubx, self._rtcm = UbxFramer(), RtcmFramer()
        self._bytes = 0
        self._nmea = 0
        self._kinds: Counter[str] = Counter()
        self._epochs: list[RawGnssSamples] = []
        self._ephemerides: set[int] = set()

    def feed(self, seq: int, t_rx_ns: int, data: bytes) -> list[GnssSamples]:
        """Bytes as they arrived; the receiver's own fixes among them."""
        self._bytes += len(data)
        self._nmea += data.count(b"$G")
        for frame in self._ubx.feed(data):
            self._kinds[f"UBX {frame.kind >> 8:02X}-{frame.kind & 255:02X}"] += 1
        for payload in self._rtcm.feed(data):
            if len(payload) > 1:
                self._kinds[f"{payload[0] << 4 | payload[1] >> 4}"] += 1
        fixes = []
        for samples in self._session.feed(seq, t_rx_ns, data):
            if isinstance(samples, RawGnssSamples):
                self._epochs.append(samples)
            elif isinstance(samples, BroadcastSamples):
                self._ephemerides |= set(samples.sat.tolist()) - {0}
            else:
                fixes.append(samples)
        return fixes

    def heard(self, refused: str) -> ReceiverHeard:
        """All of it."""
        config, counters = self._config, self._session.counters
        heard = {"ublox": self._ubx.frames, "rtcm3": self._rtcm.frames}
        t = np.array([int(e.t_rx_ns[0]) for e in self._epochs])
        rate = float((len(t) - 1) * NS / (t[-1] - t[0])) if len(t) > 1 and t[-1] > t[0] else 0.0
        seen = [e.sat[0] > 0 for e in self._epochs]
        sats = sorted(
            {int(s) for e, k in zip(self._epochs, seen, strict=True) for s in e.sat[0, k]}
        )
        cn0 = [c for e, k in zip(self._epochs, seen, strict=True) for c in e.cn0[0, k] if c == c]
        doppler = any(np.isfinite(e.rate).any() for e in self._epochs)
        last = self._epochs[-1].sat[0] if self._epochs else np.zeros(0, np.int64)
        return ReceiverHeard(
            name=config.endpoint,
            protocol=config.protocol,
            refused=refused,
            bytes=self._bytes,
            frames=counters["frames"],
            malformed=counters["malformed"],
            other_protocol={k: n for k, n in heard.items() if k != config.protocol},
            nmea=self._nmea,
            kinds=dict(sorted(self._kinds.items())),
            epochs=len(self._epochs),
            rate_hz=rate,
            satellites={
                name: int((last // 100 - 1 == k).sum())
                for k, name in enumerate(SYSTEM_NAMES)
                if any(s // 100 - 1 == k for s in sats)
            },
            cn0_dbhz=float(np.median(cn0)) if cn0 else float("nan"),
            doppler=doppler,
            ephemerides=tuple(satellite_name(s) for s in sorted(self._ephemerides)),
            ahead_s=float(np.median([_ahead_s(e) for e in self._epochs])) if len(t) else math.nan,
        )


def _ahead_s(epoch: RawGnssSamples) -> float:
    """A receiver's time − that of the computer at the epoch's arrival, UTC both [s]."""
    gps_s = float(epoch.week[0]) * WEEK_S + float(epoch.tow[0])
    return gps_s - leap_seconds(gps_s) + GPS_EPOCH_POSIX_S - float(epoch.t_rx_ns[0]) / NS


def _span(seconds: float) -> str:
    weeks = seconds / WEEK_S
    return f"{weeks:.0f} weeks" if weeks > 1.0 else f"{seconds:.1f} s"


def receiver_findings(config: Config, heard: ReceiverHeard, seconds: float) -> Iterator[Finding]:
    """What is well with the line and what is not, and what to do about it."""
    part, speaks = heard.name, PROTOCOLS[heard.protocol]
    if heard.refused:
        advice = "does the device exist, and may this user open it (group dialout)?"
        if not part.startswith("/"):
            advice = "raw_gnss.endpoint: address and port"
        yield Finding("error", part, heard.refused, advice)
    elif not heard.bytes:
        advice = "raw_gnss.baud, TX and RX crossed, the receiver's output on this port"
        yield Finding("error", part, "nothing came", advice)
    elif not heard.frames:
        yield Finding("error", part, f"{heard.bytes} bytes, none of them {speaks}", _other(heard))
    elif not heard.epochs:
        kinds = ", ".join(heard.kinds)
        text = f"{heard.frames} messages of {speaks}, no raw measurements; heard are {kinds}"
        yield Finding("error", part, text, _wanted(heard.protocol))
    else:
        yield from _measurements(config, heard, seconds)


def _other(heard: ReceiverHeard) -> str:
    for protocol, frames in heard.other_protocol.items():
        if frames:
            return f"{frames} are {PROTOCOLS[protocol]}: raw_gnss.protocol = '{protocol}'"
    if heard.nmea:
        return f"NMEA comes, which has no ranges: {_wanted(heard.protocol)}"
    return f"raw_gnss.baud, and {_wanted(heard.protocol)}"


def _wanted(protocol: str) -> str:
    if protocol == "ublox":
        return "switch on UBX-RXM-RAWX and UBX-RXM-SFRBX on this port"
    return "switch on MSM5 or MSM7 (1075 or 1077, 1095, 1125) and 1019, 1042, 1046"


def _measurements(config: Config, heard: ReceiverHeard, seconds: float) -> Iterator[Finding]:
    part = heard.name
    sats = " ".join(f"{LETTERS[SYSTEM_NAMES.index(n)]}{k}" for n, k in heard.satellites.items())
    text = f"raw GNSS at {heard.rate_hz:.1f} Hz, satellites {sats}, {heard.cn0_dbhz:.0f} dB-Hz"
    yield Finding("ok", part, f"{text}, {len(heard.ephemerides)} ephemerides")
    if abs(heard.ahead_s) > _ANOTHER_TIME_S:
        text = f"its time is {_span(abs(heard.ahead_s))} "
        text += f"{'ahead of' if heard.ahead_s > 0 else 'behind'} this computer's"
        advice = "the computer's clock, or a receiver that lost weeks or leap seconds: it finds no "
        yield Finding("warning", part, text, advice + "ephemeris that fits")
    if sum(heard.satellites.values()) < _FEW:
        yield Finding("warning", part, f"satellites {sats or 'none'}", "open sky, antenna")
    if heard.protocol == "rtcm3" and _OF_A_BASE & heard.kinds.keys():
        text = "a station's coordinates come (1005, 1006): a base's corrections?"
        yield Finding("warning", part, text, "ranges must be those of the vehicle's own receiver")
    if not heard.doppler:
        advice = "MSM5 or MSM7 instead of MSM4 or MSM6" if heard.protocol == "rtcm3" else ""
        yield Finding("warning", part, "no Doppler: no velocity from it", advice)
    if not heard.ephemerides:
        wait = "a satellite sends its own every 30 s (--for 40)"
        if heard.protocol == "rtcm3":
            wait = "1019, 1042, 1045 or 1046 switched on? Some send them every minute only"
        yield Finding("warning", part, f"no ephemeris in {seconds:g} s", wait)
    if heard.malformed > _BROKEN_SHARE * (heard.frames + heard.malformed):
        text = f"{heard.malformed} broken messages beside {heard.frames}"
        yield Finding("warning", part, text, "a baud rate that carries it all, wiring")
    if config.raw_gnss.coupling == "off":
        advice = "raw_gnss.coupling = 'tight' or 'loose'"
        yield Finding("warning", part, "is logged and not used", advice)
