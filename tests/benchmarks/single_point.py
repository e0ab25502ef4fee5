"""Single-point position on three real recordings, and of RTKLIB on the same observations.

Run as ``python -m tests.benchmarks.single_point``. ``rtk-walk``: u-blox F9 in the open, against its
own RTK; ``instinct-static``: an Emlid receiver at rest, against the other receiver's mean beside
it; ``android``: a phone carried through a city's streets, against what the phone made of its own
measurements, which is no truth. Errors are of epochs alone, no filter; RTKLIB is its single-point
mode with the same elevation mask, models and satellite systems, without and with its own test for
faults (RAIM), which leaves out one satellite at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib as rk

from companion.config import DEG, RawGnss
from companion.gnss import orbit as ob
from companion.gnss.geometry import ned_axes
from companion.gnss.single_point import P_COV, P_POS
from companion.gnss.systems import BEIDOU, GALILEO, GPS
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64, NS, BroadcastSamples, RawGnssSamples
from replay.raw_gnss.android import read_gnss_logger
from replay.raw_gnss.folder import on_clock
from replay.raw_gnss.rinex_navigation import read_navigation
from replay.raw_gnss.rinex_observations import read_observations
from replay.raw_gnss.ubx import read_ubx
from tests.gnss.rtklib import as_rtklib

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
TCKF = DATA / "instinct-static-vn310" / "test" / "data" / "DataProcessor" / "tckf"
_CODES = {GPS: "CODE_L1C", GALILEO: "CODE_L1X", BEIDOU: "CODE_L2I"}
_SYSTEMS = {GPS: rk.SYS_GPS, GALILEO: rk.SYS_GAL, BEIDOU: rk.SYS_CMP}


@dataclass(frozen=True, slots=True)
class Case:
    """One recording with what it is compared to."""

    name: str
    raw: RawGnssSamples
    broadcast: BroadcastSamples
    reference: F64
    """(N, 3) ECEF [m] at the epochs."""


def cases() -> Iterator[Case]:
    """The three."""
    raw, broadcast, fixes, _ = read_ubx(DATA / "rtk-walk" / "gnss_1730.ubx")
    assert fixes is not None
    place = ecef(fixes.lat, fixes.lon, fixes.height)
    yield Case("rtk-walk", raw, broadcast, _at(raw, fixes.t_ns, place))
    name = "reach-m2-01_raw_202306291111"
    raw, _ = read_observations(TCKF / f"{name}.23O")
    broadcast, _ = read_navigation(TCKF / f"{name}.nav")
    yield Case("instinct-static", raw, broadcast, np.tile(_vectornav(), (len(raw), 1)))
    folder = DATA / "android-gnss"
    raw, _ = read_gnss_logger(folder / "gnss_log_raw_data_2.txt")
    broadcast, _ = read_navigation(folder / "hour0530.23n")
    t, place = _phone(folder / "gnss_log_raw_data_2.txt")
    yield Case("android", raw, broadcast, _at(on_clock(raw, "utc"), t, place))


def _at(raw: RawGnssSamples, t_ns: Any, place: F64) -> F64:
    return np.stack([np.interp(raw.t_ns, t_ns, place[:, k]) for k in range(3)], axis=1)


def _vectornav() -> F64:
    """Median place of the VectorNav's own fixes."""
    lines = (TCKF / "vn310-gnss.csv").read_text().splitlines()
    names = lines[0].split(",")
    at = [k for k, name in enumerate(names) if name.startswith("GNSS1::PosLla::")]
    rows = [line.split(",") for line in lines[1:]]
    values = [[float(r[k]) for k in at] for r in rows if len(r) == len(names) and r[at[0]]]
    lat, lon, height = np.median(np.array(values), axis=0)
    return ecef(*(np.array([x]) for x in (math.radians(lat), math.radians(lon), height)))[0]


