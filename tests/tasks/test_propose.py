"""A proposed plan can be read back, whatever the plan was called that it follows; where it cannot,
that is said and the diagnosis stands."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planrunner.plan.model import parse_plan
from planrunner.tasks.diagnose import diagnose_recorded, recorded_file
from planrunner.tasks.propose import Frame, MenuEntry, plan_text
from tests.tasks.test_diagnose import laboratory, listed

UP = MenuEntry("{x: up, y: north, z: west}", "10 s")


@pytest.mark.parametrize(
    ("title", "kind"),
    [
        ("Six positions", "imu"),
        ("It's: a {title} # with signs", "imu"),
        ("t" * 200, "imu"),
        ("", "null"),
        ("Six positions", "True"),
    ],
)
def test_a_proposed_plan_is_read_back_under_any_title_and_kind(title: str, kind: str) -> None:
    text = plan_text(Frame(title, "virtual_imu", kind, ("gyro_x", "null"), 10.0, 60.0), [UP], "Why: this.")
    plan, log = parse_plan(text, "proposed")
    assert plan is not None and not log.errors, [str(finding) for finding in log]
    assert plan.sensor.kind == kind
    assert plan.sensor.outputs == ("gyro_x", "null")
    assert plan.title == f"What to measure next: {title}"[:200]


def test_a_plan_that_cannot_be_proposed_leaves_the_diagnosis_and_is_said(tmp_path) -> None:
    """A bench in deeply nested folders: a plan cannot name it by more than 200 characters."""
    laboratory(tmp_path, listed()[:6])
    recorded = recorded_file(tmp_path / "plan.yaml", None, tmp_path / "recording.parquet", tmp_path / "segments.csv")
    found = diagnose_recorded(replace(recorded, bench="/bench" * 60 + "/bench.yaml"))
    assert found.to_json()["next"] is None
    (said,) = [finding for finding in found.findings if finding.code == "gap-next-unsound"]
    assert said.severity == "warning" and "no executable plan can be proposed" in said.message
