"""``python -m replay.simulator.live``: a simulated vehicle until its flight ends or Ctrl-C."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from companion.types import CompanionError
from replay.simulator.live.process import Options, run
from replay.simulator.live.scenario import live_scenario


def _options(argv: list[str]) -> Options:
    parser = argparse.ArgumentParser(
        prog="python -m replay.simulator.live",
        description="A simulated multirotor in real time: CAN IMU on an slcan adapter, autopilot "
        "over MAVLink. Faults as JSON lines on stdin; ends with it.",
    )
    parser.add_argument(
        "--mavlink",
        default="udpin:127.0.0.1:14550",
        metavar="udpin|udpout:HOST:PORT",
        help="autopilot's side of the link; port 0: any free one (default: %(default)s)",
    )
    parser.add_argument(
        "--can", type=Path, metavar="PATH", help="device of the slcan adapter; absent: no CAN bus"
    )
    parser.add_argument("--protocol", default="dronecan", help="of the CAN IMU: %(default)s")
    parser.add_argument("--node", type=int, default=42, help="its node number (%(default)s)")
    parser.add_argument("--imu-rate", type=float, default=200.0, metavar="HZ", help="%(default)s")
    parser.add_argument("--gnss-rate", type=float, default=5.0, metavar="HZ", help="%(default)s")
    parser.add_argument("--seconds", type=float, default=300.0, help="of flight: %(default)s")
    parser.add_argument("--rest", type=float, default=8.0, help="seconds on the ground first")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--receiver", default="", metavar="tcp|PATH", help="a receiver with raw GPS, too"
    )
    parser.add_argument(
        "--receiver-protocol", default="ublox", choices=("ublox", "rtcm3"), help="%(default)s"
    )
    parser.add_argument("--truth", type=Path, metavar="CSV", help="write the true flight here")
    given = parser.parse_args(argv)
    return Options(
        scenario=live_scenario(given.seconds, given.rest, given.imu_rate, given.gnss_rate),
        seed=given.seed,
        mavlink=given.mavlink,
        can=given.can,
        protocol=given.protocol,
        encoder_options={"node_id": given.node},
        receiver=given.receiver,
        receiver_protocol=given.receiver_protocol,
        truth=given.truth,
    )


if __name__ == "__main__":
    try:
        run(_options(sys.argv[1:]))
    except CompanionError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
