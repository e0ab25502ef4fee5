"""The simulated IMUs' traffic on a CAN bus, as ``candump -l`` would have recorded it."""

from __future__ import annotations

from pathlib import Path

from companion.types import VehicleRecording
from drivers.can_imu.dronecan import DroneCanEncoder
from replay.candump import candump_line

FIRST_NODE = 50
CHANNEL = "can0"
_FRAME_NS = 130_000
"""Time that a frame of 29-bit identifier and 8 bytes takes at 1 Mbit/s."""


def write_can_log(recording: VehicleRecording, path: Path) -> None:
    """Every IMU of ``recording`` as a DroneCAN node that sends RawIMU, from node 50 on.

    A unit that gives integrals sends those (float32), another one its latest values (float16), with
    the time of validity. The first frame of a transfer is stamped with the sample's arrival.
    """
    lines: list[tuple[int, str]] = []
    for number, imu in enumerate(recording.imu):
        frames = DroneCanEncoder(FIRST_NODE + number, stamped=True).encode(imu)
        each = len(frames) // max(len(imu), 1)
        for i, frame in enumerate(frames):
            t_ns = int(imu.t_rx_ns[i // each]) + i % each * _FRAME_NS
            lines.append((t_ns, candump_line(t_ns, CHANNEL, *frame)))
    lines.sort(key=lambda line: line[0])
    path.write_text("".join(text for _, text in lines), encoding="ascii")
