"""``companion watch --foxglove``: a bridge to Foxglove and Lichtblick, until Ctrl-C or SIGTERM."""

from __future__ import annotations

import signal
import threading
from contextlib import closing

from rich.console import Console
from rich.markup import escape

from companion.outputs.subscriber import Subscriber
from companion.watch.foxglove_bridge import FoxgloveBridge

_WAIT_S = 0.2


def serve(console: Console, subscriber: Subscriber, where: str, bind: str, port: int) -> None:
    """Pass everything on; ``where`` is what the subscriber listens to, for people."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with closing(subscriber), closing(FoxgloveBridge(bind, port)) as bridge:
        console.print(f"Foxglove  ws://{bind}:{bridge.port}", markup=False, highlight=False)
        console.print(f"Listening to {escape(where)}; Ctrl-C ends it")
        while not stop.is_set():
            for heard in subscriber.take(_WAIT_S):
                bridge.give(heard)
    if bridge.broken or subscriber.dropped:
        console.print(f"{bridge.broken} messages unreadable, {subscriber.dropped} dropped here")
