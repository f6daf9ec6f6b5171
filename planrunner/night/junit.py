"""Writes a night as JUnit XML, in the form that Jenkins and GitLab read: one test suite for each plan, and one test case for each
test.

A failed limit becomes a `failure`. A fault, a refused plan, and a test that did not run become an `error`, because CI systems
regard skipped tests as harmless. A known failure becomes `skipped`, with the reason that the suite states.
"""

from __future__ import annotations

import re
from datetime import datetime
from xml.etree import ElementTree as ET

from planrunner.base.documents import JsonObject

_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ELEMENT = {
    "failed": "failure",
    "fault": "error",
    "refused": "error",
    "not_run": "error",
    "known_failure": "skipped",
    "waiting": "error",
    "running": "error",
}


def to_junit(night: JsonObject) -> bytes:
    """Makes the JUnit document of a night from the night's record in JSON."""
    tests = night["tests"]
    root = ET.Element("testsuites", {"name": _text(night["title"]), **_counts(tests), "time": _total(tests)})
    for entry in dict.fromkeys(test["entry"] for test in tests):
        members = [test for test in tests if test["entry"] == entry]
        about = {
            "name": _text(entry),
            **_counts(members),
            "skipped": str(sum(_ELEMENT.get(test["state"]) == "skipped" for test in members)),
            "time": _total(members),
            "timestamp": _text(night["begins"][:19]),
            "hostname": _text(night["host"]),
        }
        suite = ET.SubElement(root, "testsuite", about)
        for test in members:
            _add_case(suite, test)
    ET.indent(root)
    document: bytes = ET.tostring(root, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add_case(suite: ET.Element, test: JsonObject) -> None:
    case = ET.SubElement(
        suite, "testcase", name=_text(test["test"]), classname=_text(test["entry"]), time=_seconds(_duration(test))
    )
    element = _ELEMENT.get(test["state"])
    if element is not None:
        told = ET.SubElement(case, element, type=test["state"], message=_text(test["reason"]))
        if element != "skipped":
            failed = [limit for limit in test["limits"] if limit["verdict"] != "pass"]
            told.text = _text("\n".join(f"{limit['quantity']}: {limit['words']}" for limit in failed) or test["reason"])
    where = [
        f"run: {test['run']}",
        f"analysis: {test['analysis']}",
        f"device: {test['device']}, bench: {test['bench']}",
    ]
    ET.SubElement(case, "system-out").text = _text("\n".join(where))


def _counts(tests: list[JsonObject]) -> dict[str, str]:
    kinds = [_ELEMENT.get(test["state"]) for test in tests]
    return {"tests": str(len(tests)), "failures": str(kinds.count("failure")), "errors": str(kinds.count("error"))}


def _duration(test: JsonObject) -> float:
    if test["begins"] is None or test["ends"] is None:
        return 0.0
    return max(0.0, (datetime.fromisoformat(test["ends"]) - datetime.fromisoformat(test["begins"])).total_seconds())


def _total(tests: list[JsonObject]) -> str:
    return _seconds(sum(map(_duration, tests)))


def _seconds(value: float) -> str:
    return f"{value:.3f}"


def _text(text: str) -> str:
    """Replaces characters that XML 1.0 does not permit."""
    return _NOT_XML.sub("�", text)
