"""The ``companion`` command: :mod:`app` is the surface, :mod:`commands` what it does."""

from companion.cli.app import main

__all__ = ["main"]
