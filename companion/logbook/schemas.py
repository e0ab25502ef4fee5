"""Topics and message types of the run log."""

from __future__ import annotations

from typing import Any

from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet

from companion.proto import adaptation_pb2, health_pb2, navigation_pb2, run_pb2, samples_pb2

LOG_FORMAT = 1
"""Raised when a reader of the previous format would misread the log."""

CONFIG_TOPIC = "companion/config"
VERSIONS_TOPIC = "companion/versions"
SUMMARY_TOPIC = "companion/summary"

MESSAGES: dict[str, Any] = {
    m.DESCRIPTOR.full_name: m
    for m in (
        samples_pb2.ImuBatch,
        samples_pb2.GnssBatch,
        samples_pb2.BaroBatch,
        samples_pb2.MagBatch,
        samples_pb2.AttitudeBatch,
        samples_pb2.ReferenceBatch,
        samples_pb2.RawGnssBatch,
        samples_pb2.BroadcastBatch,
        samples_pb2.RawBatch,
        navigation_pb2.NavState,
        navigation_pb2.SolutionBatch,
        navigation_pb2.AidingReport,
        navigation_pb2.Satellites,
        adaptation_pb2.AdaptationTrace,
        health_pb2.Health,
        run_pb2.Config,
        run_pb2.Versions,
        run_pb2.VehicleInfo,
        run_pb2.Checkpoint,
        run_pb2.Summary,
        LocationFix,
        Odometry,
        Log,
    )
}
"""Generated class of every message type in the log, by its full name."""


def member_topic(estimator: str) -> str:
    """Topic, after the vehicle, of one estimator of a bank."""
    return f"nav/estimators/{estimator}"


def topic(vehicle: str, name: str) -> str:
    """Topic of one vehicle, the same text as its zenoh key.

    Characters with a meaning in zenoh keys are replaced; the exact name is in the channel's
    metadata.
    """
    safe = "".join("_" if c in "/*$?#" or ord(c) < 33 else c for c in vehicle) or "_"
    return f"companion/{safe}/{name}"


def descriptor_set(message: str) -> bytes:
    """Serialised ``FileDescriptorSet`` of a message type and all it imports, as MCAP asks for."""
    out = FileDescriptorSet()
    seen: set[str] = set()

    def add(file: FileDescriptor) -> None:
        if file.name in seen:
            return
        seen.add(file.name)
        for dependency in file.dependencies:
            add(dependency)
        file.CopyToProto(out.file.add())

    add(MESSAGES[message].DESCRIPTOR.file)
    return out.SerializeToString()
