"""Text that comes from files, for a terminal that it must not drive.

Labels, paths and answers of instruments may hold control characters that erase lines, set a window's title or reverse the reading
order. They are shown as codes at one place, the stream itself, whatever printed them. What planrunner sends to steer the terminal, such
as colours, goes to the stream `beneath`.
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
    r"""A character as a code such as `\x1b` or `\u202e`."""
    number = ord(char)
    return f"\\x{number:02x}" if number < 0x100 else f"\\u{number:04x}" if number < 0x10000 else f"\\U{number:08x}"


def printable(text: str, keep: str = "\n", code: Callable[[str], str] = escape) -> str:
    """Control characters, marks of the reading order and other characters without a shape as codes, but those in `keep`, and spaces of
    any width, as they are."""
    if text.replace("\n", "").isprintable() and ("\n" in keep or "\n" not in text):
        return text
    return "".join(char if char in keep or _shown(char) else code(char) for char in text)


def _shown(char: str) -> bool:
    return char.isprintable() or unicodedata.category(char) == "Zs"


class PrintableStream(io.TextIOBase):
    """A stream of text on which nothing that is printed drives the terminal. stream: the one beneath."""

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
        """The stream beneath belongs to the process and stays open."""


def beneath(stream: TextIO) -> TextIO:
    """The stream that reaches the terminal as it stands, for colours and for text that is printable already."""
    return stream.stream if isinstance(stream, PrintableStream) else stream


@contextlib.contextmanager
def printable_streams() -> Iterator[None]:
    """Standard output and standard error as printable streams, for as long as a command runs."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (
        stream if stream is None or isinstance(stream, PrintableStream) else PrintableStream(stream)
        for stream in before
    )
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
