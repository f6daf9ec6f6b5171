"""A frozen set is answered once, by committed code, and its answers are short."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.blind.frozen_set import PLACES, NotFrozenError, answer_all, main


def frozen(folder: Path) -> Path:
    for name in ("case-01", "case-02"):
        (folder / "round-9" / name).mkdir(parents=True)
        (folder / "round-9" / name / "recording.parquet").write_bytes(b"")
    (folder / "round-9" / "segments.csv").write_text("label\n", encoding="utf-8")
    return folder / "round-9"


def answer(recording: Path, segments: Path, plan: str) -> dict[str, Any]:
    assert recording.is_file() and segments.is_file()
    where = [{"channel": "gyro_x", "share": 1 / (n + 1)} for n in range(40)]
    following = {"plan": None, "expected": 0.97, "text": "planrunner: 1\n"}
    return {
        "posterior": {"none": 1.0, "gyro_ripple": 1e-9},
        "where": where,
        "next": following,
        "plan": plan,
        "pictures": {"heat": [0.0] * 1000},
    }


def test_answers_are_short_and_name_their_commit(tmp_path: Path) -> None:
    answers = tmp_path / "docs" / "round-9.json"
    assert answer_all(frozen(tmp_path), answers, answer, lambda: "abc") == 2
    found = json.loads(answers.read_text(encoding="utf-8"))
    assert found["commit"] == "abc"
    assert list(found["cases"]) == ["round-9/case-01", "round-9/case-02"]
    one = found["cases"]["round-9/case-01"]
    assert one.keys() == {"posterior", "where", "next", "plan"}
    assert one["posterior"] == {"none": 1.0}
    assert len(one["where"]) == PLACES
    assert one["next"] == {"plan": None, "expected": 0.97}


def test_every_case_is_answered_with_its_own_plan(tmp_path: Path) -> None:
    folder, answers = frozen(tmp_path), tmp_path / "round-9.json"
    (folder / "cases.csv").write_text("case,plan\ncase-01,D\ncase-02,C\n", encoding="utf-8")
    with pytest.raises(NotFrozenError, match="no plan file is named for D: add --plan D=PLAN"):
        answer_all(folder, answers, answer, lambda: "abc", {"C": "c.yaml"})
    answer_all(folder, answers, answer, lambda: "abc", {"C": "c.yaml", "D": "d.yaml"})
    cases = json.loads(answers.read_text(encoding="utf-8"))["cases"]
    assert {name: one["plan"] for name, one in cases.items()} == {
        "round-9/case-01": "d.yaml",
        "round-9/case-02": "c.yaml",
    }


def test_it_is_answered_once(tmp_path: Path) -> None:
    folder, answers = frozen(tmp_path), tmp_path / "round-9.json"
    answer_all(folder, answers, answer, lambda: "abc")
    before = answers.read_bytes()
    with pytest.raises(NotFrozenError, match="is there already"):
        answer_all(folder, answers, answer, lambda: "abc")
    assert answers.read_bytes() == before


def test_nothing_is_answered_by_code_that_differs_from_its_commit(tmp_path: Path) -> None:
    def dirty() -> str:
        raise NotFrozenError("files differ from the commit")

    with pytest.raises(NotFrozenError, match="files differ"):
        answer_all(frozen(tmp_path), tmp_path / "round-9.json", answer, dirty)
    assert not (tmp_path / "round-9.json").exists()


def test_a_folder_that_holds_no_set_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(NotFrozenError, match="holds no blind set"):
        answer_all(tmp_path, tmp_path / "round-9.json", answer, lambda: "abc")
    (tmp_path / "there.json").write_text("{}", encoding="utf-8")
    assert main([str(tmp_path), str(tmp_path / "there.json")]) == 2
    assert "is answered once" in capsys.readouterr().err
