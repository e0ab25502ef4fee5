"""docs/configuration.md, written from the sections themselves.

``python -m companion.config.reference [FILE]``. Meanings are the docstrings of the keys, defaults
those of the structs, units are in the keys' names; what a value may be is asked of the checks, by
giving them what cannot be: nothing of it is said twice.
"""

from __future__ import annotations

import ast
import copy
import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import msgspec

from companion.config import Config, from_table, section_of
from companion.config.section import Section
from companion.types import ConfigError

_UNITS = (
    ("mps3_rthz", "m/s³/√Hz"), ("mps2_rthz", "m/s²/√Hz"), ("mps2_rts", "m/s²/√s"),
    ("mps_rts", "m/s/√s"), ("m_rts", "m/√s"), ("dps2_rthz", "deg/s²/√Hz"),
    ("dps_rthz", "deg/s/√Hz"), ("dps_rts", "deg/s/√s"), ("gain_rthz", "1/√Hz"), ("dbhz", "dB-Hz"),
    ("mps2", "m/s²"), ("mps", "m/s"), ("dps", "deg/s"), ("deg", "deg"), ("ppm", "ppm"),
    ("ms", "ms"), ("ns", "ns"), ("hz", "Hz"), ("m", "m"), ("s", "s"), ("t", "T"),
)  # fmt: skip
"""Endings of keys, longer before shorter."""

_DBC = {
    "file": "imu.dbc",
    "gyro_signals": ["gx", "gy", "gz"],
    "accel_signals": ["ax", "ay", "az"],
}
_UNIT_ON_CAN = {"name": "imu", "protocol": "dronecan"}

_IMPOSSIBLE: dict[str, tuple[Any, ...]] = {
    "float": (float("nan"), -1e30, 1e30),
    "int": (-(10**9), 10**9),
    "str": (" ", "nonsense:"),
}


def _example(path: tuple[str, ...]) -> dict[str, Any]:
    """A configuration with something in each section that is empty by default."""
    unit = {**_UNIT_ON_CAN, "protocol": "dbc", "dbc": _DBC} if "dbc" in path else _UNIT_ON_CAN
    return copy.deepcopy(
        {
            "further_imu": [{"source": "imu2"}],
            "alignment": {"last_heading": {"heading_deg": 0.0, "sd_deg": 1.0, "t_ns": 0}},
            "can": [{"channel": "can0", "imu": [unit]}],
        }
    )


_HEAD = """# Configuration

One TOML file, for `companion run` and, with `--config`, for whatever replays. Start from the one in
[`configs/`](../configs) that is nearest. What is left out has its default; an unknown key is an
error that names its nearest neighbour; files are looked for beside the configuration. Units are
part of the keys: `_dps_rthz` is deg/s/√Hz, `_rts` is per √s. Axes are body forward, right, down; σ
is one standard deviation. `companion check FILE` tries a live one out, and each run log keeps its
configuration with every key.

Without `--config`, logs of autopilots are replayed with values for their kind (latencies, slow
error of the receiver, a gyro that warms up), which the output names. How to get noise from a
datasheet or from a log: [README](../README.md#noise-from-a-datasheet).

Written by `python -m companion.config.reference docs/configuration.md`; do not edit.
"""


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a section, in words."""

    name: str
    kind: str
    unit: str
    default: str
    allowed: str
    meaning: str


def reference() -> str:
    """The whole page."""
    sections = list(_sections(Config, ()))
    index = "\n".join(f"- [`{head}`](#{_anchor(head)}): {_said(of)[0]}" for head, of, _ in sections)
    parts = [_HEAD, index]
    for head, section, path in sections:
        first, rest = _said(section)
        parts.append(f"\n## `{head}`\n\n" + (f"{first} {rest}").strip() + "\n")
        parts.append("\n".join(_table(list(keys_of(section, path)))))
    return "\n".join(parts) + "\n"


def _sections(
    section: type[Section], path: tuple[str, ...], head: str = ""
) -> Iterator[tuple[str, type[Section], tuple[str, ...]]]:
    """Every section with its heading as TOML writes it, and its path; parents before children."""
    if path:
        yield head, section, path
    for field in msgspec.structs.fields(section):
        inner = section_of(field.type)
        if inner is not None:
            name = ".".join((*path, field.name))
            several = get_origin(field.type) is tuple
            yield from _sections(
                inner, (*path, field.name), f"[[{name}]]" if several else f"[{name}]"
            )


def keys_of(section: type[Section], path: tuple[str, ...]) -> Iterator[Key]:
    """The keys of a section that are no sections themselves."""
    meanings = docstrings(section)
    for field in msgspec.structs.fields(section):
        if section_of(field.type) is None:
            yield Key(
                field.name,
                _kind(field.type),
                _unit(field.name),
                _default(field),
                _allowed((*path, field.name), field.type),
                " ".join(meanings.get(field.name, "").split()),
            )


@cache
def docstrings(section: type[Section]) -> dict[str, str]:
    """The text under each key in the source of its section."""
    [made] = ast.parse(textwrap.dedent(inspect.getsource(section))).body
    assert isinstance(made, ast.ClassDef)
    found = {}
    for key, text in zip(made.body, made.body[1:], strict=False):
        if (
            isinstance(key, ast.AnnAssign)
            and isinstance(key.target, ast.Name)
            and isinstance(text, ast.Expr)
            and isinstance(text.value, ast.Constant)
        ):
            found[key.target.id] = str(text.value.value)
    return found


def _said(section: type[Section]) -> tuple[str, str]:
    """The section's docstring: its first sentence, and what follows."""
    text = " ".join((section.__doc__ or "").replace("``", "`").split())
    first, stop, rest = text.partition(". ")
    return first + stop.rstrip(), rest


