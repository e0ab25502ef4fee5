"""Android's raw measurements, as the GnssLogger app writes them (``Raw`` and ``Fix`` lines).

Pseudorange = c · (time of reception − time of transmission), GNSS time of reception being
TimeNanos + TimeOffsetNanos − FullBiasNanos − BiasNanos (android.location.GnssMeasurement).
"""

from __future__ import annotations

from pathlib import Path

from companion.gnss.gps_time import MOST_WEEKS
from companion.gnss.systems import CARRIER_HZ, C, satellite
from companion.types import LogFormatError, RawGnssSamples
from replay.raw_gnss.epochs import Epoch, Observation, possible, raw_samples
from replay.raw_gnss.rinex_observations import text_lines

_SYSTEM = {1: 0, 6: 1, 5: 2}
"""ConstellationType: GPS, Galileo, BeiDou."""
_WEEK_NS = 604_800 * 10**9
_BDT_NS = 14 * 10**9
_CODE_LOCK, _TOW, _TOW_KNOWN, _E1_LOCK = 1, 8, 1 << 14, 1 << 10
_MOST_UNCERTAIN_NS = 500.0
_BAND_HZ = 1e6


def _observation(f: dict[str, str], received_ns: int) -> Observation | None:
    """One ``Raw`` line; None where it is not one of ours or not locked. Raises ValueError."""
    system = _SYSTEM.get(int(f["ConstellationType"]))
    if system is None:
        return None
    carrier = float(f.get("CarrierFrequencyHz") or CARRIER_HZ[0])
    state = int(f["State"])
    lock = state & (_CODE_LOCK if system != 1 else _CODE_LOCK | _E1_LOCK)
    if abs(carrier - CARRIER_HZ[system]) > _BAND_HZ or not lock or not state & (_TOW | _TOW_KNOWN):
        return None
    if float(f["ReceivedSvTimeUncertaintyNanos"]) > _MOST_UNCERTAIN_NS:
        return None
    sent = int(f["ReceivedSvTimeNanos"]) + (_BDT_NS if system == 2 else 0)
    travel = (received_ns - sent) % _WEEK_NS
    if travel > _WEEK_NS // 2:
        travel -= _WEEK_NS
    fraction = float(f.get("TimeOffsetNanos") or 0.0) - float(f.get("BiasNanos") or 0.0)
    return Observation(
        satellite(system, int(f["Svid"])),
        (travel + fraction) * 1e-9 * C,
        float(f["PseudorangeRateMetersPerSecond"]),
        float(f["Cn0DbHz"]),
        float(f["ReceivedSvTimeUncertaintyNanos"]) * 1e-9 * C,
        float(f["PseudorangeRateUncertaintyMetersPerSecond"]),
    )


def read_gnss_logger(path: Path) -> tuple[RawGnssSamples, list[str]]:
    """Epochs of a GnssLogger file, GPS time, and notes.

    Raises :class:`LogFormatError` where it is none, or has no measurement that can be used.
    """
    names: list[str] = []
    epochs: list[Epoch] = []
    bad, last = 0, ""
    for line in text_lines(path):
        if line.startswith("# Raw,"):
            names = line[2:].split(",")
        if not line.startswith("Raw,") or not names:
            continue
        f = dict(zip(names, line.split(","), strict=False))
        try:
            received = int(f["TimeNanos"]) - int(f["FullBiasNanos"])
            o = _observation(f, received)
            if f["TimeNanos"] != last:
                week, rest = divmod(received, _WEEK_NS)
                if not 0 <= week < MOST_WEEKS:
                    raise ValueError(received)
                if epochs and not epochs[-1].satellites:
                    epochs.pop()
                fraction = float(f.get("BiasNanos") or 0.0)
                epochs.append(Epoch(week, (rest - fraction) * 1e-9))
                last = f["TimeNanos"]
        except (ValueError, KeyError):
            bad += 1
            continue
        if o is None:
            continue
        if possible(o) and all(o.sat != other.sat for other in epochs[-1].satellites):
            epochs[-1].satellites.append(o)
        else:
            bad += 1
    epochs = [e for e in epochs if e.satellites]
    if not epochs:
        raise LogFormatError(f"{path}: no 'Raw' lines of a GnssLogger file that can be used")
    notes = [f"{path.name}: {bad} lines that cannot be, left out"] if bad else []
    return raw_samples(path.stem, epochs), notes
