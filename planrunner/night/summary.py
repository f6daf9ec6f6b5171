"""Writes the summary of a night: Markdown for readers and chat rooms, and annotations for GitHub Actions."""

from __future__ import annotations

from collections.abc import Iterator

from planrunner.base.documents import JsonObject
from planrunner.base.findings import count_of

WORDS = {
    "passed": "passed",
    "failed": "FAILED",
    "known_failure": "known failure",
    "fault": "FAULT",
    "refused": "REFUSED",
    "not_run": "DID NOT RUN",
    "waiting": "not yet run",
    "running": "running",
}
"""The states of a test in words."""
_ANNOTATION = {"failed": "error", "fault": "error", "refused": "error", "not_run": "error", "known_failure": "warning"}


def headline(night: JsonObject) -> str:
    """States the result of the night in one line."""
    counts = ", ".join(f"{number} {WORDS[state].lower()}" for state, number in night["counts"].items())
    state = {"finished": "", "running": " (running)", "interrupted": " (interrupted)", "abandoned": " (cut short)"}
    return f"{night['title']}: {counts}{state[night['state']]}"


def summary(night: JsonObject) -> str:
    """Returns the summary of the night as Markdown. Tests that did not pass come first."""
    lines = [f"# {_cell(headline(night))}", ""]
    lines += [f"- Begin: {night['begins']}", f"- End: {night['ends'] or '–'} (predicted {night['foreseen_end']})"]
    lines += [
        f"- Suite: `{_cell(night['suite'])}`",
        f"- Time: {'simulated' if night['clock'] == 'virtual' else 'real'}",
    ]
    if night["exit_code"] is not None:
        lines.append(f"- Exit code: {night['exit_code']}")
    if night["remarks"]:
        lines += ["", "## Remarks", "", *(f"- {_cell(text)}" for text in night["remarks"])]
    if night["check_standards"]:
        lines += ["", "## Check standards", "", "| bench | check standard | state | why |", "|---|---|---|---|"]
        for item in night["check_standards"]:
            state, why = item["state"], "; ".join(item["state"]["reasons"])
            words = state["standing"] if state["standing"] == "in control" else f"**{state['standing'].upper()}**"
            lines.append(f"| {_cell(item['bench'])} | {_cell(state['device'])} | {words} | {_cell(why) or '–'} |")
    if night["fleet"]:
        lines += ["", "## Fleet", ""]
        for group in night["fleet"]:
            said = group["statements"] or ["no device, bench or occasion stands out, and nothing changed"]
            lines += [f"- {_cell(group['plan'])} ({count_of(group['runs'], 'run')}): {_cell(text)}" for text in said]
        named = [one for group in night["fleet"] for one in group["verdicts"] if one["effects"]]
        if named:
            lines += ["", "| run | diagnosis |", "|---|---|"]
            lines += [f"| `{_cell(one['run'])}` | {_cell(', '.join(one['effects']))} |" for one in named]
    order = sorted(night["tests"], key=lambda test: (test["state"] == "passed", test["state"] == "known_failure"))
    lines += ["", "## Tests", "", "| test | result | reason | run |", "|---|---|---|---|"]
    for test in order:
        run = f"`{test['run']}`" if test["run"] else "–"
        lines.append(f"| {_cell(test['test'])} | {WORDS[test['state']]} | {_cell(test['reason']) or '–'} | {run} |")
    failed = [item for item in night["notifications"] if not item["sent"]]
    if failed:
        lines += ["", "## Notifications that could not be sent", ""]
        lines += [f"- {_cell(item['to'])}: {_cell(item['reason'])}" for item in failed]
    return "\n".join(lines) + "\n"


def github_annotations(night: JsonObject) -> Iterator[str]:
    """Yields workflow commands for GitHub Actions: one annotation for each test that did not pass."""
    for test in night["tests"]:
        level = _ANNOTATION.get(test["state"])
        if level is not None:
            title, file = _property(f"{test['test']}: {WORDS[test['state']]}"), _property(test["plan"])
            yield f"::{level} file={file},title={title}::{_message(test['reason'])}"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _message(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _message(text).replace(":", "%3A").replace(",", "%2C")
