"""The ``companion`` command: arguments in, one function call, tables or one JSON object out.

Heavy modules are imported inside the commands, so that ``--help`` answers at once. Exit status:
0 success, 1 a failure explained in one line on stderr, 2 wrong usage.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence
from typing import Annotated, NoReturn

import typer

from companion import __version__
from companion.cli.surface import live, logs, workshop
from companion.cli.surface.options import emit

app = typer.Typer(
    name="companion",
    help="Navigation for drones and vehicles: replay recorded flights through the filter, "
    "evaluate, export, simulate.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback(invoke_without_command=True)
def _root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
) -> None:
    if version:
        print(f"companion {__version__}")
        raise typer.Exit


# In the order of the help.
app.command(no_args_is_help=True)(logs.replay)
app.command(no_args_is_help=True)(live.run)
app.command(no_args_is_help=True)(logs.evaluate)
app.command(no_args_is_help=True)(logs.compare)
app.command(no_args_is_help=True)(logs.smooth)
app.command(no_args_is_help=True)(logs.export)
app.command(no_args_is_help=True)(logs.report)
app.command(no_args_is_help=True)(logs.satellites)
app.command(no_args_is_help=True)(workshop.tune)
app.command(no_args_is_help=True)(workshop.simulate)
app.command()(live.demo)
app.command(no_args_is_help=True)(live.check)
app.command()(live.watch)
app.command(no_args_is_help=True)(workshop.reproduce)
app.command(no_args_is_help=True)(logs.batch)
app.command()(workshop.bench)


def _fail(text: str, argv: Sequence[str]) -> NoReturn:
    """One line on stderr (and one JSON object where one was asked for); exit 1."""
    line = " ".join(text.split())
    print(f"error: {line}", file=sys.stderr)
    if "--json" in argv:
        emit({"error": line})
    sys.exit(1)


def main(argv: Sequence[str] | None = None) -> NoReturn:
    """Entry point: runs a command and turns every failure into one line and a status."""
    args = list(sys.argv[1:] if argv is None else argv)
    try:
        app(args, prog_name="companion")
    except BrokenPipeError:
        # The reader of our output went away (`| head`); nothing is left to tell it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        _fail(_one_line(error), args)
    sys.exit(0)


def _one_line(error: Exception) -> str:
    from companion.types import CompanionError

    if isinstance(error, CompanionError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'input/output'}: {error.strerror or error}"
    if isinstance(error, MemoryError):
        return "not enough memory for this log"
    if os.environ.get("COMPANION_DEBUG"):
        traceback.print_exception(error)
    return (
        f"internal error {type(error).__name__}: {error}; "
        "run with COMPANION_DEBUG=1 for the traceback"
    )
