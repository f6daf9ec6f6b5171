"""Every `console` example of the docs: its commands run, and what it shows of their output appears.

In a ```console block a line that begins with `$` is a command; the lines after it must appear in its output in that order, `…` standing for
anything. The blocks of one page run one after the other in one folder, which holds copies of the shipped plans. A plain `planrunner`
command is called in this process, anything that needs a shell in one. Where a page shows no report, the plans ask for none, whose
pictures take longer than most runs; `make test-slow` runs the plans as they are shipped.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import NO_PAGE, PAGE
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"^```console\n(.*?)^```", re.DOTALL | re.MULTILINE)
DATA = "../shared/data"


def examples(page: Path) -> list[tuple[str, list[str]]]:
    """Commands of a page with the output lines shown."""
    found: list[tuple[str, list[str]]] = []
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.splitlines():
            if line.startswith("$ "):
                found.append((line[2:], []))
            elif line.strip():
                found[-1][1].append(line.strip())
    return found


def plain(command: str) -> bool:
    """Whether it is one `planrunner` command that a shell would do nothing to but expand `*`; not a server, which waits for signals."""
    shell = "|&;<>$`~?[("
    quoted = re.sub(r"'[^']*'", "", command)
    return command.startswith("planrunner ") and "simulate-bench" not in command and not set(shell) & set(quoted)


def expanded(word: str, folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.glob(word)) if "*" in word else [word]


SHOWN = [page for page in PAGES if examples(page)]
RUNS = [page for page in SHOWN if any(command.startswith("planrunner run ") for command, _ in examples(page))]
WITHOUT_REPORT = [page for page in RUNS if "report.html" not in page.read_text(encoding="utf-8")]


@pytest.mark.slow
@pytest.mark.parametrize("page", WITHOUT_REPORT, ids=lambda page: page.name)
def test_examples_run_with_their_reports(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    run_as_shown(page, tmp_path, request)
    reports = [report.read_text(encoding="utf-8") for report in tmp_path.glob("runs/*/analyses/1/report.html")]
    assert reports
    assert all("<svg" in report for report in reports)


@pytest.mark.parametrize("page", SHOWN, ids=lambda page: page.name)
def test_examples_run_as_shown(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    run_as_shown(page, tmp_path, request, reports=page not in WITHOUT_REPORT)


def run_as_shown(page: Path, tmp_path: Path, request: pytest.FixtureRequest, reports: bool = True) -> None:
    """reports: whether the plans write the pages that they ask for."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for plan in (ROOT / "plans").glob("*.yaml"):
        text = plan.read_text(encoding="utf-8")
        (tmp_path / plan.name).write_text(text if reports else text.replace(PAGE, NO_PAGE), encoding="utf-8")
    for command, shown in examples(page):
        if DATA in command:
            command = command.replace(DATA, str(request.getfixturevalue("data_root")))
        environment = {"PATH": path, "COLUMNS": "160"}
        if plain(command):
            words = [found for word in shlex.split(command)[1:] for found in expanded(word, tmp_path)]
            done = planrunner(*words, cwd=tmp_path, **environment)
        else:
            done = subprocess.run(
                command, shell=True, cwd=tmp_path, env={**os.environ, **environment}, capture_output=True, text=True
            )
        assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
        output = done.stdout + done.stderr
        place = 0
        for line in shown:
            words = [r"\s+".join(map(re.escape, part.split())) for part in line.split("…")]
            match = re.compile(r"[^\n]*".join(words)).search(output, place)
            assert match, f"{command}\ndoes not print\n{line}\nbut\n{output}"
            place = match.end()
