"""Recomputing stored results bit by bit, and other evaluations of a run with who, when and why."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from planrunner.archive import formats
from planrunner.archive.provenance import computed_with
from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.tasks.amendment import Amendment
from planrunner.tasks.estimate import analyse_run
from planrunner.tasks.prove import TOLERANCE, prove
from planrunner.tasks.verify import verify_run

ROOT = Path(__file__).parents[2]
FLAGSHIP = ROOT / "plans" / "flexure_gyro_eight_position.yaml"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sealed run of a short plan, with one analysis."""
    folder = tmp_path_factory.mktemp("original")
    plan = folder / "plan.yaml"
    plan.write_text(FLAGSHIP.read_text(encoding="utf-8").replace("dwell: 2 min", "dwell: 2 s"), encoding="utf-8")
    given = ["--set", "device_serial=1", "--set", "operator=test", "--quiet", "--flushed", "--runs", str(folder)]
    assert main(["run", str(plan), *given]) in (0, 1)
    (run,) = folder.glob("2*")
    return run


@pytest.fixture
def run(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "run"))


def rewrite(run: Path, change: Any) -> None:
    """The results changed with all digests that refer to them, as anyone can do without a signature."""
    path = run / "analyses" / "1" / "results.json"
    results = json.loads(path.read_bytes())
    change(results)
    path.write_bytes(formats.to_bytes(results))
    digests = json.loads(path.with_name("digests.json").read_bytes())
    del digests["digest"]
    digests["files"]["results.json"] = hashlib.sha256(path.read_bytes()).hexdigest()
    path.with_name("digests.json").write_bytes(formats.digested(digests))
    assert not verify_run(run).changes


def shift(fraction: float) -> Any:
    """Moves the first coefficient by a fraction of its standard uncertainty."""

    def change(results: dict[str, Any]) -> None:
        one = results["estimates"][0]["coefficients"][0]
        one["value"] += fraction * one["standard_uncertainty"]

    return change


def other_numpy(results: dict[str, Any]) -> None:
    results["computed_with"]["numpy"] = "1.0"


def test_results_are_proved_from_the_samples(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(path for path in run.rglob("*"))
    assert json.loads((run / "analyses/1/results.json").read_bytes())["computed_with"] == computed_with()
    assert main(["estimate", "--prove", str(run)]) == 0
    assert "bit for bit" in capsys.readouterr().out
    assert sorted(path for path in run.rglob("*")) == before


def test_a_forged_result_with_right_digests_is_not_reproduced(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite(run, shift(1e-9))
    assert main(["estimate", "--prove", str(run), "--json"]) == 4
    (entry,) = json.loads(capsys.readouterr().out)
    assert (entry["verdict"], entry["versions_changed"]) == ("different", {})
    assert entry["largest_change"] == pytest.approx(1e-9, rel=0.01)


def test_texts_that_differ_are_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def change(results: dict[str, Any]) -> None:
        results["estimates"][0]["notes"].append({"text": "added", "template": "added", "values": {}})
        results["estimates"][0]["coefficients"][0]["description"]["text"] += "!"

    rewrite(run, change)
    assert main(["estimate", "--prove", str(run)]) == 4
    said = capsys.readouterr().out
    name = json.loads((run / "analyses/1/results.json").read_bytes())["estimates"][0]["name"]
    assert "NOT REPRODUCED: every number is identical to the stored number, but texts differ" in said
    assert f"estimates.{name}.notes" in said and f"estimates.{name}.coefficients." in said
    assert "largest change" not in said


def test_numbers_that_belong_to_no_coefficient_are_named(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rewrite(run, lambda results: results["segments"][0].update(count=7))
    assert main(["estimate", "--prove", str(run)]) == 4
    said = capsys.readouterr().out
    assert "texts differ" not in said and "no coefficient changes; these differ: segments.1" in said


def test_other_versions_may_change_the_last_digits_only(run: Path) -> None:
    rewrite(run, other_numpy)
    assert prove(run).verdict == "identical"
    rewrite(run, shift(TOLERANCE / 2))
    proof = prove(run)
    assert (proof.verdict, list(proof.changed)) == ("within tolerance", ["numpy"])
    rewrite(run, shift(TOLERANCE))
    assert prove(run).verdict == "different"


def amended_plan(run: Path, folder: Path, *changes: tuple[str, str]) -> Path:
    text = (run / "plan.yaml").read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "amended.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_an_amendment_is_another_analysis_with_who_and_why(run: Path, tmp_path: Path) -> None:
    first = (run / "analyses" / "1" / "results.json").read_bytes()
    plan = amended_plan(run, tmp_path, ("segments: P*", "segments: [P1, P2, P3, P4, P5, P6, P8]"))
    words = ["--why", "P7 was recorded <b>while the door stood open</b>", "--by", "Q. Engineer"]
    assert main(["amend", str(run), *words, "--plan", str(plan)]) in (0, 1)
    folder = run / "analyses" / "2"
    amendment = json.loads((folder / "amendment.json").read_bytes())
    Draft202012Validator(json.loads((ROOT / "schemas" / "amendment.schema.json").read_bytes())).validate(amendment)
    assert (amendment["amends"], amendment["by"]) == (1, "Q. Engineer")
    digests = run / "analyses" / "1" / "digests.json"
    assert amendment["amended_digests"] == hashlib.sha256(digests.read_bytes()).hexdigest()
    assert (run / "analyses" / "1" / "results.json").read_bytes() == first
    assert (folder / "results.json").read_bytes() != first
    report = (folder / "report.html").read_text(encoding="utf-8")
    assert "Q. Engineer" in report and "&lt;b&gt;while the door" in report
    found = verify_run(run)
    assert not found.changes and "Q. Engineer" in found.amendments[2]
    assert prove(run).verdict == prove(run, 1).verdict == "identical"


def test_an_amendment_keeps_what_was_measured(run: Path, tmp_path: Path) -> None:
    plan = amended_plan(run, tmp_path, ("dwell: 2 s", "dwell: 3 s"))
    with pytest.raises(InputError, match="differs from that of the run in: segments"):
        analyse_run(run, amendment=Amendment("A", "b", _document(plan)))
    for by, why in ((" ", "b"), ("A", ""), ("A\nB", "b"), ("A", "x" * 501), ("A\u202eB", "b")):
        with pytest.raises(InputError, match="one line"):
            analyse_run(run, amendment=Amendment(by, why))
    with pytest.raises(InputError, match="no analysis 7"):
        analyse_run(run, amendment=Amendment("A", "b", amends=7))
    assert sorted(path.name for path in (run / "analyses").iterdir()) == ["1"]


def _document(path: Path) -> Any:
    from planrunner.tasks.check import Document

    return Document(path.read_bytes(), str(path))
