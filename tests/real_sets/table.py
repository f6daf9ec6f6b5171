"""The table of all real sets: what is known, what planrunner says, whether they agree, and whether repeats scatter as stated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tests.real_sets.running import Found, Value
from tests.real_sets.sets import Known, RealSet, Repeat

BEGIN, END = "<!-- real sets: begin -->", "<!-- real sets: end -->"
LEAST_P = 0.01  # probability below which repeats scatter more than their uncertainties say


@dataclass(frozen=True)
class Judged:
    """A result against a known figure. away: distance over the expanded uncertainty of the difference, 95 %."""

    known: Known
    value: Value
    away: float

    @property
    def agrees(self) -> bool:
        return self.away <= 1


@dataclass(frozen=True)
class Scatter:
    """Repeats of a quantity. ratio: their scatter over that which their standard uncertainties say (Birge ratio); p: probability of at
    least this ratio by chance."""

    repeat: Repeat
    ratio: float
    p: float

    @property
    def holds(self) -> bool:
        return self.p >= LEAST_P


def judged(known: Known, found: Found) -> Judged | None:
    value = found.values.get(known.name)
    if value is None:
        return None
    assert value.unit == known.unit, (known.name, value.unit)
    whole = math.hypot(value.expanded, 1.96 * known.u)
    return Judged(known, value, abs(value.value - known.value) / whole)


def scatter(repeat: Repeat, found: Found) -> Scatter | None:
    from scipy.stats import chi2

    values = [found.values[name] for name in repeat.names if name in found.values]
    if len(values) < 2:
        return None
    weights = [1 / value.u**2 for value in values]
    mean = sum(w * value.value for w, value in zip(weights, values, strict=True)) / sum(weights)
    squares = sum(w * (value.value - mean) ** 2 for w, value in zip(weights, values, strict=True))
    degrees = len(values) - 1
    return Scatter(repeat, math.sqrt(squares / degrees), float(chi2.sf(squares, degrees)))


def short(value: float, u: float) -> str:
    """A value to two digits of its uncertainty."""
    digits = max(0, 1 - math.floor(math.log10(u))) if u > 0 and math.isfinite(u) else 3
    return f"{value:.{min(digits, 6)}f}"


def rows(one: RealSet, found: Found) -> list[tuple[str, str, str, str]]:
    """Rows of the table: what, known, what planrunner says, agreement."""
    out = []
    for known in one.known:
        made = judged(known, found)
        if made is None:
            out.append((known.what, "", first_line(found.errors) or "no such result", "not determined"))
            continue
        told = f"{short(made.value.value, made.value.u)} ± {short(made.value.expanded, made.value.u)}"
        agreement = "yes" if made.agrees else f"no: {made.away:.2g} U away"
        out.append(
            (known.what, f"{known.value:.5g}", told + ("" if known.unit == "1" else f" {known.unit}"), agreement)
        )
    for repeat in one.repeats:
        seen = scatter(repeat, found)
        if seen is not None:
            told = (
                "scatter consistent with U"
                if seen.holds
                else f"scatter {seen.ratio:.2g} times as large as expected from U"
            )
            out.append((repeat.what, f"{len(repeat.names)} repeats", told, "yes" if seen.holds else "no"))
    if one.nominal is not None:
        out.append(diagnosed(one, found))
    if not out:
        told = first_line(found.errors) or f"{len(found.values)} coefficients, {len(found.warnings)} warnings"
        out.append((one.remark, "", told, ""))
    return out


def diagnosed(one: RealSet, found: Found) -> tuple[str, str, str, str]:
    expected = " + ".join(one.names) or "nothing"
    if found.diagnosis is None:
        return ("diagnosis", expected, first_line(found.diagnosis_error), "not determined")
    verdict = found.diagnosis["verdict"]
    named = " + ".join(verdict["effects"]) or verdict["kind"]
    if verdict["class"]:
        named += f" (one of {len(verdict['class'])} that cannot be distinguished)"
    if verdict["something_else"]:
        named += ", and something else"
    return ("diagnosis", expected, named, "yes" if right(one, verdict) else "no")


def right(one: RealSet, verdict: Mapping[str, Any]) -> bool:
    """Whether the known effects are named, or are in the class of those that the recording cannot distinguish."""
    return set(verdict["effects"]) == set(one.names) or "+".join(sorted(one.names)) in verdict["class"]


def first_line(text: str) -> str:
    """What the first error says, without its place."""
    line = text.strip().splitlines()[0] if text.strip() else ""
    return line.split(": error", 1)[-1].partition("]: ")[2][:160] if ": error" in line else line[:160]


def of_page(text: str) -> list[tuple[str, ...]]:
    """The rows of the table in a page, with the title of the recording in each."""
    title, found = "", []
    for line in text.partition(BEGIN)[2].partition(END)[0].strip().splitlines()[2:]:
        cells = tuple(cell.strip().replace("\\|", "|") for cell in line.replace("\\|", "\x00").strip("|").split("|"))
        cells = tuple(cell.replace("\x00", "|") for cell in cells)
        title = cells[0] or title
        found.append((title, *cells[1:]))
    return found


def markdown(all_rows: Sequence[tuple[RealSet, Found]]) -> str:
    lines = [
        "| recording | what | known | result of planrunner (± U, 95 %) | agrees |",
        "| --- | --- | --- | --- | --- |",
    ]
    for one, found in all_rows:
        for k, row in enumerate(rows(one, found)):
            cells = (one.title if k == 0 else "", *row)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines)
