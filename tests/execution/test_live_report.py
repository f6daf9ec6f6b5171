"""The live state that a run publishes: its statistics against numpy's over all samples at once, and answers from another process."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_bench import make_bench, segment
from test_executor import carry_out, new_run
from test_watching import events
from watched_bench import make_watched_bench

from planrunner.archive import live as files
from planrunner.archive.live import Answer, LiveState, read_live, write_answer
from planrunner.archive.run_reader import RunReader
from planrunner.archive.verifying import verify
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.execution import live, operator
from planrunner.execution.executor import execute
from planrunner.execution.live import LiveReport
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Block
from planrunner.plan.schedule import Schedule

TWO = Schedule((segment(0, "A"), segment(1, "B", prompts=("Mount face B",))), 0.0)


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every state is published."""
    monkeypatch.setattr(live, "EVERY", 0.0)
    monkeypatch.setattr(operator, "EVERY", 0.001)


@pytest.mark.parametrize("most", [7, 50_000])
@pytest.mark.usefixtures("at_once")
def test_statistics_and_strips_are_those_of_all_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most: int
) -> None:
    monkeypatch.setattr(live, "MOST_WAITING", most)
    rng = np.random.default_rng(3)
    samples = 9.80665 + 1e-6 * rng.standard_normal((2, 500))
    moments = np.arange(500, dtype=np.float64) * 0.01
    folder = GuardedFolder.open(tmp_path)
    report = LiveReport(folder, 1)
    report.announce({"x": "g", "y": "g"})
    report.begin(segment(0, "A"))
    cuts = [0, *sorted(rng.choice(np.arange(1, 500), 9, replace=False)), 500]
    buffer = np.empty((2, 500), dtype=np.float64)
    for number, (begin, end) in enumerate(pairwise(cuts)):
        piece = buffer[:, : end - begin]
        piece[:] = samples[:, begin:end]
        report.take(Block(moments[begin:end], {"x": piece[0], "y": piece[1]}))
        piece[:] = np.nan  # a driver may reuse its buffers
        if number % 3 == 2:
            report.beat()
    report.beat()
    state = read_live(folder)
    assert state is not None and [channel.name for channel in state.channels] == ["x", "y"]
    for channel, values in zip(state.channels, samples, strict=True):
        assert channel.count == 500
        assert channel.mean == pytest.approx(values.mean(), abs=2e-9)  # ten digits are published
        assert channel.standard_deviation == pytest.approx(values.std(ddof=1), rel=1e-6)
        assert (channel.least, channel.greatest) == pytest.approx((values.min(), values.max()), abs=2e-9)
        assert min(channel.strip.least) == channel.least and max(channel.strip.greatest) == channel.greatest
        assert len(channel.strip.mean) == len(state.strip_time)
    assert state.strip_time[-1] == moments[-1] and list(state.strip_time) == sorted(state.strip_time)


@pytest.mark.usefixtures("at_once")
def test_a_run_publishes_its_place_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[LiveState] = []
    publish = files.publish

    def publishing(run: GuardedFolder, state: LiveState) -> None:
        publish(run, state)
        read = read_live(run)
        assert read is not None
        seen.append(read)
        assert not [fault for fault in verify(run.path) if fault.severity == "error"]

    monkeypatch.setattr(live, "publish", publishing)
    monkeypatch.setattr("planrunner.execution.progress.EVERY", 0.0)
    outcome, reader = carry_out(tmp_path, make_bench(), TWO)
    assert outcome.ok
    assert {(one.index, one.label) for one in seen if one.label} == {(0, "A"), (1, "B")}
    assert all(one.segments == 2 for one in seen) and seen[-1].channels[0].count > 0
    fractions = [one.fraction for one in seen]
    assert fractions == sorted(fractions)
    assert not (reader.path / files.NAME).exists() and not list(verify(reader.path))


def test_a_disk_that_takes_no_live_state_does_not_end_a_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(live, "publish", full)
    monkeypatch.setattr(live, "EVERY", 0.0)
    outcome, _ = carry_out(tmp_path, make_bench(), TWO)
    assert outcome.ok


class Elsewhere:
    """The operator is at the live page."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def ask(self, prompt: str) -> Callable[[], bool]:
        return lambda: False

    def tell(self, text: str) -> None:
        self.told.append(text)


def states(run: Path) -> Iterator[LiveState]:
    deadline = time.monotonic() + 240
    while time.monotonic() < deadline:
        state = read_live(GuardedFolder.open(run))
        if state is not None:
            yield state
        time.sleep(0.002)
    raise AssertionError("the run showed no prompt")


@pytest.mark.usefixtures("at_once")
def test_a_prompt_is_confirmed_from_another_process_and_the_journal_names_who(tmp_path: Path) -> None:
    person = Elsewhere()

    def answering(run: Path) -> None:
        folder = GuardedFolder.open(run)
        question = next(state.question for state in states(run) if state.question is not None)
        write_answer(folder, Answer("f" * 16, "somebody else"))  # of an earlier prompt
        while (folder.path / files.ANSWER).exists():
            time.sleep(0.002)
        assert question.text == "Mount face B"
        write_answer(folder, Answer(question.id, "Li Wei"))

    with new_run(tmp_path) as writer:
        thread = threading.Thread(target=answering, args=(writer.path,))
        thread.start()
        outcome = execute(TWO, make_watched_bench(), writer, stop=StopRequest(), operator=person)
        thread.join()
    reader = RunReader.open(writer.path)
    assert outcome.ok and person.told == ["confirmed on the live page by Li Wei"]
    assert [(event["answer"], event["by"]) for event in events(reader, "asked")] == [("done", "Li Wei")]
    assert not list(verify(writer.path))
