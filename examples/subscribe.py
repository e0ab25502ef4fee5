"""Print what every vehicle on this machine publishes: python examples/subscribe.py [ENDPOINT]"""

import json
import sys

import zenoh

from companion.proto.navigation_pb2 import NavState

config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps(sys.argv[1:] or ["tcp/127.0.0.1:7447"]))
with zenoh.open(config) as session:
    states = session.declare_subscriber("companion/*/nav/state")
    for sample in states:
        state = NavState.FromString(sample.payload.to_bytes())
        print(sample.key_expr, NavState.Mode.Name(state.mode), state.lat, state.lon, state.yaw_deg)
