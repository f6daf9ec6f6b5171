"""Terminals, pipes, folders and arguments that are not as usual."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.reporting import terminal
from tests import in_process
from tests.conftest import FLAGSHIP, NO_PAGE, PAGE

GIVEN = ["--set", "device_serial=1", "--set", "operator=test", "--quiet"]
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": "ascii", "PYTHONCOERCECLOCALE": "0"}


def planrunner(
    *arguments: object, cwd: Path, env: dict[str, str] | None = None, shell: str = ""
) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "planrunner", *map(str, arguments)]
    if shell:
        command = ["bash", "-o", "pipefail", "-c", f'"$@" {shell}', "bash", *command]
    surroundings = {**os.environ, **(env or {})}
    done = subprocess.run(command, cwd=cwd, env=surroundings, capture_output=True, text=True, timeout=120)
    assert "internal error" not in done.stderr
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done


def slowly(value: str) -> Any:
    """A case of the slow tests: each starts a process."""
    return pytest.param(value, marks=pytest.mark.slow)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("odd")
    plan = folder / "plan.yaml"
    plan.write_text(FLAGSHIP.read_text(encoding="utf-8").replace(PAGE, NO_PAGE), encoding="utf-8")
    assert planrunner("run", plan, *GIVEN, "--runs", "runs", cwd=folder, env=ASCII).returncode == 0
    (path,) = (folder / "runs").glob("2*")
    return path


@pytest.mark.parametrize("command", [slowly("estimate"), "report", slowly("export")])
def test_a_terminal_that_knows_only_ascii(command: str, run: Path, tmp_path: Path) -> None:
    done = planrunner(command, run, *(["report.html"] if command == "report" else []), cwd=tmp_path, env=ASCII)
    assert done.returncode == 0, done.stderr
    assert done.stdout.isascii()


@pytest.mark.slow
def test_json_stays_json_without_utf8(run: Path, tmp_path: Path) -> None:
    plan = tmp_path / "\u00e9.yaml"
    plan.write_text("planrunner: 1\ntitle: \u00b5\n", encoding="utf-8")
    for arguments, code in ((["check", plan], 2), (["estimate", run], 0), (["self-test"], 0)):
        done = planrunner(*arguments, "--json", cwd=tmp_path, env=ASCII)
        assert done.returncode == code
        assert json.loads(done.stdout)


@pytest.mark.parametrize("away", ["| true", ">&-"])
@pytest.mark.parametrize("command", ["show", slowly("export")])
def test_a_reader_that_goes_away(command: str, away: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    what = FLAGSHIP if command == "show" else request.getfixturevalue("run")
    assert planrunner(command, what, cwd=tmp_path, shell=away).returncode == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_output_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    done = planrunner("show", FLAGSHIP, cwd=tmp_path, shell=">/dev/full")
    assert done.returncode == 2
    assert "No space left on device" in done.stderr


@pytest.mark.parametrize("width", ["1", slowly("30")])
def test_narrow_terminals_and_no_home(width: str, tmp_path: Path) -> None:
    done = planrunner("show", FLAGSHIP, cwd=tmp_path, env={"COLUMNS": width, "HOME": "", "NO_COLOR": "1"})
    assert done.returncode == 0
    assert "\033" not in done.stdout


def test_a_seed_is_not_negative(tmp_path: Path) -> None:
    done = in_process.planrunner("run", FLAGSHIP, *GIVEN, "--seed", "-5", cwd=tmp_path)
    assert done.returncode == 2
    assert "the seed must be at least 0: -5" in done.stderr
    assert not (tmp_path / "runs").exists()


def test_a_plan_without_estimates_and_reports_says_where_its_recording_is(tmp_path: Path) -> None:
    (tmp_path / "plan.yaml").write_text(
        "planrunner: 1\ntitle: Only a recording\nbench: virtual\n"
        "sensor: {kind: flexure-gyro, outputs: [torquer_x]}\n"
        "segments: [{label: A, orientation: {x: up, y: north, z: west}, dwell: 10 s}]\nreport: []\n",
        encoding="utf-8",
    )
    done = in_process.planrunner("run", "plan.yaml", "--quiet", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / done.stdout.splitlines()[-1] / "results.json").is_file()


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are of Unix")
def test_what_to_expect_fits_the_terminal(tmp_path: Path) -> None:
    import pty

    plan = FLAGSHIP.with_name("scale_factor_tilted.yaml")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "planrunner", "check", str(plan)]
    with open(ours, "rb", buffering=0) as terminal:
        running = subprocess.Popen(command, stdout=theirs, cwd=tmp_path, env={**os.environ, "COLUMNS": "80"})
        os.close(theirs)
        shown = b""
        try:
            while part := terminal.read(4096):
                shown += part
        except OSError:  # how Linux says that the other end has closed
            pass
        assert running.wait(60) == 0
    predicted = [line for line in shown.decode().splitlines() if line.startswith("    K_")]
    assert len(predicted) == 9  # one a line: two would take more
    assert max(map(len, predicted)) <= 80


def test_names_are_folded_on_a_narrow_terminal_and_never_cut() -> None:
    coefficients = tuple(
        Coefficient(f"temperature_coefficient_{axis}", 1.0, "(pulse/s)/(deg/s)/K", 0.1) for axis in "xyz"
    )
    text = io.StringIO()
    console = terminal.console(width=40, file=text)
    console.print(terminal.coefficients_table(Estimate("scale", "estimator", coefficients, np.eye(3))))
    assert "…" not in text.getvalue()
    for axis in "xyz":  # the tail of each name begins a line of its own
        assert re.search(rf"^ *\w+_{axis}\b", text.getvalue(), re.MULTILINE)
