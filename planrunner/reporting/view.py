"""What a report's template is given: plain dictionaries, lists, text and numbers, made from a `ReportContext`.

Templates see nothing else, so that a template can lay a report out but cannot reach a file or change a result. The keys:

    title, description, headline {kind, text, detail}, probability_percent
    run, bench, site, provenance      lists of [name, value]
    instruments                       list of {role, facts: list of [name, value]}
    estimates                         list of {name, anchor, estimator, coefficients, headline, settings, tables, plots, correlation,
                                      strong_correlations, notes, warnings, segments}
      coefficients, headline          lists of {name, description, value, expanded, standard, unit, factor, freedom}, as text
      tables                          list of {title, columns: list of {title, numeric}, rows of text}
      plots, correlation              {title, svg}
    limits                            list of {quantity, requirement, rule, verdict, kind, value, expanded, unit, reason}
    segments                          {columns, rows} like a table; segment_count
    warnings, notes                   lists of text; the estimates' own are with the estimates
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from planrunner.estimators.interface import Coefficient, Estimate, Table
from planrunner.reporting import words
from planrunner.reporting.context import LimitVerdict, ReportContext, SegmentSummary, site_facts
from planrunner.reporting.rounding import rounded
from planrunner.uncertainty.decision import coverage_factor

if TYPE_CHECKING:
    from markupsafe import Markup

__all__ = ["coefficient_row", "limit_row", "report_view", "segment_table", "table_view"]

MAX_ROWS = 2000
_NUMERIC = re.compile(r"[-+−–]?(?:[0-9][0-9., ]*|∞|inf|nan)?(?:[eE][-+]?[0-9]+)?(?:\s*[%×±].*)?")
_PROPER = {"id": "ID", "utc": "UTC"}


def report_view(context: ReportContext) -> dict[str, Any]:
    """The whole context as templates see it."""
    return {
        "title": context.title,
        "description": context.description,
        "headline": headline(context),
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
        "segment_count": len(context.segments),
        "warnings": list(context.warnings),
        "notes": list(context.notes),
        "provenance": named(context.provenance),
    }


def headline(context: ReportContext) -> dict[str, str]:
    """The verdict on top: whether the limits are met."""
    total, failed = len(context.limits), len(context.failed)
    if not total:
        return {"kind": "none", "text": "No limits were set", "detail": "The plan asks for values, not for a verdict."}
    names = ", ".join(limit.quantity for limit in context.failed)
    if failed:
        limits = "limit is" if total == 1 else f"of {total} limits are" if failed > 1 else f"of {total} limits is"
        return {"kind": "fail", "text": f"Failed: {failed} {limits} not met", "detail": f"Not met: {names}."}
    text = "Passed: the limit is met" if total == 1 else f"Passed: all {total} limits are met"
    return {"kind": "pass", "text": text, "detail": ""}


def estimate_view(estimate: Estimate, index: int, probability: float) -> dict[str, Any]:
    """One estimate with its pictures. `index` keeps ids in the page apart."""
    from planrunner.reporting.plots import correlation, correlation_svg, plot_svg, strong

    key = f"e{index + 1}"
    names = [item.name for item in estimate.coefficients]
    shown = [coefficient_row(item, probability) for item in estimate.coefficients]
    correlated = len(names) > 1 and estimate.covariance.shape == (len(names), len(names))
    matrix = correlation(estimate.covariance) if correlated else None
    pairs = [] if matrix is None else strong(names, matrix)
    return {
        "name": estimate.name,
        "anchor": key,
        "estimator": estimate.estimator,
        "coefficients": shown,
        "headline": [row for name in estimate.headline for row in shown if row["name"] == name],
        "settings": named({name: setting(value) for name, value in estimate.settings.items()}),
        "tables": [table_view(table) for table in estimate.tables],
        "plots": [
            {"title": plot.title, "svg": _markup(plot_svg(plot, f"{key}-p{number + 1}"))}
            for number, plot in enumerate(estimate.plots)
        ],
        "correlation": {
            "title": "Correlations, in hundredths",
            "svg": _markup(correlation_svg(names, estimate.covariance, f"{key}-c")) if correlated else None,
        },
        "strong_correlations": [f"{first} and {second}: {value:+.2f}" for first, second, value in pairs[:6]],
        "notes": list(estimate.notes),
        "warnings": list(estimate.warnings),
        "segments": list(estimate.segments),
    }


def coefficient_row(item: Coefficient, probability: float = 0.95) -> dict[str, str]:
    """A coefficient as text, value and expanded uncertainty rounded together to two digits of the uncertainty."""
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
        "unit": "" if item.unit == "1" else item.unit,
        "factor": f"{factor:.2f}" if math.isfinite(factor) else "–",
        "freedom": freedom(item.degrees_of_freedom),
    }


def format_pair(value: float, uncertainty: float) -> tuple[str, str]:
    """Both as text with the same last decimal, two significant digits of the uncertainty, and the same power of ten if any."""
    pair = rounded(value, uncertainty)
    power = f"e{pair.exponent}" if pair.exponent else ""
    return pair.value + power, pair.uncertainty + power if pair.uncertainty else ""


def freedom(value: float) -> str:
    """Degrees of freedom; effective ones keep a decimal below a hundred."""
    if not math.isfinite(value):
        return "∞"
    return f"{value:.0f}" if value >= 100 or value == round(value) else f"{value:.1f}"


def limit_row(limit: LimitVerdict) -> dict[str, str]:
    value, width = format_pair(limit.value, limit.expanded_uncertainty)
    return {
        "quantity": limit.quantity,
        "requirement": limit.requirement,
        "rule": limit.rule,
        "verdict": "met" if limit.verdict == "pass" else "not met",
        "kind": "pass" if limit.verdict == "pass" else "fail",
        "value": value,
        "expanded": width,
        "unit": "" if limit.unit == "1" else limit.unit,
        "factor": f"{limit.coverage_factor:.2f}",
        "reason": limit.reason,
    }


def segment_table(segments: Sequence[SegmentSummary]) -> Table:
    """What was held and what was recorded, one row a segment; columns that no segment needs are left out."""
    units: dict[str, str] = {}
    for item in segments:
        units.update({name: unit for name, unit in item.units.items() if item.statistics is not None})
    columns: list[tuple[str, list[str]]] = [
        ("#", [str(item.segment.index + 1) for item in segments]),
        ("Segment", [item.segment.label for item in segments]),
        ("Orientation", [words.orientation(item.segment) for item in segments]),
        ("Motion", [words.motion(item.segment.motion) for item in segments]),
        ("Temperature, °C", [words.temperature(item.segment) for item in segments]),
        ("Recorded, s", [_recorded(item) for item in segments]),
        ("Samples", ["–" if item.statistics is None else str(item.statistics.count) for item in segments]),
        ("Rejected", [str(item.statistics.rejected) if item.statistics else "0" for item in segments]),
    ]
    for name, unit in units.items():
        columns.append((f"{name}, {unit}" if unit and unit != "1" else name, [_mean(item, name) for item in segments]))
    columns.append(("Remarks", [item.remark for item in segments]))
    idle = {"Motion": {"rest"}, "Rejected": {"0"}, "Remarks": {""}, "Temperature, °C": {"–"}}
    kept = [(title, cells) for title, cells in columns if not set(cells) <= idle.get(title, set())]
    rows = tuple(zip(*(cells for _, cells in kept), strict=True)) if segments else ()
    return Table("Segments: mean ± standard error", tuple(title for title, _ in kept), rows)


def _recorded(item: SegmentSummary) -> str:
    if item.statistics is None or not item.statistics.count:
        return "–"
    return words.number(round(item.statistics.end - item.statistics.start, 3), 9)


def _mean(item: SegmentSummary, channel: str) -> str:
    if item.statistics is None or channel not in item.statistics.channels or not item.statistics.count:
        return "–"
    place = item.statistics.of(channel)
    value, width = format_pair(float(item.statistics.mean[place]), float(item.statistics.standard_error[place]))
    return f"{value} ± {width}" if width else value


def table_view(table: Table) -> dict[str, Any]:
    """A table as text, with which columns hold numbers; at most MAX_ROWS rows, and says so when there are more."""
    rows = [[cell(value) for value in row] for row in table.rows[:MAX_ROWS]]
    columns = [
        {"title": title, "numeric": bool(rows) and all(_is_numeric(row[index]) for row in rows)}
        for index, title in enumerate(table.columns)
    ]
    hidden = len(table.rows) - len(rows)
    return {
        "title": table.title,
        "columns": columns,
        "rows": rows,
        "more": f"{hidden} more rows are not shown here." if hidden > 0 else "",
    }


def cell(value: Any) -> str:
    """A cell as text; numbers without uncertainty in six significant digits."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return words.number(float(value))
    return str(value)


def _is_numeric(text: str) -> bool:
    return bool(_NUMERIC.fullmatch(text.strip()))


def setting(value: Any) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, Mapping):
        return ", ".join(f"{name}: {setting(item)}" for name, item in value.items())
    if isinstance(value, Iterable):
        return ", ".join(setting(item) for item in value)
    return cell(value)


def named(facts: Mapping[str, Any]) -> list[list[str]]:
    """[name, value] pairs, names made readable: `device_serial` becomes `Device serial`."""
    return [[readable(name), setting(value)] for name, value in facts.items()]


def readable(name: str) -> str:
    text = name.replace("_", " ")
    text = " ".join(_PROPER.get(word, word) for word in text.split())
    return text[:1].upper() + text[1:]


def _markup(svg: str) -> Markup:
    """SVG made here is not escaped again."""
    from markupsafe import Markup

    return Markup(svg)
