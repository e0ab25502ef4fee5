"""Words that change a configuration: what a comparison compares, and a bank runs side by side.

    fuzzy                     an adaptation method, of adaptation.method
    error-state               an estimator, of engine.estimator
    as-configured             nothing changed
    no-source-faults          source_faults.detect = false
    no-mag, no-baro           without that sensor
    no-gnss-velocity          gnss.velocity = false
    one-imu                   without the further_imu
    flac+no-source-faults     several of them

An estimator that joins the engine needs nothing here: what ``engine.estimator`` takes is a word.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import msgspec

from companion.config.adaptation import METHODS
from companion.config.estimator import Bank, EngineConfig
from companion.types import ConfigError

if TYPE_CHECKING:
    from companion.config import Config

_SWITCHES: dict[str, dict[str, dict[str, Any]]] = {
    "as-configured": {},
    "no-source-faults": {"source_faults": {"detect": False}},
    "no-mag": {"mag": {"use": False}},
    "no-baro": {"baro": {"use": False}},
    "no-gnss-velocity": {"gnss": {"velocity": False}},
}


def estimators() -> tuple[str, ...]:
    """What ``engine.estimator`` may be."""
    found: tuple[str, ...] = get_args(get_type_hints(EngineConfig)["estimator"])
    return found


def words() -> tuple[str, ...]:
    """Every word that is known."""
    return (*METHODS, *estimators(), *_SWITCHES, "one-imu")


def changed(config: Config, text: str) -> Config:
    """``config`` with what the words of ``text``, joined by ``+``, change.

    Raises :class:`ConfigError` that lists the known words for an unknown one.
    """
    replace = msgspec.structs.replace
    for word in text.split("+"):
        if word in _SWITCHES:
            for section, values in _SWITCHES[word].items():
                config = replace(config, **{section: replace(getattr(config, section), **values)})
        elif word == "one-imu":
            config = replace(config, further_imu=())
        elif word in METHODS:
            config = replace(config, adaptation=replace(config.adaptation, method=word))
        elif word in estimators():
            config = replace(config, engine=replace(config.engine, estimator=word))
        else:
            raise ConfigError(f"unknown '{word}'; known are {', '.join(words())}")
    return config


def alone(config: Config, text: str) -> Config:
    """``config`` with its bank dissolved into the one estimator that ``text`` says."""
    return changed(msgspec.structs.replace(config, bank=Bank()), text)


def smoothable(config: Config) -> str | None:
    """The first estimator of a bank that a smoother can follow; None where there is none."""
    names = config.bank.estimators
    return next((n for n in names if alone(config, n).engine.estimator != "direct"), None)


def uses_direct(config: Config) -> bool:
    """Whether the direct filter runs, alone or in a bank."""
    named = [word for name in config.bank.estimators for word in name.split("+")]
    return config.engine.estimator == "direct" or "direct" in named
