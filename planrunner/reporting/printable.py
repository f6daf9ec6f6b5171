"""Converts text from files to a form that cannot control the terminal.

Labels, paths and replies of instruments may contain control characters that erase lines, set a window's title or reverse the
reading order. The text streams of this module show these characters as codes, so no part of the program can print them directly.
planrunner's own control sequences, such as colours, go to the underlying stream (`beneath`).
"""

from __future__ import annotations

import contextlib
import io
import sys
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from typing import TextIO

LINES = "\n\t"


def escape(char: str) -> str:
    r"""Returns a character as a code such as `\x1b` or `\u202e`."""
    number = ord(char)
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def printable(text: str, keep: str = "\n", code: Callable[[str], str] = escape) -> str:
    """Returns a text in which control characters, reading-order marks and other invisible characters are shown as codes. Characters
    in `keep` and spaces of any width are unchanged."""
    if text.replace("\n", "").isprintable() and ("\n" in keep or "\n" not in text):
        return text
    return "".join(char if char in keep or _shown(char) else code(char) for char in text)


def _shown(char: str) -> bool:
    return char.isprintable() or unicodedata.category(char) == "Zs"


class PrintableStream(io.TextIOBase):
    """A text stream on which printed text cannot control the terminal. `stream`: the underlying stream."""

    def __init__(self, stream: TextIO):
        self.stream = stream

    def write(self, text: str) -> int:
        self.stream.write(printable(text, LINES))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:  # type: ignore[override]
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        self.stream.flush()

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self.stream.isatty()

    def fileno(self) -> int:
        return self.stream.fileno()

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self.stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return self.stream.errors

    @property
    def closed(self) -> bool:
        return self.stream.closed

    def close(self) -> None:
        """Does nothing: the underlying stream must stay open because it belongs to the process."""


def beneath(stream: TextIO) -> TextIO:
    """Returns the underlying stream, whose output reaches the terminal unchanged. This stream is used for colours and for text that
    is already printable."""
    return stream.stream if isinstance(stream, PrintableStream) else stream


@contextlib.contextmanager
def printable_streams() -> Iterator[None]:
    """Replaces standard output and standard error by printable streams while a command runs."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        stream if stream is None or isinstance(stream, PrintableStream) else PrintableStream(stream)
        for stream in before
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
