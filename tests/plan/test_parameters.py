"""Parameters: the values with an anchor, and nothing else, are replaced; the text stays YAML with the same lines."""

from __future__ import annotations

import json
import random

import pytest
import yaml

from planrunner.base.findings import InputError, Mark
from planrunner.plan.parameters import Given, parameters_of, variant_name, with_parameters

TEXT = """\
a: {x: &x 2 min, °: &y no, z: &z  "5 °C" , l: [&k k, *k], &kk kk: 1}   # °
b: &m
  c: 1
d: &long |
  aa
e: &s 'it''s' # c
f: &empty
"""


def given(**values: str) -> dict[str, Given]:
    return {name: Given(value, Mark("suite.yaml", 3, 5)) for name, value in values.items()}


def test_values_are_replaced_where_their_anchors_are() -> None:
    varied = with_parameters(TEXT, "p.yaml", given(x="12 min", z="°6", k="a: b", s="10", y="yes"))
    assert yaml.safe_load(varied.text) == yaml.safe_load(TEXT) | {
        "a": {"x": "12 min", "°": True, "z": "°6", "l": ["a: b", "a: b"], "kk": 1},
        "e": "10",
    }
    assert varied.text.count("\n") == TEXT.count("\n") and "# °" in varied.text
    for name, value in (("x", "12 min"), ("z", '"°6"'), ("k", '"a: b"'), ("s", '"10"'), ("y", "yes")):
        mark = varied.places[name]
        assert mark.end is not None
        shown = varied.text.split("\n")[mark.line - 1][mark.column - 1 : mark.end[1] - 1]
        assert shown.startswith(f"&{name} ") and shown.endswith(value)


def test_any_text_arrives_as_it_was_given() -> None:
    """Whatever a value contains, YAML reads it back as this value, and nothing else of the plan changes."""
    draw = random.Random(65)
    for _ in range(300):
        value = "".join(draw.choice("a1 :#-{}[],&*!|>'\"%@`°?~\\=.") for _ in range(draw.randint(1, 8))).strip() or "x"
        varied = with_parameters(TEXT, "p.yaml", given(x=value))
        for loader in (yaml.BaseLoader, yaml.CBaseLoader):  # every scalar is a text
            changed, before = yaml.load(varied.text, loader), yaml.load(TEXT, loader)
            assert changed["a"].pop("x") == value
            del before["a"]["x"]
            assert changed == before


def test_a_dash_stays_a_text_outside_brackets_too() -> None:
    assert yaml.safe_load(with_parameters("a: &x b\n", "p.yaml", given(x="-")).text) == {"a": "-"}


@pytest.mark.parametrize(
    ("name", "words"),
    [("X", "no parameter 'X'"), ("m", "not a single value"), ("long", "not a single value"), ("kk", "not a single value"),
     ("empty", "not a single value")],
)  # fmt: skip
def test_what_is_no_parameter_is_refused_where_it_was_given(name: str, words: str) -> None:
    with pytest.raises(InputError, match=r"suite\.yaml:3:5") as caught:
        with_parameters(TEXT, "p.yaml", given(**{name: "1"}))
    assert words in str(caught.value) and caught.value.findings[0].hint


def test_an_anchor_that_stands_for_two_values_is_refused_in_the_plan() -> None:
    with pytest.raises(InputError, match=r"p\.yaml:2:4: error\[parameter-duplicate\].*first in line 1"):
        with_parameters("a: &x 1\nb: &x 2\n", "p.yaml", given(x="3"))


@pytest.mark.parametrize("settings", [["dwell"], ["dwell="], ["=1 s"], ["a b=1"], ["x=1", "x=2"], ["x=a\nb"]])
def test_a_wrong_setting_is_refused(settings: list[str]) -> None:
    with pytest.raises(InputError, match=r"command line: error\[parameter-"):
        parameters_of(settings)


def test_runs_of_variants_have_names_of_their_own() -> None:
    values = {name: one.value for name, one in parameters_of(["dwell=2 min", " rate = ±3 deg/s"]).items()}
    assert variant_name("p", values) == "p (dwell=2 min, rate=±3 deg/s)" and variant_name("p", {}) == "p"
    assert variant_name("p", dict(reversed(values.items()))) == variant_name("p", values)  # one history
    assert json.loads(json.dumps(values)) == {"dwell": "2 min", "rate": "±3 deg/s"}
