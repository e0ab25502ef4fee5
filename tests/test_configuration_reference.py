"""The configuration reference: every key explained, and the committed page is current."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from companion.config import Config, section_of
from companion.config.reference import docstrings, keys_of, reference
from companion.config.section import Section


def _sections(section: type[Section]) -> list[type[Section]]:
    inner = [section_of(field.type) for field in msgspec.structs.fields(section)]
    return [section, *(s for one in inner if one is not None for s in _sections(one))]


@pytest.mark.parametrize("section", _sections(Config), ids=lambda s: s.__name__)
def test_every_key_is_explained(section: type[Section]) -> None:
    assert section.__doc__ != Section.__doc__, "the section has no docstring"
    keys = {f.name for f in msgspec.structs.fields(section) if section_of(f.type) is None}
    assert not keys - set(docstrings(section)), "keys without a docstring under them"


def test_the_committed_page_is_current(root: Path) -> None:
    committed = (root / "docs" / "configuration.md").read_text(encoding="utf-8")
    assert committed == reference(), (
        "run: python -m companion.config.reference docs/configuration.md"
    )


def test_what_is_allowed_is_asked_of_the_checks() -> None:
    allowed = {key.name: key.allowed for key in keys_of(type(Config().imu), ("imu",))}
    assert allowed["latency_ms"] == "milliseconds between 0 and 500"
    assert allowed["gyro_noise_dps_rthz"] == "positive"
    assert allowed["source"] == ""
