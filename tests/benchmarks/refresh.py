"""Run the commands of docs/results.md again and put their output in the place of the old one.

``python -m tests.benchmarks.refresh [WORD]``: those whose command contains WORD, or all of them
(about a quarter of an hour). A command is the first line of a ``console`` block, after ``$``.
"""

from __future__ import annotations

import re
import shlex
import subprocess
import sys

from tests.benchmarks.common import ROOT

RESULTS = ROOT / "docs" / "results.md"
_BLOCK = re.compile(r"```console\n\$ (?P<command>[^\n]+)\n.*?```", re.DOTALL)
_PROGRESS = re.compile(r"^(Measuring|Vehicle \w+): \d+%$|^\w+ the numerical kernels")
_LIMIT_S = 1800.0


def output(command: str) -> str:
    """What ``command`` prints, run with this interpreter in the repository; progress left out."""
    words = shlex.split(command)
    words[:1] = [sys.executable, *(["-m", "companion"] if words[0] == "companion" else [])]
    done = subprocess.run(
        words, cwd=ROOT, capture_output=True, text=True, timeout=_LIMIT_S, check=False
    )
    if done.returncode:
        sys.exit(f"{command}: {done.stderr.strip()[-500:]}")
    kept = [line.rstrip() for line in done.stdout.splitlines() if not _PROGRESS.match(line)]
    return "\n".join(kept).strip("\n")


def main(word: str) -> None:
    """Refresh one block after the other; each is written as soon as it is known."""
    commands = [m["command"] for m in _BLOCK.finditer(RESULTS.read_text(encoding="utf-8"))]
    for command in commands:
        if word not in command:
            continue
        print(f"$ {command}", flush=True)
        new = f"```console\n$ {command}\n{output(command)}\n```"
        text = RESULTS.read_text(encoding="utf-8")
        for block in _BLOCK.finditer(text):
            if block["command"] == command:
                text = text[: block.start()] + new + text[block.end() :]
                break
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "")
