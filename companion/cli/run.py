"""``companion run``: the live process."""

from __future__ import annotations

import threading
from datetime import UTC, datetime
from pathlib import Path
from queue import Empty, Full, Queue
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from companion import present
from companion.cli.commands import compile_kernels, plain
from companion.config import Config, load
from companion.types import NS, Event, Health, Outputs
from replay.kernels import parts_of

if TYPE_CHECKING:
    from companion.outputs.publisher import Notice, Publisher

_STYLE = {"info": "", "warning": "yellow", "error": "red"}
_WAITING_LINES = 256


def run_live(
    console: Console, config_path: Path, seconds: float | None, log: Path | None
) -> dict[str, Any]:
    """Run on real links until a signal, or for ``seconds``; what ``--json`` prints."""
    config = load(config_path)
    compile_kernels(parts_of(config))
    with present.notice_if_slow(console, "Loading the numerical kernels …"):
        from companion.runtime.run import run
        from companion.runtime.start import prepare, warm_up
    start = prepare(config, log)
    with present.notice_if_slow(console, "Warming up …"):
        warm_up(start.config)
    publishers: list[Publisher] = [*_outputs(start.config), Terminal(console)]
    console.print(f"Vehicle   {escape(config.vehicle.name)}, log {escape(str(start.log))}")
    for note in start.notes:
        console.print(f"Note      {escape(note)}")
    summary = plain(run(start, config_path.parent, seconds=seconds, publishers=publishers))
    _show(console, summary)
    return summary


def _outputs(config: Config) -> list[Publisher]:
    """Every way out that the configuration asks for."""
    outputs: list[Publisher] = []
    if config.zenoh.enabled:
        from companion.outputs.zenoh_publisher import ZenohPublisher

        outputs.append(ZenohPublisher(config.zenoh, config.vehicle.name))
    return outputs


class Terminal:
    """Prints events as they come; a terminal or pipe that takes nothing keeps nobody waiting.

    A :class:`companion.outputs.publisher.Publisher`.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lines: Queue[Event | None] = Queue(_WAITING_LINES)
        self._thread = threading.Thread(target=self._print, name="terminal", daemon=True)
        self._thread.start()

    def publish(self, outputs: Outputs, arrival_monotonic_ns: int) -> None:  # noqa: ARG002 - people are not timed
        """The estimator's own events."""
        for event in outputs.events:
            self.event(event)

    def event(self, event: Event) -> None:
        """Queue a line; what does not fit is in the log."""
        try:
            self._lines.put_nowait(event)
        except Full:
            return

    def health(self, health: Health) -> None:
        """Not printed: ``companion watch`` shows it."""

    def config(self, toml: str) -> None:
        """Not printed: it is in the log."""

    def notices(self) -> list[Notice]:
        """A terminal has nothing to say of itself."""
        return []

    def close(self) -> None:
        """Print what waits, for a second at most."""
        while True:
            try:
                self._lines.put_nowait(None)
                break
            except Full:
                try:
                    self._lines.get_nowait()
                except Empty:
                    continue
        self._thread.join(1.0)

    def _print(self) -> None:
        while (event := self._lines.get()) is not None:
            at = datetime.fromtimestamp(event.t_ns / NS, UTC)
            self._console.print(
                f"{at:%H:%M:%S}  {escape(event.kind)}: {escape(event.text)}",
                style=_STYLE[event.level],
                highlight=False,
            )


def _show(console: Console, summary: dict[str, Any]) -> None:
    latency = summary["latency_ms"]
    for used in summary["inputs"]:
        console.print(f"Input     {used['kind']}: {escape(used['source'])}")
    console.print(f"Ran       {summary['duration_s']:.1f} s, at the end {summary['mode']}")
    if latency["p50"] is not None:
        console.print(
            f"Latency   arrival to hand-over p50 {latency['p50']:.2f}, p99 {latency['p99']:.2f}, "
            f"max {latency['max']:.1f} ms; {100 * summary['load']:.0f} % of a core"
        )
    if summary["log_dropped_bytes"]:
        console.print(f"Lost      {summary['log_dropped_bytes']} bytes of the log", style="red")
    console.print(
        f"Digest    settled {summary['digest'][:16]}, published {summary['digest_published'][:16]}"
    )
    console.print(f"Run log   {escape(summary['log'])}")
