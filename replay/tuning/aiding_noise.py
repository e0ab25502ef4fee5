"""Noise of GNSS and barometer from the innovations of a flight, by matching covariances.

The filter says of every innovation what variance it expects: S = H P Hᵀ + R. What is left of the
measured variance without H P Hᵀ is the sensor's own: R̂ = ⟨y²⟩ − ⟨S − R⟩ (Mehra 1970, in the form
of Mohamed and Schwarz 1999). ⟨y²⟩ is taken from the median, so that outliers do not count. With
another R comes another P: a few rounds settle it. An error that stays for minutes (multipath, a
slow receiver) is in the solution and not in the innovations: it cannot be found this way.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np

from companion.config import Config
from companion.types import AidingReports, Channel, VehicleRecording, Verdict
from replay.configuration import ChosenConfig
from replay.session import run_session
from replay.tuning.parameter import Parameter

ROUNDS = 4
MINIMUM_UPDATES = 60
_MEDIAN_OF_CHI2 = 0.4549364
"""Median of the square of a standard normal variable."""
_KEYS: tuple[tuple[Channel, str, str], ...] = (
    (Channel.GNSS_POSITION_H, "gnss", "sd_position_m"),
    (Channel.GNSS_POSITION_V, "gnss", "sd_height_m"),
    (Channel.GNSS_VELOCITY_H, "gnss", "sd_velocity_mps"),
    (Channel.GNSS_VELOCITY_V, "gnss", "sd_velocity_down_mps"),
    (Channel.BARO, "baro", "sd_m"),
)


def aiding_parameters(vehicle: VehicleRecording, config: Config) -> Iterator[Parameter]:
    """What the flight says of the ``[gnss]`` and ``[baro]`` deviations."""
    tuned = _with(config, "gnss", sd_reported="ignore")
    reports = AidingReports.empty()
    for _ in range(ROUNDS):
        reports = run_session(vehicle, ChosenConfig(tuned, "tuning", "")).reports
        for channel, section, key in _KEYS:
            sd = _own_sd(reports, channel, getattr(getattr(tuned, section), key))
            if sd is not None:
                tuned = _with(tuned, section, **{key: sd})
    for channel, section, key in _KEYS:
        before = float(getattr(getattr(config, section), key))
        count = int(np.count_nonzero(_used(reports, channel)))
        if not count:
            continue
        if count < MINIMUM_UPDATES:
            yield Parameter(section, key, before, None, f"only {count} updates")
            continue
        after = float(getattr(getattr(tuned, section), key))
        reason = f"innovations of {count} updates"
        yield Parameter(section, key, before, after, reason + _slow(reports, channel))


def _with(config: Config, section: str, **keys: object) -> Config:
    changed = msgspec.structs.replace(getattr(config, section), **keys)
    return msgspec.structs.replace(config, **{section: changed})


def _used(reports: AidingReports, channel: Channel) -> np.ndarray:
    """Updates that were held against the gate, refused ones too: leaving them out would flatter."""
    judged = (reports.verdict == Verdict.ACCEPTED) | (reports.verdict == Verdict.REJECTED_GATE)
    found: np.ndarray = (reports.channel == channel) & (reports.dof > 0) & judged
    return found


def _own_sd(reports: AidingReports, channel: Channel, sd: float) -> float | None:
    """The sensor's standard deviation that the innovations ask for; None: too few of them."""
    used = _used(reports, channel)
    if np.count_nonzero(used) < MINIMUM_UPDATES:
        return None
    axes = int(reports.dof[used].max())
    y = reports.innovation[used, :axes].ravel()
    s = (reports.innovation_sd[used, :axes] ** 2).ravel()
    known = np.isfinite(y)
    measured = float(np.median(y[known] ** 2)) / _MEDIAN_OF_CHI2
    own = measured - float(np.median(s[known] - sd * sd))
    # Where the prediction explains it all, what is left is noise of this estimate.
    return float(np.sqrt(max(own, 0.01 * measured)))


def _slow(reports: AidingReports, channel: Channel) -> str:
    """A word of warning where innovations follow one another."""
    used = _used(reports, channel)
    y = reports.innovation[used, 0]
    y = y[np.isfinite(y)]
    if len(y) < MINIMUM_UPDATES:
        return ""
    y = np.clip(y, *np.quantile(y, [0.02, 0.98]))
    y = y - y.mean()
    lag = float(np.mean(y[1:] * y[:-1]) / max(float(np.mean(y * y)), 1e-30))
    return f"; correlated (lag one {lag:.1f}): part of it is slow error" if lag > 0.3 else ""
