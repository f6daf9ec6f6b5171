"""Contains the parts that simulated message-based instruments share: a reply to each message, delayed replies, and faults."""

from __future__ import annotations

from typing import Protocol


class NotUnderstoodError(ValueError):
    """Reports a message that the instrument does not understand, or a value that it refuses."""


class Controller(Protocol):
    identity: str
    """Reply to an identity query."""

    def answer(self, message: str) -> str | None:
        """Returns the reply to a message, both without terminators; None if there is no reply."""

    def later(self) -> list[str]:
        """Returns delayed replies that have become due since the last call; empty for instruments that reply at once."""

    def watch(self) -> None:
        """Checks the limits of the instrument. The method is called many times per second."""


def first_with(word: str, options: tuple[str, ...]) -> str:
    """Returns the first option that begins with `word`; upper and lower case count as equal. Raises `NotUnderstoodError` if there
    is none."""
    found = next((option for option in options if word and option.startswith(word.lower())), None)
    if found is None:
        raise NotUnderstoodError(word)
    return found


def number(word: str) -> float:
    """Converts a word of a message to a number. Raises `NotUnderstoodError` if the text is not a number."""
    try:
        return float(word)
    except ValueError:
        raise NotUnderstoodError(word) from None


def shown(value: float, digits: int = 6) -> str:
    """Writes a number as instruments do, without trailing zeros, and with a zero that has no sign."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
