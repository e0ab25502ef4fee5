"""The eight-state filter on a real flight with fewer than four satellites for 699 s.

Run as ``python -m tests.benchmarks.dc3``. An aircraft, 1500 s at 1 Hz: pseudoranges, an unaided INS
that is 2.7 km off at the start and 11 km at the end, a reference. Two recordings of it: all
satellites, and three for 699 epochs, from 801 s on.

What three satellites are worth depends on what is known of the receiver's clock. Its noise is taken
thrice: as the filter's own defaults have it; as this clock's place by single points over the first
800 s, before anything is missing, says it afterwards; and as the receiver's stream has learned it
on line up to each epoch.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from companion.config import RawGnss
from companion.estimation.pseudorange8 import EightState, Tuning
from companion.gnss import orbit as ob
from companion.gnss.clock_noise import Q_BIAS, Q_DRIFT
from companion.gnss.corrected import ROW_SIZE
from companion.gnss.geometry import ned_axes
from companion.gnss.gps_time import gps_ns
from companion.gnss.single_point import P_CLOCK, P_POS
from companion.intake.raw_gnss.receiver import Receiver
from companion.navigation.earth import ecef
from companion.types import F64, RawGnssSamples
from replay.raw_gnss.epochs import Epoch, Observation, broadcast_samples, raw_samples

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "tub-dc3-pseudorange"
WEEK = 2048
"""Any: the file has none, and all of it lies in one."""
NOTHING = np.zeros((0, ROW_SIZE))
LEARN_S = 800
_SHORT_S, _LONG_S = 10, 300
_SEMI = (ob.E_DELTA_N, ob.E_M0, ob.E_OMEGA0, ob.E_I0, ob.E_OMEGA, ob.E_OMEGA_DOT, ob.E_IDOT)
_COLUMNS = {
    5: ob.E_GROUP_DELAY, 6: ob.E_TOC, 7: ob.E_AF2, 8: ob.E_AF1, 9: ob.E_AF0, 11: ob.E_CRS,
    12: ob.E_DELTA_N, 13: ob.E_M0, 14: ob.E_CUC, 15: ob.E_ECC, 16: ob.E_CUS, 17: ob.E_SQRT_A,
    18: ob.E_TOE, 19: ob.E_CIC, 20: ob.E_OMEGA0, 21: ob.E_CIS, 22: ob.E_I0, 23: ob.E_CRC,
    24: ob.E_OMEGA, 25: ob.E_OMEGA_DOT, 27: ob.E_IDOT,
}  # fmt: skip
"""Column of the file's table → ours; angles are semicircles there."""


def ephemerides(table: F64) -> list[tuple[int, F64]]:
    """The file's 22 ephemerides."""
    out = []
    for values in table:
        row = np.zeros(ob.EPHEMERIS_SIZE)
        row[ob.E_SAT] = 100 + values[0]
        for theirs, ours in _COLUMNS.items():
            row[ours] = values[theirs]
        row[list(_SEMI)] *= np.pi
        row[ob.E_WEEK] = row[ob.E_TOC_WEEK] = WEEK
        row[ob.E_TOE_OWN] = row[ob.E_TOE]
        out.append((int(row[ob.E_SAT]), row))
    return out


def flight(scenario: int) -> tuple[RawGnssSamples, Receiver]:
    """Epochs and a receiver that knows the ephemerides; the ionosphere was not recorded."""
    name = DATA / f"gps_proj_scen{scenario}.mat"
    file = loadmat(str(name))
    epochs: dict[int, Epoch] = {}
    for t, sv, pr in zip(*(file[k].ravel() for k in ("t_gps", "svid_gps", "pr_gps")), strict=True):
        epoch = epochs.setdefault(int(t), Epoch(WEEK, float(t)))
        epoch.satellites.append(Observation(100 + int(sv), float(pr)))
    receiver = Receiver(
        RawGnss(
            elevation_mask_deg=5.0, sd_range_m=2.0, sd_multipath_m=0.0,
            clock_walk_m_rts=Tuning().clock_m_rts, clock_drift_walk_mps_rts=Tuning().drift_mps_rts,
        )
    )  # fmt: skip
    receiver.listen(broadcast_samples("dc3", ephemerides(file["ephem"])))
    return raw_samples("dc3", list(epochs.values())), receiver