def _kind(annotation: Any) -> str:
    if get_origin(annotation) is Literal:
        return "one of " + ", ".join(f"`{_toml(choice)}`" for choice in get_args(annotation))
    if get_origin(annotation) is tuple:
        inner = get_args(annotation)
        if inner[-1] is Ellipsis:
            return f"list: {_kind(inner[0])}"
        # A matrix is a tuple of equal rows.
        return f"{len(inner)} × {_kind(inner[0])}"
    if get_origin(annotation) is dict:
        return "table"
    options = [option for option in get_args(annotation) if option is not type(None)]
    if options:
        return " or ".join(_kind(option) for option in options)
    return {"float": "number", "int": "whole number", "bool": "true or false", "str": "text"}[
        annotation.__name__
    ]


def _unit(name: str) -> str:
    for ending, unit in _UNITS:
        if name.endswith(f"_{ending}"):
            return unit
    return ""


def _default(field: Any) -> str:
    if field.default is not msgspec.NODEFAULT:
        return "none" if field.default is None else f"`{_toml(field.default)}`"
    if field.default_factory is not msgspec.NODEFAULT:
        return f"`{_toml(field.default_factory())}`"
    return "**to be given**"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, float) and 1e-4 <= abs(value) < 1e6:
        return f"{value:.10g}" if value % 1 else f"{value:.1f}"
    return str(value)


def _allowed(path: tuple[str, ...], annotation: Any) -> str:
    """What the checks say to impossible values, in their words; empty where anything goes."""
    said: list[str] = []
    for value in _impossible(annotation):
        table = _example(path)
        at: Any = table
        for part in path[:-1]:
            at = at.setdefault(part, {})
            at = at[0] if isinstance(at, list) else at
        at[path[-1]] = value
        try:
            from_table(table, "")
        except ConfigError as error:
            text = _right(str(error), path[-1])
            if text and text not in said:
                said.append(text)
    return "; ".join(said)


def _impossible(annotation: Any) -> tuple[Any, ...]:
    if get_origin(annotation) is tuple:
        inner = get_args(annotation)
        if inner[-1] is Ellipsis:
            return ()
        return tuple([value] * len(inner) for value in _impossible(inner[0])[:1])
    return _IMPOSSIBLE.get(getattr(annotation, "__name__", ""), ())


def _right(text: str, key: str) -> str:
    """Of a refusal of ``key``, what would have been right: between the key's name and the value."""
    found = re.match(rf": key '[\w.\[\]]*\b{key}(\[\d\])*': (?P<right>.*)$", text)
    if found is None:
        return ""
    right = re.split(r",? got |; got ", found["right"])[0]
    return right.removeprefix("must be ")


def _table(keys: list[Key]) -> list[str]:
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key in keys:
        value = ", ".join(part for part in (key.kind, key.unit) if part)
        meaning = key.meaning + (f" *Allowed: {key.allowed}.*" if key.allowed else "")
        # A bar would end the cell.
        cells = (f"`{key.name}`", value, key.default, meaning.replace("``", "`"))
        rows.append("| " + " | ".join(c.replace("|", "\\|") for c in cells) + " |")
    return rows


def _anchor(head: str) -> str:
    """As Markdown viewers make it of a heading."""
    return re.sub(r"[^\w-]", "", head.lower())


def main() -> None:
    """Print the page, or write it to the file that is named."""
    if len(sys.argv) > 1:
        Path(sys.argv[1]).write_text(reference(), encoding="utf-8")
    else:
        sys.stdout.write(reference())


if __name__ == "__main__":
    main()
