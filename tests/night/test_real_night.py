"""Nights with real processes of `planrunner run`: kill −9 of the night and of everything, and a bench that vanishes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.in_process import planrunner

PLAN = """\
planrunner: 1
title: Positions
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
record: {device_serial: required}
defaults: {temperature: 25 degC, dwell: 2 min}
segments:
  - repeat: 40
    steps:
      - {label: up, orientation: {x: up, y: north}}
      - {label: down, orientation: {x: down, y: north}}
"""
SUITE = """\
planrunner_suite: 1
title: Night
benches: {a: {bench: virtual}, b: {bench: virtual}}
devices:
  D1: {benches: a, set: {device_serial: D1}}
  D2: {benches: b, set: {device_serial: D2}}
plans: {x: {plan: p.yaml}, y: {plan: p.yaml, after: x}}
"""

PARAMETERS = "plans: {x: {plan: p.yaml, devices: D1, set: {operator: n}, parameters: {dwell: [1 min, 3 min]}}}\n"
ROOT = Path(__file__).resolve().parents[2]


def written(folder: Path) -> None:
    (folder / "p.yaml").write_text(PLAN, encoding="utf-8")
    (folder / "night.yaml").write_text(SUITE, encoding="utf-8")


@pytest.mark.slow
def test_after_kill_minus_nine_of_the_night_and_its_tests_half_runs_are_continued(tmp_path: Path) -> None:
    written(tmp_path)
    command = [sys.executable, "-m", "planrunner", "night", "night.yaml", "--runs", "runs", "--quiet"]
    night = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def recorded() -> list[Path]:
        return [path for path in (tmp_path / "runs").glob("2*-p-*") if len(list(path.glob("segments/*.parquet"))) > 3]

    while len(recorded()) < 2 and night.poll() is None:
        time.sleep(0.01)
    children = [int(line) for line in _children(night.pid)]
    assert len(children) == 2
    for number in (night.pid, *children):
        os.kill(number, signal.SIGKILL)
    night.wait()
    halves = {path.name for path in (tmp_path / "runs").glob("2*-p-*")}
    done = planrunner("night", "night.yaml", "--runs", "runs", "--json", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert {test["state"] for test in record["tests"]} == {"passed"}
    kinds = {test["test"]: [attempt["kind"] for attempt in test["attempts"]] for test in record["tests"]}
    assert kinds["x/D1/a"][-1] in ("resume", "estimate") and kinds["x/D2/b"][-1] in ("resume", "estimate")
    runs = {path.name for path in (tmp_path / "runs").glob("2*-p-*")}
    assert halves < runs and len(runs) == 4  # no run folder was lost, none was made twice
    verified = planrunner("verify", "runs", "--all", cwd=tmp_path)
    assert verified.returncode == 0 and "4 runs: all unchanged" in verified.stdout


def _children(number: int) -> list[str]:
    """Process ids of the children of a process, from /proc."""
    return [word for task in Path(f"/proc/{number}/task").iterdir() for word in (task / "children").read_text().split()]


@pytest.mark.slow
def test_a_bench_that_vanishes_stops_itself_alone(tmp_path: Path) -> None:
    """The process of a test is killed at "3 a.m.", as when the computer of the bench loses its link for good."""
    written(tmp_path)
    command = [sys.executable, "-m", "planrunner", "night", "night.yaml", "--runs", "runs", "--quiet"]
    night = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while len(children := _children(night.pid)) < 2 and night.poll() is None:
        time.sleep(0.01)
    os.kill(int(children[0]), signal.SIGKILL)
    assert night.wait() == 3
    (file,) = (tmp_path / "runs" / "nights").glob("2*/night.json")
    states = {test["test"]: test["state"] for test in json.loads(file.read_text(encoding="utf-8"))["tests"]}
    assert sorted(states.values()) == ["fault", "not_run", "passed", "passed"]
    assert "SIGKILL" in (file.parent / "summary.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_night_over_parameters_keeps_the_runs_of_each_combination_apart(tmp_path: Path) -> None:
    """Two dwells: two plans in each run folder, in the record, in JUnit, in the index and in the history of the device."""
    plan = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
    (tmp_path / "p.yaml").write_text(plan.replace("dwell: 2 min", "dwell: &dwell 2 min"), encoding="utf-8")
    suite = SUITE.partition("plans:")[0] + PARAMETERS
    (tmp_path / "night.yaml").write_text(suite, encoding="utf-8")
    done = planrunner("night", "night.yaml", "--runs", "runs", "--json", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr + done.stdout
    record = json.loads(done.stdout)
    assert [test["test"] for test in record["tests"]] == ["x/D1/a/dwell=1 min", "x/D1/a/dwell=3 min"]
    assert [test["parameters"] for test in record["tests"]] == [{"dwell": "1 min"}, {"dwell": "3 min"}]
    runs = {test["parameters"]["dwell"]: tmp_path / "runs" / test["attempts"][-1]["run"] for test in record["tests"]}
    for dwell, run in runs.items():
        assert f"dwell: &dwell {dwell}}}" in (run / "plan.yaml").read_text(encoding="utf-8")
    (night,) = (tmp_path / "runs" / "nights").glob("2*")
    junit = (night / "junit.xml").read_text(encoding="utf-8")
    assert 'name="x/D1/a/dwell=1 min"' in junit and 'name="x/D1/a/dwell=3 min"' in junit
    listed = planrunner("runs", "runs", "--json", cwd=tmp_path)
    assert {run["plan"] for run in json.loads(listed.stdout)["runs"]} == {"p (dwell=1 min)", "p (dwell=3 min)"}
    for dwell in runs:
        history = planrunner("history", "D1", f"drift.D_X_F (dwell={dwell})", "--json", cwd=tmp_path)
        assert [point["folder"] for point in json.loads(history.stdout)["points"]] == [runs[dwell].name]
    compared = planrunner("compare", *runs.values(), "--json", cwd=tmp_path)  # the user asks for it: one coefficient
    assert "drift.D_X_F" in {one["quantity"] for one in json.loads(compared.stdout)["coefficients"]}
    verified = planrunner("verify", "runs", "--all", cwd=tmp_path)
    assert verified.returncode == 0, verified.stdout + verified.stderr
    # a run with another value for a parameter is continued and evaluated with this value
    again = planrunner("estimate", runs["3 min"], "--json", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
