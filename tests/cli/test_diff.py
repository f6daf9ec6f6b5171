"""`planrunner diff`: exit codes, tables, JSON of its schema, hostile files, git."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import jsonschema
import pytest

from planrunner.reporting.difference_page import code
from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]
FLAGSHIP = (ROOT / "plans" / "flexure_gyro_eight_position.yaml").read_text(encoding="utf-8")
SCHEMA = json.loads((ROOT / "schemas" / "difference.schema.json").read_text(encoding="utf-8"))
CHANGED = (
    FLAGSHIP.replace("        P8: {x: south, y: west, z: down}\n", "")
    .replace("dwell: 2 min", "dwell: 1 min")
    .replace("{quantity: drift.D_X_F, within: ±5 deg/h", "{quantity: drift.D_X_F, within: ±6 deg/h")
    .replace("T1: {x: north, y: west, z: up}", "T1: {x: north, y: up, z: east}")
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "a.yaml").write_text(FLAGSHIP, encoding="utf-8")
    (tmp_path / "b.yaml").write_text(CHANGED, encoding="utf-8")
    return tmp_path


def test_exit_codes_are_those_of_diff(folder: Path) -> None:
    (folder / "same.yaml").write_text(
        "# a remark\n" + FLAGSHIP.replace("dwell: 2 min", "dwell: 120 s"), encoding="utf-8"
    )
    (folder / "wrong.yaml").write_text(FLAGSHIP.replace("dwell: 2 min", "dwell: 2"), encoding="utf-8")
    for other, expected in (("same", 0), ("b", 1), ("wrong", 2), ("absent", 2)):
        done = planrunner("diff", "a.yaml", f"{other}.yaml", "--no-predictions", cwd=folder)
        assert done.returncode == expected, done.stdout + done.stderr
    mixed = planrunner("diff", "a.yaml", "virtual", cwd=folder)
    assert mixed.returncode == 2 and "diff-kinds" in mixed.stderr


def test_consequences_are_those_of_two_checks(folder: Path) -> None:
    """Against the numbers that `show` gives for each plan on its own."""
    found = json.loads(planrunner("diff", "a.yaml", "b.yaml", "--json", cwd=folder).stdout)
    jsonschema.validate(found, SCHEMA)
    shown = [json.loads(planrunner("show", f"{name}.yaml", "--json", cwd=folder).stdout) for name in "ab"]
    assert found["consequences"]["total_s"] == [one["total_s"] for one in shown]
    u = [
        {
            (name, item["name"]): item["standard_uncertainty"]
            for name, items in one["predicted"].items()
            for item in items
        }
        for one in shown
    ]
    listed = {
        (one["estimate"], one["name"]): one["standard_uncertainties"] for one in found["consequences"]["predicted"]
    }
    assert listed == {key: [u[0][key], u[1][key]] for key in u[0] if u[0][key] != u[1][key]}
    assert len(listed) > 20
    (limit,) = found["limits"]
    assert (limit["place"], limit["tendency"]) == (["limits", "drift.D_X_F"], "loosened")
    removed = [one["before"] for one in found["segments"] if one["after"] is None]
    turned = [
        one["after"]
        for one in found["segments"]
        if any(c["place"] == ["orientation"] and c["after"] for c in one["changes"])
    ]
    assert (removed, turned) == (["P8"], ["T1"])


def test_terms_that_can_no_longer_be_determined(folder: Path) -> None:
    lines = [
        line
        for line in FLAGSHIP.splitlines(keepends=True)
        if not line.lstrip().startswith(("P4:", "P5:", "P6:", "P7:", "P8:"))
    ]
    (folder / "few.yaml").write_text("".join(lines), encoding="utf-8")
    found = json.loads(planrunner("diff", "a.yaml", "few.yaml", "--json", cwd=folder).stdout)
    assert {one["estimate"] for one in found["consequences"]["lost"]} == {"drift"}
    assert any(one["code"] == "physics-rank" for one in found["consequences"]["new_findings"])
    back = json.loads(planrunner("diff", "few.yaml", "a.yaml", "--json", cwd=folder).stdout)
    assert back["consequences"]["won"] == found["consequences"]["lost"]


def test_a_limit_of_the_bench_newly_reached(folder: Path) -> None:
    head, _, rest = FLAGSHIP.partition("temperature: 25 degC")
    (folder / "hot.yaml").write_text(f"{head}temperature: 85 degC{rest}", encoding="utf-8")
    found = json.loads(planrunner("diff", "a.yaml", "hot.yaml", "--json", cwd=folder).stdout)
    reached = {one["name"]: one["newly_reached"] for one in found["consequences"]["demands"]}
    assert reached == {"highest temperature": True, "lowest temperature": False}


def test_benches(tmp_path: Path) -> None:
    same = planrunner("diff", "virtual", "virtual", "--json", cwd=tmp_path)
    assert same.returncode == 0 and json.loads(same.stdout)["different"] is False
    other = planrunner("diff", "virtual", "virtual_imu", "--json", cwd=tmp_path)
    found = json.loads(other.stdout)
    jsonschema.validate(found, SCHEMA)
    assert other.returncode == 1 and ["site", "latitude"] in [one["place"] for one in found["parts"]]


HOSTILE = "<img src=x onerror=alert(1)> [x](javascript:y) | `a` @user #1 www.example.org"


class Elements(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append(tag)
        assert not any(name.startswith("on") for name, _ in attrs)


def test_hostile_labels_stay_text(folder: Path) -> None:
    added = f"  - {{label: {json.dumps(HOSTILE)}, orientation: {{x: up, y: north}}, conditioning: true}}\n"
    named = FLAGSHIP.replace("\nestimates:\n", f"{added}\nestimates:\n")
    (folder / "h.yaml").write_text(named, encoding="utf-8")
    done = planrunner("diff", "a.yaml", "h.yaml", "--html", "page.html", "--no-predictions", cwd=folder)
    assert done.returncode == 1, done.stderr
    page = (folder / "page.html").read_text(encoding="utf-8")
    parser = Elements()
    parser.feed(page)
    assert not {"img", "script", "iframe", "a", "form"} & set(parser.found)
    assert "&lt;img src=x" in page
    shown = planrunner("diff", "a.yaml", "h.yaml", "--no-predictions", cwd=folder).stdout
    assert "[x](javascript:y)" in " ".join(shown.split())  # no markup of the terminal's tables either
    comment = planrunner("diff", "a.yaml", "h.yaml", "--no-predictions", "--markdown", cwd=folder).stdout
    assert "&#60;img" in comment
    assert not any(sign in comment for sign in ("<img", "@user", "#1 ", "www.", "`"))
    rows = [line for line in comment.splitlines() if line.startswith("| ")]
    assert rows and all(line.count("|") == 6 for line in rows)


def test_a_text_in_markdown_is_one_code_element() -> None:
    assert code("a|b `c` <d>\n&e *f*") == "<code>a&#124;b &#96;c&#96; &#60;d&#62; &#38;e &#42;f&#42;</code>"
    assert code("") == ""
    assert code("a\u202eb\x1b[2J") == "<code>a&#92;u202eb&#92;x1b&#91;2J</code>"
    assert code("±0.5 deg/h") == "<code>±0.5 deg&#47;h</code>"


@pytest.mark.slow  # git starts planrunner for every version of a file
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_git_shows_the_meaning(folder: Path) -> None:
    environment = {**os.environ, "GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull, "HOME": str(folder)}
    program = f"'{sys.executable}' -m planrunner diff"

    def git(*words: str) -> str:
        done = subprocess.run(["git", "-C", str(folder), *words], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    git("init", "-q")
    git("config", "user.name", "n")
    git("config", "user.email", "n@example.org")
    git("config", "diff.planrunner.textconv", f"{program} --textconv")
    git("config", "difftool.planrunner.cmd", f'{program} --no-predictions "$LOCAL" "$REMOTE" || true')
    (folder / ".gitattributes").write_text("*.yaml diff=planrunner\n", encoding="utf-8")
    git("add", "a.yaml", ".gitattributes")
    git("commit", "-qm", "one")
    plan = folder / "a.yaml"
    plan.write_text("# a remark\n" + FLAGSHIP.replace("soak: 10 min", "soak: 600 s"), encoding="utf-8")
    assert git("diff") == ""
    assert "No difference in meaning" in git("difftool", "--no-prompt", "--tool=planrunner")
    plan.write_text(
        FLAGSHIP.replace("V1: {x: up, y: west, z: south}", "V1: {x: up, y: south, z: east}"), encoding="utf-8"
    )
    changed = [line for line in git("diff", "-U0").splitlines() if line[:1] in "+-" and line[:3] not in ("+++", "---")]
    assert changed == [
        '-segments["V1"].orientation: [[0,0,1],[-1,0,0],[0,-1,0]]',
        '+segments["V1"].orientation: [[0,0,1],[0,-1,0],[1,0,0]]',
    ]
    plan.write_text(FLAGSHIP.replace("dwell: 2 min", "dwell: 2"), encoding="utf-8")
    assert "+# this version has no meaning: " in git("diff")
