"""Each tutorial, followed by its own text alone but for the installation."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest

_BLOCK = re.compile(r"^```sh ?(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
PATIENCE_S = 300.0


@pytest.fixture
def place(tmp_path: Path, root: Path) -> Path:
    """Like a clone in which ``make run`` was done."""
    for name in ("companion", "configs", "drivers", "examples", "replay"):
        (tmp_path / name).symlink_to(root / name)
    (tmp_path / "out").mkdir()
    commands = tmp_path / ".venv" / "bin"
    commands.mkdir(parents=True)
    (commands / "activate").write_text("")
    for name, words in (("python", ""), ("companion", "-m companion")):
        command = commands / name
        command.write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n')
        command.chmod(0o755)
    return tmp_path


def _beside(stack: ExitStack, words: list[str], place: Path, environment: dict[str, str]) -> None:
    """A block in a terminal of its own, until it says that it is there; ended with the stack."""
    said = place / "beside.txt"
    with said.open("w") as file:
        child = subprocess.Popen(
            words, cwd=place, env=environment, stdin=subprocess.PIPE, stdout=file, stderr=file,
            process_group=0,
        )  # fmt: skip
    stack.enter_context(child)
    stack.callback(_end, child.pid)
    until = time.monotonic() + PATIENCE_S
    while not re.search("ready|Published", said.read_text()):
        assert child.poll() is None
        assert time.monotonic() < until
        time.sleep(0.1)


def _end(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGTERM)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("tutorial-logs", ["flight.html", "tuned.toml", "track.kml", "fleet/index.html"]),
        ("tutorial-autopilot", ["quad.mcap", "quad.html"]),
        ("tutorial-ground-tool", ["states.txt", "flight.mcap"]),
    ],
)
def test_its_commands_do_what_it_says(name: str, left: list[str], place: Path, root: Path) -> None:
    text = (root / "docs" / f"{name}.md").read_text(encoding="utf-8")
    environment = {
        **os.environ,
        "PATH": f"{place / '.venv' / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(root),
    }
    with ExitStack() as stack:
        for kind, block in _BLOCK.findall(text):
            words = ["bash", "-e", "-c", block]
            if kind == "background":
                _beside(stack, words, place, environment)
            elif not kind:
                done = subprocess.run(
                    words, cwd=place, env=environment, capture_output=True, text=True,
                    timeout=PATIENCE_S, check=False,
                )  # fmt: skip
                assert done.returncode == 0, f"{block}\n{done.stdout}\n{done.stderr}"
    for file in left:
        assert (place / "out" / file).stat().st_size > 0
