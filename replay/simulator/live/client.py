"""Starts a simulated vehicle as a child process and steers it; for the demo and for tests."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from companion.types import CompanionError
from replay.children import Child
from replay.simulator.live.faults import FaultName

_READY_S = 60.0
"""Imports and the simulation take 3 s on an idle machine."""
_ANSWER_S = 20.0


class VehicleProcess(Child):
    """A running ``python -m replay.simulator.live``."""

    def __init__(self, arguments: Sequence[str]) -> None:
        """``arguments`` as on the command line; :class:`CompanionError` if it does not start."""
        super().__init__("the simulated vehicle", ["replay.simulator.live", *arguments])
        try:
            self.ready = self._answer("ready", _READY_S)
            """``mavlink`` endpoint, ``can`` device, ``start_unix_ns``, ``start_monotonic_ns``."""
        except CompanionError:
            self.__exit__(None, None, None)
            raise

    def fault(
        self,
        name: FaultName,
        *,
        on: bool = True,
        for_s: float | None = None,
        share: float | None = None,
    ) -> int:
        """Break (or mend) something; the time [ns, UTC] at which it was done."""
        order: dict[str, Any] = {"fault": name, "on": on}
        if for_s is not None:
            order["for_s"] = for_s
        if share is not None:
            order["share"] = share
        self.tell(json.dumps(order).encode())
        return int(self._answer("done", _ANSWER_S)["t_ns"])

    def counts(self) -> dict[str, Any]:
        """What it has sent and received so far."""
        self.tell(b'{"ask": "counts"}')
        counts: dict[str, Any] = self._answer("counts", _ANSWER_S)["counts"]
        return counts

    def end(self) -> dict[str, Any]:
        """Land it: the final counts."""
        self.close_input()
        counts: dict[str, Any] = self._answer("ended", _ANSWER_S)["counts"]
        self.finish()
        return counts

    def _answer(self, key: str, seconds: float) -> dict[str, Any]:
        answer = self.answer(seconds)
        if key not in answer:
            raise CompanionError(f"{self.name}: {answer.get('error', 'landed')}")
        return answer
