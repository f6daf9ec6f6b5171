"""YAML text to nodes that know where they stand.

YAML 1.2 core meaning (`1e-3` is a number; `no` and `12:30` are strings; duplicate keys are errors), read from libyaml's
events without recursion, within limits on size, depth, nodes and aliases, so that no file can hurt the reader.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from planrunner.plan.findings import Findings, InputError, Mark

MAX_BYTES = 1_000_000
MAX_DEPTH = 40
MAX_NODES = 100_000
MAX_ALIASED_NODES = 10_000
MAX_SCALAR = 10_000

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_INT = re.compile(r"[-+]?[0-9]{1,18}|0o[0-7]{1,18}|0x[0-9a-fA-F]{1,15}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]{1,40}|[0-9]{1,40}(\.[0-9]{0,40})?)([eE][-+]?[0-9]{1,4})?")
_SPECIAL = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf"), float("inf")),
    "-.inf": float("-inf"),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), float("nan")),
}


@dataclass(frozen=True, slots=True)
class Scalar:
    """A scalar: `text` as written, `value` by YAML 1.2 core meaning (a quoted scalar is always a string)."""

    mark: Mark
    text: str
    value: str | int | float | bool | None


@dataclass(frozen=True, slots=True)
class Sequence:
    mark: Mark
    items: tuple[Node, ...]


@dataclass(frozen=True, slots=True)
class Mapping:
    mark: Mark
    entries: tuple[tuple[Scalar, Node], ...]

    def get(self, key: str) -> Node | None:
        return next((node for name, node in self.entries if name.text == key), None)

    def key_mark(self, key: str) -> Mark:
        """Where `key` itself is written, or where the mapping begins when it is absent."""
        return next((name.mark for name, _ in self.entries if name.text == key), self.mark)


Node = Scalar | Sequence | Mapping


def read_text(path: Path, shown: str | None = None, limit: int = MAX_BYTES) -> str:
    """The text of a UTF-8 file of at most `limit` bytes. Raises `InputError`, never `OSError`."""
    name = shown or str(path)
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except IsADirectoryError:
        raise InputError.at(Mark(name), "file-directory", "this is a folder, not a file", "name a file in it") from None
    except FileNotFoundError:
        raise InputError.at(Mark(name), "file-missing", "there is no such file", "check the path") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError.at(Mark(name), "file-unreadable", f"the file cannot be read: {reason}") from None
    if len(data) > limit:
        raise InputError.at(
            Mark(name), "file-size", f"the file is larger than {limit / 1e6:g} MB", "keep data apart from the plan"
        )
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        hint = "save the file as UTF-8 text"
        raise InputError.at(Mark(name, line), "file-encoding", "the file is not UTF-8 text", hint) from None
    return text


def load(path: Path, shown: str | None = None) -> Mapping:
    """The mapping a file holds. Raises `InputError` with `file:line:column` for whatever prevents that."""
    return parse(read_text(path, shown), shown or str(path))


def parse(text: str, file: str) -> Mapping:
    """The mapping that `text` holds; `file` is the name findings show."""
    builder = _Builder(file)
    try:
        for event in yaml.parse(text, Loader=_Loader):
            builder.take(event)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError.at(
            Mark(file, line), "syntax-character", "a character that YAML does not allow", "remove the control character"
        ) from None
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error, text, file) from None
    except yaml.YAMLError:
        raise InputError.at(Mark(file), "syntax", "this is not readable as YAML") from None
    if builder.root is None:
        raise InputError.at(Mark(file), "file-empty", "the file is empty", "start from `planrunner new`")
    if not isinstance(builder.root, Mapping):
        raise InputError.at(
            builder.root.mark, "form-type", "a mapping of keys is expected here", "start with `planrunner: 1`"
        )
    if builder.findings.errors:
        raise InputError(builder.findings)
    return builder.root


def _syntax_error(error: yaml.MarkedYAMLError, text: str, file: str) -> InputError:
    mark = error.problem_mark or error.context_mark
    line, column = (mark.line, mark.column) if mark else (0, 0)
    lines = text.split("\n")
    here = lines[line] if line < len(lines) else ""
    tab = here.find("\t")
    if tab >= 0 and not here[:tab].strip(" -?:"):
        return InputError.at(
            Mark(file, line + 1, tab + 1), "syntax-tab", "a tab is used for indentation", "indent with spaces"
        )
    problem = str(error.problem or "cannot be read")[:200]
    context = f" {str(error.context)[:100]}" if error.context else ""
    hint = "check indentation, brackets, quotes and the space after ':'"
    return InputError.at(Mark(file, line + 1, column + 1), "syntax", f"not valid YAML: {problem}{context}", hint)


class _Builder:
    """Takes parser events, one by one, and builds nodes on a stack of its own."""

    def __init__(self, file: str):
        self.file = file
        self.findings = Findings()
        self.root: Node | None = None
        self._stack: list[tuple[Mark, bool, list[Any], str | None]] = []
        self._anchors: dict[str, tuple[Node, int]] = {}
        self._nodes = 0
        self._aliased = 0
        self._documents = 0

    def take(self, event: Any) -> None:
        mark = Mark(self.file, event.start_mark.line + 1, event.start_mark.column + 1)
        match event:
            case yaml.DocumentStartEvent():
                self._documents += 1
                if self._documents > 1:
                    raise InputError.at(mark, "form-documents", "a second document begins here", "one document a file")
            case yaml.ScalarEvent():
                self._reject_tag(event, mark)
                if len(event.value) > MAX_SCALAR:
                    message = f"a text longer than {MAX_SCALAR} characters"
                    raise InputError.at(mark, "limit-text", message, "shorten it")
                plain = not event.style
                value = _resolve(event.value) if plain else event.value
                self._put(Scalar(mark, event.value, value), event.anchor)
            case yaml.SequenceStartEvent() | yaml.MappingStartEvent():
                self._reject_tag(event, mark)
                if len(self._stack) >= MAX_DEPTH:
                    raise InputError.at(
                        mark, "limit-depth", f"nested more than {MAX_DEPTH} levels deep", "flatten the structure"
                    )
                self._stack.append((mark, isinstance(event, yaml.MappingStartEvent), [], event.anchor))
            case yaml.SequenceEndEvent():
                start, _, items, anchor = self._stack.pop()
                self._put(Sequence(start, tuple(items)), anchor)
            case yaml.MappingEndEvent():
                start, _, items, anchor = self._stack.pop()
                self._put(self._mapping(start, items), anchor)
            case yaml.AliasEvent():
                self._alias(event.anchor, mark)

    def _reject_tag(self, event: Any, mark: Mark) -> None:
        if event.tag and event.tag != "!":
            raise InputError.at(mark, "syntax-tag", f"the tag {event.tag[:60]} is not allowed", "remove the tag")

    def _alias(self, anchor: str, mark: Mark) -> None:
        if anchor not in self._anchors:
            raise InputError.at(mark, "syntax-alias", f"*{anchor[:60]} has no &{anchor[:60]} before it")
        node, size = self._anchors[anchor]
        self._aliased += size
        if self._aliased > MAX_ALIASED_NODES:
            message = f"aliases repeat more than {MAX_ALIASED_NODES} values"
            raise InputError.at(mark, "limit-aliases", message, "use for_each instead of aliases")
        self._put(node, None)

    def _put(self, node: Node, anchor: str | None) -> None:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise InputError.at(node.mark, "limit-nodes", f"more than {MAX_NODES} values", "use for_each for repetition")
        if anchor:
            self._anchors[anchor] = (node, _size(node))
        if self._stack:
            self._stack[-1][2].append(node)
        else:
            self.root = node

    def _mapping(self, mark: Mark, items: list[Node]) -> Mapping:
        entries: list[tuple[Scalar, Node]] = []
        first: dict[str, Mark] = {}
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, Scalar):
                self.findings.error("form-key", key.mark, "a key must be a word", "write `key: value`")
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
        return Mapping(mark, tuple(entries))


def _size(node: Node) -> int:
    """How many nodes an alias of `node` stands for."""
    total, queue = 0, [node]
    while queue and total <= MAX_ALIASED_NODES:
        item = queue.pop()
        total += 1
        if isinstance(item, Sequence):
            queue.extend(item.items)
        elif isinstance(item, Mapping):
            queue.extend(value for _, value in item.entries)
    return total


def _resolve(text: str) -> str | int | float | bool | None:
    if text in _SPECIAL:
        return _SPECIAL[text]
    if _INT.fullmatch(text):
        prefix = {"0o": 8, "0x": 16}.get(text[:2])
        return int(text, prefix) if prefix else int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    return text


def plain(node: Node) -> Any:
    """The node as ordinary Python data, as a JSON Schema validator wants it."""
    if isinstance(node, Scalar):
        return node.value
    if isinstance(node, Sequence):
        return [plain(item) for item in node.items]
    return {key.text: plain(value) for key, value in node.entries}
