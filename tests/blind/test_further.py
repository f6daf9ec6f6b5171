"""The further kinds of cases: what is drawn, what their labels state, and how they are scored."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from tests.blind import further
from tests.blind.effects import SHOWS_UNDER
from tests.blind.scoring import Scored, calibration, score

SEED = 5


def _first(kind: str) -> int:
    return next(number for number in range(200) if further.assigned(SEED, number)[2] == kind)


def test_every_kind_has_its_share() -> None:
    drawn = Counter(further.assigned(SEED, number)[2] for number in range(2000))
    for kind, share in further.COMPOSITION.items():
        assert abs(drawn[kind] - 2000 * share) < 4 * np.sqrt(2000 * share)


@pytest.mark.slow
@pytest.mark.parametrize("kind", further.COMPOSITION)
def test_a_case_is_the_same_again_and_states_its_kind(kind: str) -> None:
    one, again = further.make(SEED, _first(kind)), further.make(SEED, _first(kind))
    assert all(np.array_equal(one.columns[name], again.columns[name]) for name in one.columns)
    assert one.label == again.label and one.label["variety"] == kind
    assert len(one.label["effects"]) == {"none": 0, "triple": 3}.get(kind, len(one.label["effects"]))


def _label(kind: str, effects: list[str], variety: str) -> dict:
    entries = [{"effect": e, "lambda": 500.0, "absorbed": False, "class": [e], "theta": [1.0]} for e in effects]
    return {
        "kind": kind,
        "effects": effects,
        "entries": entries,
        "variety": variety,
        "noise_factors": [1.0],
        "outliers": False,
    }


def _answer(effects: list[str], p: float, declarations: list[str] | None = None) -> dict:
    key = "+".join(sorted(effects)) or "none"
    kind = {0: "none", 1: "effect", 2: "pair"}.get(len(effects), "several")
    return {
        "verdict": {"kind": kind, "effects": effects, "class": []},
        "posterior": {key: p, "unknown": 1 - p},
        "ambiguity_set": [key],
        "declarations": declarations or [],
    }


def test_three_effects_and_wrong_labels_are_scored() -> None:
    three = ["a", "b", "c"]
    assert Scored(_label("several", three, "triple"), _answer(["c", "a", "b"], 0.995)).right
    assert not Scored(_label("several", three, "triple"), _answer(["a", "b"], 0.995)).right
    labels = {
        "1": _label("several", three, "triple"),
        "2": _label("several", three, "triple"),
        "3": _label("mislabelled", ["axis_reversed"], "mislabelled"),
        "4": _label("mislabelled", ["axis_reversed"], "mislabelled"),
    }
    answers = {
        "1": _answer(three, 0.995),
        "2": _answer(["a", "b"], 0.999),
        "3": _answer([], 0.7, ["axis_reversed"]),
        "4": _answer([], 0.7),
    }
    found = score(labels, answers, SHOWS_UNDER)
    assert {name: (rate.hits, rate.n) for name, rate in found["right, by variety"].items()} == {
        "triple": (1, 2),
        "mislabelled": (1, 2),
    }
    sure = found["right cause where P >= .99"]
    assert (sure.hits, sure.n) == (1, 2)
    assert [one["n"] for one in found["calibration of the sentence, in ten bins"]["bins"]] == [2]


def test_ten_bins() -> None:
    p = np.linspace(0.05, 0.95, 10)
    found = calibration(p, p > 0.5, 10)
    assert [one["confidence"] for one in found["bins"]] == pytest.approx(p)
    assert found["ece"] == pytest.approx(np.abs(p - (p > 0.5)).mean())
