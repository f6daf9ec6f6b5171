"""Parses YAML text into nodes with source positions.

Texts are interpreted according to the core schema of YAML 1.2 (`1e-3` is a number; `no` and `12:30` are strings; duplicate keys are
errors). The nodes are read from libyaml's events without recursion, within limits on size, depth, nodes and aliases, so that no
file can harm the reader.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Protocol, TypeGuard

import yaml

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import MISLEADING, Findings, InputError, Mark
from planrunner.base.regular_files import RefusedFileError, read_regular

MAX_BYTES = 1_000_000
MAX_DEPTH = 40
MAX_NODES = 20_000
MAX_ALIASED_NODES = 10_000
MAX_SCALAR = 10_000

# Characters that YAML 1.2 does not allow, and line breaks of YAML 1.1 that editors do not count as line breaks.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]")
_BREAK = re.compile("\r\n|\r|\n")

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# Limited repetitions, so that matching is fast and no number is longer than the longest label.
_INT = re.compile(r"[-+]?[0-9]{1,18}|0o[0-7]{1,18}|0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]{1,30}|[0-9]{1,30}(\.[0-9]{0,30})?)([eE][-+]?[0-9]{1,9})?")
_SPECIAL = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), float("inf")),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), float("-inf")),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


@dataclass(frozen=True, slots=True)
class Written:
    """Contains a text and the name of its file. `file`: the file name that findings state."""

    file: str
    text: str | None = None


class Position(Protocol):
    """States a position in a text. The class has the same attributes as a mark of the YAML parser. Lines and columns count from
    0."""

    @property
    def line(self) -> int: ...

    @property
    def column(self) -> int: ...


class _Placed:
    """Base class for parts of a text that know their position.

    `begin`, `end`: the positions at which the part begins and ends; None for a part that was made in code. The attribute `mark` is
    computed only when it is needed, because a plan has hundreds of nodes, of which few appear in findings.
    """

    __slots__ = ("_begin", "_end", "_written")

    def __init__(self, written: Written, begin: Position | None = None, end: Position | None = None):
        self._written = written
        self._begin = begin
        self._end = end

    @property
    def mark(self) -> Mark:
        written, begin, end = self._written, self._begin, self._end
        if begin is None or end is None:
            return Mark(written.file)
        return Mark(written.file, begin.line + 1, begin.column + 1, (end.line + 1, end.column + 1), written.text)

    def precedes(self, other: Node) -> bool:
        """Returns True if this part begins on an earlier line than another part of the same text."""
        return self._begin is not None and other._begin is not None and self._begin.line < other._begin.line


class Scalar(_Placed):
    """A scalar. `text` is the text as written, and `value` is its value in the core schema of YAML 1.2; the value of a quoted
    scalar is always a string."""

    __slots__ = ("text", "value")

    def __init__(
        self,
        text: str,
        value: str | int | float | bool | None,
        written: Written,
        begin: Position | None = None,
        end: Position | None = None,
    ):
        self.text = text
        self.value = value
        self._written = written
        self._begin = begin
        self._end = end


class Sequence(_Placed):
    __slots__ = ("items",)

    def __init__(
        self,
        items: tuple[Node, ...],
        written: Written,
        begin: Position | None = None,
        end: Position | None = None,
    ):
        self.items = items
        super().__init__(written, begin, end)


class Mapping(_Placed):
    __slots__ = ("entries",)

    def __init__(
        self,
        entries: tuple[tuple[Scalar, Node], ...],
        written: Written,
        begin: Position | None = None,
        end: Position | None = None,
    ):
        self.entries = entries
        super().__init__(written, begin, end)

    def get(self, key: str) -> Node | None:
        return next((node for name, node in self.entries if name.text == key), None)


Node = Scalar | Sequence | Mapping


def read_bytes(path: Path, shown: str | None = None) -> bytes:
    """Reads a regular file of at most `MAX_BYTES` bytes; returns its contents. Raises `InputError`, never `OSError`."""
    try:
        return read_regular(path, MAX_BYTES)
    except RefusedFileError as refused:
        raise refused_input(refused, shown or str(path)) from None


def refused_input(refused: RefusedFileError, name: str) -> InputError:
    """Returns the error about a file that is refused. `name`: file name that the finding states."""
    mark, message, hint = Mark(name), str(refused), refused.hint
    match refused.kind:
        case "missing":
            hint = "check the path; `planrunner new` lists and copies the plans that come with planrunner"
            return InputError.at(mark, "file-missing", message, hint)
        case "folder":
            return InputError.at(mark, "file-directory", message, hint)
        case "special" | "link":
            return InputError.at(mark, "file-special", message, hint)
        case "size":
            return InputError.at(mark, "file-size", message, "store data separately from the plan")
        case "unreadable":
            return InputError.at(mark, "file-unreadable", message, hint)


def decode(data: bytes, name: str) -> str:
    """Decodes a UTF-8 file, with or without a byte-order mark. Raises `InputError` if the bytes are not UTF-8. `name`: file name
    that findings state."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8", "replace")
        message = f"not UTF-8 text: byte 0x{data[error.start]:02x} cannot be read"
        raise InputError.at(
            _mark_at(before, len(before), name), "file-encoding", message, "save the file as UTF-8 text"
        ) from None


