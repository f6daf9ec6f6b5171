"""Prepares the data for a report's template: plain dictionaries, lists, text and numbers, made from a `ReportContext`.

Templates have access to nothing else: they can lay out a report but cannot read a file or change a result. The keys:

    title, description                text
    headline                          {kind: pass, warned, fail or none; text; detail}
    stamp                             {word, about, alarming}, for example with the word SIMULATED; no word if the samples were measured
    on_top                            the facts at the top of the page, a list of [name, value]
    probability_percent               coverage probability of the expanded uncertainties
    run, bench, site, provenance      lists of [name, value]
    instruments                       list of {role, facts: list of [name, value]}
    limits                            list of {quantity, requirement, rule, verdict, kind, value, expanded, unit,
                                      factor, guard, probability, reason, rule_in_words, false, prior: `stated` or "", consumer, producer}
    estimates                         list of {name, anchor, estimator, coefficients, others, settings, tables, plots,
                                      correlation, budgets, strong_correlations, notes, warnings, segments}
      coefficients, others            the headline coefficients and all others, lists of {name, description, value, expanded,
                                      standard, unit, factor, freedom}, all text
      tables                          list of {title, columns: list of {title, numeric}, rows of text, more}
      plots, correlation              {title, svg}
      budgets                         the result of `budgets.budget_views`
    signatures                        list of {meaning, name, at, key, analyses, standing, owner, why}
    segments                          one table, in the form of `tables`
    segment_tables                    the content of `segments`, in tables that fit the width of a page
    certificate                       the result of `certificate.certificate_view`
    warnings, notes                   lists of text about the whole report; each entry of `estimates` contains its own

Cells of a table are rounded and aligned according to the roles of its columns (`planrunner.estimators.tables.Role`): an uncertainty
is shown with two digits, and values to its left are rounded to the last digit of the uncertainty."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TypeGuard

from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import count_of
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.estimators.tables import Cell, Role, Table
from planrunner.instruments.models import DataOrigin
from planrunner.reporting import words
from planrunner.reporting.budgets import budget_views, freedom, shown_unit
from planrunner.reporting.certificate import certificate_view, guard_band
from planrunner.reporting.context import PrintedSignature, ReportContext, site_facts
from planrunner.reporting.rounding import format_pair
from planrunner.reporting.segment_tables import segment_table, segment_tables
from planrunner.reporting.templates import render
from planrunner.reporting.verdict import Stamp, stamp
from planrunner.uncertainty.decision import coverage_factor

MAX_ROWS = 2000
STRONG = 0.3  # stronger correlations are listed in words
_PROPER = {"id": "ID", "utc": "UTC"}


def report_view(context: ReportContext) -> JsonObject:
    """Makes the complete data for templates."""
    return {
        "title": context.title,
        "description": context.description,
        "headline": asdict(context.headline),
        "stamp": stamped(context.origin),
        "on_top": named(context.on_top),
        "probability_percent": words.number(100 * context.probability),
        "run": named(context.run_information),
        "bench": named(context.bench),
        "site": [] if context.site is None else [list(item) for item in site_facts(context.site).items()],
        "instruments": [
            {"role": readable(role), "facts": named(identity)} for role, identity in context.instruments.items()
        ],
        "estimates": [
            estimate_view(estimate, index, context.probability) for index, estimate in enumerate(context.estimates)
        ],
        "limits": [limit_row(limit) for limit in context.limits],
        "segments": table_view(segment_table(context.segments)),
        "segment_tables": [table_view(one) for one in segment_tables(context.segments)],
        "warnings": list(context.warnings),
        "notes": list(context.notes),
        "provenance": named(context.provenance),
        "certificate": certificate_view(context),
        "signatures": [signature_view(one) for one in context.signatures],
        "seal": {"digest": context.seal, "code": Picture(partial(seal_code, context.seal))} if context.seal else None,
    }


def signature_view(one: PrintedSignature) -> JsonObject:
    """Returns a signature for templates: its time to the second, and the analyses that it covers as text."""
    numbers = ", ".join(map(str, one.analyses))
    return {**asdict(one), "at": one.at[:19].replace("T", " "), "analyses": numbers}


def stamped(origin: DataOrigin | None) -> JsonObject:
    """Returns the stamp for templates; `word` is empty if there is none."""
    return asdict(stamp(origin) or Stamp("", "", False))


def estimate_view(estimate: Estimate, index: int, probability: float) -> JsonObject:
    """Returns one estimate as data for templates, with its pictures. `index`: number of the estimate, from which ids that are
    unique in the page are made."""
    from planrunner.reporting.plots import correlation, correlation_svg, plot_svg, strong

    key = f"e{index + 1}"
    every = estimate.coefficients
    first = [place for place, item in enumerate(every) if not estimate.headline or item.name in estimate.headline]
    rest = [place for place in range(len(every)) if place not in first]
    rows = [coefficient_row(item, probability) for item in every]
    names = [every[place].name for place in first]
    correlated = len(first) > 1 and estimate.covariance.shape == (len(every), len(every))
    covariance = estimate.covariance[first][:, first] if correlated else estimate.covariance
    pairs = strong(names, correlation(covariance), at_least=0.005) if correlated else []
    return {
        "name": estimate.name,
        "anchor": key,
        "estimator": estimate.estimator,
        "coefficients": [rows[place] for place in first],
        "others": [rows[place] for place in rest],
        "settings": named(estimate.settings),
        "tables": [table_view(table) for table in estimate.tables],
        "plots": [
            {"title": plot.title, "svg": Picture(partial(plot_svg, plot, f"{key}-p{number + 1}"))}
            for number, plot in enumerate(estimate.plots)
        ],
        "correlation": {
            "title": "Correlation coefficients × 100",
            "svg": Picture(partial(correlation_svg, names, covariance, f"{key}-c")) if pairs else None,
        },
        "budgets": budget_views(estimate),
        "strong_correlations": [
            f"{one} and {other}: {value:+.2f}" for one, other, value in pairs[:6] if abs(value) >= STRONG
        ],
        "notes": list(estimate.notes),
        "warnings": list(estimate.warnings),
        "segments": list(estimate.segments),
    }


def coefficient_row(item: Coefficient, probability: float = 0.95) -> dict[str, str]:
    """Returns a coefficient as texts; its value and its expanded uncertainty are rounded to two digits of the uncertainty."""
    factor = coverage_factor(item.degrees_of_freedom, probability)
    expanded = factor * item.standard_uncertainty
    value, width = format_pair(item.value, expanded)
    _, standard = format_pair(item.value, item.standard_uncertainty)
    return {
        "name": item.name,
        "description": item.description,
        "value": value,
        "expanded": width,
        "standard": standard,
        "unit": shown_unit(item.unit),
        "factor": f"{factor:.2f}" if math.isfinite(factor) else "–",
        "freedom": freedom(item.degrees_of_freedom),
    }


def limit_row(limit: LimitVerdict) -> dict[str, str]:
    value, width = format_pair(limit.value, limit.expanded_uncertainty)
    return {
        "quantity": limit.quantity,
        "requirement": limit.requirement,
        "rule": limit.rule,
        "rule_in_words": words.rule(limit.rule, limit.guard_factor, limit.coverage),
        "verdict": "met" if limit.verdict == "pass" else "not met",
        "kind": "pass" if limit.verdict == "pass" else "fail",
        "value": value,
        "expanded": width,
        "unit": shown_unit(limit.unit),
        "factor": f"{limit.coverage_factor:.2f}",
        "guard": guard_band(limit),
        "probability": words.probability(limit.probability),
        "false": words.probability(limit.false_decision),
        "prior": "" if math.isnan(limit.consumer_risk) else "stated",
        "consumer": words.probability(limit.consumer_risk),
        "producer": words.probability(limit.producer_risk),
        "reason": "" if limit.verdict == "pass" else limit.reason,
    }


def table_view(table: Table) -> JsonObject:
    """Returns a table as texts, with a flag for each column of numbers. If there are more than `MAX_ROWS` rows, a note replaces the
    other rows."""
    roles = [column.role for column in table.columns]
    guides = [_guide(roles, index) for index in range(len(roles))]
    rows = [
        [_table_cell(row, index, guides, role) for index, role in enumerate(roles)] for row in table.rows[:MAX_ROWS]
    ]
    columns = [{"title": column.heading, "numeric": column.role is not Role.LABEL} for column in table.columns]
    hidden = len(table.rows) - len(rows)
    return {
        "title": table.title,
        "columns": columns,
        "rows": rows,
        "more": f"Not shown here: {count_of(hidden, 'more row')}." if hidden > 0 else "",
    }


def _guide(roles: Sequence[Role], index: int) -> int | None:
    """Returns the index of the column that determines the rounding of the column with the number `index`. If the column itself
    contains uncertainties, the result is its own index. Otherwise, the result is the index of the next column of uncertainties to
    the right, or None if there is no such column."""
    if not (roles[index] is Role.VALUE or roles[index].uncertain):
        return None
    return next((place for place in range(index, len(roles)) if roles[place].uncertain), None)


def _table_cell(row: Sequence[Cell], index: int, guides: Sequence[int | None], role: Role) -> str:
    value, guide = row[index], guides[index]
    if role is Role.DEGREES_OF_FREEDOM and isinstance(value, float):
        return freedom(value)
    if role is Role.SHARE and isinstance(value, float):
        return f"{words.number(100 * value, 3)} %"
    if guide is None or not _measured(value):
        return cell(value)
    width = row[guide]
    return format_pair(value, width)[1 if guide == index else 0] if _measured(width) and width > 0 else cell(value)


def _measured(value: Cell) -> TypeGuard[float]:
    return isinstance(value, float) and math.isfinite(value)


def cell(value: object) -> str:
    """Returns a cell as text; a number without an uncertainty has five significant digits."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return words.number(float(value), 5)
    return str(value)


