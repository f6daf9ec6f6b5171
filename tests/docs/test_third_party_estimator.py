"""The documented third-party estimator: shown whole in the docs, installed like any package, used from a plan."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "docs" / "examples" / "median_output"


def test_the_docs_show_the_code_that_is_tested() -> None:
    page = (ROOT / "docs" / "writing-an-estimator.md").read_text(encoding="utf-8")
    code = (EXAMPLE / "median_output.py").read_text(encoding="utf-8")
    assert code.rstrip() in page
    assert len(code.splitlines()) <= 40


def test_installed_from_its_folder_it_works_in_a_plan(tmp_path: Path) -> None:
    site = tmp_path / "site"
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-deps",
        "--no-build-isolation",
        "--disable-pip-version-check",
    ]
    subprocess.run([*pip, "--target", str(site), str(EXAMPLE)], check=True, capture_output=True)
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    plan = plan.replace(
        "estimates:\n", "estimates:\n  level: {estimator: median_output, segments: P1, output: torquer_x}\n"
    )
    own = tmp_path / "plan.yaml"
    own.write_text(plan, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(site)}

    def planrunner(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "planrunner", *arguments]
        return subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path)

    assert planrunner("check", "plan.yaml").returncode == 0
    run = planrunner("run", "plan.yaml", "--set", "device_serial=1", "--set", "operator=test", "--runs", "runs")
    assert run.returncode == 0, run.stderr
    assert "level" in run.stdout
    misspelt = own.read_text(encoding="utf-8").replace("median_output", "medianoutput")
    own.write_text(misspelt, encoding="utf-8")
    refused = planrunner("check", "plan.yaml")
    assert refused.returncode == 2
    assert "did you mean 'median_output'?" in refused.stderr
