"""Findings whose cause is another finding: kept, counted for what follows, and not shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.base.findings import Finding, Findings, Mark, elsewhere
from planrunner.tasks.check import check_plan

RECORD = Mark("plan.yaml", 3, 1, (6, 1))
KEY = Mark("plan.yaml", 4, 5, (4, 9))
LATER = Mark("plan.yaml", 8, 1, (9, 1))


def test_what_rests_on_a_wrong_part_is_not_shown() -> None:
    log = Findings()
    log.error("form-type", KEY, "the cause")
    with log.resting_on(RECORD):
        log.error("physics-rank", LATER, "follows")
        log.warning("physics-limit", LATER, "follows too")
    log.error("form-size", LATER, "stands alone")
    assert [item.message for item in log] == ["the cause", "stands alone"]
    assert [item.cause.message for item in log.items if item.cause is not None] == ["the cause"] * 2
    assert log.raised == 3, "a check that asks whether it may go on counts them all"


def test_only_errors_that_were_there_before_are_causes() -> None:
    log = Findings()
    log.warning("form-type", KEY, "a warning is no cause")
    with log.resting_on(RECORD):
        log.error("a-b", RECORD, "first")
        log.error("a-b", KEY, "second")
    assert len(list(log)) == 3


def test_what_follows_from_a_consequence_follows_from_its_cause() -> None:
    log = Findings()
    log.error("form-type", KEY, "the cause")
    with log.resting_on(RECORD):
        log.error("a-b", LATER, "follows")
    with log.resting_on(LATER):
        log.error("c-d", Mark("plan.yaml", 20), "follows from that")
    assert [item.message for item in log] == ["the cause"]
    assert {item.cause.message for item in log.items if item.cause} == {"the cause"}


def test_places_cover_what_stands_in_them() -> None:
    assert RECORD.covers(KEY) and RECORD.covers(RECORD) and not KEY.covers(RECORD)
    assert not RECORD.covers(LATER) and not RECORD.covers(Mark("other.yaml", 4, 5))
    assert Mark("f", 2, 3).covers(Mark("f", 2, 3)) and not Mark("f", 2, 3).covers(Mark("f", 2, 4))


def test_an_error_given_twice_is_kept_once_and_counted_twice() -> None:
    log = Findings()
    for _ in range(2):
        log.error("a-b", KEY, "again")
    assert (len(log), log.raised) == (1, 2)


def test_other_lines_are_named_once_and_in_order() -> None:
    marks = [Mark("f", line) for line in (4, 9, 7, 7, 4)]
    assert elsewhere(marks, marks[0]) == " (also on lines 7 and 9)"
    assert elsewhere(marks[:1], marks[0]) == ""
    assert "more" in elsewhere([Mark("f", line) for line in range(1, 40)], marks[0])


PLAN = """\
planrunner: 1
title: A label mistyped
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults: {temperature: 25 degC, dwell: 2 min}
segments:
  - for_each:
      orientation:
        P1: {x: up, y: north, z: west}
        P2: {x: down, y: north, z: east}
        P3: {x: north, y: up, z: east}
        P4: {x: north, y: down, z: west}
        P5: {x: east, y: south, z: down}
        P6: {x: south, y: east, z: up}
        P7: {x: west, y: south, z: up}
        P8: {x: south, y: west, z: down}
estimates:
  drift:
    estimator: flexure_gyro_static
    segments: [P1, P2, P3, P4, P5, P6, P7, P8]
limits:
  - {quantity: drift.D_X_F, within: ±5 deg/h}
"""


def errors(tmp_path: Path, text: str) -> list[Finding]:
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return [finding for finding in check_plan(path).findings if finding.severity == "error"]


@pytest.mark.parametrize(
    ("written", "mistyped", "code"),
    [
        ("P2, P3, P4, P5, P6, P7, P8]", "P2, P3, P44, P5, P6, P7, P8]", "meaning-undefined-label"),
        ("title: A", "titel: A", "form-unknown-key"),
        ("title: A", "oops: A", "form-unknown-key"),
        ("defaults:", "default:", "form-unknown-key"),
        ("estimates:", "estimate:", "form-unknown-key"),
        ("    estimator:", "    estimatr:", "form-unknown-key"),
        ("within:", "withn:", "form-unknown-key"),
        ("dwell: 2 min", "dwel: 2 min", "form-unknown-key"),
        ("kind: flexure-gyro", "kind: imu", "meaning-sensor-kind"),
        ("  drift:\n", "  drfit:\n", "meaning-unknown-estimate"),
        (", dwell: 2 min", "", "meaning-no-dwell"),
        ("segments:\n  -", "bench: virtual_imu\nsegments:\n  -", "meaning-sensor-kind"),
    ],
)
def test_one_mistake_one_finding(tmp_path: Path, written: str, mistyped: str, code: str) -> None:
    assert not errors(tmp_path, PLAN)
    assert PLAN.count(written) == 1
    assert [finding.code for finding in errors(tmp_path, PLAN.replace(written, mistyped))] == [code]


def test_two_mistakes_two_findings(tmp_path: Path) -> None:
    text = (
        PLAN.replace("title: A", "titel: A")
        .replace("P4, P5, P6, P7, P8]", "P44, P5, P6, P7, P8]")
        .replace("within:", "withn:")
    )
    assert [finding.code for finding in errors(tmp_path, text)] == [
        "form-unknown-key",
        "meaning-undefined-label",
        "form-unknown-key",
    ]


def test_an_unknown_key_hides_no_more_missing_keys_than_it_can_stand_for(tmp_path: Path) -> None:
    text = PLAN.replace("title: A label mistyped\n", "").replace("kind: flexure-gyro, ", "").replace("dwell:", "oops:")
    codes = [finding.code for finding in errors(tmp_path, text)]
    assert codes.count("form-missing-key") == 2, "the unknown key stands in another record"