def setting(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return "; ".join(f"{name}: {setting(item)}" for name, item in value.items())
    if isinstance(value, Iterable):
        return ", ".join(setting(item) for item in value)
    return cell(value)


def named(facts: Mapping[str, Json]) -> list[list[str]]:
    """Returns the facts that are not empty, as [name, value] pairs with readable names: `device_serial` becomes `Device serial`."""
    return [[readable(name), setting(value)] for name, value in facts.items() if value != ""]


def readable(name: str) -> str:
    text = name.replace("_", " ")
    text = " ".join(_PROPER.get(word, word) for word in text.split())
    if "." in text.split(" ", 1)[0]:  # the name of a file
        return text
    return text[:1].upper() + text[1:]


@dataclass(frozen=True, slots=True)
class Picture:
    """Contains SVG that this program makes, and that is therefore not escaped. The SVG is drawn only when a template shows it."""

    draw: Callable[[], str]

    def __html__(self) -> str:
        return self.draw()


def render_report(context: ReportContext, template: str, folder: Path | None = None) -> str:
    """Renders the report of the context with `template` (such as `report.html` or `summary.md`): one self-contained text.

    `folder`: a user's template folder, which is searched before the shipped one. The same context gives the same text. Raises
    `ReportError` if the report cannot be rendered.
    """
    return render(template, report_view(context), folder)


PREFIX = "planrunner:seal:sha256:"
"""The start of the code, which the 64 hexadecimal digits follow."""
MODULE = 2
"""Width of a module on the screen in CSS pixels. In print, the width is 0.5 mm, which phones can read."""


def seal_code(digest: str) -> str:
    """Returns a QR code of a digest as inline SVG. The code is black on white in every colour scheme. The alternative text is in
    the page, not in the SVG."""
    import segno

    code = segno.make(PREFIX + digest, error="m", micro=False)
    return code.svg_inline(
        scale=MODULE, border=4, dark="#000", light="#fff", svgclass="seal-code", lineclass=None, omitsize=False
    )
