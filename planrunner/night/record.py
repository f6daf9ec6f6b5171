"""Makes the record of a night from the events of its journal.

    <archive>/nights/<UTC time>-<suite>-<id>/
      suite.yaml     the exact bytes of the suite file
      night.jsonl    one event per line, each with the SHA-256 of the previous line; an event is on the disk before the night continues
      night.json     this record (schemas/night.schema.json), replaced as a whole after each event that changes a test
      junit.xml  summary.md
      logs/          output of the process of each attempt

Everything in `night.json` follows from the journal, so that a killed night can be continued from the journal alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import tzinfo
from pathlib import Path
from typing import Literal

from planrunner.archive.verifying import RUN
from planrunner.base.documents import Json, JsonObject
from planrunner.night.civil_time import civil

FOLDER = "nights"
RECORD = "night.json"
FORMAT = 1


def holds_nights(folder: Path) -> bool:
    """Returns True if a folder contains the records of the nights of an archive. This folder is next to the run folders, so the
    pattern `runs/*` also matches it."""
    return folder.name == FOLDER and folder.is_dir() and not (folder / RUN).exists()


StateOfTest = Literal["waiting", "running", "passed", "failed", "known_failure", "fault", "refused", "not_run"]
BAD: tuple[StateOfTest, ...] = ("fault", "refused", "not_run")
"""States of a test that gave no result."""
DONE, LIMIT_FAILED, FAULT, INTERRUPTED = 0, 1, 3, 130


@dataclass(slots=True)
class Attempt:
    """Describes one attempt of a test: a process that makes a run, resumes a run, or computes estimates. `kind`: run, resume or
    estimate. `run`: name of the attempt's run folder in the archive."""

    identity: str
    kind: str
    begins: float
    log: str
    ends: float | None = None
    exit_code: int | None = None
    ending: str = ""
    run: str | None = None
    reason: str = ""


@dataclass(slots=True)
class RecordedTest:
    """Contains a test in the record of a night, with its result."""

    about: JsonObject
    state: StateOfTest = "waiting"
    reason: str = ""
    attempts: list[Attempt] = field(default_factory=list)
    limits: list[Json] = field(default_factory=list)
    analysis: str | None = None

    @property
    def name(self) -> str:
        return str(self.about["test"])


