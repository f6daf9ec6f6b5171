"""Commands on run folders that were changed, cut or made elsewhere: the exit code, what is said, and that nothing is lost."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from planrunner.archive import verifying
from planrunner.archive.origin import made_here
from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import verify
from planrunner.cli import main
from planrunner.execution.stopping import StopRequest
from planrunner.plan.schedule import Rest, Segment
from planrunner.tasks import run as running

FLAGSHIP = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
VIRTUAL = FLAGSHIP.parent / "benches" / "virtual.yaml"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sealed run of a short plan, with one analysis."""
    folder = tmp_path_factory.mktemp("original")
    plan = folder / "plan.yaml"
    text = FLAGSHIP.read_text(encoding="utf-8").replace("dwell: 2 min", "dwell: 2 s")
    plan.write_text(text, encoding="utf-8")
    given = ["--set", "device_serial=1", "--set", "operator=test", "--quiet", "--flushed", "--runs", str(folder)]
    assert main(["run", str(plan), *given]) in (0, 1)
    (run,) = folder.glob("2*")
    return run


@pytest.fixture
def run(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "run"))


def cut(run: Path) -> Path:
    """The run as if planrunner had been ended after its third segment."""
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    kept = next(
        at for at, line in enumerate(lines) if json.loads(line)["event"] == "segment" and b'"segment":2' in line
    )
    (run / "journal.jsonl").write_bytes(b"".join(lines[: kept + 1]))
    (run / "seal.json").unlink()
    shutil.rmtree(run / "analyses")
    return run


READERS = (["estimate"], ["report"], ["export"], ["diagnose"], ["resume", "--quiet"])


def outcome(command: list[str], run: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = main([command[0], str(run), *command[1:]])
    said = capsys.readouterr().err
    assert "internal error" not in said and "Traceback" not in said
    return code, said


CHANGES: dict[str, Callable[[Path], object]] = {
    "shortened results": lambda run: (run / "analyses/1/results.json").write_bytes(b'{"planrunner_results": 1, "esti'),
    "another report": lambda run: (run / "analyses/1/report.html").write_text("<p>Passed"),
    "a file too many": lambda run: (run / "notes.txt").write_text("mine"),
    "seal removed": lambda run: (run / "seal.json").unlink(),
    "journal cut": lambda run: (run / "journal.jsonl").write_bytes((run / "journal.jsonl").read_bytes()[:-300]),
    "bench": lambda run: (run / "bench.yaml").write_bytes(VIRTUAL.read_bytes() + b"\n"),
    "samples gone": lambda run: next((run / "segments").iterdir()).unlink(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_command_ends_with_four_and_writes_nothing(
    run: Path, change: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    CHANGES[change](run)
    before = sorted(str(path) for path in run.rglob("*"))
    for command in READERS:
        code, said = outcome(command, run, capsys)
        assert (code, command) == (4, command), said
        assert str(run) in said
    assert sorted(str(path) for path in run.rglob("*")) == before


def test_a_run_that_is_not_sealed_is_read_and_says_so(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cut(run)
    code, said = outcome(["report"], run, capsys)
    assert (code, "run-not-sealed" in said) == (0, True)
    code, said = outcome(["export"], run, capsys)
    assert "run-not-sealed" in said


def test_a_folder_made_here_goes_on_also_when_it_was_moved(run: Path) -> None:
    assert running.resume(cut(run), stop=StopRequest()).ok
    assert verify(run) == []


def test_resuming_looks_a_folder_over_once(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[str] = []
    check = verifying._check_samples

    def counted(found: verifying.Examined, recorded: Any, samples: verifying.SampleCheck) -> None:
        looked.append(samples)
        check(found, recorded, samples)

    monkeypatch.setattr(verifying, "_check_samples", counted)
    assert running.resume(cut(run), stop=StopRequest()).ok
    assert looked == ["contents"]


@pytest.fixture
def elsewhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As on another computer, or for another user: another key."""
    monkeypatch.setenv("PLANRUNNER_STATE", str(tmp_path / "state"))


@pytest.mark.usefixtures("elsewhere")
def test_a_folder_made_elsewhere_is_asked_about(run: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    cut(run)
    journal = (run / "journal.jsonl").read_bytes()
    code, said = outcome(["resume", "--quiet"], run, capsys)
    assert (code, "run-not-made-here" in said, "--trust-bench" in said) == (2, True, True)
    other = tmp_path / "other.yaml"
    other.write_bytes(VIRTUAL.read_bytes().replace(b"seed: ", b"seed: 9"))
    code, said = outcome(["resume", "--quiet", "--bench", str(other)], run, capsys)
    assert (code, "run-other-bench" in said, "seed" in said) == (2, True, True)
    assert (run / "journal.jsonl").read_bytes() == journal
    own = tmp_path / "own.yaml"
    own.write_bytes(b"# mine\n" + (run / "bench.yaml").read_bytes())
    assert running.resume(run, stop=StopRequest(), bench=str(own)).ok
    reopened = [json.loads(line) for line in (run / "journal.jsonl").read_bytes().splitlines() if b'"reopened"' in line]
    assert reopened[-1]["bench"] == hashlib.sha256(own.read_bytes()).hexdigest()


@pytest.mark.usefixtures("elsewhere")
def test_a_folder_made_elsewhere_goes_on_where_its_bench_is_trusted(run: Path) -> None:
    assert running.resume(cut(run), stop=StopRequest(), trust_bench=True).ok
    assert verify(run) == []


# -- where a run was made ----------------------------------------------------------------------------------------------------


def new_run(root: Path) -> RunReader:
    with RunWriter.create(root, "p", b"plan", b"bench", {}, "flushed") as writer:
        writer.begin(Segment(0, "P1", None, "", Rest(), 1.0), 0.0, {})
    return RunReader.open(writer.path)


@pytest.mark.usefixtures("elsewhere")
def test_the_key_is_the_users_alone_and_a_mark_fits_one_run(tmp_path: Path) -> None:
    first, second = new_run(tmp_path), new_run(tmp_path)
    key = tmp_path / "state" / "origin.key"
    assert key.stat().st_mode & 0o077 == 0 or sys.platform == "win32"
    assert made_here(first.folder, first.first) and made_here(second.folder, second.first)
    assert key.read_bytes().hex() not in (first.path / ".origin").read_text()
    shutil.copy(first.path / ".origin", second.path / ".origin")
    assert not made_here(second.folder, second.first)
    (first.path / ".origin").unlink()
    assert not made_here(first.folder, first.first)


@pytest.mark.parametrize("place", ["no home", "a file", "for all to write", "a key that others may read"])
def test_without_a_state_folder_runs_are_made_and_resume_says_why_it_asks(
    place: str, tmp_path: Path, run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "state"
    monkeypatch.setenv("PLANRUNNER_STATE", str(state))
    if place == "no home":
        monkeypatch.delenv("PLANRUNNER_STATE")
        monkeypatch.delenv("XDG_STATE_HOME", raising=False)
        monkeypatch.setenv("HOME", "")
    elif place == "a file":
        state.write_text("")
    elif place == "for all to write":
        state.mkdir()
        state.chmod(0o777)
    else:
        state.mkdir()
        (state / "origin.key").write_bytes(bytes(32))
        (state / "origin.key").chmod(0o644)
    made = new_run(tmp_path / "runs")
    assert not (made.path / ".origin").exists()
    code, said = outcome(["resume", "--quiet"], cut(run), capsys)
    assert (code, "planrunner cannot determine whether" in said, "--trust-bench" in said) == (2, True, True), said
