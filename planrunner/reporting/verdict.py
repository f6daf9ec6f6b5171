"""Writes the verdict at the top of every page and at the end of the terminal output, and the stamp beside the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from planrunner.base.findings import count_of
from planrunner.estimators.limits import LimitVerdict, VerdictKind, verdict_kind
from planrunner.instruments.models import DataOrigin


@dataclass(frozen=True, slots=True)
class Headline:
    """The headline of a report. `kind`: the verdict; `warned` means passed with warnings, and `none` means that the plan sets no
    limits."""

    kind: VerdictKind
    text: str
    detail: str = ""


def headline(limits: Sequence[LimitVerdict], failures: Mapping[str, str], warnings: int) -> Headline:
    """Makes the headline, which states whether the limits are met, and the number of warnings that may invalidate the verdict."""
    kind = verdict_kind(limits, failures, warnings)
    failed = [limit.quantity for limit in limits if limit.verdict != "pass"]
    total = len(limits)
    beside = "" if not warnings else f"with {count_of(warnings, 'warning')}"
    if failures:
        whys = "; ".join(f"{name}: {why}" for name, why in failures.items())
        return Headline(kind, _and("Incomplete", beside, "not everything could be estimated"), whys)
    if not total:
        text = f"No limits were set ({count_of(warnings, 'warning')})" if warnings else "No limits were set"
        return Headline(kind, text, "The plan requires values, not a verdict.")
    if failed:
        are = "limit is" if total == 1 else f"of {total} limits are" if len(failed) > 1 else f"of {total} limits is"
        text = _and("Failed", beside, f"{len(failed)} {are} not met")
        return Headline(kind, text, f"Not met: {', '.join(failed)}.")
    met = {1: "the limit is met", 2: "both limits are met"}.get(total, f"all {total} limits are met")
    if not beside:
        return Headline(kind, f"Passed: {met}")
    return Headline(
        kind, _and("Passed", beside, met), "Read the warnings: they state the limits of validity of the values."
    )


def _and(verdict: str, beside: str, why: str) -> str:
    return f"{verdict}{f', {beside}' if beside else ''}: {why}"


@dataclass(frozen=True, slots=True)
class Stamp:
    """Describes the mark next to every verdict on samples that were not measured in this run. `about`: a sentence that explains the
    mark. `alarming`: True if no real item was measured."""

    word: str
    about: str
    alarming: bool


_STAMPS = {
    "simulated": Stamp("SIMULATED", "No item was measured: the instruments of this run are simulated.", True),
    "replayed": Stamp(
        "PLAYED BACK", "The samples are a recording that was played back; they were not recorded in this run.", False
    ),
}


def stamp(origin: DataOrigin | None) -> Stamp | None:
    """Returns the stamp for the origin of samples; None for measured samples, and for results that do not state the origin."""
    return None if origin is None else _STAMPS.get(origin)
