"""Nights with a stand-in for `planrunner run`, which answers as it is told: rules, record, restarts, faults, reports."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from lxml import etree
from numpy.linalg import LinAlgError

from planrunner.archive.formats import IntegrityError
from planrunner.archive.storage import Storage
from planrunner.base.findings import InputError, Mark
from planrunner.base.workers import ALONE
from planrunner.execution.stopping import StopRequest
from planrunner.night.record import FAULT, INTERRUPTED
from planrunner.night.summary import github_annotations
from planrunner.night.timetable import EndOfTest
from planrunner.observation.refusals import EstimationError
from planrunner.tasks import night as tasks_night
from planrunner.tasks.check_suite import SoundSuite, check_suite
from planrunner.tasks.night import NightClock, NightOptions, NightResult, judged, run_night

ROOT = Path(__file__).resolve().parents[2]
PLAN = """\
planrunner: 1
title: One position
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
record: {device_serial: optional, say: optional}
defaults: {temperature: 25 degC, dwell: 10 min}
segments:
  - {label: A, orientation: {x: up, y: north}}
"""
STAND_IN = """\
import json, os, sys
words = sys.argv[1:]
given = dict(word.split("=", 1) for word in words if "=" in word)
with open(os.environ["CALLS"], "a") as file:
    file.write(json.dumps(words) + "\\n")
kept = os.environ["CALLS"] + ".say"
if words[0] == "run":
    folder = os.path.join(words[words.index("--runs") + 1], "20260101T000000Z-p-" + words[words.index("--id") + 1])
    os.makedirs(folder)
    said = given.get("say", "0").split("+")
    if len(said) > 1:  # answers to the calls, one after the other
        open(kept, "w").write("+".join(said))
else:
    said = open(kept).read().split("+") if os.path.exists(kept) else ["0"]
say = said[min(len(open(os.environ["CALLS"]).readlines()) - 1, len(said) - 1)]
LIMIT = {"quantity": "d.F", "verdict": "fail", "value": 7.0, "unit": "deg/h", "requirement": "within 5", "reason": ""}
answers = {
  "0": {"analysis": "x/analyses/1", "limits": [], "failures": {}},
  "1": {"analysis": "x/analyses/1", "limits": [LIMIT], "failures": {}},
  "3": {"failures": ["the table \\u0007 vanished | at 3 a.m."], "unsafe": []},
  "2": [{"code": "form-type", "severity": "error", "message": "wrong plan"}],
  "busy": [{"code": "bench-in-use", "severity": "error", "message": "held by process 7"}],
  "full": [{"code": "disk-space", "severity": "error", "message": "the disk is full"}]}
if say == "die":
    os.kill(os.getpid(), 9)
print(json.dumps(answers[say]))
sys.exit(int(say) if say.isdigit() else 2)
"""


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "p.yaml").write_text(PLAN, encoding="utf-8")
    (tmp_path / "stand_in.py").write_text(STAND_IN, encoding="utf-8")
    monkeypatch.setenv("CALLS", str(tmp_path / "calls"))
    (tmp_path / "calls").touch()
    return tmp_path


def suite_in(lab: Path, text: str) -> SoundSuite:
    file = lab / "night.yaml"
    file.write_text(f"planrunner_suite: 1\ntitle: Night\nzone: UTC\n{text}", encoding="utf-8")
    return check_suite(file, at="2026-01-12T20:00", workers=ALONE).sound()


def night(lab: Path, sound: SoundSuite, stop: StopRequest | None = None, **options: Any) -> NightResult:
    program = (sys.executable, str(lab / "stand_in.py"))
    told: Callable[[str], None] = options.pop("tell", lambda text: None)
    given = NightOptions(lab / "runs", flushed=True, program=program, tell=told, **options)
    return run_night(sound, given, stop or StopRequest())


def states(result: NightResult) -> dict[str, str]:
    return {test["test"]: test["state"] for test in result.record["tests"]}


@cache
def junit_schema() -> etree.XMLSchema:
    return etree.XMLSchema(etree.parse(str(Path(__file__).parent / "junit-10.xsd")))


def check_reports(result: NightResult) -> etree._Element:
    """The record holds its schema and is on the disk, and JUnit the schema of Jenkins."""
    schema = json.loads((ROOT / "schemas" / "night.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(schema).validate(result.record)
    assert json.loads((result.folder / "night.json").read_text(encoding="utf-8")) == result.record
    document = etree.parse(str(result.folder / "junit.xml"))
    junit_schema().assertValid(document)
    return document.getroot()


EVERYTHING = """\
benches: {a: {bench: virtual}, b: {bench: virtual}}
devices:
  D1: {benches: a, set: {device_serial: D1}}
  D2: {benches: b, set: {device_serial: D2}}
