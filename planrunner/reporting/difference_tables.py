"""Presents the difference between two plans, benches or runs as tables and as JSON. The terminal, the page and the comment in
Markdown show the same tables.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from planrunner.base.documents import Json, JsonObject, finite
from planrunner.base.findings import Finding
from planrunner.estimators.tables import Cell, Role, Shown, Table, TableColumn, table_of
from planrunner.plan.units import ZERO_CELSIUS
from planrunner.reporting import words
from planrunner.reporting.budgets import shown_unit, two_digits
from planrunner.reporting.show_page import labels_in_short
from planrunner.review.compared import Compared
from planrunner.review.consequences import Consequences, Demand, Undetermined
from planrunner.review.difference import PartChange, SegmentChange
from planrunner.review.runs import CoefficientDifference

FORMAT = 1
MOST_TEXT = 160
"""Maximum length of the text in a cell. A longer text is cut and ends with an ellipsis."""


def headline(compared: Compared) -> str:
    """States in one line whether the two plans, benches or runs differ, and in how many places."""
    found = compared.meaning
    if compared.kind == "run":
        return "The runs differ." if compared.different else "The runs have the same results."
    if found.empty:
        return f"No difference in meaning: both {'plans' if compared.kind == 'plan' else 'benches'} say the same."
    parts = [
        (len([item for item in found.segments if item.before is None]), "segment added", "segments added"),
        (len([item for item in found.segments if item.after is None]), "segment removed", "segments removed"),
        (len([item for item in found.segments if item.moved]), "segment moved", "segments moved"),
        (len([item for item in found.segments if item.renamed]), "segment renamed", "segments renamed"),
        (len([item for item in found.segments if _both(item) and item.changes]), "segment changed", "segments changed"),
        (len(found.limits), "limit changed", "limits changed"),
        (len(found.parts), "other change", "other changes")
        if compared.kind == "plan"
        else (len(found.parts), "change", "changes"),
        (len(found.bench), "change of the bench", "changes of the bench"),
    ]
    return ", ".join(f"{count} {one if count == 1 else many}" for count, one, many in parts if count) + "."


def _both(item: SegmentChange) -> bool:
    return item.before is not None and item.after is not None


def difference_tables(compared: Compared) -> list[Table]:
    """Returns the tables that have rows, the most important first. Values are shown as the files contain them."""
    return [table for table in _tables(compared) if table.rows]


def notes(compared: Compared) -> list[str]:
    """Returns notes on differences that do not change the meaning but may interest a reader, and on results that could not be
    computed."""
    found = compared.meaning
    lines = [
        f"The {change.place[-1]} differs. It is a text for readers, so this is not a difference in meaning."
        for change in found.texts
    ]
    for change in found.rounded:
        lines.append(
            f"{'.'.join(change.place)}: {change.shown[0]} and {change.shown[1]} are equal within the written digits."
        )
    if compared.unforeseen and not found.empty:
        lines.append(f"Consequences are not shown: {compared.unforeseen}.")
    if compared.runs is not None:
        for name, only in zip(compared.names, compared.runs.only, strict=True):
            if only:
                lines.append(f"Only {name} has {', '.join(only)}.")
    return lines


def _tables(compared: Compared) -> Iterator[Table]:
    found, follows = compared.meaning, compared.consequences
    if compared.runs is not None:
        yield _coefficients(compared)
        yield _facts("What differs between the runs", compared, conditions=False)
        yield _facts("Conditions", compared, conditions=True)
    yield _limits(found.limits)
    yield _segments(found.segments)
    yield _parts("Other parts of the plan" if compared.kind != "bench" else "Bench", found.parts)
    yield _parts("Bench", found.bench)
    if follows is not None:
        yield from _consequences(follows)


def _table(title: str, columns: Sequence[str], rows: Sequence[Sequence[Cell]], numbers: Sequence[str] = ()) -> Table:
    made = tuple(TableColumn(text, Role.NUMBER if text in numbers else Role.LABEL) for text in columns)
    return Table(title, made, tuple(tuple(row) for row in rows))


def cut(text: str) -> str:
    """Returns a text, shortened to fit a cell."""
    return text if len(text) <= MOST_TEXT else f"{text[: MOST_TEXT - 1]}…"


# -- meaning ---------------------------------------------------------------------------------------------------------


def _segments(segments: Sequence[SegmentChange]) -> Table:
    """Returns a table with one row for each kind of change: segments that change in the same way share a row."""
    rows: dict[tuple[str, str, str], list[str]] = {}
    for item in segments:
        name = item.after if item.after is not None else item.before or ""
        for change in _segment_rows(item):
            rows.setdefault(change, []).append(name)
    found = [(labels_in_short(names), str(len(names)), *change) for change, names in rows.items()]
    return _table("Segments", ("Segments", "Number", "What", "Before", "After"), found, ("Number",))


def _segment_rows(item: SegmentChange) -> Iterator[tuple[str, str, str]]:
    """Yields the changes of one segment, each as three texts: what changed, the value before the change, and the value after it."""
    if item.before is None or item.after is None:
        text = cut(", ".join(f"{_key(change.place)} {change.shown[0] or change.shown[1]}" for change in item.changes))
        yield ("added", "–", text) if item.before is None else ("removed", text, "–")
        return
    if item.renamed:
        yield "renamed", item.before, item.after
    if item.moved:
        yield "moved", f"place {item.positions[0]}", f"place {item.positions[1]}"
    for change in item.changes:
        yield _key(change.place), *_sides(change)


def _key(place: Sequence[str]) -> str:
    return ".".join(place).replace("_", " ")


def _sides(change: PartChange) -> tuple[str, str]:
    """Returns the values before and after a change as text. For lists of names, only the removed and the added names are shown."""
    if change.gained or change.lost:
        return cut(", ".join(change.lost)) or "–", cut(", ".join(change.gained)) or "–"
    return cut(change.shown[0]) or "–", cut(change.shown[1]) or "–"


def _limits(limits: Sequence[PartChange]) -> Table:
    rows = []
    for change in limits:
        what = {"both": "loosened and tightened", "": "changed"}.get(change.tendency, change.tendency)
        what = "removed" if change.after is None else "added" if change.before is None else what
        rows.append((change.place[-1], what, *_sides(change)))
    return _table("Limits", ("Quantity", "What", "Before", "After"), rows)


def _parts(title: str, changes: Sequence[PartChange]) -> Table:
    return _table(title, ("What", "Before", "After"), [(".".join(change.place), *_sides(change)) for change in changes])


# -- consequences ----------------------------------------------------------------------------------------------------


def _consequences(follows: Consequences) -> Iterator[Table]:
    before, after = follows.total
    if before != after:
        change = (
            ""
            if before is None or after is None
            else f"{'+' if after > before else '−'}{words.duration(abs(after - before))}"
        )
        shown = [("–" if one is None else words.duration(one)) for one in (before, after)]
        yield _table("Total time", ("Before", "After", "Change"), [(*shown, change)])
    yield _table(
        "Terms that can no longer be determined",
        ("Estimate", "Output", "Terms"),
        [_terms(item) for item in follows.lost],
    )
    yield _table(
        "Terms that can now be determined", ("Estimate", "Output", "Terms"), [_terms(item) for item in follows.won]
    )
    yield _table(
        "Predicted standard uncertainties",
        ("Estimate", "Coefficient", "Before", "After", "Unit", "Change"),
        [
            (
                item.estimate,
                item.coefficient,
                _u(item.before),
                _u(item.after),
                shown_unit(item.unit),
                _relative(item.before, item.after),
            )
            for item in follows.predicted
        ],
        ("Before", "After", "Change"),
    )
    yield _table(
        "Use of the bench",
        ("What", "Before", "After", "Limit of the bench", "Unit", "Remark"),
        [_demand(item) for item in follows.demands],
        ("Before", "After", "Limit of the bench"),
    )
    yield _findings("New findings", follows.new)
    yield _findings("Findings that no longer occur", follows.gone)


def _terms(item: Undetermined) -> tuple[str, str, str]:
    return item.estimate, item.output, ", ".join(item.terms)


def _u(value: float | None) -> str:
    return "–" if value is None else two_digits(value)


def _relative(before: float | None, after: float | None) -> str:
    if before is None or after is None:
        return "no longer predicted" if after is None else "newly predicted"
    if not before:
        return ""
    percent = 100 * (after / before - 1)
    return f"{percent:+.1f} %" if abs(percent) < 1000 else f"× {words.number(after / before, 3)}"


def _demand(item: Demand) -> tuple[str, ...]:
    def shown(value: float | None) -> str:
        if value is None:
            return "–"
        return words.number(round(math.degrees(value), 9) if item.unit == "rad/s" else round(value - ZERO_CELSIUS, 6))

    unit = "°/s" if item.unit == "rad/s" else "°C"
    remark = "limit newly reached" if item.newly_reached else ""
    return item.name, shown(item.before), shown(item.after), shown(item.limits[1]), unit, remark


def _findings(title: str, findings: Sequence[Finding]) -> Table:
    rows = [(str(one.mark), f"{one.severity}[{one.code}]", one.message) for one in findings]
    return _table(title, ("Place", "Code", "Finding"), rows)


# -- runs ------------------------------------------------------------------------------------------------------------


def _coefficients(compared: Compared) -> Table:
    assert compared.runs is not None
    columns: tuple[Shown[CoefficientDifference], ...] = (
        Shown(TableColumn("Coefficient"), lambda item: f"{item.estimate}.{item.coefficient}"),
        Shown(TableColumn("First", Role.VALUE), lambda item: item.values[0]),
        Shown(TableColumn("Second", Role.VALUE), lambda item: item.values[1]),
        Shown(TableColumn("Difference", Role.VALUE), lambda item: item.difference),
        Shown(TableColumn("u of the difference", Role.STANDARD_UNCERTAINTY), lambda item: item.standard_uncertainty),
        Shown(TableColumn("Unit"), lambda item: shown_unit(item.unit)),
        Shown(TableColumn("In common"), lambda item: _share(item.common)),
        Shown(TableColumn("p"), lambda item: _probability(item.p)),
        Shown(TableColumn("p (Holm)"), lambda item: _probability(item.holm)),
    )
    return table_of("Coefficients", columns, compared.runs.coefficients)


def _share(common: float) -> str:
    return "–" if abs(common) < 0.005 else f"{100 * common:.0f} %"


def _probability(p: float) -> str:
    if math.isnan(p):
        return "–"
    return "< 0.0001" if p < 1e-4 else f"{p:.2g}"


def _facts(title: str, compared: Compared, *, conditions: bool) -> Table:
    facts = compared.conditions if conditions else compared.facts
    rows = [(fact.name, cut(fact.before) or "–", cut(fact.after) or "–") for fact in facts]
    return _table(title, ("What", "First", "Second"), rows)


# -- JSON ------------------------------------------------------------------------------------------------------------


def difference_json(compared: Compared) -> JsonObject:
    """Returns the difference according to schemas/difference.schema.json. NaN and infinity become null, because JSON has no such
    numbers."""
    found = compared.meaning
    document: JsonObject = {
        "planrunner_difference": FORMAT,
        "kind": compared.kind,
        "different": compared.different,
        "before": {"name": compared.names[0], "sha256": compared.digests[0]},
        "after": {"name": compared.names[1], "sha256": compared.digests[1]},
        "segments": [_segment_json(item) for item in found.segments],
        "limits": [{**_change_json(item), "tendency": item.tendency or None} for item in found.limits],
        "parts": [_change_json(item) for item in found.parts],
        "bench": [_change_json(item) for item in found.bench],
        "texts": [_change_json(item) for item in found.texts],
        "rounded": [_change_json(item) for item in found.rounded],
        "consequences": None if compared.consequences is None else _consequences_json(compared.consequences),
        "unforeseen": compared.unforeseen or None,
    }
    if compared.runs is not None:
        document["coefficients"] = [
            {
                "estimate": item.estimate,
                "name": item.coefficient,
                "unit": item.unit,
                "values": [finite(value) for value in item.values],
                "standard_uncertainties": [finite(value) for value in item.uncertainties],
                "difference": finite(item.difference),
                "standard_uncertainty": finite(item.standard_uncertainty),
                "degrees_of_freedom": finite(item.degrees_of_freedom),
                "common": finite(item.common),
                "p": finite(item.p),
                "p_holm": finite(item.holm),
            }
            for item in compared.runs.coefficients
        ]
        document["only"] = [list(names) for names in compared.runs.only]
        for name, facts in (("facts", compared.facts), ("conditions", compared.conditions)):
            document[name] = [{"name": fact.name, "before": fact.before, "after": fact.after} for fact in facts]
    return document


def _change_json(change: PartChange) -> JsonObject:
    shown: list[Json] = [text or None for text in change.shown]
    made: JsonObject = {"place": list(change.place), "before": change.before, "after": change.after, "shown": shown}
    if change.gained or change.lost:
        made |= {"gained": list(change.gained), "lost": list(change.lost)}
    return made


def _segment_json(item: SegmentChange) -> JsonObject:
    return {
        "before": item.before,
        "after": item.after,
        "positions": list(item.positions),
        "moved": item.moved,
        "renamed": item.renamed,
        "changes": [_change_json(change) for change in item.changes],
    }


def _consequences_json(follows: Consequences) -> JsonObject:
    return {
        "total_s": list(follows.total),
        "predicted": [
            {
                "estimate": item.estimate,
                "name": item.coefficient,
                "unit": item.unit,
                "standard_uncertainties": [item.before, item.after],
            }
            for item in follows.predicted
        ],
        "lost": [_undetermined_json(item) for item in follows.lost],
        "won": [_undetermined_json(item) for item in follows.won],
        "demands": [
            {
                "name": item.name,
                "unit": item.unit,
                "values": [item.before, item.after],
                "limits": list(item.limits),
                "newly_reached": item.newly_reached,
            }
            for item in follows.demands
        ],
        "new_findings": [one.to_json() for one in follows.new],
        "gone_findings": [one.to_json() for one in follows.gone],
    }


def _undetermined_json(item: Undetermined) -> JsonObject:
    return {"estimate": item.estimate, "output": item.output, "terms": list(item.terms)}
