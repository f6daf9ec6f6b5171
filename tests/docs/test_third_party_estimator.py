"""The documented third-party estimator: shown whole in the docs, installed like any package, used from a plan."""

from __future__ import annotations

from pathlib import Path

import pytest
from third_party import EXAMPLES, ROOT, installed, shown_whole


def test_the_docs_show_the_code_that_is_tested() -> None:
    assert shown_whole("writing-an-estimator.md", "median_output")
    code = (EXAMPLES / "median_output" / "median_output.py").read_text(encoding="utf-8")
    assert len(code.splitlines()) <= 40


@pytest.mark.slow
def test_installed_from_its_folder_it_works_in_a_plan(tmp_path: Path) -> None:
    planrunner = installed("median_output", tmp_path)
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    plan = plan.replace(
        "estimates:\n", "estimates:\n  level: {estimator: median_output, segments: P1, output: torquer_x}\n"
    )
    own = tmp_path / "plan.yaml"
    own.write_text(plan, encoding="utf-8")
    assert planrunner("check", "plan.yaml").returncode == 0
    run = planrunner("run", "plan.yaml", "--set", "device_serial=1", "--set", "operator=test", "--runs", "runs")
    assert run.returncode == 0, run.stderr
    assert "level" in run.stdout
    own.write_text(plan.replace("median_output", "medianoutput"), encoding="utf-8")
    refused = planrunner("check", "plan.yaml")
    assert refused.returncode == 2
    assert "did you mean 'median_output'?" in refused.stderr
