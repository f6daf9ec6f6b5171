"""The recipes of docs/recipes: each calls `planrunner night` with arguments that it accepts, and is valid in its own language."""

from __future__ import annotations

import argparse
import json
import re
import shlex
import shutil
import subprocess
from configparser import RawConfigParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml

from planrunner.cli import night
from tests.in_process import planrunner

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "recipes"
CALL = re.compile(r"planrunner(?:\.exe)?(?:</Command>\s*<Arguments>)? ?night ([^'\n<|]*?)(?= 2>&1|'|\n|<|$)")


def text(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")


def test_the_page_links_every_recipe() -> None:
    page = (FOLDER.parent / "running-a-night.md").read_text(encoding="utf-8")
    assert all(f"recipes/{path.name}" in page for path in FOLDER.iterdir())


@pytest.mark.parametrize("path", sorted(FOLDER.iterdir()), ids=lambda path: path.name)
def test_the_command_is_one_that_planrunner_accepts(path: Path) -> None:
    calls = CALL.findall(path.read_text(encoding="utf-8"))
    assert calls or path.suffix == ".timer"
    for call in calls:
        parser = argparse.ArgumentParser(exit_on_error=True)
        night.add_arguments(parser)
        found = parser.parse_args(shlex.split(call.replace("\\", "/")))
        assert (found.suite, found.runs) == ("suites/laboratory_night.yaml", Path("runs"))


def test_cron() -> None:
    (line,) = [line for line in text("planrunner-night.cron").splitlines() if line[:1].isdigit()]
    *fields, user, command = line.split(maxsplit=6)
    assert user == "lab"
    assert all(re.fullmatch(r"\*|[0-9]+(-[0-9]+)?", field) for field in fields) and len(fields) == 5
    assert "%" not in command  # cron would end the command there
    subprocess.run(["sh", "-n", "-c", command], check=True)


def unit(name: str) -> RawConfigParser:
    found = RawConfigParser(strict=True)
    found.optionxform = str  # type: ignore[assignment,method-assign]
    found.read_string(text(name))
    return found


def test_systemd(tmp_path: Path) -> None:
    service, timer = unit("planrunner-night.service"), unit("planrunner-night.timer")
    assert service["Service"]["User"] != "root"
    assert timer["Install"]["WantedBy"] == "timers.target"
    tool = shutil.which("systemd-analyze")
    if tool is None:
        pytest.skip("systemd-analyze is not installed")
    calendar = subprocess.run([tool, "calendar", timer["Timer"]["OnCalendar"]], capture_output=True, text=True)
    assert calendar.returncode == 0, calendar.stderr
    for name in ("planrunner-night.service", "planrunner-night.timer"):
        program = shutil.which("true") or "/bin/true"
        (tmp_path / name).write_text(text(name).replace("/opt/planrunner/bin/planrunner", program), encoding="utf-8")
    units = [str(tmp_path / name) for name in ("planrunner-night.service", "planrunner-night.timer")]
    done = subprocess.run([tool, "verify", "--man=no", *units], capture_output=True, text=True)
    ours = [line for line in done.stderr.splitlines() if "planrunner-night" in line and "Unknown" in line]
    assert not ours, done.stderr


def document(name: str) -> Any:
    return yaml.load(text(name), Loader=yaml.BaseLoader)


def test_github_actions() -> None:
    workflow = document("github-actions.yml")
    steps = workflow["jobs"]["night"]["steps"]
    assert {"schedule", "workflow_dispatch"} == set(workflow["on"])
    assert all(("uses" in step) != ("run" in step) for step in steps)
    assert [step.get("if") for step in steps[2:]] == ["always()", "always()"]
    for step in steps:
        subprocess.run(["sh", "-n", "-c", step.get("run", "")], check=True)


def test_gitlab() -> None:
    job = document("gitlab-ci.yml")["night"]
    assert job["artifacts"]["when"] == "always"
    assert job["artifacts"]["reports"]["junit"] == "runs/nights/*/junit.xml"


def test_jenkins() -> None:
    script = text("Jenkinsfile")
    assert script.count("{") == script.count("}") and script.count("(") == script.count(")")
    assert "junit 'runs/nights/*/junit.xml'" in script


def test_docker_image_does_not_run_as_root_and_has_a_health_check() -> None:
    """As text: it is built from the tree, from packages whose hashes are locked, for a user that is not root, with programs that exist."""
    root = FOLDER.parents[1]
    lines = re.sub(r"\\\n", " ", text("Dockerfile")).splitlines()
    words = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    order = [word for word, _ in words]
    found = dict(words)
    assert order[0] == "FROM" and order[-1] == "ENTRYPOINT"
    assert re.fullmatch(r"python:3\.\d+-slim", found["FROM"]) and "latest" not in found["FROM"]
    copied, _ = found["COPY"].split()
    assert (root / copied / "pyproject.toml").is_file()
    installs = [part for part in found["RUN"].split("&&") if "pip install" in part]
    assert len(installs) == 2
    locked, own = installs
    assert "--require-hashes" in locked and (root / locked.split("/src/")[1].strip()).is_file()
    assert "--no-deps" in own and own.split()[-1] == "/src"
    user = re.search(r"useradd .*--uid (\d+) (\w+)", found["RUN"])
    assert user is not None and int(user[1]) > 0
    assert found["USER"] == user[2] and order.index("USER") > order.index("RUN")
    options, command = found["HEALTHCHECK"].split(" CMD ")
    assert "--interval=" in options and "--timeout=" in options
    program, *arguments = json.loads(command)
    assert [program] == json.loads(found["ENTRYPOINT"])
    assert planrunner(*arguments, cwd=root).returncode == 0


def test_windows_task() -> None:
    space = "{http://schemas.microsoft.com/windows/2004/02/mit/task}"
    root = ET.fromstring(text("windows-task.xml"))
    assert root.tag == f"{space}Task"
    assert [child.tag.removeprefix(space) for child in root] == ["Triggers", "Principals", "Settings", "Actions"]
    assert root.findtext(f".//{space}MultipleInstancesPolicy") == "IgnoreNew"
    assert root.findtext(f".//{space}RunLevel") == "LeastPrivilege"
