"""`--json` prints one JSON document, of the shape that docs/json-output.md gives, errors too; commands over several runs do all of them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from planrunner.cli import main
from planrunner.cli.exit_codes import DONE, INTEGRITY, WRONG_INPUT

ROOT = Path(__file__).resolve().parents[2]
FLAGSHIP = str(ROOT / "plans" / "flexure_gyro_eight_position.yaml")
FINDING = {"file", "line", "column", "code", "severity", "message", "hint"}
PAGE = (ROOT / "docs" / "json-output.md").read_text(encoding="utf-8")


def documented(command: str) -> str:
    """The cell of the page that gives a command's shape."""
    (row,) = [line for line in PAGE.splitlines() if line.startswith("| ") and f"`{command}`" in line.split("|")[1]]
    return row


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Two runs, the second of them tampered with."""
    folder = tmp_path_factory.mktemp("json")
    plan = folder / "short.yaml"
    plan.write_text(Path(FLAGSHIP).read_text(encoding="utf-8").replace("dwell: 2 min", "dwell: 10 s"), encoding="utf-8")
    given = ["--set", "device_serial=1", "--set", "operator=test", "--quiet", "--flushed"]
    for name in ("good", "bad"):
        assert main(["run", str(plan), *given, "--runs", str(folder / name)]) in (0, 1)
    good, bad = (next(path for path in (folder / name).iterdir() if path.is_dir()) for name in ("good", "bad"))
    file = next((bad / "segments").glob("*P3*.parquet"))
    file.write_bytes(file.read_bytes()[:-1] + b"x")
    return str(good), str(bad)


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, Any]:
    """Exit code and what standard output holds, which must be JSON and nothing else."""
    capsys.readouterr()
    code = main([*words, "--json"])
    return code, json.loads(capsys.readouterr().out)


def assert_findings(found: Any) -> None:
    assert found and all(set(one) == FINDING for one in found)


@pytest.mark.parametrize("command", ["estimate", "report", "export"])
def test_several_runs_are_all_done_and_the_worst_decides(
    command: str, runs: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    good, bad = runs
    words = (command, bad, good, "nowhere") if command == "estimate" else (command, bad, good)
    code, found = printed(capsys, *words)
    assert [one["run"] for one in found] == list(words[1:])
    done = {one["run"]: one for one in found}
    if command == "export":  # which reads results, not samples
        assert code == done[bad]["exit_code"] == DONE
    else:
        assert code == done[bad]["exit_code"] == INTEGRITY
        assert_findings(done[bad]["findings"])
    if command == "estimate":
        assert done["nowhere"]["exit_code"] == WRONG_INPUT
        assert done["nowhere"]["findings"][0]["code"] == "run-not-found"
    assert done[good]["exit_code"] in (0, 1)
    assert "findings" not in done[good]
    assert all(f"`{key}`" in documented(command) for key in done[good] if not key.startswith("planrunner_")) or (
        command == "estimate"
    )


def test_one_run_is_a_list_too(runs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    _, found = printed(capsys, "estimate", runs[0])
    assert len(found) == 1
    assert found[0]["planrunner_results"] == 3
    assert Path(found[0]["analysis"]).is_dir()


def test_several_runs_are_exported_into_a_folder(
    runs: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", *runs, "drift", "--output", str(tmp_path / "one.csv")]) == WRONG_INPUT
    assert "export-several" in capsys.readouterr().err
    assert main(["export", *runs, "drift", "--output", str(tmp_path)]) == DONE
    assert {path.name for path in tmp_path.iterdir()} == {f"{Path(run).name}-drift.csv" for run in runs}


def test_a_certificate_belongs_to_one_run(runs: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    code, found = printed(capsys, "report", *runs, "certificate.html")
    assert code == WRONG_INPUT
    assert found[0]["code"] == "report-several"


def test_results_in_the_terminal_stand_below_the_name_of_their_run(
    runs: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main(["estimate", runs[1], runs[0]]) == INTEGRITY
    out = capsys.readouterr().out
    assert 0 <= out.index(f"{runs[1]}:") < out.index(f"{runs[0]}:") < out.index("SF_X")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("show", "nowhere.yaml"), "file-missing"),
        (("run", "nowhere.yaml"), "file-missing"),
        (("new", "nothing-like-it"), "new-unknown"),
        (("pause", "nowhere"), "run-not-found"),
        (("report",), "command-usage"),
        (("export",), "command-usage"),
        (("check",), "command-usage"),
    ],
)
def test_errors_are_findings(words: tuple[str, ...], code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exit_code, found = printed(capsys, *words)
    assert exit_code == WRONG_INPUT
    assert_findings(found)
    assert found[0]["code"] == code


def test_unknown_arguments_are_answered_with_the_usage_of_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", FLAGSHIP, "--fast"]) == WRONG_INPUT
    said = capsys.readouterr().err
    assert "usage: planrunner check" in said
    assert "unrecognized arguments: --fast" in said
    assert "`planrunner check --help`" in said
    _, found = printed(capsys, "check", FLAGSHIP, "--fast")
    assert found[0]["message"] == "unrecognized arguments: --fast"
    assert found[0]["hint"].startswith("usage: planrunner check")


def test_show(capsys: pytest.CaptureFixture[str]) -> None:
    code, found = printed(capsys, "show", FLAGSHIP)
    assert code == DONE
    assert set(found) == set(re.findall(r"`(\w+)`", documented("show"))) - {
        "show", "name", "nominal", "unit", "standard_uncertainty",
    }  # fmt: skip
    first, second = found["segments"][:2]
    assert second["start_s"] >= first["start_s"] + first["dwell_s"]
    assert found["total_s"] >= found["segments"][-1]["start_s"]
    assert {item["name"] for item in found["predicted"]["drift"]} >= {"SF_X", "D_X_F"}


def test_bench_list_and_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _, listed = printed(capsys, "bench", "list")
    assert set(listed) == {"benches", "drivers"}
    assert {"virtual", "lab_simulated"} <= {one["name"] for one in listed["benches"]}
    assert {one["role"] for one in listed["drivers"]} >= {"table", "chamber", "sensor"}
    _, plans = printed(capsys, "new")
    assert "flexure_gyro_allan" in {one["name"] for one in plans}
    monkeypatch.chdir(tmp_path)
    _, made = printed(capsys, "new", "flexure_gyro_allan", "mine.yaml")
    assert Path(made["plan"]).is_file() and Path(made["schema"]).is_file()


HEADER = re.compile(r"^# yaml-language-server: \$schema=(\S+)$", re.MULTILINE)


@pytest.mark.parametrize("where", ["", "schemas", "../schemas"])
def test_a_copied_plan_names_a_schema_that_exists(where: str, tmp_path: Path) -> None:
    """In an empty folder, and in projects that keep the schema beneath or beside the folder of the plan."""
    project = tmp_path / "project" / "plans"
    project.mkdir(parents=True)
    if where:
        (project / where).mkdir()
        (project / where / "plan.schema.json").write_text("{}", encoding="utf-8")
    target = project / "mine.yaml"
    assert main(["new", "flexure_gyro_allan", str(target)]) == DONE
    header = HEADER.search(target.read_text(encoding="utf-8"))
    assert header is not None
    schema = target.parent / header[1]
    assert schema.is_file()
    if where:
        assert schema.read_text(encoding="utf-8") == "{}"
        assert [path.name for path in project.rglob("*.json")] == (["plan.schema.json"] if where == "schemas" else [])
    else:
        assert json.loads(schema.read_text(encoding="utf-8"))["title"]
    assert main(["check", str(target)]) == DONE


def test_a_copy_that_cannot_be_finished_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "plan.schema.json").mkdir()
    assert main(["new", "flexure_gyro_allan", str(tmp_path / "mine.yaml")]) == WRONG_INPUT
    assert not (tmp_path / "mine.yaml").exists()
