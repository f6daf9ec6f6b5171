"""Scores of made-up answers, worked by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.container import ErrorbarContainer
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from tests.blind.__main__ import main
from tests.blind.curve import curve
from tests.blind.report import table
from tests.blind.scoring import Rate, Scored, calibration, closure_against, closure_held_out, plain, rate, score

FACTORS = {"table_tilt": ("orientation",), "gyro_warm_up": ("time",), "emi_bursts": ("time",), "table_rate_error": ()}


def label(
    kind: str, *entries: tuple[str, float, list[str]], factors: tuple[float, float] = (1.0, 1.0)
) -> dict[str, Any]:
    return {
        "kind": kind,
        "effects": sorted(name for name, _, _ in entries),
        "entries": [
            {
                "effect": name,
                "lambda": strength,
                "absorbed": name == "table_rate_error",
                "class": members,
                "theta": [1.0],
                "channels": [1.0, 0.0, 0.0],
            }
            for name, strength, members in entries
        ],
        "noise_factors": list(factors),
        "outliers": False,
        "channel_names": ["gx", "gy", "gz"],
    }


def answer(kind: str, *effects: str, members: tuple[str, ...] = (), **more: Any) -> dict[str, Any]:
    return {"verdict": {"kind": kind, "effects": list(effects), "class": list(members)}, **more}


TILT = label("single", ("table_tilt", 200.0, ["table_tilt", "table_position_error"]))
BOTH = label(
    "pair", ("table_tilt", 200.0, ["table_tilt"]), ("gyro_warm_up", 150.0, ["gyro_warm_up", "gyro_bias_random_walk"])
)
FOREIGN = label("unknown", ("emi_bursts", 950.0, ["emi_bursts"]))
ALIKE = label("unknown", ("rate_resonance", 950.0, ["gyro_scale_asymmetry", "rate_resonance"]))
NONE = label("none")


@pytest.mark.parametrize(
    ("truth", "said", "right", "exact"),
    [
        (TILT, answer("effect", "table_tilt"), True, True),
        (TILT, answer("effect", "table_position_error"), True, False),
        (TILT, answer("effect", "gyro_warm_up"), False, False),
        (TILT, answer("indistinguishable", "gyro_warm_up", members=("gyro_warm_up", "table_tilt")), True, False),
        (TILT, answer("pair", "table_tilt", "gyro_warm_up"), False, False),
        (TILT, answer("none"), False, False),
        (TILT, answer("unknown"), False, False),
        (TILT, {"error": "ValueError: no"}, False, False),
        (BOTH, answer("pair", "gyro_bias_random_walk", "table_tilt"), True, False),
        (BOTH, answer("pair", "gyro_warm_up", "table_tilt"), True, True),
        (BOTH, answer("pair", "gyro_warm_up", "gyro_bias_random_walk"), False, False),
        (BOTH, answer("indistinguishable", "a", "b", members=("a+b", "gyro_warm_up+table_tilt")), True, False),
        (BOTH, answer("effect", "table_tilt"), False, False),
        (FOREIGN, answer("unknown"), True, True),
        (FOREIGN, answer("effect", "emi_bursts"), False, False),
        (ALIKE, answer("unknown"), True, True),
        (ALIKE, answer("effect", "gyro_scale_asymmetry"), True, False),
        (ALIKE, answer("effect", "rate_resonance"), False, False),
        (ALIKE, answer("pair", "gyro_scale_asymmetry", "table_tilt"), False, False),
        (NONE, answer("none"), True, True),
        (NONE, answer("unknown"), False, False),
    ],
)
def test_right_at_class_level_and_exactly(truth: dict, said: dict, right: bool, exact: bool) -> None:
    assert (Scored(truth, said).right, Scored(truth, said).exact) == (right, exact)


NOISY = label("pair", ("table_tilt", 200.0, ["table_tilt"]), ("gyro_noise_excess", 90.0, ["gyro_noise_excess"]))


def test_noise_beside_a_cause_is_asked_for_but_is_no_part_of_the_cause() -> None:
    beside = answer("effect", "table_tilt", posterior={"table_tilt": 0.97, "none": 0.03}, ambiguity_set=["table_tilt"])
    for said, noise in (
        (beside, False),
        ({**beside, "verdict": {**beside["verdict"], "noise": ["gyro_noise_excess"]}}, True),
    ):
        found = Scored(NOISY, said)
        assert (found.right, found.exact, found.noise_is_right) == (noise, noise, noise)
        assert found.cause_is_right and found.covered and found.confidence == pytest.approx(0.97)
    joint = {"gyro_noise_excess+table_tilt": 0.7, "table_tilt": 0.2, "gyro_noise_excess": 0.1}
    pair = Scored(NOISY, answer("pair", "gyro_noise_excess", "table_tilt", posterior=joint))
    assert pair.right and pair.confidence == pytest.approx(0.9)
    assert pair.posterior == pytest.approx({"table_tilt": 0.9, "gyro_noise_excess": 0.1})
    assert not Scored(TILT, pair.answer).right and Scored(TILT, pair.answer).cause_is_right


def test_an_absorbed_effect_is_none_and_its_name_alone_is_wrong() -> None:
    truth = label("none", ("table_rate_error", 0.0, ["table_rate_error"]))
    assert Scored(truth, answer("none")).right
    assert not Scored(truth, answer("effect", "table_rate_error")).says_none


def test_noise_declared_wrongly_is_no_effect() -> None:
    said = answer("effect", "gyro_noise_excess")
    for factor in (1.8, 0.6):
        wrongly = label("none", factors=(factor, 1.0))
        assert not Scored(wrongly, said).right and not Scored(wrongly, said).says_none
    asked = label("single", ("gyro_noise_excess", 100.0, ["gyro_noise_excess"]), factors=(1.5, 1.0))
    assert Scored(asked, said).right and not Scored(asked, answer("none")).right


def test_interval_of_a_share() -> None:
    low, high = Rate(9, 10).interval  # Wilson: (p + z²/2n ± z√(p(1−p)/n + z²/4n²)) ÷ (1 + z²/n)
    assert (low, high) == pytest.approx((0.5958, 0.9821), abs=1e-4)
    assert rate([]).interval == (0.0, 1.0)
    assert Rate(0, 50).interval == pytest.approx((0.0, 0.0713), abs=1e-4)


def test_calibration_is_zero_when_calibrated_and_large_when_not() -> None:
    p = np.repeat([0.5, 0.9], 1000)
    y = np.r_[np.arange(1000) < 500, np.arange(1000) < 900]
    assert calibration(p, y)["ece"] == pytest.approx(0)
    bold = calibration(np.full(1000, 0.99), np.arange(1000) < 910)
    assert bold["ece"] == pytest.approx(0.08) and bold["chance"] == 0
    assert bold["bins"] == [{"confidence": pytest.approx(0.99), "right": 0.91, "n": 1000}]


def test_confidence_brier_and_coverage_take_a_class_together() -> None:
    said = answer(
        "effect",
        "table_tilt",
        posterior={"table_tilt": 0.6, "table_position_error": 0.3, "none": 0.1},
        ambiguity_set=["none", "table_position_error"],
    )
    case = Scored(TILT, said)
    assert case.confidence == pytest.approx(0.9)
    assert case.brier == pytest.approx(0.1**2 + 0.1**2)
    assert case.covered
    assert case.size == 2
    assert case.announced_brier == pytest.approx(0.1**2)
    both = Scored(TILT, said | {"ambiguity_set": ["table_tilt", "table_position_error", "none", "unknown"]})
    assert both.size == 3
    assert Scored(FOREIGN, both.answer).size == 4
    assert not Scored(FOREIGN, said).covered
    wrong = Scored(FOREIGN, said)
    assert wrong.confidence == pytest.approx(0.6)
    assert wrong.brier == pytest.approx(1 + 0.36 + 0.09 + 0.01)


def test_the_place_asks_for_channel_and_factor() -> None:
    def place(channel: str, factor: str) -> bool:
        where = [{"channel": channel, "factor": factor, "level": "", "share": 1.0, "p": 0.01}]
        return Scored(TILT, answer("effect", "table_tilt", where=where)).place_is_right(FACTORS)

    assert place("gx", "orientation")
    assert not place("gy", "orientation")
    assert not place("gx", "time")


def test_the_whole_table() -> None:
    labels = {"a": TILT, "b": BOTH, "c": FOREIGN, "d": NONE, "e": NONE, "f": TILT}
    answers = {
        "a": answer(
            "effect",
            "table_tilt",
            seconds=1.0,
            closure={"resolvable": True, "shrinks_by": 0.8, "interval_90": [0.7, 0.95]},
        ),
        "b": answer("pair", "table_tilt", "gyro_warm_up", seconds=3.0),
        "c": answer("none", seconds=2.0),
        "d": answer("none"),
        "e": answer("effect", "table_tilt"),
    }
    figures = score(labels, answers, FACTORS)
    assert figures["unanswered"] == 1
    assert figures["singles"]["right class"]["80-260 (144)"] == Rate(1, 1)
    assert figures["pairs"]["right class, each >= 144"] == Rate(1, 1)
    assert figures["false alarm"]["all"] == Rate(1, 2)
    assert figures["unknown"]["recognised, >= 900"] == Rate(0, 1)
    assert figures["unknown"]["catalogue called unknown"] == Rate(0, 2)
    assert figures["seconds"]["median"] == 2.0
    shut = closure_against(labels, answers, {"a": {"closure": {"shrinks_by": 0.9}}})
    assert shut["ratio"]["144-900"]["mean"] == pytest.approx(0.8 / 0.9)
    assert shut["interval holds the oracle's"] == Rate(1, 1)
    text = table(6, {"planrunner": figures})
    assert "false alarm: all" in text and "0.500" in text
    assert plain(figures)["false alarm"]["all"]["n"] == 2


def test_closures_are_held_to_the_truth_of_held_out_segments() -> None:
    def answer(low: float, said: float, high: float, true: float) -> dict:
        return {
            "closure": {
                "resolvable": True,
                "shrinks_by": said,
                "interval_90": [low, high],
                "true": true,
                "told": 0.8,
            },
        }

    entry = {"effect": "table_tilt", "class": ["table_tilt"], "absorbed": False}
    labels = {n: {"kind": "single", "entries": [{**entry, "lambda": 40.0}]} for n in "abc"}
    labels["weak"] = {"kind": "single", "entries": [{**entry, "lambda": 35.0}]}
    answers = {
        "a": answer(0.5, 0.7, 0.9, 0.6),
        "b": answer(0.5, 0.7, 0.9, 0.95),
        "c": {"closure": {"resolvable": False, "shrinks_by": None, "interval_90": None}},
        "weak": answer(0.5, 0.7, 0.9, 0.0),
    }
    found = closure_held_out(labels, answers)
    assert (found["interval holds the truth"].hits, found["interval holds the truth"].n) == (1, 2)
    assert (found["not resolvable"].hits, found["not resolvable"].n) == (1, 3)
    assert found["said less true"]["largest"] == pytest.approx(0.25)
    ratio = found["ratio to the true effects told"]["36-144"]
    assert (ratio["n"], ratio["mean"]) == (2, pytest.approx((0.6 + 0.95) / 2 / 0.8))


def test_the_curve_stands_where_the_bins_are(tmp_path: Path) -> None:
    bins = [{"confidence": 0.35, "right": 0.5, "n": 4}, {"confidence": 0.95, "right": 1.0, "n": 40}]
    figures = {"planrunner": {"calibration": {"ece": 0.05, "chance": 0.4, "bins": bins}}}
    over, below = curve(figures).axes
    (points,) = over.containers
    assert isinstance(points, ErrorbarContainer)
    line, _, (intervals,) = points.lines
    assert isinstance(line, Line2D) and isinstance(intervals, LineCollection)
    assert np.asarray(line.get_ydata()).tolist() == [0.5, 1.0]
    assert line.get_xdata() == pytest.approx([0.35, 0.95], abs=0.01)
    # Wilson by hand: 2 of 4 gives 0.15 to 0.85, 40 of 40 gives 0.912 to 1.
    ((low, high), (least, most)) = (segment[:, 1] for segment in intervals.get_segments())
    assert (low, high, least, most) == pytest.approx((0.150, 0.850, 0.912, 1.0), abs=1e-3)
    assert [bar.get_height() for bar in below.patches if isinstance(bar, Rectangle)] == [4, 40]
    (tmp_path / "score.json").write_text(json.dumps({"answers": figures}), encoding="utf-8")
    for name in ("a.svg", "b.svg"):
        assert main(["curve", str(tmp_path / "score.json"), str(tmp_path / name)]) == 0
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_look_alikes_are_counted_apart() -> None:
    labels = {"a": FOREIGN, "b": ALIKE}
    figures = score(labels, {"a": answer("unknown"), "b": answer("effect", "gyro_scale_asymmetry")}, FACTORS)["unknown"]
    assert figures["recognised, >= 900"] == Rate(1, 1)
    assert figures["of the look-alikes, >= 144"] == Rate(1, 1)
    assert figures["called unknown, with the look-alikes, >= 144"] == Rate(1, 2)
