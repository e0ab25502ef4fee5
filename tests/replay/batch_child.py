"""A batch's child whose logs say what happens to it: ``die``, ``hang``, ``err``, or nothing."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path
from typing import Any

from replay.batch import child, one_log


def _work_on(log: str, **_: Any) -> list[dict[str, Any]]:
    match Path(log).read_text():
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "hang":
            threading.Event().wait()
        case "err":
            raise RuntimeError("as it\nwas told")
    return []


if __name__ == "__main__":
    one_log.work_on = _work_on
    child.main()
