"""The section [adaptation]: what is refused, by name, and that its rules can be written down."""

from __future__ import annotations

import pytest

from companion.config import parse, to_toml
from companion.config.adaptation import Adaptation
from companion.types import ConfigError

RULE = '[[adaptation.fuzzy.rules]]\nspread = "high"\nmean = "zero"\nr = "match"\nq = "hold"\n'


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ('[adaptation]\nmethod = "magic"', "adaptation.method"),
        ("[adaptation]\nwindow = 33", "adaptation.window"),
        ("[adaptation]\nwindow = 7", "adaptation.window"),
        ("[adaptation]\nigg3 = [6.0, 1.5]", "adaptation.igg3"),
        ("[adaptation]\nhuber = nan", "adaptation.huber"),
        ("[adaptation.fuzzy]\nfalse_alarm = 0.5", "adaptation.fuzzy.false_alarm"),
        ("[adaptation.fuzzy]\nr_min = 0.0", "adaptation.fuzzy.r_min"),
        ("[adaptation.flac]\nlarge = 0.9", "adaptation.flac.large"),
        (2 * RULE, "adaptation.fuzzy.rules"),
        (RULE.replace("match", "twice"), "adaptation.fuzzy.rules"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(text: str, names: str) -> None:
    with pytest.raises(ConfigError, match=names.replace(".", r"\.")):
        parse(text)


def test_one_rule_is_changed_by_writing_it() -> None:
    """The others stay as they are, and the whole table comes back from the full text."""
    rules = parse(RULE).adaptation.fuzzy.rules
    changed = {(r.spread, r.mean): (r.r, r.q) for r in rules}
    usual = {(r.spread, r.mean): (r.r, r.q) for r in Adaptation().fuzzy.rules}
    assert changed.pop(("high", "zero")) == ("match", "hold")
    assert usual.pop(("high", "zero")) == ("match", "nominal")
    assert changed == usual
    assert parse(to_toml(parse(RULE))) == parse(RULE)


def test_all_nine_can_be_written() -> None:
    rules = [
        f'[[adaptation.fuzzy.rules]]\nspread = "{r.spread}"\nmean = "{r.mean}"\nr = "hold"\n'
        f'q = "{r.q}"\n'
        for r in Adaptation().fuzzy.rules
    ]
    config = parse('[adaptation]\nmethod = "fuzzy"\n' + "".join(rules))
    assert [r.r for r in config.adaptation.fuzzy.rules] == ["hold"] * 9