def read_text(path: Path, shown: str | None = None) -> str:
    """Returns the text of a file (see `read_bytes` and `decode`)."""
    return decode(read_bytes(path, shown), shown or str(path))


def load(path: Path, shown: str | None = None) -> Mapping:
    """Reads the mapping in a file. Raises `InputError` with `file:line:column` if it cannot be read (see `parse`)."""
    return parse(read_text(path, shown), shown or str(path))


def parse(text: str, file: str, log: Findings | None = None) -> Mapping:
    """Parses the mapping in `text`. `file`: file name that findings state.

    Raises `InputError` if the text is not a mapping that can be read. After some faults, such as duplicate keys, the rest of the
    text can still be read. If `log` is given, findings about such faults are added to it, and no exception is raised.
    """
    if forbidden := _forbidden(text):
        raise _not_allowed(forbidden[0], _mark_at(text, forbidden.start(), file))
    builder = _Builder(Written(file, text))
    try:
        loader = _Loader(text)
        try:
            builder.take(iter(loader.get_event, None))
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, text, file) from None
    except (yaml.YAMLError, UnicodeError, ValueError):
        raise InputError.at(
            Mark(file, text=text), "syntax", "this is not readable as YAML", "check brackets, quotes and escapes"
        ) from None
    if builder.root is None or (isinstance(builder.root, Scalar) and builder.root.value is None):
        raise InputError.at(
            Mark(file), "file-empty", "the file is empty", "start from a plan that `planrunner new` copies"
        )
    if not isinstance(builder.root, Mapping):
        message = "the file must contain keys and values, `key: value` on each line"
        raise InputError.at(builder.root.mark, "form-type", message, "start with `planrunner: 1`")
    if log is not None:
        log.extend(builder.findings.items)
    elif builder.findings.errors:
        raise InputError(builder.findings)
    return builder.root


def _forbidden(text: str) -> re.Match[str] | None:
    """Returns the first character in the text that a file must not contain, directly or as an escape; None if there is none."""
    return _FORBIDDEN.search(text) or MISLEADING.search(text)


def _not_allowed(char: str, mark: Mark) -> InputError:
    why = ": it is invisible and changes how the surrounding text appears" if MISLEADING.match(char) else ""
    message = f"the character U+{ord(char):04X} is not allowed in YAML text{why}"
    return InputError.at(mark, "syntax-character", message, "remove it, or save the file as plain text")


def _mark_at(text: str, position: int, file: str) -> Mark:
    breaks = [match.end() for match in _BREAK.finditer(text, 0, position)]
    return Mark(file, len(breaks) + 1, position - (breaks[-1] if breaks else 0) + 1, text=text)


