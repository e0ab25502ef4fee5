"""Several estimators or settings on one recording, read once, side by side.

What is compared is a *setting*: the run's configuration with something changed, as words say
(:mod:`companion.config.settings`), or ``mine=settings.toml``: a name, and a file whose keys are
laid over the configuration. ``bank`` is the one published of ``bank.estimators``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from companion.config import Bank, Config, from_table, to_toml
from companion.config.adaptation import METHODS
from companion.config.settings import changed
from companion.types import ConfigError, VehicleRecording, Verdict
from replay.assessment import assess
from replay.configuration import ChosenConfig
from replay.evaluation import EvaluationError
from replay.session import Progress, SessionResult, run_session
from replay.window import Window

DEFAULT = ("none", *(m for m in METHODS if m != "none"))
"""What is compared where nothing is said: every adaptation."""


@dataclass(frozen=True, slots=True)
class Setting:
    """One column of a comparison."""

    name: str
    chosen: ChosenConfig


class Row(msgspec.Struct, frozen=True):
    """What one setting made of the recording; errors are None where nothing is there to compare."""

    name: str
    reference: str | None
    position_rmse_m: dict[str, float | None] | None
    velocity_rmse_mps: dict[str, float | None] | None
    attitude_rmse_deg: dict[str, float | None] | None
    position_nees_mean: float | None
    outages: list[dict[str, float | None]]
    accepted: int
    rejected: int
    """Measurements that the filter saw and did not take: gate, source, unconfirmed."""
    resets: int
    warnings: list[str]
    """Kinds of the events that were warnings or errors, in order."""
    digest: str
    digest_published: str
    cpu_s: float
    no_accuracy_because: str | None = None


def _changed(config: Config, text: str) -> Config:
    """``config`` with what words change, its bank dissolved."""
    if text == "bank":
        if not config.bank.estimators:
            raise ConfigError("--estimators: 'bank' needs bank.estimators in the configuration")
        return config
    try:
        return changed(msgspec.structs.replace(config, bank=Bank()), text)
    except ConfigError as error:
        raise ConfigError(f"--estimators: {error}, and NAME=FILE.toml") from None


def usual(config: Config) -> tuple[str, ...]:
    """What is compared where nothing is said: the bank and its members, else every adaptation."""
    names = config.bank.estimators
    return ("bank", *names) if names else DEFAULT


def _laid_over(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """``base`` with the keys of ``changes``, section by section."""
    out = dict(base)
    for key, value in changes.items():
        old = out.get(key)
        both = isinstance(old, dict) and isinstance(value, dict)
        out[key] = _laid_over(old, value) if both else value  # type: ignore[arg-type]
    return out


def _from_file(config: Config, path: Path) -> Config:
    """``config`` with the keys of a TOML file in the place of its own."""
    try:
        changes = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}") from None
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from None
    merged = _laid_over(tomllib.loads(to_toml(config)), changes)
    return from_table(merged, str(path))


def settings(chosen: ChosenConfig, names: Sequence[str]) -> list[Setting]:
    """The settings that ``names`` ask for, each once; :class:`ConfigError` for an unknown one."""
    found: dict[str, Setting] = {}
    for text in names:
        name, equals, path = text.partition("=")
        if equals:
            config = _from_file(chosen.config, Path(path))
        else:
            config = _changed(chosen.config, text)
        origin = f"{chosen.origin}, {text}"
        found.setdefault(name, Setting(name, ChosenConfig(config, origin, to_toml(config))))
    return list(found.values())


_SEEN = (Verdict.REJECTED_GATE, Verdict.REJECTED_SOURCE, Verdict.REJECTED_UNCONFIRMED)


def _row(name: str, result: SessionResult, outages: Sequence[Window]) -> Row:
    accuracy: dict[str, Any] = {}
    because = None
    try:
        accuracy = assess(
            result.vehicle, result.chosen.config, result.solution, result.reports, withheld=outages
        ).to_json()
    except EvaluationError as error:
        because = str(error)
    used = result.reports.dof > 0
    verdict = result.reports.verdict[used]
    return Row(
        name=name,
        reference=accuracy.get("reference"),
        position_rmse_m=accuracy.get("position_rmse_m"),
        velocity_rmse_mps=accuracy.get("velocity_rmse_mps"),
        attitude_rmse_deg=accuracy.get("attitude_rmse_deg"),
        position_nees_mean=accuracy.get("position_nees_mean"),
        outages=accuracy.get("outages", []),
        accepted=int((verdict == Verdict.ACCEPTED).sum()),
        rejected=int(sum((verdict == v).sum() for v in _SEEN)),
        resets=int(result.solution.resets[-1]) if len(result.solution) else 0,
        warnings=[e.kind for e in result.events if e.level != "info"],
        digest=result.digest,
        digest_published=result.digest_published,
        cpu_s=result.cpu_s,
        no_accuracy_because=because,
    )


def compare(
    vehicle: VehicleRecording,
    chosen: Sequence[Setting],
    outages: Sequence[Window] = (),
    progress: Progress | None = None,
) -> list[Row]:
    """Run one vehicle's recording through every setting; ``outages`` withhold GNSS."""
    rows = []
    for done, setting in enumerate(chosen):
        part = _part(progress, done, len(chosen))
        result = run_session(vehicle, setting.chosen, outages=outages, progress=part)
        rows.append(_row(setting.name, result, outages))
    return rows


def _part(progress: Progress | None, done: int, of: int) -> Callable[[float], None] | None:
    """Progress of one run as a part of all of them."""
    if progress is None:
        return None
    return lambda fraction: progress((done + fraction) / of)