@dataclass(slots=True)
class NightRecord:
    """The record of a night. `state`: running, interrupted, finished, or abandoned if the night was not continued."""

    zone: tzinfo | None = None
    created: JsonObject = field(default_factory=dict)
    tests: list[RecordedTest] = field(default_factory=list)
    state: str = "running"
    now: float = 0.0
    exit_code: int | None = None
    remarks: list[str] = field(default_factory=list)
    warm_ups: list[JsonObject] = field(default_factory=list)
    notifications: list[JsonObject] = field(default_factory=list)
    check_standards: list[JsonObject] = field(default_factory=list)
    fleet: list[JsonObject] = field(default_factory=list)
    sessions: int = 0

    def take(self, event: Mapping[str, Json]) -> None:
        """Updates the record with one event of the journal."""
        self.now = max(self.now, event.get("now", self.now))
        match event["event"]:
            case "created":
                self.created = dict(event)
                self.tests = [RecordedTest(dict(about)) for about in event["tests"]]
            case "session":
                self.sessions += 1
                self.state = "running"
            case "begun":
                test = self.tests[event["test"]]
                test.state = "running"
                test.attempts.append(Attempt(event["id"], event["kind"], event["now"], event["log"]))
            case "ended":
                self._ended(event)
            case "not_run":
                test = self.tests[event["test"]]
                test.state, test.reason = "not_run", event["reason"]
            case "not_repeated":
                test = self.tests[event["test"]]
                test.state, test.reason = event["state"], event["reason"]
            case "warm_up":
                self.warm_ups.append({"bench": event["bench"], "begins": event["now"], "ends": event["until"]})
            case "check_standard":
                self.check_standards.append({"bench": event["bench"], "state": event["state"]})
            case "fleet":
                known = ("plan", "runs", "statements", "changes", "shared", "verdicts")
                self.fleet.append({name: event[name] for name in known})
            case "remark":
                self.remarks.append(event["text"])
            case "notified":
                self.notifications.append({"to": event["to"], "sent": event["sent"], "reason": event["reason"]})
            case "interrupted":
                self.state = "interrupted"
            case "finished":
                self.state, self.exit_code = event["state"], event["exit_code"]

    def _ended(self, event: Mapping[str, Json]) -> None:
        test = self.tests[event["test"]]
        last = test.attempts[-1]
        last.ends, last.exit_code, last.ending = event["now"], event["exit_code"], event["ending"]
        last.run, last.reason = event["run"], event["reason"]
        test.state, test.reason = event["state"], event["reason"]
        test.limits, test.analysis = event["limits"], event["analysis"]

    def verdict(self) -> int:
        """Returns the exit code of the night: 3 if a test gave no result, otherwise 1 if a test failed, otherwise 0."""
        states = {test.state for test in self.tests}
        if states & {*BAD, "waiting", "running"}:
            return FAULT
        return LIMIT_FAILED if "failed" in states else DONE

    def counts(self) -> dict[str, int]:
        """Returns the number of tests in each state, with the most important state first. States without tests are left out."""
        order = ("failed", "fault", "refused", "not_run", "known_failure", "passed", "running", "waiting")
        found = {state: sum(test.state == state for test in self.tests) for state in order}
        return {state: number for state, number in found.items() if number}

    def time(self, instant: float | None) -> str | None:
        """Converts an instant to local time with offset, as ISO 8601 text. None stays None."""
        return None if instant is None else civil(instant, self.zone).isoformat(timespec="seconds")

    def to_json(self) -> JsonObject:
        """Returns the content of night.json."""
        ends = [attempt.ends for test in self.tests for attempt in test.attempts if attempt.ends is not None]
        return {
            "planrunner_night": FORMAT,
            "night": self.created["night"],
            "suite": self.created["suite"],
            "title": self.created["title"],
            "digest": self.created["digest"],
            "clock": self.created["clock"],
            "host": self.created["host"],
            "planrunner": self.created["planrunner"],
            "state": self.state,
            "begins": self.time(self.created["begins"]),
            "limit": self.time(self.created["closes"]),
            "foreseen_end": self.time(self.created["foreseen_end"]),
            "ends": self.time(max(ends)) if ends else None,
            "exit_code": self.exit_code,
            "sessions": self.sessions,
            "counts": self.counts(),
            "tests": [self._test_json(test) for test in self.tests],
            "warm_ups": [
                {"bench": item["bench"], "begins": self.time(item["begins"]), "ends": self.time(item["ends"])}
                for item in self.warm_ups
            ],
            "check_standards": list(self.check_standards),
            "fleet": list(self.fleet),
            "remarks": list(self.remarks),
            "notifications": list(self.notifications),
        }

    def _test_json(self, test: RecordedTest) -> JsonObject:
        attempts = [
            {
                "kind": attempt.kind,
                "run": attempt.run,
                "begins": self.time(attempt.begins),
                "ends": self.time(attempt.ends),
                "exit_code": attempt.exit_code,
                "ending": attempt.ending,
                "reason": attempt.reason,
                "log": attempt.log,
            }
            for attempt in test.attempts
        ]
        first = test.attempts[0] if test.attempts else None
        last = test.attempts[-1] if test.attempts else None
        return {
            **test.about,
            "state": test.state,
            "reason": test.reason,
            "begins": self.time(first.begins) if first else None,
            "ends": self.time(last.ends) if last else None,
            "run": last.run if last else None,
            "analysis": test.analysis,
            "limits": test.limits,
            "attempts": attempts,
        }
