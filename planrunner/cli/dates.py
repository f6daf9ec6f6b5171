"""Dates on the command line."""

from __future__ import annotations

from datetime import date

from planrunner.base.findings import COMMAND_LINE, InputError


def day_of(text: str | None) -> date | None:
    """Reads a date in ISO 8601 form; returns None if the text is None. Raises `InputError` for any other text."""
    try:
        return None if text is None else date.fromisoformat(text)
    except ValueError:
        message = f"'{text}' is not a calendar date"
        raise InputError.at(COMMAND_LINE, "meaning-date", message, "write for example 2028-12-31") from None
