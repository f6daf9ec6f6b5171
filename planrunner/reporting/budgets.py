"""Prepares uncertainty budgets for templates. The budgets have the columns of JCGM 100:2008, table H.1, and also show the share and
the source of each input."""

from __future__ import annotations

import math

from planrunner.base.documents import JsonObject
from planrunner.estimators.interface import Estimate
from planrunner.reporting import words
from planrunner.reporting.rounding import rounded
from planrunner.uncertainty.influences import Budget, BudgetLine


def budget_views(estimate: Estimate) -> list[JsonObject]:
    """Returns the budgets that contain more than the contribution of the data; budgets of the headline coefficients come first.

    Each budget has the keys {coefficient, unit, headline, lines, standard, freedom, factor, expanded}; each of its lines has
    {quantity, kind, value, standard, unit, distribution, freedom, sensitivity, contribution, share, source, added}. All values
    except `headline` and `added` are text. A share is a percentage of the combined variance; the shares of one budget add up to 100
    %.
    """
    shown = [_view(one, not estimate.headline or one.coefficient in estimate.headline) for one in estimate.budgets]
    told = [
        view for view, one in zip(shown, estimate.budgets, strict=True) if any(line.kind == "B" for line in one.lines)
    ]
    return sorted(told, key=lambda view: not view["headline"])


def _view(budget: Budget, headline: bool) -> JsonObject:
    return {
        "coefficient": budget.coefficient,
        "unit": shown_unit(budget.unit),
        "headline": headline,
        "lines": [_line(line, budget.standard_uncertainty**2) for line in budget.lines],
        "standard": two_digits(budget.standard_uncertainty),
        "freedom": freedom(budget.degrees_of_freedom),
        "factor": f"{budget.coverage_factor:.2f}" if math.isfinite(budget.coverage_factor) else "–",
        "expanded": two_digits(budget.coverage_factor * budget.standard_uncertainty),
    }


def _line(line: BudgetLine, variance: float) -> JsonObject:
    value = rounded(line.value, line.standard_uncertainty)
    power = f"e{value.exponent}" if value.exponent else ""
    share = words.probability(line.contribution**2 / variance) if line.added and variance > 0 else "–"
    return {
        "quantity": line.quantity if line.count == 1 else f"{line.quantity} ({line.count} ×)",
        "kind": line.kind,
        "value": value.value + power,
        "standard": two_digits(line.standard_uncertainty),
        "unit": shown_unit(line.unit),
        "distribution": line.distribution,
        "freedom": freedom(line.degrees_of_freedom),
        "sensitivity": words.number(line.sensitivity, 3),
        "contribution": two_digits(line.contribution),
        "share": share,
        "source": f"{line.source}, {line.calibrated}" if line.calibrated else line.source,
        "added": line.added,
    }


def shown_unit(unit: str) -> str:
    """Returns the unit as text that follows a number; empty for pure numbers."""
    return "" if unit == "1" else unit


def two_digits(uncertainty: float) -> str:
    """Returns an uncertainty with two significant digits."""
    if not math.isfinite(uncertainty) or uncertainty == 0:
        return words.number(uncertainty)
    own = rounded(uncertainty, abs(uncertainty))
    return own.value + (f"e{own.exponent}" if own.exponent else "")


def freedom(value: float) -> str:
    """Returns degrees of freedom as text. Effective degrees of freedom below a hundred have one decimal. Numbers above ten thousand
    are not distinguished, because they no longer affect the coverage factor."""
    if not math.isfinite(value):
        return "∞"
    if value > 1e4:
        return "> 10000"
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}".removesuffix(".0")
