"""Compiles a JSON Schema into functions, which are fast enough to check every event of a journal with hundreds of thousands of
events.

Only the keywords used in the schemas of run folders are supported. Any other keyword makes the compilation fail, so that no keyword
is ignored. The check is stricter than the standard in three points: an integer has no decimal point, a number is finite, and
`format` (date-time with an offset, date) is checked. All files of a run folder meet these stricter rules.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import date, datetime

from planrunner.base.documents import Json

Check = Callable[[Json], str | None]
"""Function that checks a value. It returns None if the value is valid, otherwise a description of the fault. The description begins
with the place of the fault within the value, or with nothing if the whole value is wrong."""

ABOUT = {"$schema", "$id", "$defs", "title", "description"}
FIRST_YEAR, LAST_YEAR = 1971, 9000  # range that every time zone and every system can represent


def compile_schema(schema: Mapping[str, Json], whole: Mapping[str, Json]) -> Check:
    """Compiles a schema into a function that checks data. `whole`: the document that `$ref` refers to. Raises ValueError for an
    unsupported keyword."""
    return _compiled(schema, whole, {})


def _compiled(schema: Json, whole: Mapping[str, Json], known: dict[str, list[Check]]) -> Check:
    if schema is True:
        return _anything
    checks: list[Check] = []
    rest = dict(schema)
    for name in ABOUT:
        rest.pop(name, None)
    reference = rest.pop("$ref", None)
    if reference is not None:
        checks.append(_referred(reference, whole, known))
    if "type" in rest:
        kinds = rest.pop("type")
        checks.append(_typed([kinds] if isinstance(kinds, str) else kinds))
    if "const" in rest:
        checks.append(_one_of([rest.pop("const")]))
    if "enum" in rest:
        checks.append(_one_of(rest.pop("enum")))
    if "anyOf" in rest:
        checks.append(_any_of([_compiled(item, whole, known) for item in rest.pop("anyOf")]))
    if "pattern" in rest:
        checks.append(_like(rest.pop("pattern")))
    if "format" in rest:
        checks.append(_FORMATS[rest.pop("format")])
    if "minimum" in rest or "maximum" in rest:
        checks.append(_between(rest.pop("minimum", -math.inf), rest.pop("maximum", math.inf)))
    if "maxLength" in rest or "maxItems" in rest:
        checks.append(_at_most(rest.pop("maxLength", None), rest.pop("maxItems", None)))
    if {"properties", "required", "additionalProperties"} & set(rest):
        properties = {name: _compiled(item, whole, known) for name, item in rest.pop("properties", {}).items()}
        others = rest.pop("additionalProperties", True)
        other = None if others is False else _compiled(others, whole, known)
        checks.append(_object(properties, rest.pop("required", []), other))
    if "items" in rest:
        checks.append(_items(_compiled(rest.pop("items"), whole, known)))
    if rest:
        raise ValueError(f"this schema uses keywords that are not supported here: {', '.join(sorted(rest))}")
    return checks[0] if len(checks) == 1 else _all_of(checks)


def _referred(reference: str, whole: Mapping[str, Json], known: dict[str, list[Check]]) -> Check:
    """Compiles a definition to which a schema refers. A definition is compiled only once, and may refer to itself."""
    if reference not in known:
        known[reference] = []
        target: Json = whole
        for step in reference.removeprefix("#/").split("/"):
            target = target[step]
        known[reference].append(_compiled(target, whole, known))
    later = known[reference]
    return later[0] if later else lambda value: later[0](value)


def _anything(value: Json) -> str | None:
    return None


def _all_of(checks: Sequence[Check]) -> Check:
    def check(value: Json) -> str | None:
        for one in checks:
            fault = one(value)
            if fault is not None:
                return fault
        return None

    return check


def _any_of(checks: Sequence[Check]) -> Check:
    def check(value: Json) -> str | None:
        faults = [one(value) for one in checks]
        return None if None in faults else faults[0]

    return check


_TYPES: dict[str, Callable[[Json], bool]] = {
    "integer": lambda value: type(value) is int,
    "number": lambda value: type(value) is int or (type(value) is float and math.isfinite(value)),
    "string": lambda value: type(value) is str,
    "boolean": lambda value: type(value) is bool,
    "object": lambda value: type(value) is dict,
    "array": lambda value: type(value) is list,
    "null": lambda value: value is None,
}


def _typed(kinds: Sequence[str]) -> Check:
    tests = [_TYPES[kind] for kind in kinds]
    wanted = " or ".join(kinds)

    def check_one(value: Json) -> str | None:
        return None if test(value) else f": {_shown(value)} is not of type {wanted}"

    def check(value: Json) -> str | None:
        return None if any(test(value) for test in tests) else f": {_shown(value)} is not of type {wanted}"

    test = tests[0]
    return check_one if len(tests) == 1 else check


def _one_of(values: Sequence[Json]) -> Check:
    def check(value: Json) -> str | None:
        for one in values:
            if type(one) is type(value) and one == value:
                return None
        return f": {_shown(value)} is not {' or '.join(map(repr, values))}"

    return check


def _like(pattern: str) -> Check:
    compiled = re.compile(pattern.removesuffix("$") + r"\Z") if pattern.endswith("$") else re.compile(pattern)

    def check(value: Json) -> str | None:
        if type(value) is not str or compiled.search(value):
            return None
        return f": {_shown(value)} is not of the form {pattern}"

    return check


def _date_time(value: Json) -> str | None:
    if type(value) is not str:
        return None
    try:
        moment = datetime.fromisoformat(value)
        if moment.tzinfo is not None and FIRST_YEAR <= moment.year <= LAST_YEAR:
            return None
    except ValueError:
        pass
    return f": {_shown(value)} is not a time with an offset to UTC, such as 2026-03-01T12:00:00+00:00"


def _date(value: Json) -> str | None:
    if type(value) is not str:
        return None
    try:
        if date.fromisoformat(value).isoformat() == value:
            return None
    except ValueError:
        pass
    return f": {_shown(value)} is not a date, such as 2026-03-01"


_FORMATS: dict[str, Check] = {"date-time": _date_time, "date": _date}


def _between(least: float, most: float) -> Check:
    def check(value: Json) -> str | None:
        if type(value) not in (int, float) or least <= value <= most:
            return None
        return f": {_shown(value)} is not " + (f"at least {least}" if value < least else f"at most {most}")

    return check


def _at_most(letters: int | None, items: int | None) -> Check:
    def check(value: Json) -> str | None:
        if type(value) is str and letters is not None and len(value) > letters:
            return f": it has {len(value)} characters, at most {letters} are allowed"
        if type(value) is list and items is not None and len(value) > items:
            return f": it has {len(value)} items, at most {items} are allowed"
        return None

    return check


def _object(properties: Mapping[str, Check], required: Sequence[str], other: Check | None) -> Check:
    known = dict(properties)
    needed = tuple(required)

    def check(value: Json) -> str | None:
        if type(value) is not dict:
            return None
        for name in needed:
            if name not in value:
                return f": it lacks '{name}'"
        for name, item in value.items():
            one = known.get(name, other)
            if one is None:
                return f": it has an unknown key, {_shown(name)}"
            fault = one(item)
            if fault is not None:
                return f"/{name[:40]}{fault}"
        return None

    return check


def _items(one: Check) -> Check:
    def check(value: Json) -> str | None:
        if type(value) is list:
            for place, item in enumerate(value):
                fault = one(item)
                if fault is not None:
                    return f"/{place}{fault}"
        return None

    return check


def _shown(value: Json) -> str:
    if isinstance(value, dict | list):
        return f"{'an object' if isinstance(value, dict) else 'an array'} of {len(value)}"
    if isinstance(value, int) and not -(10**20) < value < 10**20:
        return "a number of more than 20 digits"
    text = repr(value)
    return text if len(text) <= 60 else text[:60] + "…"
