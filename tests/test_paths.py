"""The two paths in CONTRIBUTING.md, against a profile of a run and of its diagnosis: the code enters each listed file."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "planrunner"
ELSEWHERE = {
    "archive/played_back.py": "a recording in a file",
    "instruments/recording.py": "a recording in a file",
}
"""Files of the path of a diagnosis that this recording does not need, and what needs them."""

PROFILE = """
import json, sys, threading
from pathlib import Path
from planrunner.cli import main
package, out, *arguments = sys.argv[1:]
entered = set()
def note(frame, event, argument):
    if event == "call" and frame.f_code.co_flags & 1:  # a function, not the body of a module or class
        entered.add(frame.f_code.co_filename)
threading.setprofile(note)
sys.setprofile(note)
code = main(arguments)
sys.setprofile(None)
inside = [name[len(package) + 1 :].replace(chr(92), "/") for name in entered if name.startswith(package)]
Path(out).write_text(json.dumps(inside), encoding="utf-8")
sys.exit(code)
"""


def listed(path: str) -> set[str]:
    section = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split(f"## The path of a {path}\n")[1]
    folder, found = "", set()
    for named, file in re.findall(r"`([\w/]+/)`|`([\w/]+\.py)`", section.split("\n## ")[0].split("\n1. ", 1)[1]):
        folder = named or folder
        if file:
            found.add(file if "/" in file else f"{folder}{file}")
    return found


def entered(out: Path, *arguments: str) -> set[str]:
    run = [sys.executable, "-c", PROFILE, str(PACKAGE), str(out), *arguments]
    subprocess.run(run, check=True, capture_output=True, cwd=ROOT)
    return set(json.loads(out.read_text(encoding="utf-8")))


@pytest.mark.slow
def test_a_run_and_its_diagnosis_enter_the_files_of_their_paths(tmp_path: Path) -> None:
    plan, said = "plans/imu_multi_position.yaml", ["--set", "device_serial=1", "--set", "operator=X"]
    dwell = entered(tmp_path / "run.json", "run", plan, "--flushed", "--quiet", "--runs", str(tmp_path / "runs"), *said)
    assert listed("dwell") - dwell == set()
    (run,) = (tmp_path / "runs").iterdir()
    page = str(tmp_path / "page.html")
    diagnosis = entered(tmp_path / "diagnosis.json", "diagnose", str(run), "--html", page)
    assert listed("diagnosis") - diagnosis == ELSEWHERE.keys()
    of_the_gap = {name for name in diagnosis if name.startswith("gap/")}
    assert of_the_gap - listed("diagnosis") == set(), "files of the diagnosis that its path does not list"