# Messages of libyaml, and what to show instead to readers who do not know what a token is.
_PLAIN_WORDS = {
    "mapping values are not allowed in this context": "a ':' is in a place where no key is possible: a text that contains "
    "': ' needs quotes",
    "did not find expected key": "a key is expected here: this line is not indented like the lines around it, or a quote or "
    "bracket is open",
    "could not find expected ':'": "a ':' is missing after this key",
    "did not find expected ',' or ']'": "a list opened with '[' is not closed: ',' or ']' is missing",
    "did not find expected ',' or '}'": "a mapping opened with '{' is not closed: ',' or '}' is missing",
    "did not find expected '-' indicator": "a list entry beginning with '-' is expected here: check the indentation",
    "found unexpected end of stream": "the file ends inside a quoted text: the closing quote is missing",
    "did not find expected node content": "a value is missing here",
    "found character that cannot start any token": "this character cannot begin a value: put the text in quotes",
    "did not find expected <document start>": "text follows after the end of the content",
    "block sequence entries are not allowed in this context": "a list entry '- ' cannot begin here: put it on a "
    "separate line",
}


def _syntax_error(error: yaml.MarkedYAMLError, text: str, file: str) -> InputError:
    open_quote = error.problem == "found unexpected end of stream"
    mark = (open_quote and error.context_mark) or error.problem_mark or error.context_mark
    line, column = (mark.line, mark.column) if mark else (0, 0)
    lines = _BREAK.split(text)
    here = lines[line] if line < len(lines) else ""
    tab = here.find("\t")
    if tab >= 0 and not here[:tab].strip(" -?:"):
        message = "a tab is used for indentation"
        return InputError.at(Mark(file, line + 1, tab + 1, text=text), "syntax-tab", message, "indent with spaces")
    problem = str(error.problem or "cannot be read")[:200]
    opened = (
        f" (it began on line {error.context_mark.line + 1})"
        if error.context_mark and error.context_mark.line != line
        else ""
    )
    hint = "check indentation, brackets, quotes and the space after ':'"
    return InputError.at(
        Mark(file, line + 1, column + 1, text=text),
        "syntax",
        f"not valid YAML: {_PLAIN_WORDS.get(problem, problem)}{opened}",
        hint,
    )


@dataclass(slots=True)
class _Open:
    """A sequence or mapping whose end has not been read yet.

    `around`: the nodes of the enclosing collection that come before this one. `before`: number of all nodes in the file before this
    one. An alias counts as all nodes to which it refers."""

    start: yaml.CollectionStartEvent
    around: list[Node]
    before: int


