"""``companion watch --web``: the live picture as a page, until Ctrl-C or SIGTERM."""

from __future__ import annotations

import asyncio
import contextlib
import signal
from contextlib import closing

from rich.console import Console
from rich.markup import escape

from companion.outputs.subscriber import Subscriber
from companion.watch.web.server import LiveServer, new_model, serve_page


def serve(console: Console, subscriber: Subscriber, where: str, bind: str, port: int) -> None:
    """Serve the page; ``where`` is what the subscriber listens to, for people."""
    with closing(subscriber):
        asyncio.run(_serve(console, subscriber, where, bind, port))


async def _serve(
    console: Console, subscriber: Subscriber, where: str, bind: str, port: int
) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    model = new_model()
    server = LiveServer(model)
    bound = await server.open(bind, port)
    shown = f"[{bind}]" if ":" in bind else bind
    console.print(f"Page      http://{shown}:{bound}/", markup=False, highlight=False)
    console.print(f"Listening to {escape(where)}; Ctrl-C ends it")
    with contextlib.suppress(asyncio.CancelledError):
        await serve_page(server, model, subscriber, stop)
