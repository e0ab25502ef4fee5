"""The vehicle as a whole: autopilot, CAN unit and faults, told the time. Pure but for its links."""

from __future__ import annotations

import random
from dataclasses import fields, replace
from typing import Any

from companion.types import NS, Samples, VehicleRecording
from replay.simulator.live import garbage, slcan
from replay.simulator.live.autopilot import SimulatedAutopilot
from replay.simulator.live.can_unit import SimulatedCanImu
from replay.simulator.live.faults import Faults, Order
from replay.simulator.live.links import Plug, UdpLink
from replay.simulator.live.receiver import SimulatedReceiver, TcpServer

CAN_SOURCE = "can-imu"
"""Name of the simulated unit that is on the CAN bus; the autopilot's is ``HIGHRES_IMU``."""


def moved(recording: VehicleRecording, by_ns: int) -> VehicleRecording:
    """The recording with all its times later by ``by_ns``."""

    def later(samples: Any) -> Any:
        return replace(samples, t_ns=samples.t_ns + by_ns, t_rx_ns=samples.t_rx_ns + by_ns)

    changes: dict[str, Any] = {}
    for field in fields(recording):
        value = getattr(recording, field.name)
        if isinstance(value, Samples):
            changes[field.name] = later(value)
        elif isinstance(value, tuple) and value and isinstance(value[0], Samples):
            changes[field.name] = tuple(later(samples) for samples in value)
    return replace(recording, **changes)


class LiveVehicle:
    """What is done at a moment; the caller waits for :attr:`next_ns` or for readable links."""

    def __init__(
        self,
        autopilot: SimulatedAutopilot,
        link: UdpLink,
        unit: SimulatedCanImu | None,
        plug: Plug | None,
        seed: int = 0,
        receiver: SimulatedReceiver | None = None,
        line: Plug | TcpServer | None = None,
    ) -> None:
        """``receiver`` speaks over ``line``, where there is one."""
        self.autopilot, self.link = autopilot, link
        self.receiver, self.line = receiver, line
        self.unit, self.plug = unit, plug
        self.adapter = slcan.SlcanAdapter()
        self.faults = Faults()
        self.heard = 0
        """Frames that went through the open adapter."""
        self._garbage = random.Random(seed)

    @property
    def next_ns(self) -> int | None:
        """When something is due; None when the flight is over."""
        due = [self.autopilot.next_ns]
        if self.unit is not None:
            due.append(self.unit.next_ns)
        if self.receiver is not None:
            due.append(self.receiver.next_ns)
        times = [t for t in due if t is not None]
        if not times:
            return None
        mend_ns = self.faults.next_ns
        return min(times) if mend_ns is None else min(*times, mend_ns)

    def order(self, order: Order, now_ns: int) -> None:
        """Break or mend something."""
        if order.fault == "autopilot-reboot" and order.on:
            self.autopilot.reboot(now_ns + round((order.for_s or 0.0) * NS))
        self.faults.take(order, now_ns)
        self._apply()

    def advance(self, now_ns: int) -> None:
        """Read what came and send what is due."""
        for fault in self.faults.mend(now_ns):
            if fault == "autopilot-reboot":
                self.autopilot.reboot(now_ns)
            self._apply()
        self._advance_mavlink(now_ns)
        if self.unit is not None:
            self._advance_can(self.unit, now_ns)
        if self.receiver is not None and self.line is not None:
            self.line.write(self.receiver.advance(now_ns))

    def _advance_mavlink(self, now_ns: int) -> None:
        booting = self.faults.on("autopilot-reboot")
        for data in self.link.read():
            if not booting:
                self.autopilot.feed(now_ns, data)
        frames = self.autopilot.advance(now_ns)
        if booting:
            return
        if self.faults.on("mavlink-garbage"):
            bad = garbage.mavlink_garbage(frames, self._garbage)
            frames = [frame for pair in zip(bad, frames, strict=True) for frame in pair]
        self.link.write(frames)

    def _advance_can(self, unit: SimulatedCanImu, now_ns: int) -> None:
        frames = unit.advance(now_ns)
        if self.plug is None:
            return
        closings = self.adapter.closings
        answers = self.adapter.feed(self.plug.read())
        if self.adapter.closings > closings:
            self.plug.drop_waiting()
        self.plug.write(answers)
        self.adapter.sent.clear()
        if not self.adapter.hears:
            return
        self.heard += len(frames)
        lines = [slcan.line(frame) for frame in frames]
        if self.faults.on("can-garbage"):
            bad = garbage.can_garbage(frames, self._garbage)
            lines = [line for pair in zip(bad, lines, strict=True) for line in pair]
        self.plug.write(b"".join(lines))

    def _apply(self) -> None:
        """Bring the parts in line with the faults that are on."""
        on = self.faults.on
        self.autopilot.gnss_silent = on("gnss-silent")
        if self.receiver is not None:
            self.receiver.silent = on("gnss-silent")
        if on("mavlink-down"):
            self.link.close()
        else:
            self.link.open()
        if self.unit is not None:
            self.unit.silent = on("imu-silent")
            self.unit.loss_share = self.faults.can_loss_share if on("can-loss") else 0.0
        if self.plug is not None:
            if on("can-gone"):
                self.plug.pull()
                self.adapter = slcan.SlcanAdapter(self.adapter.bus_bitrate)
            else:
                self.plug.put_in()

    def counts(self) -> dict[str, Any]:
        """What was sent and received so far."""
        pilot = self.autopilot
        counts: dict[str, Any] = {
            "mavlink_sent": dict(pilot.sent),
            "mavlink_received": dict(pilot.received),
            "mavlink_bad_received": pilot.bad_received,
            "mavlink_dropped": self.link.dropped,
            "timesync_answers": pilot.timesync_answers,
        }
        if self.unit is not None:
            counts |= {
                "can_samples": self.unit.samples,
                "can_frames": self.unit.frames,
                "can_frames_lost": self.unit.lost,
                "can_frames_heard": self.heard,
                "can_commands_refused": self.adapter.refused,
            }
        if self.receiver is not None:
            counts["raw_epochs"] = self.receiver.epochs
        if self.plug is not None:
            counts["can_bytes_dropped"] = self.plug.dropped_bytes
        return counts
