"""JSON Schema and reader are one declaration: files up to date, every key explained, and no plan on which the two disagree."""

from __future__ import annotations

import json
import os
import random
import re
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from planrunner.base.findings import InputError
from planrunner.plan import source
from planrunner.plan.model import read_plan
from planrunner.plan.quantity import anchored
from planrunner.tasks.write_schemas import SCHEMAS, plan_schema, text

from .mutation import ROOT, SHIPPED_PLANS, as_yaml, examples, mutate


@cache
def validator() -> Draft202012Validator:
    return Draft202012Validator(plan_schema())


@cache
def donors() -> list[Any]:
    return examples()


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_the_files_in_schemas_are_what_the_records_say(name: str) -> None:
    written = (ROOT / "schemas" / name).read_text(encoding="utf-8")
    assert written == text(SCHEMAS[name]()), "run `make schemas`"


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_the_schemas_are_valid(name: str) -> None:
    Draft202012Validator.check_schema(SCHEMAS[name]())


def keys_in(schema: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key that a document may have, with what the schema says of it."""
    if isinstance(schema, list):
        for item in schema:
            yield from keys_in(item, path)
        return
    if not isinstance(schema, dict):
        return
    for word, part in schema.items():
        if word == "properties":
            for name, about in part.items():
                yield f"{path}/{name}", about
                yield from keys_in(about, f"{path}/{name}")
        elif word == "$defs":
            for name, about in part.items():
                yield from keys_in(about, f"#{name}")
        elif word not in ("if", "examples", "description", "enum", "const", "required", "pattern"):
            yield from keys_in(part, path)


@pytest.mark.parametrize("name", sorted(SCHEMAS))
def test_every_key_has_a_description_and_an_example_that_holds(name: str) -> None:
    schema = SCHEMAS[name]()
    found = dict(keys_in(schema))
    assert len(found) > 50
    whole = Draft202012Validator(schema)
    for path, about in found.items():
        assert about.get("description", "").strip(), path
        assert about.get("examples"), path
        for example in about["examples"]:
            problems = [error.message for error in whole.evolve(schema=about).iter_errors(example)]
            assert not problems, (path, example, problems)


def test_patterns_mean_the_same_to_editors() -> None:
    """Editors use ECMA-262 expressions: no named groups, no inline flags, no possessive or atomic groups."""
    for found in re.findall(r'"pattern": ("(?:[^"\\]|\\.)*")', text(plan_schema())):
        pattern = json.loads(found)
        re.compile(pattern)
        assert not re.search(r"\(\?(?![:!=]|<[!=])|\\[AZz]|\+\+|\*\+", pattern), pattern
    assert not re.search(anchored("a"), "a\n"), "a final newline is no part of a name"


def agree(data: Any) -> bool | None:
    """Whether the schema accepts `data`, after asserting that the reader says the same; None when it is no YAML document at all."""
    try:
        root = source.parse(as_yaml(data), "f")
    except InputError:
        return None
    _, log = read_plan(root)
    form = [str(finding) for finding in log if finding.code.startswith("form-")]
    errors = [
        f"{list(error.absolute_path)}: {error.message[:200]}" for error in validator().iter_errors(source.plain(root))
    ]
    assert bool(form) == bool(errors), f"reader: {form}\nschema: {errors}\n{as_yaml(data)}"
    return not errors


@pytest.mark.parametrize("path", SHIPPED_PLANS, ids=lambda path: path.stem)
def test_schema_and_reader_agree_on_whole_plans(path: Any) -> None:
    assert agree(source.plain(source.load(path)))


def test_schema_and_reader_agree_on_every_example() -> None:
    """Each example of a key, put where that key stands."""
    base = donors()[0]
    for path, about in keys_in(plan_schema()):
        if path.count("/") == 1 and not path.startswith("#"):
            for example in about["examples"]:
                assert agree({**base, path[1:]: example}) is True, path


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.integers(0, 2**32), st.integers(1, 4))
def test_schema_and_reader_agree_on_mutated_plans(seed: int, times: int) -> None:
    draw = random.Random(seed)
    agree(mutate(draw.choice(donors()), draw, donors(), times))


@pytest.mark.slow
def test_schema_and_reader_agree_at_length() -> None:
    """`make fuzz` draws ten times as many."""
    accepted = refused = 0
    count = 2 * int(os.environ.get("PLANRUNNER_FUZZ", "3000"))
    for seed in range(count):
        draw = random.Random(seed)
        verdict = agree(mutate(draw.choice(donors()), draw, donors(), draw.choice((1, 1, 1, 2, 3))))
        accepted += verdict is True
        refused += verdict is False
    assert accepted > count / 20
    assert refused > count / 20