plans:
  good: {plan: p.yaml, devices: D1}
  limit: {plan: p.yaml, devices: D1, set: {say: "1"}}
  needs: {plan: p.yaml, devices: D1, needs: limit}
  known: {plan: p.yaml, devices: D1, set: {say: "1"}}
  refused: {plan: p.yaml, devices: D1, set: {say: "2"}}
  fault: {plan: p.yaml, devices: D2, set: {say: "3"}}
  rest: {plan: p.yaml, devices: D2}
known_failures: [{tests: known/*, until: "2026-12-31", reason: "worn <cable>"}]
"""


def test_every_kind_of_end_reaches_record_exit_code_junit_summary_and_annotations(lab: Path) -> None:
    result = night(lab, suite_in(lab, EVERYTHING))
    assert states(result) == {
        "good/D1/a": "passed",
        "limit/D1/a": "failed",
        "needs/D1/a": "not_run",
        "known/D1/a": "known_failure",
        "refused/D1/a": "refused",
        "fault/D2/b": "fault",
        "rest/D2/b": "not_run",
    }
    assert result.exit_code == result.record["exit_code"] == FAULT
    root = check_reports(result)
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("7", "1", "4")
    found = {
        case.get("name"): [child.tag for child in case if child.tag != "system-out"] for case in root.iter("testcase")
    }
    assert found["good/D1/a"] == [] and found["known/D1/a"] == ["skipped"] and found["needs/D1/a"] == ["error"]
    text = (result.folder / "summary.md").read_text(encoding="utf-8")
    assert "| rest/D2/b | DID NOT RUN | bench b was stopped: there was a fault in fault/D2/b |" in text
    assert "known until 2026-12-31: worn &lt;cable>; d.F: 7 deg/h, required within 5" in text
    assert "vanished \\| at 3 a.m." in text
    lines = list(github_annotations(result.record))
    assert len(lines) == 6
    assert any(line.startswith("::warning ") and "known/D1/a%3A known failure" in line for line in lines)
    assert all(line.count("\n") == 0 for line in lines)


def test_a_night_in_which_only_known_failures_failed_is_good(lab: Path) -> None:
    result = night(lab, suite_in(lab, EVERYTHING.replace('"1"}}\n  needs', '"0"}}\n  needs').split("  refused")[0]
                                + EVERYTHING[EVERYTHING.index("known_failures") :]))  # fmt: skip
    assert result.exit_code == 0 and "known_failure" in states(result).values()


ONE = "benches: {{a: {{bench: virtual}}}}\nset: {{device_serial: D1}}\nplans: {{x: {{plan: p.yaml, set: {{say: '{say}'}}, {more}}}}}\n"


@pytest.mark.parametrize(
    ("say", "more", "state", "attempts"),
    [
        ("3+0", "retries: 1", "passed", 2),
        ("3+3+0", "retries: 1", "fault", 2),
        ("1+0", "retries: 2", "failed", 1),
        ("1+0", "retries: 2, retry_on: [limit]", "passed", 2),
        ("die", "retries: 0", "fault", 1),
        ("full", "retries: 0", "fault", 1),
    ],
)
def test_repetitions(lab: Path, say: str, more: str, state: str, attempts: int) -> None:
    result = night(lab, suite_in(lab, ONE.format(say=say, more=more)))
    (test,) = result.record["tests"]
    assert (test["state"], len(test["attempts"])) == (state, attempts)
    check_reports(result)


NO_TIME = """\
budget: 9 h
benches: {{a: {{bench: virtual}}}}
set: {{device_serial: D1, say: '{say}'}}
plans:
  x: {{plan: p.yaml, retries: 1, retry_on: [limit, fault], retry_after: 10 h, on_limit: stop_night, on_fault: stop_night}}
  rest: {{plan: p.yaml, after: x}}
known_failures: [{{tests: x/*, until: '2026-12-31', reason: worn, of: [{known}]}}]
"""


@pytest.mark.parametrize(
    ("say", "known", "state", "rest", "code"),
    [
        ("1", "fault", "failed", "not_run", 1 | FAULT),
        ("1", "limit", "known_failure", "not_run", FAULT),
        ("3", "limit", "fault", "not_run", FAULT),
    ],
)
def test_a_failure_that_there_is_no_time_to_repeat_is_the_result(
    say: str, known: str, state: str, rest: str, code: int, lab: Path
) -> None:
    """The repetition would begin after the end of the night. What a failure stops is stopped then too."""
    text = NO_TIME.format(say=say, known=known)
    result = night(lab, suite_in(lab, text))
    test, after = result.record["tests"]
    assert (test["state"], after["state"], len(test["attempts"])) == (state, rest, 1)
    assert "; not repeated: it does not fit" in test["reason"]
    assert result.exit_code == code
    assert "not repeated: it does not fit" in (result.folder / "summary.md").read_text(encoding="utf-8")
    check_reports(result)


def test_a_bench_in_use_is_waited_for_and_the_summary_says_so(lab: Path) -> None:
    result = night(lab, suite_in(lab, ONE.format(say="busy+0", more="retries: 0")))
    assert result.exit_code == 0
    assert result.record["remarks"] == ["x/a waited: held by process 7"]
    assert "held by process 7" in (result.folder / "summary.md").read_text(encoding="utf-8")


def test_a_fault_is_continued_in_its_run_folder(lab: Path) -> None:
    night(lab, suite_in(lab, ONE.format(say="3+0", more="retries: 1")))
    first, second = [json.loads(line) for line in (lab / "calls").read_text(encoding="utf-8").splitlines()]
    assert first[0] == "run" and second[0] == "resume"
    assert second[1].endswith(first[first.index("--id") + 1])


def test_a_second_night_of_the_suite_is_refused_while_one_runs(lab: Path) -> None:
    sound = suite_in(lab, ONE.format(say="0", more="retries: 0"))
    found: list[str] = []

    def second(text: str) -> None:
        if not found and "begins" in text:
            with pytest.raises(InputError) as caught:
                night(lab, sound)
            found.append(caught.value.findings[0].code)

    assert night(lab, sound, tell=second).exit_code == 0
    assert found == ["night-in-use"]


def test_two_suites_run_in_one_archive_at_once(lab: Path) -> None:
    sound = suite_in(lab, ONE.format(say="0", more="retries: 0"))
    other = suite_in(lab, ONE.format(say="1", more="retries: 0"))
    inner: list[NightResult] = []

    def second(text: str) -> None:
        if not inner and "begins" in text:
            inner.append(night(lab, other))

    outer = night(lab, sound, tell=second)
    assert (outer.exit_code, inner[0].exit_code) == (0, 1)
    assert outer.folder != inner[0].folder
    assert len(list((lab / "runs").glob("2026*-p-*"))) == 2


KILLER = """\
import os, sys
from pathlib import Path
from planrunner.base.workers import ALONE
from planrunner.execution.stopping import StopRequest
from planrunner.tasks.check_suite import check_suite
from planrunner.tasks.night import NightOptions, run_night

lab, word, number = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
heard = []

def tell(text):
    heard.append(word in text)
    if sum(heard) == number:
        os.kill(os.getpid(), 9)

sound = check_suite(lab / "night.yaml", at="2026-01-12T20:00", workers=ALONE).sound()
run_night(sound, NightOptions(lab / "runs", program=(sys.executable, str(lab / "stand_in.py")), tell=tell), StopRequest())
"""


@pytest.mark.parametrize(
    ("word", "number"),
    [
        pytest.param("begins", 2, marks=pytest.mark.slow),
        ("passed", 1),
        pytest.param("warm-up", 1, marks=pytest.mark.slow),
    ],
)
def test_a_killed_night_goes_on_where_it_stopped(lab: Path, word: str, number: int) -> None:
    text = "benches: {a: {bench: virtual, warm_up: 5 min}}\nplans: {x: {plan: p.yaml, matrix: {device_serial: [D1, D2, D3]}}}\n"
    sound = suite_in(lab, text)
    killed = subprocess.run([sys.executable, "-c", KILLER, str(lab), word, str(number)], cwd=ROOT, check=False)
    assert killed.returncode == -9
    before = [json.loads(line) for line in (lab / "calls").read_text(encoding="utf-8").splitlines()]
    result = night(lab, sound)
    assert result.exit_code == 0 and set(states(result).values()) == {"passed"}
    assert len(list((lab / "runs" / "nights").glob("2*"))) == 1
    assert result.record["sessions"] == 2
    assert "interrupted and continued" in result.record["remarks"][0]
    check_reports(result)
    # What had ended is not run again.
    ended = 1 if word == "passed" or number == 2 else 0
    calls = [json.loads(line) for line in (lab / "calls").read_text(encoding="utf-8").splitlines()][len(before) :]
    assert len([call for call in calls if call[0] == "run"]) <= 3 - ended
    again = night(lab, sound)
    assert again.folder != result.folder  # a finished night is not continued


def test_a_killed_night_keeps_a_result_that_was_not_repeated(lab: Path) -> None:
    text = """\
benches: {a: {bench: virtual}, b: {bench: virtual}}
set: {device_serial: D1, say: "1"}
plans:
  x: {plan: p.yaml, benches: a, retries: 1, retry_on: [limit], retry_after: 1 h}
  y: {plan: p.yaml, benches: b, on_limit: stop_night}
"""
    sound = suite_in(lab, text)
    killed = subprocess.run([sys.executable, "-c", KILLER, str(lab), "not repeated", "1"], cwd=ROOT, check=False)
    assert killed.returncode == -9
    result = night(lab, sound)
    assert states(result) == {"x/a": "failed", "y/b": "failed"} and result.record["sessions"] == 2
    assert "not repeated: the night was stopped: a limit failed in y/b" in result.record["tests"][0]["reason"]
    assert len((lab / "calls").read_text(encoding="utf-8").splitlines()) == 2


def test_ctrl_c_ends_after_the_running_test_and_the_night_can_be_continued(lab: Path) -> None:
    sound = suite_in(
        lab, "benches: {a: {bench: virtual}}\nplans: {x: {plan: p.yaml, matrix: {device_serial: [D1, D2]}}}\n"
    )
    stop = StopRequest()
    result = night(lab, sound, stop, tell=lambda text: stop.request(reason="Ctrl-C") if "passed" in text else None)
    assert result.exit_code == INTERRUPTED
    assert result.record["state"] == "interrupted"
    assert sorted(states(result).values()) == ["passed", "waiting"]
    assert night(lab, sound).exit_code == 0


def test_a_full_disk_stops_the_night_loses_nothing_and_is_said(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = suite_in(
        lab, "benches: {a: {bench: virtual}}\nplans: {x: {plan: p.yaml, matrix: {device_serial: [D1, D2]}}}\n"
    )
    heard: list[str] = []
    write, full = Storage.write, [False]

    def limited(self: Storage, file: Any, data: Any) -> None:
        if full[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        write(self, file, data)

    def tell(text: str) -> None:
        heard.append(text)
        full[0] = full[0] or "begins" in text

    monkeypatch.setattr(Storage, "write", limited)
    result = night(lab, sound, tell=tell)
    assert result.exit_code == FAULT
    assert "No space left on device" in result.trouble
    assert any("no further test begins" in text for text in heard)
    assert states(result) == {"x/a/device_serial=D1": "passed", "x/a/device_serial=D2": "not_run"}
    full[0] = False
    again = night(lab, sound)
    assert again.folder == result.folder and again.exit_code == 0  # the journal ends before the disk was full


def test_a_disk_that_may_be_too_small_is_said_at_the_beginning(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sound = suite_in(lab, ONE.format(say="0", more="retries: 0"))
    assert sound.size > 600 * 100 * 8  # ten minutes at 100 Hz of one channel, and its time
    monkeypatch.setattr("shutil.disk_usage", lambda place: SimpleNamespace(free=sound.size - 1))
    assert "later tests may not run" in night(lab, sound).record["remarks"][0]
    monkeypatch.setattr("shutil.disk_usage", lambda place: SimpleNamespace(free=sound.size))
    assert night(lab, sound).record["remarks"] == []


def test_a_night_in_real_time_waits_for_its_tests_and_warm_ups(lab: Path) -> None:
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    (lab / "real.yaml").write_text(bench.replace("clock: virtual", "clock: wall"), encoding="utf-8")
    text = """\
benches: {a: {bench: real.yaml, warm_up: 1 s}, b: {bench: real.yaml}}
devices: {D1: {benches: a, set: {device_serial: D1}}, D2: {benches: b, set: {device_serial: D2}}}
plans: {x: {plan: p.yaml}, y: {plan: p.yaml, needs: x, set: {say: "1"}}}
"""
    (lab / "night.yaml").write_text(f"planrunner_suite: 1\ntitle: Night\nzone: UTC\n{text}", encoding="utf-8")
    result = night(lab, check_suite(lab / "night.yaml", workers=ALONE).sound())
    assert result.record["clock"] == "wall"
    assert states(result) == {"x/D1/a": "passed", "x/D2/b": "passed", "y/D1/a": "failed", "y/D2/b": "failed"}
    assert result.exit_code == 1
    first = next(test for test in result.record["tests"] if test["test"] == "x/D1/a")
    (warm_up,) = result.record["warm_ups"]
    assert first["begins"] >= warm_up["ends"]
    check_reports(result)


def test_a_damaged_night_is_left_alone_and_a_torn_line_is_dropped(lab: Path) -> None:
    sound = suite_in(lab, ONE.format(say="0", more="retries: 0"))
    first = night(lab, sound)
    journal = first.folder / "night.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    cut = next(number for number, line in enumerate(lines) if b'"event":"ended"' in line)
    journal.write_bytes(b"".join(lines[:cut]) + lines[cut][:20])
    assert night(lab, sound).folder == first.folder
    journal.write_bytes(b"".join(lines[:cut]).replace(b"Night", b"Nacht"))
    heard: list[str] = []
    assert night(lab, sound, tell=heard.append).folder != first.folder
    assert any("cannot be read and is left as it is" in text for text in heard)


def test_an_archive_that_is_a_file_is_refused(lab: Path) -> None:
    sound = suite_in(lab, ONE.format(say="0", more="retries: 0"))
    (lab / "runs").write_text("", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        night(lab, sound)
    assert caught.value.findings[0].code == "night-unwritable"


def test_the_clock_of_a_night_never_goes_back() -> None:
    wall, monotonic = [1000.0], [50.0]
    jumps: list[float] = []
    clock = NightClock(1000.0, virtual=False, jump=jumps.append, wall=lambda: wall[0], monotonic=lambda: monotonic[0])

    def pass_(seconds: float, wall_too: float) -> float:
        monotonic[0] += seconds
        wall[0] += wall_too
        return clock.now()

    assert pass_(10, 10) == 1010
    assert pass_(10, 10 - 3600) == 1020  # an hour back, over midnight: ten seconds have passed
    assert pass_(10, 10) == 1030
    assert pass_(10, 10 + 600) == 1640  # forward, as after a suspended computer
    assert pass_(1, 3) == 1641
    assert jumps == pytest.approx([-3600, 600])


@pytest.mark.parametrize(
    ("code", "document", "ending", "words"),
    [
        (0, {}, EndOfTest.PASSED, ""),
        (1, {"limits": [], "failures": {"drift": "no data"}}, EndOfTest.LIMIT, "drift: no data"),
        (2, {"failures": {"drift": "wrong key"}}, EndOfTest.REFUSED, "wrong key"),
        (
            3,
            {"failures": [], "unsafe": ["table: no answer"]},
            EndOfTest.FAULT,
            "NOT IN THE SAFE STATE: table: no answer",
        ),
        (
            4,
            {"findings": [{"severity": "error", "message": "changed", "code": "run-changed"}]},
            EndOfTest.FAULT,
            "changed",
        ),
        (130, {}, EndOfTest.FAULT, "ended by a signal"),
        (-9, {}, EndOfTest.FAULT, "SIGKILL"),
        (3, {}, EndOfTest.FAULT, "exit code 3"),
        (3, {"unsigned": ["the key is missing"], "failures": {}}, EndOfTest.PASSED, "the key is missing"),
    ],
)
def test_how_a_process_ended(code: int, document: Any, ending: EndOfTest, words: str) -> None:
    found, reason = judged(code, document, asked=False)
    assert found is ending and words in reason


def test_a_process_that_was_asked_to_stop_has_not_failed() -> None:
    assert judged(130, {}, asked=True)[0] is None
    assert judged(130, {}, asked=True, overdue=True)[0] is EndOfTest.FAULT


def test_a_check_standard_that_is_not_in_control_blocks_its_bench_alone(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stand-in answers that the run passed, but leaves no values: no chart, so no other test on this bench. An override lets them
    run, and each gets the reason."""
    monkeypatch.setenv("PLANRUNNER_INDEX", str(lab / "index.sqlite"))
    bench = (ROOT / "plans" / "benches" / "virtual.yaml").read_text(encoding="utf-8")
    rule = "{device: CS-01, plan: standard.yaml, coefficients: {drift.D_X_F: {}}, max_age: 1 d, may_override: [anna]}"
    (lab / "lab.yaml").write_text(f"{bench}check_standard: {rule}\n", encoding="utf-8")
    (lab / "standard.yaml").write_text(PLAN, encoding="utf-8")
    text = """\
benches: {a: {bench: ./lab.yaml, check_standard_first: true%s}, b: {bench: virtual}}
devices: {D1: {}}
plans: {x: {plan: p.yaml}}
"""
    result = night(lab, suite_in(lab, text % ""))
    assert states(result) == {"check standard/CS-01/a": "failed", "x/D1/a": "not_run", "x/D1/b": "passed"}
    first, blocked, _ = result.record["tests"]
    assert "the check standard CS-01 of bench 'virtual' is missing" in first["reason"]
    assert blocked["reason"] == "it needs check standard/CS-01/a, which did not pass"
    check_reports(result)
    assert "| a | CS-01 | **MISSING** |" in (result.folder / "summary.md").read_text(encoding="utf-8")
    again = suite_in(lab, text % ', override_check_standard: {by: anna, why: "levelled"}')
    (lab / "calls").write_text("", encoding="utf-8")
    result = night(lab, again)
    assert states(result) == {"check standard/CS-01/a": "failed", "x/D1/a": "passed", "x/D1/b": "passed"}
    told = "bench a: anna (name not authenticated) overrides the check standard: levelled"
    assert told in result.record["remarks"]
    words = [json.loads(line) for line in (lab / "calls").read_text(encoding="utf-8").splitlines()]
    given = [one[one.index("--override-check-standard") :] for one in words if "--override-check-standard" in one]
    assert [one[:4] for one in given] == [["--override-check-standard", "levelled", "--override-by", "anna"]]


def test_the_diagnosis_after_the_night_is_in_its_record_and_never_its_failure(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = "bench bench-2: table_tilt about_east changed by 4.1 ± 0.6 arcsec"
    record = {
        "plan": "One position",
        "runs": 8,
        "statements": [text],
        "changes": [],
        "shared": [],
        "verdicts": [{"run": "r1", "verdict": "named", "effects": ["table_tilt"]}],
    }
    given: list[Any] = []

    def diagnosed(archive: Path, runs: list[str], asked: Any) -> Any:
        given.append((archive, runs, asked.recent))
        yield record, ""
        yield None, "p: 2 runs are too few to be diagnosed together"
        raise InputError.at(Mark("index"), "index-unavailable", "the server stopped", "start it")

    monkeypatch.setattr(tasks_night, "diagnose_night", diagnosed)
    sound = suite_in(lab, "benches: {a: {bench: virtual}}\nplans: {x: {plan: p.yaml}}\ndiagnosis: {recent: 12}\n")
    result = night(lab, sound)
    assert result.exit_code == 0
    check_reports(result)
    assert not (result.folder / "logs" / "diagnosis.txt").exists()
    ((archive, runs, recent),) = given
    assert (archive, recent) == (lab / "runs", 12)
    assert runs == [result.record["tests"][0]["run"]]
    assert result.record["fleet"] == [record]
    assert any("too few" in remark for remark in result.record["remarks"])
    assert any("the server stopped" in remark for remark in result.record["remarks"])
    summary = (result.folder / "summary.md").read_text(encoding="utf-8")
    assert f"- One position (8 runs): {text}" in summary and "| `r1` | table_tilt |" in summary


@pytest.mark.parametrize(
    ("kind", "internal"), [(LinAlgError, True), (ValueError, True), (EstimationError, True), (IntegrityError, False)]
)
def test_a_night_whose_diagnosis_fails_is_finished(
    lab: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Exception], internal: bool
) -> None:
    def diagnosed(*_: object) -> Any:
        yield None, "p: 2 runs are too few to be diagnosed together"
        raise kind("what went wrong")

    monkeypatch.setattr(tasks_night, "diagnose_night", diagnosed)
    sound = suite_in(lab, "benches: {a: {bench: virtual}}\nplans: {x: {plan: p.yaml}}\ndiagnosis: {recent: 12}\n")
    result = night(lab, sound)
    assert result.exit_code == 0 and result.record["state"] == "finished"
    check_reports(result)
    why = f"internal error: {kind.__name__}: what went wrong; see logs/diagnosis.txt" if internal else "what went wrong"
    assert f"the runs could not be diagnosed: {why}" in result.record["remarks"]
    trace = result.folder / "logs" / "diagnosis.txt"
    assert trace.exists() == internal and (not internal or "in diagnosed" in trace.read_text(encoding="utf-8"))
