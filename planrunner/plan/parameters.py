"""Replaces the values of parameters in the text of a plan. A parameter is a value with a YAML anchor, such as `dwell: &dwell 2
min`. A run or a suite may replace this value.

A plan with other values for its parameters is a different plan. The text of the new plan differs only in these values; every other
line keeps its position. The run stores the changed text, so readers of the run need nothing else.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence

import yaml

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import COMMAND_LINE, Findings, InputError, Mark, closest

NAME = r"[A-Za-z0-9_-]{1,60}"
"""Form of the name of a parameter, which is the name of a YAML anchor."""
VALUE = r"[^\x00-\x1f]{1,200}"

_Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True, slots=True)
class Given:
    """Contains a value that the user gives for a parameter, and where the user gave it (a file or the command line)."""

    value: str
    mark: Mark


def parameters_of(settings: Sequence[str]) -> dict[str, Given]:
    """Reads the values from the options `--parameter NAME=VALUE`. Raises `InputError` for an option that has another form."""
    log, found = Findings(), dict[str, Given]()
    for setting in settings:
        name, _, value = (part.strip() for part in setting.partition("="))
        if not re.fullmatch(NAME, name) or not re.fullmatch(VALUE, value):
            message = f"--parameter {setting[:60]} gives no value"
            log.error(
                "parameter-value", COMMAND_LINE, message, "write --parameter NAME=VALUE, with the value on one line"
            )
        elif name in found:
            message = f"the parameter '{name}' is given twice"
            log.error("parameter-duplicate", COMMAND_LINE, message, "give it once")
        else:
            found[name] = Given(value, COMMAND_LINE)
    if log.errors:
        raise InputError(log)
    return found


@dataclass(frozen=True, slots=True)
class Varied:
    """Contains the text of a plan whose parameters have other values. `places`: maps each parameter to the position of its value in
    `text`."""

    text: str
    places: Mapping[str, Mark]


@dataclass(frozen=True, slots=True)
class _Anchored:
    """A value with an anchor. `start`: index of the anchor in the text. `begin`, `end`: indices of the text of the value, without
    its anchor; they are equal if the value is not a scalar on one line."""

    mark: Mark
    start: int
    begin: int
    end: int
    quoted: bool


def variant_name(plan: str, parameters: Mapping[str, str]) -> str:
    """Returns the name that the plan has in the archive if it runs with these values. A plan with other values is a different plan,
    so its results belong to another history. The order in which the values were given does not change the name."""
    if not parameters:
        return plan
    return f"{plan} ({', '.join(f'{name}={value}' for name, value in sorted(parameters.items()))})"


def with_parameters(text: str, file: str, given: Mapping[str, Given]) -> Varied:
    """Returns the text of the plan with these values for its parameters. Raises `InputError` for a name that is not a parameter of
    the plan. Text that is not valid YAML is returned unchanged."""
    log = Findings()
    try:
        found = _anchored(text, file, log)
    except yaml.YAMLError:
        return Varied(text, {})
    changes = []
    for name, new in given.items():
        if name not in found:
            usable = [other for other, place in found.items() if place.begin < place.end]
            message = f"the plan has no parameter '{name[:60]}'"
            hint = closest(name, usable) or f"mark the value in the plan with an anchor: `&{name[:60]} value`"
            log.error("parameter-unknown", new.mark, message, hint)
        elif found[name].begin == found[name].end:
            message = f"&{name[:60]} in line {found[name].mark.line} of the plan is not a single value on one line"
            log.error("parameter-unknown", new.mark, message, "put the anchor before a number, a quantity or a word")
        else:
            changes.append((found[name], name, new))
    if log.errors:
        raise InputError(log)
    places: dict[str, tuple[int, int, int]] = {}  # line, column and length in the new text
    for place, name, new in sorted(changes, key=lambda change: -change[0].begin):
        written = _written(new.value, quoted=place.quoted)
        grown = len(written) - (place.end - place.begin)
        text = text[: place.begin] + written + text[place.end :]
        line, column = place.mark.line, place.mark.column
        for other, (there, at, size) in places.items():  # those behind this one
            if there == line:
                places[other] = there, at + grown, size
        places[name] = line, column, place.begin - place.start + len(written)
    return Varied(
        text,
        {name: Mark(file, line, at, (line, at + size), text) for name, (line, at, size) in places.items()},
    )


def _written(value: str, *, quoted: bool) -> str:
    """Returns a value as YAML text. Quotes are omitted only if `quoted` is False and YAML reads the same text without quotes at any
    place in a file."""
    return value if not quoted and _is_plain(value) else json.dumps(value, ensure_ascii=False)


def _is_plain(value: str) -> bool:
    if value == "-" or re.search("[?:]", value):  # an entry of a list; parsers differ in where they end the others
        return False
    try:
        events = list(yaml.parse(f"[{value}]", _Loader))
    except yaml.YAMLError:
        return False
    scalars = [event for event in events if isinstance(event, yaml.NodeEvent)][1:]
    if len(scalars) != 1 or not isinstance(scalars[0], yaml.ScalarEvent):
        return False
    one = scalars[0]
    return bool(one.value == value and one.anchor is None and one.tag is None and one.style in (None, ""))


def _anchored(text: str, file: str, log: Findings) -> dict[str, _Anchored]:
    """Returns the values that have an anchor, by the name of the anchor. An anchor name with two values causes a finding."""
    found: dict[str, _Anchored] = {}
    for event, is_key in _nodes(text):
        if event.anchor is None:
            continue
        start, end = event.start_mark, event.end_mark
        assert start is not None and end is not None  # the parser marks every event
        mark = Mark(file, start.line + 1, start.column + 1, (end.line + 1, end.column + 1), text)
        if event.anchor in found:
            message = f"the anchor '{event.anchor[:60]}' stands for two values (first in line {found[event.anchor].mark.line})"
            log.error("parameter-duplicate", mark, message, "rename one of them, so that the parameter is unique")
            continue
        written = text[start.index : end.index].rstrip()
        begin = stop = start.index
        if isinstance(event, yaml.ScalarEvent) and not is_key and event.style not in ("|", ">") and event.tag is None:
            value = written[len(event.anchor) + 1 :].lstrip(" ")
            if "\n" not in value and "\r" not in value and value:
                begin, stop = start.index + len(written) - len(value), start.index + len(written)
        quoted = isinstance(event, yaml.ScalarEvent) and event.style in ("'", '"')
        found[event.anchor] = _Anchored(mark, start.index, begin, stop, quoted)
    return found


def _nodes(text: str) -> Iterator[tuple[yaml.NodeEvent, bool]]:
    """Yields each node that is not an alias. The second value is True if the node is a key of a mapping."""
    open_: list[bool | None] = []  # of each open mapping: whether a key comes next; None for a list
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.CollectionEndEvent):
            open_.pop()
        elif isinstance(event, yaml.NodeEvent):
            is_key = bool(open_ and open_[-1])
            if open_ and open_[-1] is not None:
                open_[-1] = not is_key
            if not isinstance(event, yaml.AliasEvent):
                yield event, is_key
            if isinstance(event, yaml.CollectionStartEvent):
                open_.append(True if isinstance(event, yaml.MappingStartEvent) else None)
