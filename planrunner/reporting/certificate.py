"""Prepares the data that the template of a certificate needs in addition to the data of the report. All data are plain texts,
divided into parts that catalogues can translate.

The wording is in the template; names, figures and dates are prepared here. A missing value is an empty text, which the page shows
as "not stated".
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from planrunner.base.documents import JsonObject
from planrunner.estimators.interface import Coefficient, Estimate
from planrunner.estimators.limits import LimitVerdict
from planrunner.reporting import words
from planrunner.reporting.budgets import freedom, shown_unit, two_digits
from planrunner.reporting.certificate_names import of_estimator
from planrunner.reporting.context import CertificateFacts, ReportContext
from planrunner.reporting.rounding import format_pair
from planrunner.reporting.templates import Told
from planrunner.uncertainty.decision import coverage_factor


def certificate_view(context: ReportContext) -> JsonObject:
    """Returns the data for the template of a certificate, with these keys: number, number_css (a CSS string), laboratory, told,
    corrected, references, conditions, events, performed, issued, plan_digest, approvals, run, analysis, duration, before_run,
    simulated, replayed, results, has_before, rules, conformity, warnings."""
    facts = context.certificate
    if facts is None:
        facts = CertificateFacts("")
    external, certified = (named_in(facts.told, name) for name in ("external_estimates", "certified_estimates"))
    shown = [item for item in context.estimates if item.coefficients and (not certified or item.name in certified)]
    limits = [item for item in context.limits if not certified or item.quantity.partition(".")[0] in certified]
    results = [
        _results(item, facts.before.get(item.name), context.probability) | {"external": item.name in external}
        for item in shown
    ]
    number = facts.told.get("certificate_number", "")
    return {
        "number": number,
        "number_css": css_string(number),
        "laboratory": {name: facts.laboratory.get(name, "") for name in _LABORATORY},
        "told": Told(facts.told),
        "corrected": list(facts.corrected.items()),
        "references": [asdict(item) for item in facts.references],
        "conditions": [list(item) for item in facts.conditions],
        "events": [list(item) for item in facts.events],
        "performed": _span(*facts.performed),
        "issued": facts.issued,
        "plan_digest": facts.plan_digest,
        "approvals": list(facts.approvals),
        "run": facts.run,
        "analysis": context.provenance.get("analysis", ""),
        "duration": words.duration(facts.duration) if facts.duration else "",
        "before_run": facts.before_run,
        "simulated": facts.simulated,
        "replayed": facts.replayed,
        "results": results,
        "has_before": any(one["has_before"] for one in results),
        "rules": _rules(limits),
        "conformity": [_conformity(limit) for limit in limits],
        "warnings": [[one.name, text] for one in shown for text in one.warnings],
    }


def named_in(told: Mapping[str, str], name: str) -> set[str]:
    """Returns the names in a list of run information, such as `drift, residual`."""
    return {part.strip() for part in told.get(name, "").split(",")} - {""}


_LABORATORY = ("name", "address", "location", "contact", "accreditation", "traceability")


def _span(first: str, last: str) -> str:
    return first if first == last or not last else f"{first} – {last}"


def _results(estimate: Estimate, before: Estimate | None, probability: float) -> JsonObject:
    found = {} if before is None else {item.name: item for item in before.coefficients}
    rows = []
    for item in estimate.coefficients:
        if estimate.headline and item.name not in estimate.headline:
            continue
        earlier = found.get(item.name)
        factor = coverage_factor(item.degrees_of_freedom, probability)
        expanded = factor * item.standard_uncertainty
        value, width = format_pair(item.value, expanded)
        same = earlier is not None and earlier.unit == item.unit
        older = (
            format_pair(
                earlier.near(item.value),
                coverage_factor(earlier.degrees_of_freedom, probability) * earlier.standard_uncertainty,
            )
            if earlier is not None and same
            else ("", "")
        )
        rows.append(
            {
                "name": item.name,
                "said": item.description,
                "value": value,
                "expanded": width,
                "unit": shown_unit(item.unit),
                "factor": _factor(item, probability),
                "freedom": freedom(item.degrees_of_freedom),
                "before": older[0],
                "before_expanded": older[1],
                "before_factor": _factor(earlier, probability) if earlier is not None and same else "",
            }
        )
    has_before = any(row["before"] for row in rows)
    return {
        "name": estimate.name,
        "estimator": of_estimator(estimate.estimator),
        "rows": rows,
        "has_before": has_before,
    }


def _factor(item: Coefficient, probability: float) -> str:
    factor = coverage_factor(item.degrees_of_freedom, probability)
    return f"{factor:.2f}" if math.isfinite(factor) else "–"


def _rules(limits: Sequence[LimitVerdict]) -> list[dict[str, str]]:
    """Returns the decision rules that were used, each listed once.

    Each rule has three keys. `factor`: factor r of the guard band r·U. `percent`: coverage probability of U. `risk`: for r ≥ 1, an
    upper bound, in percent, of the probability that the true value is beyond a limit although the measured value was accepted."""
    used = sorted({(limit.rule, limit.guard_factor, limit.coverage) for limit in limits})
    return [
        {
            "rule": rule,
            "factor": words.number(factor),
            "percent": words.number(100 * coverage),
            "risk": words.number(50 * (1 - coverage), 3) if factor >= 1 else "",
        }
        for rule, factor, coverage in used
    ]


def guard_band(limit: LimitVerdict) -> str:
    """Returns the width of the guard band in the unit of the limit; empty if the results come from an earlier version that did not
    store this width."""
    return "" if math.isnan(limit.guard_band) else two_digits(limit.guard_band)


def _conformity(limit: LimitVerdict) -> dict[str, str]:
    value, width = format_pair(limit.value, limit.expanded_uncertainty)
    return {
        "quantity": limit.quantity,
        "lower": "" if math.isinf(limit.lower) else words.number(limit.lower),
        "upper": "" if math.isinf(limit.upper) else words.number(limit.upper),
        "value": value,
        "expanded": width,
        "unit": shown_unit(limit.unit),
        "factor": f"{limit.coverage_factor:.2f}",
        "rule": limit.rule,
        "guard": guard_band(limit),
        "verdict": limit.verdict,
        "probability": words.probability(limit.probability),
        "wrong": words.probability(limit.false_decision),
        "consumer_risk": "" if math.isnan(limit.consumer_risk) else words.probability(limit.consumer_risk),
        "producer_risk": "" if math.isnan(limit.producer_risk) else words.probability(limit.producer_risk),
    }


def css_string(text: str) -> str:
    """Returns a text as a safe CSS string: all characters except letters and digits are escaped."""
    return "".join(char if char.isascii() and char.isalnum() else f"\\{ord(char):06x}" for char in text)
