"""Jobs through Dask, on this machine or a cluster: a few in flight, each outcome as it comes.

Dask is imported here only, when a batch begins: it is an extra (``batch``).
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

from companion.types import CompanionError
from replay.batch.outcome import Outcome, as_outcome
from replay.batch.worker import CHILDREN, Job, end_idle_children, failed, work

_IN_FLIGHT = 2
"""Jobs for each thread: one at work, one so near that nobody waits for the network."""
_CONNECT_S = 15.0
_WORKERS_S = 60.0
_ADDRESS = re.compile(r"(tcp|tls|ws|wss|inproc)://\S+")
"""Of a scheduler: what Dask does not understand, it only notices half a minute after it failed."""
_GONE = "the Dask scheduler is gone; with another one the same command goes on from here"


def run(jobs: Sequence[Job], scheduler: str | None, workers: int) -> Iterator[Outcome]:
    """Work on every job; outcomes in the order in which they end.

    ``scheduler``: address of a Dask scheduler; None: ``workers`` logs at a time on this machine.
    Raises :class:`CompanionError` without Dask, and where a cluster cannot be reached or is lost.
    """
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise CompanionError(f"no Dask scheduler at {scheduler}: tcp://HOST:PORT, or tls://…")
    try:
        import distributed
    except ImportError:
        raise CompanionError(
            "batch needs Dask: pip install 'companion-nav[batch]', or 'dask[distributed]'"
        ) from None
    with _client(distributed, scheduler, workers) as client:
        try:
            yield from _through(distributed, client, jobs)
        except (OSError, asyncio.CancelledError, concurrent.futures.CancelledError):
            raise CompanionError(_GONE) from None
        finally:
            if scheduler is not None and client.status == "running":
                client.run(end_idle_children)


@contextmanager
def _client(distributed: Any, scheduler: str | None, workers: int) -> Iterator[Any]:
    """A client of the cluster, or of threads in this process that each drive a child."""
    # What goes wrong comes back as an outcome or an error; its log would come between the lines for
    # people. Each of Dask's loggers has a level of its own.
    for name in list(logging.root.manager.loggerDict):
        if name.startswith(("distributed", "tornado")):
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    if scheduler is None:
        CHILDREN.begin()
        cluster = distributed.LocalCluster(
            n_workers=1,
            threads_per_worker=workers,
            processes=False,
            # No dashboard; and what answers HTTP all the same does so on loopback only.
            dashboard_address="127.0.0.1:0",
            worker_dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
            silence_logs=logging.CRITICAL,
        )
        try:
            with closing(distributed.Client(cluster, set_as_default=False)) as client:
                yield client
        finally:
            # Those at work end with the batch that is interrupted; else all are idle.
            CHILDREN.end_all()
            cluster.close()
        return
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except OSError as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise CompanionError(f"no Dask scheduler at {scheduler}: {text}") from None
    with closing(client):
        try:
            client.wait_for_workers(1, timeout=_WORKERS_S)
        except TimeoutError:
            raise CompanionError(
                f"the scheduler at {scheduler} has no worker: dask worker {scheduler}"
            ) from None
        yield client


def _through(distributed: Any, client: Any, jobs: Sequence[Job]) -> Iterator[Outcome]:
    waiting = iter(jobs)
    at_work: dict[str, Job] = {}
    ended = distributed.as_completed(loop=client.loop)

    def fill() -> None:
        # Asked each time: a cluster grows and shrinks.
        threads = max(1, sum(client.nthreads().values()))
        while len(at_work) < _IN_FLIGHT * threads:
            job = next(waiting, None)
            if job is None:
                return
            # Not pure: what is there already is the store's to know, not the scheduler's.
            future = client.submit(work, job, pure=False)
            at_work[future.key] = job
            ended.add(future)

    fill()
    for future in ended:
        job = at_work.pop(future.key)
        yield _outcome(future, job)
        fill()


def _outcome(future: Any, job: Job) -> Outcome:
    if future.status == "finished":
        return as_outcome(future.result())
    if future.status == "error":
        error = future.exception()
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return failed(job.log, job.path, f"its Dask worker failed: {text}")
    raise CompanionError(_GONE)
