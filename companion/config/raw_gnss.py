"""Configuration of raw GNSS: what ranges are worth, which satellites are used, receiver's clock."""

from __future__ import annotations

from typing import Literal

from companion.config.ranges import mavlink_endpoint, positive, within
from companion.config.section import Section
from companion.types import ConfigError


class RawGnss(Section):
    """Pseudoranges and Doppler. The lever arm is the antenna's, ``gnss.lever_arm_b_m``."""

    coupling: Literal["off", "loose", "tight"] = "off"
    """``tight``: the filter takes each range, so that fewer than four satellites still aid;
    ``loose``: it takes the least-squares position and velocity of each epoch; ``off``: neither."""
    source: str = "auto"
    """Stream name of the receiver, or ``auto`` for the first one."""
    endpoint: str = ""
    """Live: what the receiver sends, from a serial device or ``tcp:HOST:PORT``; empty: none."""
    protocol: Literal["ublox", "rtcm3"] = "ublox"
    """Of that line: u-blox UBX (RXM-RAWX, RXM-SFRBX, NAV-PVT), or RTCM 3 (MSM4 to MSM7 of GPS,
    Galileo and BeiDou, ephemerides 1019, 1042, 1045, 1046)."""
    baud: int = 115_200
    """Of a serial device."""
    clock: Literal["utc", "gps"] = "utc"
    """Of a sensor folder's stamps: POSIX nanoseconds in UTC, or in GPS time (18 s ahead)."""
    latency_ms: float = 0.0
    """Stamp − validity of an epoch; live, the shortest time from measurement to arrival."""
    systems: tuple[Literal["gps", "galileo", "beidou"], ...] = ("gps", "galileo", "beidou")
    """Satellite systems that are used."""
    sd_range_m: float = 1.0
    """Pseudorange at the zenith with a strong signal, 1σ; grows with 1/sin of the elevation and as
    the signal weakens. A larger deviation that the receiver itself reports is believed."""
    sd_multipath_m: float = 0.5
    """The slow part of its error beside that, likewise at the zenith, 1σ: reflections that last."""
    multipath_tau_s: float = 5.0
    """How long: seconds for a vehicle that moves, minutes for one that stands."""
    sd_rate_mps: float = 0.05
    """Range rate (Doppler) with a strong signal, 1σ."""
    strong_cn0_dbhz: float = 45.0
    """Below it variances grow tenfold every 10 dB."""
    iono_residual: float = 0.3
    """Part of the modelled ionospheric delay that is left as error, 1σ (the model takes off about
    half of the delay, RMS)."""
    elevation_mask_deg: float = 10.0
    """Lower satellites are left out."""
    choice: Literal["all", "best"] = "all"
    """``best``: only the ``best_of`` satellites with the smallest GDOP, over all combinations."""
    best_of: int = 4
    """How many, with ``choice = "best"``."""
    best_margin: float = 0.1
    """A set is kept until another's GDOP is smaller by more than this part of it."""
    exclude: bool = True
    """Leave out satellites whose range contradicts the others, epoch by epoch."""
    clock_noise: Literal["learned", "configured"] = "learned"
    """Noise of the receiver's clock: ``learned`` from each epoch's own clock once half a minute of
    it was seen, from 0.01 to 10 times what is configured; or as ``configured`` throughout."""
    clock_walk_m_rts: float = 0.1
    """Receiver clock: random walk of its bias [m/√s]."""
    clock_drift_walk_mps_rts: float = 0.2
    """And of its drift [m/s/√s]."""
    clock_ramp_mps2: float = 0.2
    """Change of its drift as its quartz warms up or cools, 1σ [m/s²]: 0.03 ppm/°C and 1 °C a minute
    make 0.15 m/s²; with an oven, 0.01 or less."""
    clock_ramp_tau_s: float = 200.0
    """How long a change of temperature lasts."""
    system_bias_sd_m: float = 100.0
    """Bias of Galileo and BeiDou against GPS in the receiver, 1σ at the start."""
    system_bias_walk_m_rts: float = 0.01
    """Random walk of that bias [m/√s]."""


def check_raw_gnss(raw: RawGnss) -> None:
    """Raise :class:`ConfigError` for values that cannot be."""
    for name, unit in (
        ("sd_range_m", "metres"), ("sd_rate_mps", "m/s"), ("clock_walk_m_rts", "m/√s"),
        ("clock_drift_walk_mps_rts", "m/s/√s"), ("system_bias_sd_m", "metres"),
        ("system_bias_walk_m_rts", "m/√s"), ("clock_ramp_mps2", "m/s²"),
        ("clock_ramp_tau_s", "seconds"), ("multipath_tau_s", "seconds"),
    ):  # fmt: skip
        positive(f"raw_gnss.{name}", getattr(raw, name), unit)
    within("raw_gnss.sd_multipath_m", raw.sd_multipath_m, 0.0, 100.0, "metres")
    within("raw_gnss.latency_ms", raw.latency_ms, 0.0, 2000.0, "milliseconds")
    within("raw_gnss.strong_cn0_dbhz", raw.strong_cn0_dbhz, 20.0, 60.0, "dB-Hz")
    within("raw_gnss.iono_residual", raw.iono_residual, 0.0, 1.0, "a part")
    within("raw_gnss.elevation_mask_deg", raw.elevation_mask_deg, 0.0, 60.0, "degrees")
    within("raw_gnss.best_of", raw.best_of, 4, 12, "satellites")
    within("raw_gnss.best_margin", raw.best_margin, 0.0, 1.0, "a part")
    if raw.endpoint:
        mavlink_endpoint("raw_gnss.endpoint", raw.endpoint)
    within("raw_gnss.baud", raw.baud, 1200, 12_000_000, "bit/s")
    if not raw.systems:
        raise ConfigError("key 'raw_gnss.systems': at least one of 'gps', 'galileo', 'beidou'")
