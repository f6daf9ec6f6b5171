"""Between two segments: prompts that wait for the operator in the safe state, pauses, and how both end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from fake_bench import Bench, make_bench, segment
from test_executor import carry_out, new_run
from test_watching import events
from watched_bench import make_watched_bench

from planrunner.archive.pausing import ask_to_pause, asked_to_pause, is_written, take_back
from planrunner.archive.run_reader import RunReader
from planrunner.base.guarded_folder import GuardedFolder
from planrunner.execution import operator
from planrunner.execution.executor import execute
from planrunner.execution.stopping import StopRequest
from planrunner.instruments.interfaces import Condition, InstrumentError
from planrunner.plan.schedule import Schedule

TWO = Schedule(
    (segment(0, "A", temperature=308.15, soak=20.0), segment(1, "B", temperature=308.15, prompts=("Mount face B",))),
    0.0,
)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operator, "EVERY", 0.001)


class Person:
    """Answers after being looked at a few times; keeps what was said, and what the bench had been asked by then."""

    def __init__(self, bench: Bench, patience: int = 3):
        self.bench, self.patience = bench, patience
        self.asked: list[str] = []
        self.before: list[str] = []
        self.told: list[str] = []

    def ask(self, prompt: str) -> Callable[[], bool]:
        self.asked.append(prompt)
        self.before = list(self.bench.calls)
        left = [self.patience]

        def done() -> bool:
            left[0] -= 1
            return left[0] <= 0

        return done

    def tell(self, text: str) -> None:
        self.told.append(text)


def test_the_operator_is_asked_with_the_bench_safe_and_all_is_reached_again(tmp_path: Path) -> None:
    bench = make_watched_bench()
    person = Person(bench)
    outcome, reader = carry_out(tmp_path, bench, TWO, operator=person)
    assert outcome.ok and person.asked == ["Mount face B"]
    assert person.before[-3:] == ["table.safe", "chamber.safe", "sensor.safe"]
    after = [
        call
        for call in bench.calls[len(person.before) :]
        if call.startswith(("table.limit", "table.or", "chamber.set"))
    ]
    assert after == ["table.limit", "chamber.set 308.15", "table.orient 10"]  # limits first, then what was commanded
    assert [(event["prompt"], event["answer"]) for event in events(reader, "asked")] == [("Mount face B", "done")]


def test_an_open_interlock_is_no_fault_while_the_operator_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The table's interlock is open and the sensor switched off until the operator is done."""
    bench = make_watched_bench()
    person = Person(bench, 50)
    working = {"now": False}
    ask, looked = person.ask, []

    def asked(prompt: str) -> Callable[[], bool]:
        working["now"] = True
        done = ask(prompt)

        def ready() -> bool:
            bench.clock.sleep(0.5)  # time goes by
            working["now"] = not done()
            return not working["now"]

        return ready

    def course(now: float) -> Condition:
        looked.append(working["now"])
        return Condition(faults=("interlock open",) if working["now"] else ())

    def beat() -> None:
        if working["now"]:
            raise InstrumentError("the sensor was switched off")

    monkeypatch.setattr(person, "ask", asked)
    bench.table.course, bench.sensor.heartbeat = course, beat
    outcome, reader = carry_out(tmp_path, bench, TWO, operator=person)
    assert outcome.ok and any(looked)
    assert [event["text"] for event in events(reader, "noticed")] == ["the sensor was switched off"]


def test_nobody_is_asked_on_a_simulated_bench(tmp_path: Path) -> None:
    bench = make_bench(block=1000)
    outcome, reader = carry_out(tmp_path, bench, TWO)
    assert outcome.ok
    assert [event["answer"] for event in events(reader, "asked")] == ["not asked: the bench is simulated"]
    assert bench.calls.count("table.safe") == 1


def test_a_stop_at_a_prompt_ends_the_run_there(tmp_path: Path) -> None:
    bench, stop = make_watched_bench(), StopRequest()
    outcome, reader = carry_out(tmp_path, bench, TWO, stop=stop, operator=Leaving(bench, stop))
    assert outcome.stopped == "after the segment" and outcome.completed == 1 and not outcome.failures
    assert not events(reader, "asked") and len(reader.acknowledged()) == 1


class Leaving(Person):
    """Presses Ctrl-C instead of answering."""

    def __init__(self, bench: Bench, stop: StopRequest):
        super().__init__(bench)
        self.stop = stop

    def ask(self, prompt: str) -> Callable[[], bool]:
        self.stop.request(reason="Ctrl-C")
        return lambda: False


def test_a_bench_that_cannot_be_made_safe_is_not_approached(tmp_path: Path) -> None:
    bench = make_watched_bench()
    bench.safe_fails = True
    person = Person(bench)
    outcome, _ = carry_out(tmp_path, bench, TWO, operator=person)
    assert not person.asked
    assert (
        "cannot be brought into a state that is safe to approach: table: the brake does not answer"
        in outcome.failures[0].message
    )
    assert outcome.unsafe


def test_a_run_waits_at_the_boundary_and_goes_on(tmp_path: Path) -> None:
    """Asked to pause from outside while the first segment records; continued from outside, as the commands do it."""
    bench = make_watched_bench()
    person = Person(bench)
    schedule = Schedule((segment(0, "A"), segment(1, "B")), 0.0)
    stream = bench.sensor.stream
    with new_run(tmp_path) as writer:

        def asking(item: object) -> object:
            if item is schedule.segments[0]:
                assert is_written(writer.folder)
                ask_to_pause(writer.folder)
            return stream(item)

        bench.sensor.stream = asking
        waited = threading.Thread(target=_go_on_later, args=(writer.path, bench))
        waited.start()
        outcome = execute(schedule, bench, writer, stop=StopRequest(), operator=person)
        waited.join()
    reader = RunReader.open(writer.path)
    assert outcome.ok and len(reader.acknowledged()) == 2
    assert len(events(reader, "paused")) == len(events(reader, "continued")) == 1
    assert bench.calls.count("table.safe") == 2  # for the pause, and at the end
    assert person.told == [f"paused in the safe state; continue with: planrunner resume {writer.path}"]
    assert not is_written(writer.folder)


def _go_on_later(run: Path, bench: Bench) -> None:
    deadline = time.monotonic() + 120
    while "table.safe" not in bench.calls and time.monotonic() < deadline:
        time.sleep(0.005)
    assert take_back(GuardedFolder.open(run))


def test_a_pause_can_be_ended_by_stopping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, stop = make_watched_bench(), StopRequest()
    person = Person(bench)
    monkeypatch.setattr(person, "tell", lambda text: stop.request(at_once=True, reason="SIGTERM"))
    with new_run(tmp_path) as writer:
        ask_to_pause(writer.folder)
        outcome = execute(TWO, bench, writer, stop=stop, operator=person)
    assert outcome.stopped == "at once" and outcome.completed == 0
    assert asked_to_pause(writer.folder) and not take_back(writer.folder) and not asked_to_pause(writer.folder)
