"""The running runs of an archive, as other processes see them."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from running_run import QUESTION, RunningRun, close_all

from planrunner.archive.live import ANSWER, take_answer
from planrunner.archive.pausing import asked_to_pause
from planrunner.base.findings import InputError
from planrunner.live import monitor as watching
from planrunner.live.monitor import Monitor


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    close_all()


def test_a_run_is_seen_while_it_is_written_and_after_it_has_ended(tmp_path: Path) -> None:
    monitor = Monitor(tmp_path)
    assert monitor.look().running == () and monitor.look().recent == ()
    run = RunningRun(tmp_path)
    (seen,) = monitor.look().running
    assert (seen.header.plan, seen.header.device, seen.header.operator) == ("drift", "FG-7", "night")
    assert seen.state.label == "P3" and not seen.asked_to_pause
    run.end()
    activity = monitor.look()
    assert activity.running == () and [one.outcome for one in activity.recent] == ["finished"]
    json.dumps(activity.to_json(), allow_nan=False)


def test_a_run_whose_process_was_killed_is_not_running(tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    run.writer.close()  # the lock goes, the live state stays
    activity = Monitor(tmp_path).look()
    assert activity.running == () and [one.outcome for one in activity.recent] == ["not finished"]


def test_a_silent_run_is_running_as_long_as_its_folder_is_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watching, "SILENT", 0.0)
    monitor, run = Monitor(tmp_path), RunningRun(tmp_path)
    assert monitor.look().running and monitor.look().running
    run.writer.close()
    assert not monitor.look().running and not monitor.look().running


def test_the_lock_is_tried_seldom(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying it takes it for a moment, in which a resumed run would be refused."""
    tried: list[object] = []

    def is_written(folder: object) -> bool:
        tried.append(folder)
        return False

    monkeypatch.setattr("planrunner.archive.pausing.is_written", is_written)
    monitor, run = Monitor(tmp_path), RunningRun(tmp_path)
    for _ in range(5):
        monitor.look()
    assert len(tried) == 1
    run.show()
    assert monitor.look().running and len(tried) == 1  # a new state is a sign of life


def test_other_folders_and_damaged_states_are_left_out(tmp_path: Path) -> None:
    run = RunningRun(tmp_path)
    (tmp_path / "notes").mkdir()
    (tmp_path / "file").write_text("x", encoding="utf-8")
    (tmp_path / "20260101T000000Z-link-000000").symlink_to(run.path)
    monitor = Monitor(tmp_path)
    assert len(monitor.look().running) == 1
    (run.path / ".live").write_text('{"planrunner_live": 1}', encoding="utf-8")
    activity = monitor.look()
    assert activity.running == () and len(activity.recent) == 1
    (run.path / "run.json").write_text("{}", encoding="utf-8")
    (recent,) = Monitor(tmp_path).look().recent
    assert recent.header.plan == "" and recent.header.run == run.path.name


def test_a_run_is_paused_continued_and_answered(tmp_path: Path) -> None:
    monitor, run = Monitor(tmp_path), RunningRun(tmp_path)
    folder, name = run.writer.folder, run.path.name
    monitor.pause(name)
    assert asked_to_pause(folder) and monitor.look().running[0].asked_to_pause
    monitor.go_on(name)
    assert not asked_to_pause(folder)
    run.show(question=QUESTION)
    monitor.answer(name, QUESTION.id, "  Li   Wei ")
    answer = take_answer(folder, QUESTION.id)
    assert answer is not None and answer.by == "Li Wei"


@pytest.mark.parametrize("by", ["", "   ", "x" * 101, "a\x1b[2Jb", "a\u202eb"])
def test_an_answer_needs_a_name(tmp_path: Path, by: str) -> None:
    monitor, run = Monitor(tmp_path), RunningRun(tmp_path)
    run.show(question=QUESTION)
    with pytest.raises(InputError, match="give a name"):
        monitor.answer(run.path.name, QUESTION.id, by)
    assert not (run.path / ANSWER).exists()


def test_an_answer_must_fit_the_prompt_that_is_shown(tmp_path: Path) -> None:
    monitor, run = Monitor(tmp_path), RunningRun(tmp_path)
    with pytest.raises(InputError, match="this prompt is no longer open"):
        monitor.answer(run.path.name, QUESTION.id, "Li Wei")
    run.show(question=QUESTION)
    with pytest.raises(InputError, match="this prompt is no longer open"):
        monitor.answer(run.path.name, "f" * 16, "Li Wei")


@pytest.mark.parametrize("name", ["", ".", "..", "../other", "a/b", "a\0b", "no such run"])
def test_what_is_no_running_run_of_the_archive_is_refused(tmp_path: Path, name: str) -> None:
    archive = tmp_path / "runs"
    RunningRun(tmp_path / "other")
    RunningRun(archive)
    for act in (Monitor(archive).pause, Monitor(archive).go_on):
        with pytest.raises(InputError, match="no process is writing this run"):
            act(name)


def test_an_archive_that_does_not_exist_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="this folder cannot be opened"):
        Monitor(tmp_path / "nowhere")
