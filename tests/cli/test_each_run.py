"""Commands on several runs: one that fails, also while its result is stored, does not stop the others."""

from __future__ import annotations

import json
import pickle
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from planrunner.base.findings import InputError, Mark
from planrunner.base.workers import ALONE
from planrunner.cli import exit_codes
from planrunner.cli.each_run import Done, each_result

_RUNS = [Path(name) for name in "abc"]


def name_of(run: Path) -> str:
    return run.name


def divides_by_zero(run: Path) -> float:
    return len(run.name) / 0


@pytest.mark.parametrize("error", [InputError.at(Mark("b"), "file-system", "read-only"), OSError(30, "read-only", "b")])
def test_a_result_that_cannot_be_stored_stops_no_other(error: Exception, capsys: pytest.CaptureFixture[str]) -> None:
    stored = []

    def store(name: str) -> Done:
        if name == "b":
            raise error
        stored.append(name)
        return Done(exit_codes.DONE, {"analysis": name})

    code = each_result(_RUNS, name_of, store, ALONE, what="storing", as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert code == exit_codes.WRONG_INPUT and stored == ["a", "c"]
    assert [one.get("analysis") for one in found] == ["a", None, "c"]
    assert found[1]["findings"][0]["message"] == "read-only"


def test_the_reader_who_closes_the_pipe_ends_the_command() -> None:
    def show(_: str) -> Done:
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        each_result(_RUNS, name_of, show, ALONE, what="showing", as_json=False)


def test_a_traceback_is_written_by_the_command_and_not_by_the_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The results pass through pickle, and the worker can write no temporary file."""

    def elsewhere(work: Callable[[Path], object], items: list[Path], *_: object) -> list[object]:
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "absent"))
        answers = [pickle.loads(pickle.dumps(work(item))) for item in items]
        monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
        return answers

    monkeypatch.setattr("planrunner.cli.each_run.results_in_order", elsewhere)
    code = each_result(_RUNS[:2], divides_by_zero, lambda _: Done(0), ALONE, what="dividing", as_json=False)
    files = sorted(tmp_path.iterdir())
    assert code == exit_codes.FAULT and len(files) == 2
    assert all("ZeroDivisionError" in file.read_text() for file in files)
    said = capsys.readouterr().err
    assert all(str(file) in said for file in files)