def _phone(path: Path) -> tuple[Any, F64]:
    """Times [ns, UTC] and places of its ``Fix`` lines."""
    lines = [line.split(",") for line in path.read_text().splitlines() if line[:4] == "Fix,"]
    lat, lon, height = np.array([[float(x) for x in f[2:5]] for f in lines]).T
    t = np.array([int(f[8]) * (NS // 1000) for f in lines])
    return t, ecef(np.radians(lat), np.radians(lon), height)


def ours(case: Case, config: RawGnss) -> tuple[F64, F64]:
    """(N, 3) places, NaN without, and (N, 9) what they say of themselves."""
    receiver = Receiver(config)
    receiver.listen(case.broadcast)
    out = np.full((len(case.raw), 12), np.nan)
    for i in range(len(case.raw)):
        point = receiver.take(case.raw, i).point
        if point is not None:
            out[i, :3], out[i, 3:] = point[P_POS : P_POS + 3], point[P_COV : P_COV + 9]
    return out[:, :3], out[:, 3:]


def rtklib(case: Case, config: RawGnss, raim: int) -> F64:
    """(N, 3) places of RTKLIB's ``pntpos``, NaN where it gives none."""
    nav = rk.nav_t()
    rows = [row for sat, row in zip(case.broadcast.sat, case.broadcast.values, strict=True) if sat]
    ephemerides = rk.Arr1Deph_t(len(rows))
    for k, row in enumerate(rows):
        eph = as_rtklib(row)
        eph.ttr, eph.iode = eph.toe, int(row[ob.E_ISSUE])
        eph.svh, eph.sva = int(row[ob.E_HEALTH]), 0
        eph.week, eph.code = int(row[ob.E_WEEK]), 0
        eph.tgd[1 if row[ob.E_SAT] // 100 == 2 else 0] = float(row[ob.E_GROUP_DELAY])
        ephemerides[k] = eph
    nav.eph, nav.n, nav.nmax = ephemerides, len(rows), len(rows)
    for values in case.broadcast.values[case.broadcast.sat == 0]:
        for k in range(8):
            nav.ion_gps[k] = float(values[k])
    option = rk.prcopt_default
    option.mode, option.ionoopt, option.tropopt = 0, rk.IONOOPT_BRDC, rk.TROPOPT_SAAS
    option.navsys = sum(_SYSTEMS.values())
    option.elmin, option.posopt[4] = config.elevation_mask_deg * DEG, raim
    out = np.full((len(case.raw), 3), np.nan)
    for i in range(len(case.raw)):
        solution = _pntpos(case.raw, i, nav, option)
        if solution is not None:
            out[i] = solution
    return out


def _pntpos(raw: RawGnssSamples, i: int, nav: Any, option: Any) -> F64 | None:
    seen = [k for k, s in enumerate(raw.sat[i].tolist()) if s and raw.signal[i, k] == 0]
    observed = rk.Arr1Dobsd_t(max(len(seen), 1))
    for one, k in zip(range(len(seen)), seen, strict=True):
        system, prn = divmod(int(raw.sat[i, k]) - 100, 100)
        o = observed[one]
        o.time = rk.gpst2time(int(raw.week[i]), float(raw.tow[i]))
        o.sat, o.rcv = rk.satno(_SYSTEMS[system], prn), 1
        o.P[0], o.code[0] = float(raw.pseudorange[i, k]), getattr(rk, _CODES[system])
        o.SNR[0] = round(float(np.nan_to_num(raw.cn0[i, k])) * 1000)
    solution, message = rk.sol_t(), rk.Arr1Dchar(256)
    sky, state = rk.Arr1Ddouble(2 * max(len(seen), 1)), rk.Arr1Dssat_t(rk.MAXSAT)
    done = rk.pntpos(observed.ptr, len(seen), nav, option, solution, sky, state.ptr, message)
    return np.array([solution.rr[k] for k in range(3)]) if done else None


def _row(case: Case, who: str, place: F64, says: F64 | None = None) -> str:
    """Errors in NED about the reference, and about their own mean."""
    axes = np.empty((3, 3))
    x = case.reference[0]
    lat, lon = math.atan2(x[2], math.hypot(x[0], x[1])), math.atan2(x[1], x[0])
    ned_axes(lat, lon, axes)
    there = np.isfinite(place[:, 0])
    e = (place[there] - case.reference[there]) @ axes.T
    mean = e.mean(axis=0)
    h, about = np.hypot(e[:, 0], e[:, 1]), np.hypot(*(e - mean)[:, :2].T)
    cells = f"{there.sum():6d} of {len(there):4d}{np.median(h):10.2f}{np.sqrt((h**2).mean()):8.2f}"
    cells += f"{np.percentile(h, 95):8.2f}{np.sqrt((e[:, 2] ** 2).mean()):10.2f}"
    cells += "   {:6.2f} {:6.2f} {:7.2f}".format(*mean) + f"{np.sqrt((about**2).mean()):10.2f}"
    if says is not None:
        P = axes @ says[there].reshape(-1, 3, 3) @ axes.T
        cells += f"{np.median(np.sqrt(P[:, 0, 0] + P[:, 1, 1])):10.2f}"
    return f"{case.name:16}{who:14}{cells}"


def main() -> None:
    config = RawGnss()
    print(f"{'recording':16}{'':14}{'epochs':>14}{'h median':>10}{'h RMS':>8}{'h 95 %':>8}"
          f"{'v RMS':>10}{'mean N E D m':>25}{'h about it':>10}{'h it says':>10}")  # fmt: skip
    for case in cases():
        print(_row(case, "companion", *ours(case, config)))
        for raim, word in ((0, "RTKLIB"), (1, "RTKLIB, RAIM")):
            print(_row(case, word, rtklib(case, config, raim)))
    case = next(c for c in cases() if c.name == "android")
    cn0 = case.raw.cn0[case.raw.sat > 0]
    shares = np.percentile(cn0, [5, 25, 50, 75, 95])
    print(
        "\nandroid: C/N0 of what is measured, dB-Hz, 5 to 95 %: "
        + " ".join(f"{s:.0f}" for s in shares)
    )


if __name__ == "__main__":
    main()
