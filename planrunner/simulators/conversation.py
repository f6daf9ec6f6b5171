"""Parts of a message-based simulated instrument: a reply to each message, delayed replies, and faults."""

from __future__ import annotations

from typing import Protocol


class NotUnderstoodError(ValueError):
    """A message that the instrument does not understand, or a value that it refuses."""


class Controller(Protocol):
    identity: str
    """Reply to an identity query."""

    def answer(self, message: str) -> str | None:
        """The reply to a message (both without terminators); None if there is no reply."""

    def later(self) -> list[str]:
        """Replies that have become due since the last call; empty for instruments that only reply to messages."""

    def watch(self) -> None:
        """Checks the limits of the instrument. It is called many times per second."""


def first_with(word: str, options: tuple[str, ...]) -> str:
    """The first option that a word abbreviates, ignoring case. Raises `NotUnderstoodError`."""
    found = next((option for option in options if word and option.startswith(word.lower())), None)
    if found is None:
        raise NotUnderstoodError(word)
    return found


def number(word: str) -> float:
    """The number in a message. Raises `NotUnderstoodError`."""
    try:
        return float(word)
    except ValueError:
        raise NotUnderstoodError(word) from None


def shown(value: float, digits: int = 6) -> str:
    """A number in the form that instruments write, without an unnecessary fraction or the sign of zero."""
    text = f"{value:.{digits}f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
