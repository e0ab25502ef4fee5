"""What an epoch of the direct filter costs, and how that grows with the number of units.

    python -m tests.benchmarks.direct_cost

An epoch is a sample of each unit at 100 Hz and the steps of the model between them; a fix once a
second. CPU time of the walk alone, median of the rounds, which take turns. States: 15 of the
trajectory, 12 a unit. *As the arithmetic*: six scalar updates a unit, each n² for P − g gᵀ, set to
the cost of one unit; the steps of the model are 15 rows of n and hardly count.
"""

from __future__ import annotations

import time

import msgspec
import numpy as np

from companion.config import Baro, Config, EngineConfig, FurtherImu
from companion.estimation.aid_table import AID_SIZE, KIND_GNSS, KIND_IMU
from companion.estimation.direct.layout import T_IMU, T_NOW, T_OUTPUT
from companion.estimation.direct.start import Setup
from companion.estimation.direct.walk import walk
from companion.estimation.output_row import ROW_SIZE
from companion.estimation.parameters import OUTPUT_NS
from companion.estimation.update import REPORT_SIZE
from companion.estimation.walk import DONE
from companion.types import NS
from tests.benchmarks.common import table

UNITS = (1, 2, 3, 4, 6)
SECONDS, RATE_HZ, ROUNDS = 20, 100, 5


def _once(units: int) -> tuple[int, float]:
    """Number of states, and microseconds an epoch."""
    further = tuple(FurtherImu(source=f"imu{i + 2}") for i in range(units - 1))
    config = msgspec.structs.replace(
        Config(engine=EngineConfig(estimator="direct", output_rate_hz=10.0)),
        further_imu=further,
        baro=Baro(use=False),
    )
    setup = Setup(config)
    n = setup.layout.n
    s, k = setup.layout.blank()
    s[0] = 1.0
    s[4:7] = 0.8, 0.2, 100.0
    P = setup.covariance(s)
    P[np.diag_indices(n)] = 0.01
    k[T_NOW] = k[T_IMU] = NS
    k[T_OUTPUT] = NS // int(setup.ipar[OUTPUT_NS])
    rng = np.random.default_rng(1)
    count = SECONDS * RATE_HZ
    t = NS + NS // RATE_HZ * np.arange(1, count + 1)
    still = np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.8, 0.0])
    noise = np.array([1e-3] * 3 + [0.02] * 3 + [0.0])

    def samples() -> np.ndarray:
        return still + noise * rng.standard_normal((count, 7))

    rows = np.full((count * (units - 1) + SECONDS, AID_SIZE), np.nan)
    kinds = np.zeros((len(rows), 2), np.int64)
    times = np.concatenate([np.repeat(t, units - 1), t[:: count // SECONDS]])
    for unit in range(units - 1):
        rows[unit : count * (units - 1) : units - 1, :7] = samples()
        kinds[unit : count * (units - 1) : units - 1] = KIND_IMU, unit
    kinds[count * (units - 1) :, 0] = KIND_GNSS
    rows[count * (units - 1) :, :12] = [0.8, 0.2, 100.0, 0, 0, 0, 1, 1, 4, 0.01, 0.01, 0.04]
    order = np.argsort(times, kind="stable")
    m = len(rows)
    reports = 3 * count + 5 * m
    at = np.array([0, count, 0, m, 0, 0, 0])
    begin = time.process_time()
    code = walk(
        s, k, setup.lay, setup.par, setup.ipar, setup.units, setup.slow, t, samples(),
        times[order], kinds[order], rows[order],
        np.zeros(2 * count, np.int64), np.zeros((2 * count, ROW_SIZE)),
        np.zeros(reports, np.int64), np.zeros((reports, REPORT_SIZE)),
        np.zeros((8, len(s))), np.zeros((8, len(k)), np.int64), np.zeros((count, 2), np.int64), at,
    )  # fmt: skip
    spent = time.process_time() - begin
    assert code == DONE
    return n, spent / count * 1e6


def main() -> None:
    """Print the table."""
    found: dict[int, list[float]] = {units: [] for units in UNITS}
    states = {}
    _once(1)
    for _ in range(ROUNDS):
        for units in UNITS:
            states[units], cost = _once(units)
            found[units].append(cost)
    median = {units: float(np.median(costs)) for units, costs in found.items()}
    rows = []
    for units in UNITS:
        n = states[units]
        by_arithmetic = median[1] * units * n * n / states[1] ** 2
        rows.append([
            str(units), str(n), f"{median[units]:.0f}", f"{median[units] / units:.0f}",
            f"{median[units] / median[1]:.1f}", f"{by_arithmetic / median[1]:.1f}",
        ])  # fmt: skip
    print(f"{SECONDS} s at {RATE_HZ} Hz, {ROUNDS} rounds")
    print(table(["units", "states", "µs an epoch", "µs a sample", "over one unit",
                 "as the arithmetic"], rows))  # fmt: skip
    few, many = UNITS[1], UNITS[-1]
    a_sample = np.log((median[many] / many) / (median[few] / few))
    power = a_sample / np.log(states[many] / states[few])
    print(f"A sample costs states to the power {power:.2f} from {few} units to {many}")


if __name__ == "__main__":
    main()