def learned_clock() -> Tuning:
    """The clock's noise from the second differences of its bias over 10 and over 300 s.

    A random walk of the bias makes q √(2 τ) of them, one of the drift q τ √(2 τ / 3): each is given
    all that was seen at its end, so that the clock is trusted no further than it has shown.
    """
    raw, receiver = flight(2)
    points = [receiver.take(raw, i).point for i in range(LEARN_S)]
    assert all(p is not None for p in points)
    assert (np.diff(raw.tow[:LEARN_S]) == 1.0).all()
    clock = np.array([p[P_CLOCK] for p in points if p is not None])

    def second_difference(tau: int) -> float:
        d = clock[2 * tau :] - 2.0 * clock[tau:-tau] + clock[: -2 * tau]
        return float(np.sqrt((d**2).mean()))

    return Tuning(
        clock_m_rts=second_difference(_SHORT_S) / np.sqrt(2.0 * _SHORT_S),
        drift_mps_rts=second_difference(_LONG_S) * np.sqrt(1.5) / _LONG_S**1.5,
    )


def on_line(scale: F64) -> Tuning:
    """The clock's noise by the factors on the configured one that the stream has learned so far."""
    bias, drift = np.sqrt(scale[[Q_BIAS, Q_DRIFT]])
    start = Tuning()
    return Tuning(clock_m_rts=start.clock_m_rts * bias, drift_mps_rts=start.drift_mps_rts * drift)


def main() -> None:
    learned = learned_clock()
    print(f"Clock learned from the first {LEARN_S} s: {learned.clock_m_rts:.2f} m/√s of bias, "
          f"{learned.drift_mps_rts:.4f} m/s/√s of drift; defaults {Tuning().clock_m_rts:g}, "
          f"{Tuning().drift_mps_rts:g}")  # fmt: skip
    reference = loadmat(str(DATA / "gps_ref.mat"))["r_ref_gps"].T
    ins = loadmat(str(DATA / "ins_proj.mat"))
    t_ins = ins["t_ins"].ravel()
    place = ins["r_llh_ins"].T
    print(f"{'recording':14}{'method':22}{'epochs':>8}{'horizontal m':>14}{'vertical m':>12}"
          f"{'with < 4: h RMS':>17}{'h max':>8}{'all: h max':>12}")  # fmt: skip
    for scenario, words in ((1, "all"), (2, "699 s of 3")):
        raw, receiver = flight(scenario)
        filters = {
            "feedforward": EightState(Tuning(), feedback=False),
            "feedback": EightState(Tuning(), feedback=True),
            "feedforward, learned": EightState(learned, feedback=False),
            "feedback, learned": EightState(learned, feedback=True),
            "feedforward, on line": EightState(Tuning(), feedback=False),
            "feedback, on line": EightState(Tuning(), feedback=True),
            "four or none": EightState(Tuning(), feedback=True),
        }
        errors: dict[str, list[F64]] = {"single point": [], **{k: [] for k in filters}}
        few = []
        for i, t in enumerate(t_ins):
            at = int(np.searchsorted(raw.t_ns, gps_ns(WEEK, float(t))))
            prepared = receiver.take(raw, at)
            axes = np.empty((3, 3))
            ned_axes(reference[i, 0], reference[i, 1], axes)
            truth = ecef(*(reference[i, k : k + 1] for k in range(3)))[0]
            none = np.full(3, np.nan)
            point = none if prepared.point is None else prepared.point[P_POS : P_POS + 3]
            errors["single point"].append(axes @ (point - truth))
            for name, filter_ in filters.items():
                enough = len(prepared.rows) >= 4 or name != "four or none"
                if name.endswith("on line"):
                    filter_.tuning = on_line(prepared.clock_scale)
                estimate = filter_.step(1.0, place[i], prepared.rows if enough else NOTHING)
                errors[name].append(axes @ (estimate.ecef - truth))
            few.append(len(prepared.rows) < 4)
        less = np.array(few)
        last = filters["feedback, on line"].tuning
        print(f"{words}: at the end, learned on line {last.clock_m_rts:.2f} m/√s of bias, "
              f"{last.drift_mps_rts:.4f} m/s/√s of drift")  # fmt: skip
        for name, found in errors.items():
            e = np.array(found)
            e[:60] = np.nan  # until it has converged
            h = np.hypot(e[:, 0], e[:, 1])
            rms = [np.sqrt(np.nanmean(x**2)) for x in (h, e[:, 2])]
            gap = h[less & np.isfinite(h)]
            inside = (np.sqrt((gap**2).mean()), gap.max()) if len(gap) else (np.nan, np.nan)
            print(f"{words:14}{name:22}{np.isfinite(h).sum():8d}{rms[0]:14.2f}{rms[1]:12.2f}"
                  f"{inside[0]:17.2f}{inside[1]:8.1f}{np.nanmax(h):12.1f}")  # fmt: skip


if __name__ == "__main__":
    main()