class _Builder:
    """Builds nodes from parser events on an explicit stack."""

    def __init__(self, written: Written):
        self.findings = Findings()
        self._written = written
        self._stack: list[_Open] = []
        self._items: list[Node] = []  # of the innermost open sequence or mapping; outside, the root
        self._anchors: dict[str, tuple[Node, int]] = {}
        self._nodes = 0
        self._written_out = 0  # nodes, with aliases written out
        self._aliased = 0
        self._documents = 0

    @property
    def root(self) -> Node | None:
        return self._items[0] if self._items else None

    def take(self, events: Iterable[yaml.Event]) -> None:
        for event in events:
            if isinstance(event, yaml.ScalarEvent):  # most events are
                self._put(self._scalar(event), event.anchor, 1)
            elif isinstance(event, yaml.CollectionEndEvent):
                done, items = self._stack.pop(), self._items
                self._items = done.around
                begin, end = done.start.start_mark, event.end_mark
                node = (
                    Mapping(self._entries(items), self._written, begin, end)
                    if isinstance(event, yaml.MappingEndEvent)
                    else Sequence(tuple(items), self._written, begin, end)
                )
                self._put(node, done.start.anchor, 1, self._written_out - done.before)
            elif isinstance(event, yaml.CollectionStartEvent):
                if event.tag:
                    self._reject_tag(event)
                if len(self._stack) >= MAX_DEPTH:
                    message = f"nested more than {MAX_DEPTH} levels deep"
                    raise InputError.at(self._mark(event), "limit-depth", message, "flatten the structure")
                self._stack.append(_Open(event, self._items, self._written_out))
                self._items = []
            elif isinstance(event, yaml.AliasEvent):
                self._alias(str(event.anchor), self._mark(event))
            elif isinstance(event, yaml.DocumentStartEvent):
                self._documents += 1
                if self._documents > 1:
                    raise InputError.at(
                        self._mark(event),
                        "form-documents",
                        "a second document begins here",
                        "write one document per file",
                    )

    def _scalar(self, event: yaml.ScalarEvent) -> Scalar:
        text, style, tag = event.value, event.style, event.tag
        if tag:
            self._reject_tag(event)
        if len(text) > MAX_SCALAR:
            message = f"a text longer than {MAX_SCALAR} characters"
            raise InputError.at(self._mark(event), "limit-text", message, "shorten it")
        # The text itself has none (see `parse`), but an escape may stand for one.
        if style == '"' and (forbidden := _forbidden(text)):
            raise _not_allowed(forbidden[0], self._mark(event))
        value = text if style or tag == "!" else _resolve(text)
        return Scalar(text, value, self._written, event.start_mark, event.end_mark)

    def _mark(self, event: yaml.Event) -> Mark:
        return _Placed(self._written, event.start_mark, event.end_mark).mark

    def _reject_tag(self, event: yaml.ScalarEvent | yaml.CollectionStartEvent) -> None:
        if event.tag and event.tag != "!":
            message = f"the tag {event.tag[:60]} is not allowed"
            raise InputError.at(self._mark(event), "syntax-tag", message, "remove the tag")

    def _alias(self, anchor: str, mark: Mark) -> None:
        if anchor not in self._anchors:
            message = f"*{anchor[:60]} has no target: there is no &{anchor[:60]} before it"
            raise InputError.at(
                mark, "syntax-alias", message, "write the value itself, or quote a text that begins with *"
            )
        node, size = self._anchors[anchor]
        self._aliased += size
        if self._aliased > MAX_ALIASED_NODES:
            message = f"aliases repeat more than {MAX_ALIASED_NODES} values"
            raise InputError.at(mark, "limit-aliases", message, "use for_each instead of aliases")
        self._put(node, None, size)

    def _put(self, node: Node, anchor: str | None, size: int, inside: int = 0) -> None:
        """Adds a node to the open collection. `size`: number of nodes that are added with it; an alias counts as all the nodes to
        which it refers. `inside`: number of nodes within this node that have already been counted."""
        self._nodes += 1
        self._written_out += size
        if self._nodes > MAX_NODES:
            raise InputError.at(
                node.mark, "limit-nodes", f"more than {MAX_NODES} values", "use for_each for repetition"
            )
        if anchor:
            self._anchors[anchor] = node, size + inside
        self._items.append(node)

    def _entries(self, items: list[Node]) -> tuple[tuple[Scalar, Node], ...]:
        """Returns the entries of a mapping, made from a list in which keys and values alternate."""
        pairs = tuple(zip(items[::2], items[1::2], strict=True))
        if _sound(pairs):
            return pairs
        entries: list[tuple[Scalar, Node]] = []
        first: dict[str, Mark] = {}
        for key, value in pairs:
            if not isinstance(key, Scalar):
                self.findings.error(
                    "form-key", key.mark, "a key must be a word, not a list or a mapping", "write `key: value`"
                )
                continue
            if key.text == "<<":
                message = "'<<' has no effect: YAML 1.2 has no merge keys"
                self.findings.error(
                    "syntax-merge", key.mark, message, "use `defaults` or nested `steps` for keys that segments share"
                )
                continue
            if key.text in first:
                self.findings.error(
                    "syntax-duplicate-key",
                    key.mark,
                    f"'{key.text[:60]}' is given twice (first on line {first[key.text].line})",
                    "keep one of them",
                )
                continue
            first[key.text] = key.mark
            entries.append((key, value))
        return tuple(entries)


def _sound(pairs: tuple[tuple[Node, Node], ...]) -> TypeGuard[tuple[tuple[Scalar, Node], ...]]:
    """Returns True if all keys of a mapping are scalars with different texts, and none of them is a merge key."""
    names = {key.text for key, _ in pairs if type(key) is Scalar}
    return len(names) == len(pairs) and "<<" not in names


@lru_cache(maxsize=4096)
def _resolve(text: str) -> str | int | float | bool | None:
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INT.fullmatch(text):
        prefix = {"0o": 8, "0x": 16}.get(text[:2])
        return int(text, prefix) if prefix else int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def plain(node: Node) -> Json:
    """Converts a node to plain Python data, for a JSON Schema validator."""
    if isinstance(node, Scalar):
        return node.value
    if isinstance(node, Sequence):
        return [plain(item) for item in node.items]
    return {key.text: plain(value) for key, value in node.entries}
