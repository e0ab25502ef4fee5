"""The run log: one MCAP file a run, written while it runs (``docs/adr/0005-log.md``)."""

from companion.logbook.sink import LogWriteError
from companion.logbook.writer import LogWriter

__all__ = ["LogWriteError", "LogWriter"]
