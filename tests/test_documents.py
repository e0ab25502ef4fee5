"""Documents name what is there: files, links, code, commands and configuration keys."""

from __future__ import annotations

import importlib
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from companion.config import Config

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PACKAGES = ("companion", "companion/estimation", "replay", "drivers")
"""Where a name in a document may begin."""


def _ids(page: Path) -> str:
    return str(page.relative_to(ROOT))


def _anchors(page: Path) -> set[str]:
    heads = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


@pytest.mark.parametrize("page", PAGES, ids=_ids)
def test_links_lead_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        if anchor and path.suffix == ".md":
            assert anchor in _anchors(path), target


def _code_names(text: str) -> Iterator[str]:
    """What stands between backticks and looks like a module, with or without a name in it."""
    yield from re.findall(r"(?<!`)`([a-z_0-9]+(?:[./][A-Za-z_0-9]+)+)`(?!`)", text)


def _found(name: str) -> bool:
    """Whether ``a/b.c`` or ``b.c`` is a module of ours, or a name in one."""
    parts = re.split(r"[./]", name)
    for cut in range(len(parts), 0, -1):
        head = Path(*parts[:cut])
        for package in ("", *PACKAGES):
            at = ROOT / package / head
            if at.is_dir() and cut == len(parts):
                return True
            if not at.with_suffix(".py").exists():
                continue
            module = ".".join((*Path(package).parts, *parts[:cut]))
            return cut == len(parts) or hasattr(importlib.import_module(module), parts[cut])
    # ``module.name`` where the module's package is left out.
    for package in ("companion", "replay", "drivers"):
        for path in (ROOT / package).rglob(f"{parts[0]}.py"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            if len(parts) == 1 or hasattr(importlib.import_module(module), parts[1]):
                return True
    return False


def test_the_mathematics_names_code_that_exists() -> None:
    text = (ROOT / "docs" / "mathematics.md").read_text(encoding="utf-8")
    names = [n for n in _code_names(text) if not n.startswith(("tests/", "docs/"))]
    assert len(names) > 10
    assert [name for name in names if not _found(name)] == []


@pytest.mark.parametrize("page", PAGES, ids=_ids)
def test_configuration_in_documents_has_known_keys(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"^```toml\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    # Also what a tutorial writes into a file.
    blocks += re.findall(r"^cat > \S+\.toml <<'END'\n(.*?)^END", text, re.DOTALL | re.MULTILINE)
    for block in blocks:
        msgspec.convert(tomllib.loads(block), Config)
