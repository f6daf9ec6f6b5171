"""A text with its template: English by itself, the same after JSON and pickle, and nothing but its values can be inserted."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable

import pytest

from planrunner.base.said import Said, counted, said

FIND = said(
    "{what} in {places} at {time:.3g} s, {share:.0f} % {{of all}}",
    what=counted("{count} spike", "{count} spikes", 3),
    places=("R1", said("the {number:d}. turn", number=2)),
    time=12.3456,
    share=99.6,
)


def test_a_text_is_its_english() -> None:
    assert FIND == "3 spikes in R1, the 2. turn at 12.3 s, 100 % {of all}"
    assert f"{FIND}" == str(FIND)
    assert type(str(FIND)) is str
    assert said("No values.") == "No values."
    assert {counted("{count} spike", "{count} spikes", 1), "1 spike"} == {"1 spike"}


@pytest.mark.parametrize(
    "again",
    [lambda one: Said.from_json(json.loads(json.dumps(one.to_json()))), lambda one: pickle.loads(pickle.dumps(one))],
)
def test_a_text_comes_back_whole(again: Callable[[Said], Said]) -> None:
    other = again(FIND)
    assert (other, other.template, other.plural) == (FIND, FIND.template, "")
    assert other.values == FIND.values
    inner = other.values["what"]
    assert isinstance(inner, Said)
    assert (inner.template, inner.plural, inner.number) == ("{count} spike", "{count} spikes", 3)


def test_a_text_without_a_template_is_only_its_text() -> None:
    plain = Said("from a plug-in, {not} a template")
    assert plain.to_json() == {"text": str(plain)}
    assert Said.from_json(plain.to_json()) == plain
    assert not Said.from_json(plain.to_json()).template
    with pytest.raises(TypeError, match="not a text"):
        Said.from_json(str(plain))


@pytest.mark.parametrize(
    "template", ["{name.__class__}", "{name[0]}", "{name!r}", "{name:99999d}", "{name:>9}", "{0}", "{}", "{"]
)
def test_a_template_states_names_and_formats_of_numbers_alone(template: str) -> None:
    with pytest.raises(ValueError, match=r"cannot contain|Single|expected"):
        said(template, name=1)


def test_a_name_needs_a_value() -> None:
    with pytest.raises(KeyError):
        said("{name}")
