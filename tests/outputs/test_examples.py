"""The subscriber that users start from works as it stands."""

from __future__ import annotations

import subprocess
import sys
from contextlib import closing
from pathlib import Path

from companion.config import Zenoh
from companion.outputs.zenoh_publisher import ZenohPublisher
from tests.outputs.zenoh_help import PATIENCE_S, free_port, outputs, solution, wait_for


def test_python_subscriber_prints_states(root: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-u", "examples/subscribe.py", endpoint]
    with closing(ZenohPublisher(Zenoh(listen=(endpoint,)), "v1")) as publisher:
        assert publisher.link.wait_open(PATIENCE_S)
        live = publisher.link.live
        assert live is not None
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=root) as run:
            wait_for(lambda: live.publishers["nav/state"].matching_status.matching, "subscribed")
            publisher.publish(outputs(solution()), 1)
            assert run.stdout is not None
            line = run.stdout.readline()
            run.kill()
    assert line.split() == ["companion/v1/nav/state", "NAVIGATING", "0.8", "0.15", "30.0"]
