"""Output of a design study of rates: tables for the terminal, plain data, and a page with the variance over rate."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.interface import Coefficient, Plot, Role, Table, TableColumn
from planrunner.reporting import words
from planrunner.reporting.columns import alike
from planrunner.reporting.study_page import StudyPage

TITLES = {"planned": "as planned", "best": "best found"}
FOOTER = (
    "Rates are evaluated for the estimator’s terms and, unless left out, |rate| and rate³, which determine asymmetry "
    "and nonlinearity, with the declared noise of the sensor in each "
    "recording. Efficiencies are by the criterion, per coefficient."
)


@dataclass(frozen=True, slots=True)
class ShownRates:
    """One set of rates: rates (n,), rad/s, and dwells (n,), s, largest rate first; other fields as in
    `planrunner.tasks.design_rates.RateSet`."""

    rates: tuple[float, ...]
    dwells: tuple[float, ...]
    efficiency: float
    per_hour: float
    variance: NDArray[np.float64]
    predicted: tuple[Coefficient, ...]
    total: float


@dataclass(frozen=True, slots=True)
class RatesContext:
    """time: the time budget [s], or None. sets: `planned` and `best`. course: rates [rad/s] at which variances are given. excess:
    remaining distance from the certified bound."""

    title: str
    estimate: str
    output: str
    terms: tuple[str, ...]
    criterion: str
    time: float | None
    repeats: int
    sets: Mapping[str, ShownRates]
    course: NDArray[np.float64]
    excess: float
    facts: Mapping[str, str] = field(default_factory=dict)


def render_page(context: RatesContext, folder: Path | None = None) -> str:
    """One self-contained HTML page. Raises `ReportError`."""
    said = {**context.facts, **facts(context)}
    study = StudyPage("Design of rates", context.title, said, tables(context), plots(context), notes(context), FOOTER)
    return study.render(folder)


def facts(context: RatesContext) -> dict[str, str]:
    return {
        "Estimate": f"{context.estimate} ({context.output})",
        "Terms": ", ".join(context.terms),
        "Searched for": f"{context.criterion}-optimal sets of {len(context.sets['planned'].rates)} rates",
        "Repeats": str(context.repeats),
    }


def heading(context: RatesContext) -> str:
    return f"{context.estimate}: {facts(context)['Searched for']} for {', '.join(context.terms)}"


def tables(context: RatesContext) -> list[Table]:
    """Efficiencies, the rates with their recording times, and expected uncertainties."""
    compared = tuple(
        (TITLES[name], _percent(one.efficiency), _percent(one.per_hour), words.duration(one.total))
        for name, one in context.sets.items()
    )
    return [
        Table(
            "Information from the rates",
            (
                *alike(Role.LABEL, "Rates"),
                *alike(Role.SHARE, "Of the best found", "Of the best use of their time"),
                *alike(Role.LABEL, "Plan takes"),
            ),
            compared,
        ),
        _rates(context),
        *_uncertainties(context),
    ]


def _rates(context: RatesContext) -> Table:
    planned, best = context.sets["planned"], context.sets["best"]
    recorded = TableColumn("recorded for")
    columns = (TableColumn("As planned", Role.NUMBER), recorded, TableColumn("Best found", Role.NUMBER), recorded)
    rows = [
        (_degrees(a), words.duration(x), _degrees(b), words.duration(y))
        for a, x, b, y in zip(planned.rates, planned.dwells, best.rates, best.dwells, strict=True)
    ]
    return Table("Rates [°/s]", columns, tuple(rows))


def _pairs(context: RatesContext) -> dict[str, tuple[Coefficient, Coefficient]]:
    """Expected coefficients of both sets by name."""
    after = {item.name: item for item in context.sets["best"].predicted}
    return {item.name: (item, after[item.name]) for item in context.sets["planned"].predicted if item.name in after}


def _alike(before: Coefficient, now: Coefficient) -> bool:
    return abs(now.standard_uncertainty - before.standard_uncertainty) <= 0.01 * before.standard_uncertainty


def _uncertainties(context: RatesContext) -> list[Table]:
    """Uncertainties of the coefficients for which they change."""
    rows = [
        (name, f"{before.standard_uncertainty:.3g}", f"{now.standard_uncertainty:.3g}", now.unit)
        for name, (before, now) in _pairs(context).items()
        if not _alike(before, now)
    ]
    columns = (
        TableColumn("Coefficient"),
        *alike(Role.STANDARD_UNCERTAINTY, "as planned", "best found"),
        TableColumn("Unit"),
    )
    return [Table("Expected standard uncertainties that change", columns, tuple(rows))] if rows else []


def notes(context: RatesContext) -> list[str]:
    """What the figures mean, in sentences."""
    planned, best = context.sets["planned"], context.sets["best"]
    said = []
    if len(planned.variance) and len(best.variance):
        said.append(
            "Compared with the planned rates, the worst variance of a predicted output over the rates becomes "
            f"{best.variance.max() / planned.variance.max():.3g} times as large, the mean "
            f"{best.variance.mean() / planned.variance.mean():.3g} times."
        )
    stay = [name for name, (before, now) in _pairs(context).items() if _alike(before, now)]
    if stay:
        more = f" and {len(stay) - 6} more" if len(stay) > 6 else ""
        said.append(
            f"{', '.join(stay[:6])}{more} stay within 1 %: their uncertainty is dominated by something other than "
            f"noise; the budgets in the estimate's report show the contributions."
        )
    said.append(
        "For a straight line alone, all rates would be at the largest; interior rates determine asymmetry and "
        "nonlinearity, and the lowest rate determines threshold and resolution."
    )
    if context.excess > 1e-4:
        said.append(f"The bound is certified to {context.excess:.2g} only.")
    if context.time is not None:
        said.append(
            "Recording times are whole turns; every rate keeps at least a quarter of an equal share, or one turn."
        )
    return said


def plots(context: RatesContext) -> list[Plot]:
    series = {
        TITLES[name]: tuple(np.round(one.variance, 6).tolist())
        for name, one in context.sets.items()
        if len(one.variance)
    }
    if not series:
        return []
    x = tuple(np.round(np.degrees(context.course), 6).tolist())
    words_y = "variance, of one recording at the largest rate = 1"
    return [Plot("Variance of a predicted output over rate", "rate [°/s]", words_y, x, series, lines=True)]


def to_json(context: RatesContext) -> dict[str, Any]:
    """The study as plain data."""
    return {
        "estimate": context.estimate,
        "output": context.output,
        "terms": list(context.terms),
        "criterion": context.criterion,
        "sets": {
            name: {
                "rates_deg_per_s": [round(math.degrees(rate), 9) for rate in one.rates],
                "dwells_s": list(one.dwells),
                "efficiency": one.efficiency,
                "efficiency_per_time": one.per_hour,
                "total_s": one.total,
                "standard_uncertainties": {item.name: [item.standard_uncertainty, item.unit] for item in one.predicted},
            }
            for name, one in context.sets.items()
        },
        "excess": context.excess,
        "notes": notes(context),
    }


def _degrees(rate: float) -> str:
    return f"±{round(math.degrees(rate), 6):g}"


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"
