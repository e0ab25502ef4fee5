"""The sample flight that ships with the project; ``python -m replay.simulator.sample`` remakes it.

The bits depend on numpy's generators and on the processor's sine: another machine may differ in
the last place of a value, never in a count or a time.
"""

from __future__ import annotations

from pathlib import Path

from replay.simulator.aids import BaroSpec, GnssSpec, Outage
from replay.simulator.scenarios import Scenario, TrajectorySpec, graded
from replay.simulator.simulation import simulate
from replay.simulator.tlog_writer import write_tlog

SAMPLE = Scenario(
    name="sample-flight",
    trajectory=TrajectorySpec(kind="multirotor-mission", duration_s=140.0, rest_s=10.0),
    truth_rate_hz=10.0,
    # Stamped as ArduPilot does: the IMU behind its filter, a fix when it has arrived.
    imu=(graded("mems-consumer", rate_hz=100.0, latency_ms=10.0, vibration_mps2=0.3),),
    gnss=(
        GnssSpec(
            rate_hz=5.0,
            latency_ms=100.0,
            stamped="arrival",
            outages=(Outage(start_s=80.0, length_s=10.0),),
            during_outage="no-fix",
        ),
    ),
    baro=BaroSpec(rate_hz=10.0),
)
"""A small quadrotor on a mission with one GPS outage of 10 s, as a ground station logs it."""
SAMPLE_SEED = 7
SAMPLE_DIRECTORY = Path(__file__).resolve().parent.parent / "data"
SAMPLE_NAME = "sample-flight.tlog"


def write_sample(directory: Path = SAMPLE_DIRECTORY) -> Path:
    """Write the sample flight into ``directory`` and return its path."""
    path = directory / SAMPLE_NAME
    write_tlog(simulate(SAMPLE, SAMPLE_SEED), path, "multirotor")
    return path


if __name__ == "__main__":
    print(write_sample())
