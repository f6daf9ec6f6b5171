"""Stopping a run with signals, going on with it, and run folders that were moved, copied or tampered with."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from planrunner.archive.run_folder import RunWriter
from planrunner.archive.run_reader import RunReader
from planrunner.cli import main
from planrunner.instruments.interfaces import SummaryChannels
from planrunner.plan.schedule import Segment

FLAGSHIP = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
GIVEN = ["--set", "device_serial=1", "--set", "operator=test", "--quiet"]
Main = Callable[..., tuple[int, str]]


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Main:
    """Runs a command in this process; the exit code and standard error."""

    def run(*arguments: object) -> tuple[int, str]:
        code = main([str(argument) for argument in arguments])
        said = capsys.readouterr().err
        assert "internal error" not in said
        return code, said

    return run


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("finished")
    assert main(["run", str(FLAGSHIP), *GIVEN, "--runs", str(folder)]) == 0
    (run,) = folder.glob("2*")
    return run


@pytest.fixture
def copy(finished: Path, tmp_path: Path) -> Path:
    """A copy of a finished run, somewhere else."""
    return Path(shutil.copytree(finished, tmp_path / "moved" / "run"))


def results(run: Path) -> bytes:
    newest = max((run / "analyses").iterdir(), key=lambda path: int(path.name))
    return (newest / "results.json").read_bytes()


def cut_short(run: Path) -> None:
    """As after a crash in the third segment."""
    (run / "seal.json").unlink()
    shutil.rmtree(run / "analyses")
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    (run / "journal.jsonl").write_bytes(b"".join(lines[:9]))


@pytest.mark.skipif(os.name == "nt", reason="signals as on POSIX")
@pytest.mark.parametrize(
    ("signals", "how", "segments"),
    [
        ([signal.SIGINT], "Stopped after the segment", 2),
        ([signal.SIGINT, signal.SIGINT], "Stopped at once", 1),
        ([signal.SIGTERM], "Stopped at once", 1),
    ],
)
def test_signals_stop_a_run_that_can_go_on(
    tmp_path: Path,
    plan_file: Callable[..., Path],
    command: Main,
    monkeypatch: pytest.MonkeyPatch,
    signals: list[signal.Signals],
    how: str,
    segments: int,
) -> None:
    """They come while the second segment records. To processes of their own: tests/lab."""
    begin, left = RunWriter.begin, list(signals)

    def interrupted(
        self: RunWriter,
        segment: Segment,
        clock: float,
        channels: Mapping[str, str],
        summary: SummaryChannels | None = None,
    ) -> None:
        begin(self, segment, clock, channels, summary)
        while segment.index == 1 and left:
            signal.raise_signal(left.pop())

    monkeypatch.setattr(RunWriter, "begin", interrupted)
    code, said = command("run", plan_file(), *GIVEN, "--runs", tmp_path / "runs")
    (run,) = (tmp_path / "runs").glob("2*")
    assert code == 130, said
    assert how in said
    assert "The instruments are in their safe state." in said
    assert f"Continue with: planrunner resume {run}" in said
    assert not (run / "seal.json").exists()
    assert len(RunReader.open(run).acknowledged()) == segments


def test_a_cut_run_goes_on_elsewhere_with_the_same_results(copy: Path, finished: Path, command: Main) -> None:
    cut_short(copy)
    code, said = command("resume", copy, "--quiet")
    assert code == 0, said
    assert results(copy) == results(finished)
    code, said = command("resume", copy)
    assert code == 2
    assert "error[run-finished]" in said


def test_one_of_two_resumes_is_turned_away(copy: Path, finished: Path) -> None:
    cut_short(copy)
    resume = [sys.executable, "-m", "planrunner", "resume", str(copy), "--quiet"]
    both = [subprocess.Popen(resume, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    said = [process.communicate(timeout=120)[1] for process in both]
    assert sorted(process.returncode for process in both) == [0, 2], said
    assert any("error[run-in-use]" in text or "error[run-finished]" in text for text in said)
    assert results(copy) == results(finished)


def test_analyses_may_be_deleted(copy: Path, finished: Path, command: Main) -> None:
    shutil.rmtree(copy / "analyses")
    code, said = command("export", copy)
    assert code == 2
    assert "this run has no analysis yet" in said
    assert command("estimate", copy)[0] == 0
    assert results(copy) == results(finished)
    code, said = command("export", copy, "--analysis", 9)
    assert code == 2
    assert "known here: 1" in said


def change_line(run: Path, change: Callable[[list[bytes]], object]) -> None:
    lines = (run / "journal.jsonl").read_bytes().splitlines(keepends=True)
    change(lines)
    (run / "journal.jsonl").write_bytes(b"".join(lines))


def replace_samples(run: Path) -> None:
    first, second, *_ = sorted((run / "segments").glob("*.parquet"))
    shutil.copy(second, first)


TAMPERED: dict[str, tuple[Callable[[Path], object], str]] = {
    "line edited": (lambda run: change_line(run, lambda lines: lines.insert(5, lines.pop(5)[:-2] + b" }\n")), ":7:"),
    "line removed": (lambda run: change_line(run, lambda lines: lines.pop(5)), ":6:"),
    "line repeated": (lambda run: change_line(run, lambda lines: lines.insert(5, lines[4])), ":6:"),
    "last line removed": (lambda run: change_line(run, lambda lines: lines.pop()), "seal.json: the seal counts"),
    "journal gone": (lambda run: (run / "journal.jsonl").unlink(), "journal.jsonl"),
    "samples replaced": (replace_samples, "0001-P1.parquet"),
    "samples gone": (lambda run: shutil.rmtree(run / "segments"), "segments"),
    "plan edited": (
        lambda run: (run / "plan.yaml").write_text((run / "plan.yaml").read_text() + "#"),
        "plan.yaml: differs",
    ),
    "operator changed": (
        lambda run: (run / "run.json").write_text((run / "run.json").read_text().replace('"test"', '"other"')),
        "run.json: differs",
    ),
    "seal emptied": (lambda run: (run / "seal.json").write_text("{}"), "seal.json"),
}


@pytest.mark.parametrize("name", TAMPERED)
def test_tampering_is_named_and_nothing_is_estimated(copy: Path, command: Main, name: str) -> None:
    tamper, message = TAMPERED[name]
    tamper(copy)
    code, said = command("estimate", copy)
    assert code == 4
    assert message in said
    assert len(list((copy / "analyses").iterdir())) == 1


def test_what_is_no_recording_beside_the_recordings_stops_resume(copy: Path, command: Main) -> None:
    cut_short(copy)
    stray = copy / "segments" / "0009-X.parquet"
    stray.write_text("junk")
    code, said = command("resume", copy, "--quiet")
    assert code == 4
    assert "0009-X.parquet: not samples of this run: move it elsewhere" in said
    stray.unlink()
    assert command("resume", copy, "--quiet")[0] == 0
