"""The shipped rocking test from end to end on its bench: truth recovered, headline in the report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from planrunner.cli import main

ROOT = Path(__file__).resolve().parents[2]
TRUE = {"drift_x": 0.010, "drift_y": -0.014, "drift_z": 0.008}  # deg/h while rocking, as the bench declares
ROCKED = 419 / 538


@pytest.fixture(scope="module")
def analysis(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rocking")
    plan = (ROOT / "plans" / "platform_rocking.yaml").read_text(encoding="utf-8")
    (folder / "plan.yaml").write_text(
        plan.replace("mode: navigation}", "mode: navigation, sample_rate: 10 Hz}"), encoding="utf-8"
    )
    told = [f"--set={name}=test" for name in ("device_serial", "operator", "accelerometer_range")]
    assert main(["run", str(folder / "plan.yaml"), "--runs", str(folder / "runs"), "--quiet", *told]) == 0
    return next((folder / "runs").glob("*/analyses/1"))


@pytest.mark.slow
def test_declared_rocking_drifts_lie_within_their_intervals(analysis):
    results = json.loads((analysis / "results.json").read_text(encoding="utf-8"))
    found = {item["name"]: item for item in results["estimates"][0]["coefficients"]}
    for name, rate in TRUE.items():
        item = found[name]
        # t with two degrees of freedom: 9.92 holds 99 %
        assert abs(item["value"] - rate * ROCKED) < 9.92 * item["standard_uncertainty"]
        assert 2e-4 < item["standard_uncertainty"] < 0.01
    assert [limit["verdict"] for limit in results["limits"]] == ["pass"] * 3


@pytest.mark.slow
def test_the_report_opens_with_the_comparison_of_both_methods(analysis):
    results = json.loads((analysis / "results.json").read_text(encoding="utf-8"))
    estimate = results["estimates"][0]
    pairings = estimate["extra"]["pairings"]
    assert set(pairings) == {"x", "y", "z"}
    for item in pairings.values():
        assert 0 < item["standard_deviation"] < item["gimbal_standard_deviation"]
        assert item["smaller"] > 0.5
    assert estimate["tables"][0]["title"].startswith("Comparison of the two methods")
    page = (analysis / "report.html").read_text(encoding="utf-8")
    assert "smaller standard deviation on every axis" in page
    assert page.count("Rocking drift about") >= 3
