#!/bin/sh
# Regenerate the protobuf modules of this folder. Needs grpcio-tools 1.71 (protoc 5.29): the
# generated code then runs with every protobuf runtime that the Foxglove schemas run with.
set -eu
cd "$(dirname "$0")/../.."
python -m grpc_tools.protoc -I . --python_out=. --pyi_out=. companion/proto/*.proto
# protoc leaves the type of a mapping open, which strict type checking refuses.
sed -i 's/_Mapping\]/_Mapping[str, object]]/g' companion/proto/*_pb2.pyi
