"""A schedule has a greatest length and a greatest number of samples, whatever makes it long; what lies beyond is a finding."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from planrunner.base.findings import Findings
from planrunner.bench.scheduling import build_schedule
from planrunner.cli.check import summary
from planrunner.plan.expand import expand
from planrunner.tasks.check import check_plan

PLAN = """\
planrunner: 1
title: Too long
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults:
  orientation: {x: up, y: north}
  dwell: 1 min
segments:
  - {label: zero}
  - {label: long, KEYS}
"""


def codes(tmp_path: Path, keys: str) -> list[tuple[str, int]]:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN.replace("KEYS", keys), encoding="utf-8")
    checked = check_plan(path)
    assert summary(checked)
    return [(finding.code, finding.mark.line) for finding in checked.findings if finding.severity == "error"]


@pytest.mark.parametrize(
    "keys",
    [
        "dwell: 1e8 h",
        "dwell: 367 d",
        "settle: 1e8 h",
        "temperature: 40 degC, soak: 1e8 h",
        "dwell: 20 h, repeat: 5000",
        "rate: 1e-6 deg/s, dwell: {turns: 1}",
        "rate: 1 deg/s, dwell: {turns: 1, at_least: 1e9 s}",
        "settle: {rate_error: 1 deg/s, for: 1e9 h, within: 1e9 h}",
        "motion: {cycle: {A: 0 deg, B: 9 deg}, moves: [A +9 B, B -9 A], turn_rate: 9 deg/s, stop: 1 h}, dwell: {cycles: 1000000}",
    ],
)
def test_a_schedule_of_more_than_a_year(tmp_path: Path, keys: str) -> None:
    assert codes(tmp_path, keys) == [("limit-time", 9)]


def test_more_samples_than_can_be_kept(tmp_path: Path) -> None:
    text = PLAN.replace("KEYS", "dwell: 2000 h").encode()
    path = tmp_path / "plan.yaml"
    path.write_bytes(text)
    checked = check_plan(path)
    assert checked.models is not None and checked.models.sensor is not None and checked.plan is not None
    fast = replace(checked.models, sensor=replace(checked.models.sensor, sample_rate=2e6))
    log = Findings()
    assert not build_schedule(expand(checked.plan, log), fast, log).segments
    assert [finding.code for finding in log] == ["limit-samples"]


def test_a_long_test_that_somebody_might_run(tmp_path: Path) -> None:
    assert codes(tmp_path, "dwell: 2000 h") == []
