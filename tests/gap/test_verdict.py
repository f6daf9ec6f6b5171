"""What a verdict states is always in its 95 % set, once."""

from __future__ import annotations

from planrunner.gap.answer.verdict import Verdict, ambiguity_set

LIKELY = {"gyro_bias": 0.97, "gyro_bias+unknown": 0.02, "none": 0.01}


def test_the_likeliest_hypotheses_make_up_the_set() -> None:
    assert ambiguity_set({"a": 0.6, "b": 0.36, "c": 0.04}, Verdict("effect", ("a",))) == ["a", "b"]


def test_a_verdict_that_is_not_the_likeliest_is_in_the_set() -> None:
    said = Verdict("effect", ("table_tilt",), residue="unknown")
    assert ambiguity_set({"unknown": 0.99, "table_tilt": 0.01}, said) == ["unknown", "table_tilt"]
    assert ambiguity_set({"a+b": 0.99, "b+c": 0.01}, Verdict("pair", ("c", "b"))) == ["a+b", "b+c"]
    assert ambiguity_set(LIKELY, Verdict("none")) == ["gyro_bias", "none"]


def test_an_effect_with_and_without_something_else_counts_once() -> None:
    assert ambiguity_set(LIKELY, Verdict("effect", ("gyro_bias",), something_else=True)) == ["gyro_bias"]
