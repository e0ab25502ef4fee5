"""One tuned key of the configuration, and the file that holds them."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec


class Parameter(msgspec.Struct, frozen=True):
    """A key with what it was, what the data say, and why; ``after`` None: the data cannot say."""

    section: str
    key: str
    before: float
    after: float | None
    reason: str


def as_toml(parameters: Sequence[Parameter], title: str) -> str:
    """A configuration of the keys that the data had something to say about, reasons beside them."""
    lines = [f"# {title}", "# Every other key keeps its default; lay these over a vehicle's own."]
    for section in dict.fromkeys(p.section for p in parameters):
        mine = [p for p in parameters if p.section == section]
        lines += ["", f"[{section}]"]
        for p in mine:
            if p.after is None:
                lines.append(f"# {p.key} = {p.before:.3g}: {p.reason}")
            else:
                lines.append(f"{p.key} = {p.after:.3g}  # was {p.before:.3g}; {p.reason}")
    return "\n".join(lines) + "\n"
