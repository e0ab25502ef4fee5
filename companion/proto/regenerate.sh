#!/bin/sh
# Regenerate the protobuf modules of this folder. Needs grpcio-tools 1.71 (protoc 5.29): the
# generated code then runs with every protobuf runtime that the Foxglove schemas run with.
set -eu
cd "$(dirname "$0")/../.."
python -m grpc_tools.protoc -I . --python_out=. --pyi_out=. companion/proto/*.proto
