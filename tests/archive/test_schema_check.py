"""The compiled schemas against jsonschema, which they stand in for: what one takes, the other takes."""

from __future__ import annotations

import copy
import json
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from planrunner.archive import formats
from planrunner.archive.schema_check import compile_schema

SHA = "0a" * 32
COMMON = {"seq": 1, "at": "2026-03-01T12:00:00+00:00", "previous": SHA}
PART = {"file": "segments/0001-P1.parquet", "sha256": SHA, "rows": 5, "bytes": 900}
FRAMES = {"received": 1, "lost": 0, "corrupt": 0, "overflowed": 0, "skipped_bytes": 0, "details": {"a": 1.5, "b": None}}
SEGMENT = {"segment": 0, "label": "P1", "attempt": 1, "parts": [PART]}
EVENTS: dict[str, dict[str, Any]] = {
    "created": {"run": "r", "files": {"run.json": SHA, "plan.yaml": SHA, "bench.yaml": SHA}},
    "instruments": {"instruments": {"table": {"model": "m"}}},
    "begun": {"segment": 0, "label": "P1", "attempt": 1, "clock": 0.5, "on_break": "keep"},
    "part": {"segment": 0, "attempt": 1, "part": PART, "clock": 1},
    "segment": {
        **SEGMENT,
        "clock": 2.0,
        "readings": {"t": 1.0, "u": None},
        "states": {},
        "truncated": False,
        "frames": FRAMES,
    },
    "rejected": {**SEGMENT, "reason": "why"},
    "protected": {"limits": {"table": ["one", "two"]}},
    "reopened": {"repaired_bytes": 0, "reason": "why", "seal": SHA},
    "finished": {"finished": "2026-03-01T12:00:00.5+00:00"},
}
FILES: dict[str, Any] = {
    "run": {
        "planrunner_run": 1,
        "run": "20260301T120000Z-p-abc",
        "created": COMMON["at"],
        "plan": "p",
        "seed": None,
        "durability": "durable",
        "versions": {"planrunner": "1", "python": "3"},
        "info": {"operator": "A"},
    },
    "digests": {
        "planrunner_digests": 3,
        "made": COMMON["at"],
        "files": {"a": SHA},
        "previous": SHA,
        "journal": {"events": 3, "head": SHA},
        "seal": None,
        "digest": SHA,
    },
    "seal": {
        "planrunner_seal": 2,
        "run": "r",
        "sealed": COMMON["at"],
        "journal": {"events": 3, "head": SHA},
        "files": {"run.json": SHA, "plan.yaml": SHA, "bench.yaml": SHA, "journal.jsonl": SHA},
        "digest": SHA,
    },
}
VALUES = st.sampled_from([None, True, 0, 1, -1, 3, 10**9, 0.5, "", "keep", SHA, [], {}, [PART], {"a": 1}, "x" * 300])


def places(value: Any) -> list[tuple[Any, ...]]:
    """Every place in a JSON value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [(), *((name, *rest) for name, item in inner for rest in places(item))]


def changed(data: st.DataObject, value: Any) -> Any:
    """The value with something exchanged, removed or added."""
    value = copy.deepcopy(value)
    for _ in range(data.draw(st.integers(0, 2))):
        *path, last = data.draw(st.sampled_from([place for place in places(value) if place] or [("new",)]))
        target = value
        for name in path:
            target = target[name]
        how = data.draw(st.sampled_from(["exchange", "remove", "add"]))
        if how == "exchange":
            target[last] = copy.deepcopy(data.draw(VALUES))
        elif how == "remove":
            target.pop(last)
        elif isinstance(target, dict):
            target[data.draw(st.sampled_from(["new", "segment", "reason", "rows"]))] = copy.deepcopy(data.draw(VALUES))
    return value


@cache
def oracle_of(name: str) -> Draft202012Validator:
    return Draft202012Validator(formats.schema(name))


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_an_event_is_taken_where_jsonschema_takes_it(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from(sorted(EVENTS)))
    event = changed(data, {**COMMON, "event": kind, **EVENTS[kind]})
    oracle = oracle_of("journal-event").is_valid(event)
    fault = formats.event_fault(event)
    assert (fault is None) == oracle or "is not a time" in str(fault)


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_a_file_is_taken_where_jsonschema_takes_it(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(sorted(FILES)))
    value = changed(data, FILES[name])
    schema = formats.schema(name)
    fault = compile_schema(schema, schema)(value)
    assert (fault is None) == oracle_of(name).is_valid(value) or "is not a time" in str(fault)


@pytest.mark.parametrize("kind", sorted(EVENTS))
def test_events_as_they_are_written_are_taken(kind: str) -> None:
    assert formats.event_fault({**COMMON, "event": kind, **EVENTS[kind]}) is None


@pytest.mark.parametrize("name", ["run", "seal", "digests", "issued", "results"])
def test_every_schema_is_one_that_is_understood_whole(name: str) -> None:
    Draft202012Validator.check_schema(formats.schema(name))
    compile_schema(formats.schema(name), formats.schema(name))


def test_a_keyword_that_is_not_known_is_not_passed_over() -> None:
    with pytest.raises(ValueError, match="uniqueItems"):
        compile_schema({"type": "array", "uniqueItems": True}, {})


def test_stricter_than_the_standard_where_the_files_are() -> None:
    schema = {"type": "integer"}
    assert compile_schema(schema, {})(1.0) is not None
    assert compile_schema({"type": "number"}, {})(json.loads("1e999")) is not None
    assert compile_schema({"pattern": "^a$"}, {})("a\n") is not None
    when = compile_schema({"type": "string", "format": "date-time"}, {})
    assert when("2026-01-01T00:00:00Z") is None
    assert all(when(text) for text in ("x", "2026-01-01", "2026-01-01T00:00:00", "0001-01-01T00:00:00+00:00"))
