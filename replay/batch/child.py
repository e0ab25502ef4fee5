"""The process that logs are worked on in, one after the other: a job a line in, an answer out.

``python -m replay.batch.child``. A log that kills it or never ends costs this process and nothing
else. It ends at once when its standard input does, whatever it is at: whoever gave it the job is
gone then.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import resource
import sys
import threading
import traceback
from typing import Any

_PARTS = ("filter", "files")
"""Kernels that every log needs; others compile when one asks for them."""


def main() -> None:
    """Get ready, say so, and work until told no more."""
    # One core a process: several of them fill the others. Must be said before numpy is loaded.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # What a library prints must not get between the answers.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    jobs: queue.Queue[str] = queue.Queue()
    threading.Thread(target=_listen, args=(jobs,), daemon=True).start()
    _get_ready()
    _say(answers, {"ready": os.getpid()})
    while True:
        _say(answers, _answer(json.loads(jobs.get())))


def _listen(jobs: queue.Queue[str]) -> None:
    for line in sys.stdin:
        jobs.put(line)
    os._exit(0)


def _say(answers: Any, answer: dict[str, Any]) -> None:
    with contextlib.suppress(BrokenPipeError):
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _get_ready() -> None:
    """Load the kernels; where they have to be compiled, by one process for all."""
    import fcntl

    from companion._kernel_cache import folder
    from replay import kernels

    if not kernels.compiled(*_PARTS):
        folder().mkdir(parents=True, exist_ok=True)
        with (folder() / "batch.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            kernels.load(_PARTS)
    import replay.batch.one_log  # noqa: F401, what takes long to load


def _answer(job: dict[str, Any]) -> dict[str, Any]:
    """What became of a job: ``rows``, or why there are none under ``refused`` or ``failed``."""
    from companion.types import CompanionError
    from replay.batch.one_log import NotWritten, work_on

    answer: dict[str, Any]
    try:
        answer = {"rows": work_on(**job)}
    except CompanionError as error:
        answer = {"refused": " ".join(str(error).split())}
    except NotWritten as error:
        answer = {"failed": str(error)}
    except MemoryError:
        answer = {"failed": "not enough memory for this log"}
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        answer = {"failed": f"internal error {text} ({os.path.basename(where.filename)})"}
    answer["peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return answer


if __name__ == "__main__":
    main()
