"""Every `console` example of the docs: its commands run, and what it shows of their output appears.

In a ```console block a line that begins with `$` is a command; the lines after it must appear in its output in that order, `…` standing for
anything. The blocks of one page run one after the other in one folder, which holds copies of the shipped plans and suites. A plain
`planrunner` command is called in this process, anything that needs a shell in one.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

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
LONG = ("planrunner run ", "planrunner night ", "planrunner design ", "planrunner diagnose ", "planrunner simulate ")


def marked(page: Path) -> Any:
    """The README's examples belong to the fast tests whatever they do; of the other pages those that take seconds to the slow ones."""
    takes_long = page.name != "README.md" and any(command.startswith(LONG) for command, _ in examples(page))
    return pytest.param(page, marks=[pytest.mark.slow] if takes_long else [], id=page.name)


@pytest.mark.parametrize("page", [marked(page) for page in SHOWN])
def test_examples_run_as_shown(page: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for plan in (ROOT / "plans").glob("*.yaml"):
        (tmp_path / plan.name).write_bytes(plan.read_bytes())
    shutil.copytree(ROOT / "plans" / "suites", tmp_path / "suites")
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
