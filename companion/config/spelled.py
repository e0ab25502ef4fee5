"""A configuration written out with every key, so that no later default can change a replay."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from companion.config.section import Section


def to_toml(config: Section) -> str:
    """The configuration as TOML with every key spelled out; ``parse`` gives it back."""
    return "\n".join(_table("", msgspec.to_builtins(config))).lstrip("\n") + "\n"


def _table(path: str, values: dict[str, Any]) -> list[str]:
    """Lines of one table: its own keys first, as TOML wants, then the tables inside it."""
    lines: list[str] = []
    inner: list[str] = []
    for word, value in values.items():
        key = _key(word)
        name = f"{path}.{key}" if path else key
        if isinstance(value, dict):
            inner += ["", f"[{name}]", *_table(name, value)]
        elif _is_tables(value):
            for item in value:
                inner += ["", f"[[{name}]]", *_table(name, item)]
        elif value is not None:  # TOML has no null: an absent key is what stands for None
            lines.append(f"{key} = {_value(value)}")
    return lines + inner


def _is_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and bool(value) and isinstance(value[0], dict)


def _key(word: str) -> str:
    """A key as TOML wants it: bare where that is allowed, quoted otherwise."""
    return word if re.fullmatch(r"[A-Za-z0-9_-]+", word) else _value(word)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        # A JSON string is a TOML basic string, but for DEL, which TOML wants escaped.
        return msgspec.json.encode(value).decode().replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return repr(value)
