"""Reads the values of a JSON file one after the other, so that the required memory does not grow with the length of the file."""

from __future__ import annotations

import codecs
import json
import re
from collections.abc import Iterator
from typing import BinaryIO

from planrunner.instruments.interfaces import InstrumentError

PIECE = 1 << 18
"""Number of bytes that are read together."""
MAX_VALUE = 1 << 22
"""Maximum number of characters of a value that is decoded as a whole, such as one sample."""
_DEEPEST = 50  # levels of nested values
_SPACE = re.compile(r"[ \t\r\n]*")
_WORDS = ("true", "false", "null", "NaN", "Infinity", "-Infinity")
_ESCAPE = 6  # characters of an escape such as \\u00e9
_PART = re.compile(r"\.|[eE][+-]?")  # end of an incomplete number
_NUMBERED = re.compile(r'"\d+"')


class JsonScanner:
    """Reads JSON values from an open file in UTF-8. `name`: name of the file, used in messages.

    `truncated`: True if the file ended within a value, a list or an object. Such a value is not yielded.
    """

    def __init__(self, file: BinaryIO, name: str):
        self.name = name
        self.truncated = False
        self._file = file
        self._decode = codecs.getincrementaldecoder("utf-8-sig")().decode
        self._scan = json.JSONDecoder().raw_decode
        self._text, self._at, self._began = "", 0, 0
        self._line, self._column = 1, 1  # place of the first character of the text
        self._ended = False

    def peek(self) -> str:
        """Returns the next character that is not a blank, without reading it; empty at the end of the file."""
        while True:
            self._at = _SPACE.match(self._text, self._at).end()  # type: ignore[union-attr]
            if self._at < len(self._text):
                return self._text[self._at]
            if self._ended:
                return ""
            self._more()

    def place(self) -> str:
        """Returns a text that names the place of the value that was read last, for messages."""
        return self._named(self._began)

    @property
    def left(self) -> int:
        """Returns the approximate number of bytes that were read from the file, but not decoded yet."""
        return len(self._text) - self._at

    def value(self) -> object:
        """Reads the next value as a whole. Raises `InstrumentError` if it is not correct JSON, or is longer than `MAX_VALUE`."""
        self.peek()
        while True:
            try:
                value, end = self._scan(self._text, self._at)
            except json.JSONDecodeError as error:
                wrong, place = f"{error.msg[:1].lower()}{error.msg[1:]}", error.pos
            except (RecursionError, ValueError):
                raise self._fault("the value is nested too deeply, or contains a number with too many digits") from None
            else:
                if (end < len(self._text) and not _PART.fullmatch(self._text, end)) or self._ended:
                    self._began, self._at = self._at, end
                    return value
                wrong, place = "", end
            cut = self._is_cut(wrong, place)
            if self._ended:
                self.truncated = cut
                raise self._fault(wrong, place)
            if len(self._text) - self._at > MAX_VALUE:
                raise (
                    self._fault(f"the value is longer than {MAX_VALUE} characters")
                    if cut
                    else self._fault(wrong, place)
                )
            self._more()

    def values(self) -> Iterator[object]:
        """Yields all values of a file in which values follow each other, as in JSON lines."""
        while self.peek():
            value = self._last_value()
            if self.truncated:
                return
            yield value

    def elements(self) -> Iterator[None]:
        """Reads a list. Each time the iterator yields, the caller reads one element. An object whose keys are numbers is read like
        a list."""
        if self.peek() == "{":
            yield from (None for _ in self.members())
            return
        self._take("[")
        following = self.peek()
        while following != "]":
            yield None
            following = self.peek()
            if following == "," and not self.truncated:
                self._at += 1
                following = self.peek()
                if following == "]":
                    raise self._fault("an element is missing after the comma")
            elif self._stopped(following):
                return
            elif following != "]":
                raise self._fault("a comma or ] is missing between two elements")
        self._at += 1

    def records(self) -> Iterator[object]:
        """Yields the elements of a list, each as a whole. An element that the file does not contain completely is omitted."""
        for _ in self.elements():
            value = self._last_value()
            if self.truncated:
                return
            yield value

    def members(self) -> Iterator[str]:
        """Reads an object, and yields its keys. Each time the iterator yields, the caller reads the value of the key."""
        self._take("{")
        following = self.peek()
        while following != "}":
            key = self.value() if following == '"' else None
            if not isinstance(key, str):
                raise self._fault("a key in quotes is missing")
            self._take(":")
            yield key
            following = self.peek()
            if following == "," and not self.truncated:
                self._at += 1
                following = self.peek()
            elif self._stopped(following):
                return
            elif following != "}":
                raise self._fault("a comma or } is missing after a value")
        self._at += 1

    def skip(self, depth: int = 0) -> None:
        """Reads the next value of any length, and discards it."""
        if depth > _DEEPEST:
            raise self._fault("the value is nested too deeply")
        opening = self.peek()
        if opening == "{":
            for _ in self.members():
                self.skip(depth + 1)
        elif opening == "[":
            for _ in self.elements():
                self.skip(depth + 1)
        else:
            self.value()

    def numbered(self) -> bool:
        """Returns True if the next value is an object whose first key is a number, as pandas writes a column."""
        if self.peek() != "{":
            return False
        while len(self._text) - self._at < 100 and not self._ended:
            self._more()
        after = _SPACE.match(self._text, self._at + 1).end()  # type: ignore[union-attr]
        return _NUMBERED.match(self._text, after) is not None

    def _is_cut(self, wrong: str, place: int) -> bool:
        """Returns True if the decoder stopped at `place` with the message `wrong` because the text ends there."""
        rest = self._text[place:].strip()
        part = _PART.fullmatch(rest) is not None or (wrong.startswith("invalid \\u") and len(rest) < _ESCAPE)
        return part or wrong.startswith("unterminated") or any(one.startswith(rest) for one in _WORDS)

    def _last_value(self) -> object:
        """Reads the next value. If it is incomplete because the file ends within it, sets `truncated` and returns None."""
        try:
            return self.value()
        except InstrumentError:
            if self.truncated:
                return None
            raise

    def _stopped(self, following: str) -> bool:
        """Returns True if the file ends within a list or an object, for example because the logger lost power."""
        self.truncated = self.truncated or not following
        return self.truncated

    def _take(self, expected: str) -> None:
        if self.peek() != expected:
            raise self._fault(f"'{expected}' is missing")
        self._at += 1

    def _more(self) -> None:
        """Reads the next piece of the file, and discards the text that has been processed."""
        done = self._text[: self._at]
        if "\n" in done:
            self._line += done.count("\n")
            self._column = len(done) - done.rfind("\n")
        else:
            self._column += len(done)
        piece = self._file.read(PIECE)
        try:
            self._text = self._text[self._at :] + self._decode(piece, not piece)
        except UnicodeDecodeError:
            message = f"it is not UTF-8 text after line {self._line}"
            raise InstrumentError(f"{self.name} cannot be read: {message}; save it again as UTF-8") from None
        self._at, self._began, self._ended = 0, 0, not piece

    def _named(self, at: int) -> str:
        before = self._text[:at]
        line = self._line + before.count("\n")
        column = at - before.rfind("\n") if "\n" in before else self._column + at
        return f"line {line}, column {column}"

    def _fault(self, message: str, at: int | None = None) -> InstrumentError:
        where = self._named(self._at if at is None else at)
        return InstrumentError(f"{self.name}, {where}: {message}; correct the file there, or remove this sample")
