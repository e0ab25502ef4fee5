"""What goes wrong in a way that a user can be told in one line."""

from __future__ import annotations


class CompanionError(Exception):
    """Base of every error that the project raises on purpose; its text is one line for a user."""


class ConfigError(CompanionError):
    """A configuration that cannot be used; names the key, its unit and what would be right."""


class LogFormatError(CompanionError):
    """A log that cannot be read at all, or that holds nothing which can be navigated with."""


class ImuTooSlowError(LogFormatError):
    """The best inertial source is slower than a strapdown filter can use; names the rate."""


class LinkLost(CompanionError):
    """A device or connection that was open is gone: the owner closes it and opens it again."""
