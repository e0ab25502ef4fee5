"""The run log: one MCAP file a run, written while it runs (``docs/adr/0005-log.md``)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from companion.logbook.sink import LogWriteError
    from companion.logbook.writer import LogWriter

__all__ = ["LogWriteError", "LogWriter"]


def __getattr__(name: str) -> Any:
    # The writer brings numerical kernels along; who only reads messages starts without them.
    if name == "LogWriter":
        from companion.logbook.writer import LogWriter

        return LogWriter
    if name == "LogWriteError":
        from companion.logbook.sink import LogWriteError

        return LogWriteError
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
