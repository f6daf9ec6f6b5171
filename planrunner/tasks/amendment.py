"""Evaluates a run once more, on behalf of a named person and for a stated reason. The evaluation is stored as a new analysis, which
names the analysis that it amends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime

from planrunner.archive.analyses import StoredAnalysis, chosen_analysis
from planrunner.archive.run_reader import RunReader
from planrunner.base.documents import JsonObject
from planrunner.base.findings import COMMAND_LINE, MISLEADING, InputError, Mark
from planrunner.plan.model import Plan
from planrunner.review.meaning import meaning_of_plan, plain
from planrunner.tasks.check import Document, Sound

AMENDMENT = "amendment.json"
EVALUATED_PLAN = "plan.yaml"
"""The plan whose estimates and limits an amendment uses, stored in its analysis."""
FORMAT = 1
MOST_TEXT = 500
MAY_DIFFER = ("estimates", "limits", "report", "diagnosis")
"""Keys of a plan that belong to the evaluation. All other keys describe what was done."""


@dataclass(frozen=True, slots=True)
class Amendment:
    """Describes an amendment of the evaluation of a run.

    `by`: the person who makes the amendment. `why`: the reason. `plan`: a plan with other estimates or limits; None to use the plan
    of the run. `amends`: number of the analysis that is amended; by default, the newest.
    """

    by: str
    why: str
    plan: Document | None = None
    amends: int | None = None

    def to_json(self, amended: StoredAnalysis) -> JsonObject:
        """Returns the amendment as JSON data according to schemas/amendment.schema.json."""
        return {
            "planrunner_amendment": FORMAT,
            "amends": amended.number,
            "amended_digests": amended.digest,
            "by": self.by,
            "why": self.why,
            "at": datetime.now(UTC).isoformat(timespec="seconds"),
        }


def checked_amendment(amendment: Amendment) -> Amendment:
    """Checks an amendment; returns it without leading and trailing spaces in its texts. Raises `InputError` if the person or the
    reason is missing, or is not one line of plain text."""
    told = {"--by": amendment.by.strip(), "--why": amendment.why.strip()}
    for option, text in told.items():
        if not text or len(text) > MOST_TEXT or not text.isprintable() or MISLEADING.search(text):
            message = f"{option} needs one line of 1 to {MOST_TEXT} characters"
            raise InputError.at(COMMAND_LINE, "amendment-text", message, "write who amends the run, and the reason")
    return Amendment(told["--by"], told["--why"], amendment.plan, amendment.amends)


def amended_analysis(reader: RunReader, amendment: Amendment) -> StoredAnalysis:
    """Returns the analysis that an amendment amends. Raises `InputError` if the run has no such analysis."""
    return chosen_analysis(reader.path, reader.analyses, amendment.amends)


def require_same_measurement(run: Sound, evaluated: Sound) -> None:
    """Raises `InputError` if the plan of an amendment differs from the plan of the run in anything except its evaluation. The
    samples were recorded with the plan of the run, so nothing else can be changed."""
    differ = [name for name, meaning in _measured(evaluated.plan).items() if meaning != _measured(run.plan).get(name)]
    if differ:
        message = f"this plan differs from that of the run in: {', '.join(differ)}"
        hint = f"copy plan.yaml from the run folder and change only {', '.join(MAY_DIFFER)}"
        raise InputError.at(Mark(evaluated.file), "amendment-other-measurement", message, hint)


def _measured(plan: Plan) -> JsonObject:
    return {name: plain(part) for name, part in meaning_of_plan(plan).content.items() if name not in MAY_DIFFER}


def stored_amendment(analysis: StoredAnalysis) -> JsonObject | None:
    """Returns the amendment that an analysis contains; None for an ordinary analysis. Raises `IntegrityError` if the analysis was
    changed."""
    if AMENDMENT not in analysis.files:
        return None
    return analysis.read_json(AMENDMENT, "amendment", "planrunner_amendment", FORMAT)


def in_words(amendment: Mapping[str, object]) -> str:
    """Describes the amendment in one line, for reports and the terminal."""
    return f"amends analysis {amendment['amends']}, by {amendment['by']}: {amendment['why']}"
