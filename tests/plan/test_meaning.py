"""What only the whole plan can tell: references, labels, limits, reports; and that one run finds all of it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from planrunner.base.findings import Findings
from planrunner.plan.expand import expand
from planrunner.plan.meaning import check_meaning
from planrunner.plan.model import Plan, parse_plan
from planrunner.plan.selection import Labels, matches, select

from .mutation import SHIPPED_PLANS

REPORTS = ["report.html", "summary.md"]
PLAN = """\
planrunner: 1
title: t
sensor: {kind: k, outputs: [o]}
defaults: {orientation: unknown, dwell: 5 s}
segments:
  - {label: P1}
  - {label: P2}
  - {label: V1}
estimates:
  drift: {estimator: flexure_gyro_static, segments: P*}
  rest:
    estimator: compensation_residual
    uses: [drift]
    segments: [V1]
limits:
  - {quantity: drift.D_X_F, within: ±0.5 deg/h}
  - {quantity: rest.rss, at_least: 0, at_most: 1}
report: [report.html, summary.md]
"""


def check(text: str) -> tuple[Plan | None, Findings]:
    plan, log = parse_plan(text, "f")
    if plan is not None:
        check_meaning(plan, expand(plan, log), REPORTS, log)
    return plan, log


def found(text: str) -> list[tuple[str, int, int]]:
    return [(item.code, item.mark.line, item.mark.column) for item in check(text)[1]]


def test_the_plan_itself_is_sound() -> None:
    assert found(PLAN) == []


@pytest.mark.parametrize(
    ("old", "new", "code", "at", "hint"),
    [
        ("segments: P*", "segments: Q*", "meaning-undefined-label", "Q*", ""),
        ("segments: [V1]", "segments: [V1, V1, Vx]", "meaning-undefined-label", "Vx", "V1"),
        ("uses: [drift]", "uses: [drift, drfit]", "meaning-unknown-estimate", "drfit", "'drift'"),
        ("uses: [drift]", "uses: [drift, drift]", "meaning-estimate-twice", "drift]", "once"),
        ("uses: [drift]", "uses: rest", "meaning-estimate-order", "rest", ""),
        ("segments: P*}", "segments: P*, uses: rest}", "meaning-estimate-order", "rest}", "above"),
        (
            "flexure_gyro_static",
            "flexure_gyro_statics",
            "form-unknown-estimator",
            "flexure_gyro_statics",
            "'flexure_gyro_static'",
        ),
        ("drift.D_X_F", "drfit.D_X_F", "meaning-unknown-estimate", "drfit", "'drift'"),
        ("within: ±0.5 deg/h", "within: 0.5 deg/h", "form-text", "0.5 deg/h", "±"),
        ("within: ±0.5 deg/h", "within: ±0.5 dog/h", "meaning-unit", "±0.5", "'deg/h'"),
        ("within: ±0.5 deg/h", "within: ±0 deg/h", "meaning-range", "±0", ""),
        ("within: ±0.5 deg/h", "within: ±0.5 deg/h, at_most: 1 deg/h", "meaning-limit", "±0.5", "at_least"),
        (", within: ±0.5 deg/h", "", "meaning-limit", "{quantity: drift", "within"),
        ("at_least: 0,", "at_least: 2,", "meaning-limit", "2, at_most", ""),
        ("at_least: 0,", "at_least: 0 deg/h,", "meaning-dimension", "1}\nreport", ""),
        ("at_least: 0,", "at_leest: 0,", "form-unknown-key", "at_leest", "'at_least'"),
        ("summary.md]", "sumary.md]", "meaning-unknown-report", "sumary", "'summary.md'"),
        ("{label: P2}", "{lable: P2}", "form-unknown-key", "lable", "'label'"),
        ("{label: P2}", "{label: P2, dwell: 0 s}", "meaning-range", "0 s", ""),
        ("{label: P2}", "{label: P2, settle: -1 s}", "meaning-range", "-1 s", ""),
        ("{label: P2}", "{label: P2, dwell: {turns: 0}}", "form-range", "0}}", "1"),
        ("{label: P2}", "{label: P2, on_break: keeep}", "form-choice", "keeep", "'keep'"),
        ("{label: P2}", "{label: true}", "form-type", "true", "quotes"),
        ("title: t", "titel: t", "form-unknown-key", "titel", "'title'"),
        ("kind: k,", "kind: 5,", "form-text", "5,", "letter"),
        ("planrunner: 1", "planrunner: 2", "form-range", "2", "1"),
        ("planrunner: 1", "planrunner: one", "form-type", "one", ""),
    ],
)
def test_each_mistake_is_found_where_it_stands(old: str, new: str, code: str, at: str, hint: str) -> None:
    assert old in PLAN
    text = PLAN.replace(old, new, 1)
    _, log = check(text)
    finding = next(item for item in log if item.code == code)
    begin = text.index(new) + new.index(at) if at in new else text.index(at)
    line = text.count("\n", 0, begin) + 1
    assert (finding.mark.line, finding.mark.column) == (line, begin - (text.rfind("\n", 0, begin) + 1) + 1)
    assert hint in finding.hint
    assert finding.hint
    others = {item.code for item in log if item.severity == "error"} - {code}
    assert others <= {"form-missing-key"}, "one mistake gives one finding"


def test_a_pure_number_is_named_in_words() -> None:
    _, log = check(PLAN.replace("at_least: 0,", "at_least: 0 deg/h,"))
    (finding,) = log
    assert "at_least is in deg/h, at_most is a pure number" in finding.message


def test_an_unused_segment_is_a_warning() -> None:
    text = PLAN.replace("  - {label: V1}\n", "  - {label: V1}\n  - for_each: {temperature: '1, 2, 3, 4, 5 K'}\n")
    _, log = check(text)
    (finding,) = log
    assert (finding.code, finding.severity, finding.mark.line) == ("meaning-unused-label", "warning", 9)
    assert "'1K', '2K', '3K' and 2 more" in finding.message


def test_a_warm_up_may_be_unused() -> None:
    for mark in (
        "- {label: warm-up, conditioning: true}",
        "- {label: w, conditioning: true, steps: [{label: a}, {label: b}]}",
    ):
        _, log = check(PLAN.replace("  - {label: V1}\n", f"  - {{label: V1}}\n  {mark}\n"))
        assert list(log) == []
    _, log = check(
        PLAN.replace(
            "  - {label: V1}\n",
            "  - {label: V1}\n  - {label: w, steps: [{label: a, conditioning: true}, {label: b}]}\n",
        )
    )
    (finding,) = log
    assert finding.code == "meaning-unused-label"
    assert "'w/b'" in finding.message


def test_all_mistakes_are_found_in_one_run() -> None:
    text = PLAN
    for old, new in (
        ("title: t", "title: t\ntitle: u"),
        ("orientation: unknown", "orientation: {x: up, y: west, z: north}"),
        ("{label: P2}", "{label: P2, dwell: 5 apples, settle: 5}"),
        ("segments: [V1]", "segments: [V1]\n    colour: red"),
        ("drift.D_X_F", "drfit.D_X_F"),
        ("summary.md]", "sumary.md]"),
    ):
        text = text.replace(old, new, 1)
    assert found(text) == [
        ("syntax-duplicate-key", 3, 1),
        ("meaning-left-handed", 5, 25),
        ("meaning-unit", 8, 24),
        ("form-unit-missing", 8, 42),
        ("form-unknown-key", 16, 5),
        ("meaning-unknown-estimate", 18, 16),
        ("meaning-unknown-report", 20, 23),
    ]


def test_a_broken_estimate_is_not_called_unknown_elsewhere() -> None:
    assert [code for code, *_ in found(PLAN.replace("flexure_gyro_static", "nothing_of_the_kind"))] == [
        "form-unknown-estimator"
    ]


def test_a_bench_file_is_distinguished_from_a_plan() -> None:
    assert [code for code, *_ in found("planrunner_bench: 1\n")] == ["form-bench"]


def test_missing_keys_come_with_an_example() -> None:
    _, log = check("planrunner: 1\n")
    assert {item.code for item in log} == {"form-missing-key"}
    assert any("title: Eight-position calibration" in item.hint for item in log)


@pytest.mark.parametrize("path", SHIPPED_PLANS, ids=lambda path: path.stem)
def test_shipped_plans_are_sound(path: Path) -> None:
    plan, log = parse_plan(path.read_text(encoding="utf-8"), str(path))
    assert plan is not None
    check_meaning(plan, expand(plan, log), REPORTS, log)
    assert [str(item) for item in log.errors] == []


def test_each_method_is_said_in_sixty_lines() -> None:
    methods = {"flexure_gyro_eight_position", "scale_factor_tilted", "rotation_stop_navigation", "platform_rocking"}
    plans = {path.stem: path for path in SHIPPED_PLANS}
    assert {name for name in methods if len(plans[name].read_text(encoding="utf-8").splitlines()) <= 60} == methods


def test_the_tilted_axes_plan_expands_as_its_method_says() -> None:
    """Six repeats of three temperatures, each with two zeros, both signs of six rates, and the power taken off."""
    plan, log = parse_plan(
        next(path for path in SHIPPED_PLANS if path.stem == "scale_factor_tilted").read_text(encoding="utf-8"), "tilted"
    )
    assert plan is not None
    labels = [segment.label for segment in expand(plan, log)]
    assert len(labels) == 6 * 3 * (2 + 12 + 1)
    assert labels[:4] == ["-40degC/r1/start-zero", "-40degC/r1/R+300", "-40degC/r1/R-300", "-40degC/r1/R+150"]
    assert labels[-2:] == ["60degC/r6/end-zero", "60degC/r6/power-down"]
    assert plan.mounting["x"].angle.standard_uncertainty == pytest.approx(20 / 3600 * 3.141592653589793 / 180)
    assert plan.mounting["z"].angle.standard_uncertainty == pytest.approx(30 / 3600 * 3.141592653589793 / 180 / 3**0.5)


@pytest.mark.parametrize(
    ("label", "pattern", "meant"),
    [
        ("P1", "P*", True),
        ("20degC/P1", "P*", True),
        ("20degC/P1", "P1", True),
        ("20degC/P1", "20degC/*", True),
        ("20degC/P1", "*/P1", True),
        ("20degC/P1", "P1/*", False),
        ("20degC/P1", "20", False),
        ("P1", "p1", False),
        ("P12", "P?", False),
        ("P2", "P[12]", True),
        ("P2", "P[!12]", False),
        ("a.b", "a?b", True),
        ("a+b", "a+b", True),
    ],
)
def test_patterns(label: str, pattern: str, meant: bool) -> None:
    assert matches(label, pattern) is meant
    assert select([label], [pattern]) == ([0] if meant else [])
    assert Labels([label]).meant_by(pattern) == ({0} if meant else set())


def test_many_patterns_over_many_labels_take_no_time() -> None:
    labels = Labels([f"a{n}/b{n % 50}" for n in range(10_000)])
    start = time.process_time()
    for n in range(100):
        labels.meant_by(f"*a*b*{n}*")
    assert labels.meant_by("b7") == set(range(7, 10_000, 50))
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize(
    ("swept", "pattern", "meant"),
    [
        ("temperature: '-20, 20 degC'", "+20degC", "20degC"),
        ("temperature: '-20, 20 degC'", "+20degC/*", "20degC/*"),
        ("rate: '±10, 0 deg/s'", "10deg_s", "+10deg_s"),
        ("rate: '±10, 0 deg/s'", "+0deg_s", "0deg_s"),
        ("rate: '±10, 0 deg/s'", "1*", "+10deg_s"),
    ],
)
def test_a_label_with_another_sign_is_proposed_and_not_matched(swept: str, pattern: str, meant: str) -> None:
    text = PLAN.replace(
        "  - {label: V1}\n", f"  - {{label: V1}}\n  - {{for_each: {{{swept}}}, steps: [{{label: a}}]}}\n"
    )
    text = text.replace("segments: P*", f"segments: '{pattern}'")
    (finding,) = (item for item in check(text)[1] if item.code == "meaning-undefined-label")
    assert f"'{pattern}'" in finding.message
    assert finding.hint == f"did you mean '{meant}'?"
    assert "meaning-undefined-label" not in [item.code for item in check(text.replace(f"'{pattern}'", f"'{meant}'"))[1]]


def test_a_broken_title_does_not_hide_what_else_is_wrong() -> None:
    text = PLAN.replace("title: t\n", "").replace("outputs: [o]", "outputs: o").replace("segments: P*", "segments: Q*")
    assert [code for code, *_ in found(text)] == ["form-missing-key", "form-type", "meaning-undefined-label"]
