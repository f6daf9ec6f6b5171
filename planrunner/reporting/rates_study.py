"""Makes the output of a design study of rates: efficiencies, expected results, and the variance as a function of the rate."""

from __future__ import annotations

import math

import numpy as np

from planrunner.design.study import FoundRates, Study, Subject
from planrunner.estimators.interface import Coefficient
from planrunner.estimators.tables import Plot, Role, Table, TableColumn, alike
from planrunner.reporting import words

TITLES = {"planned": "as planned", "best": "best found"}
FOOTER = (
    "Rates are evaluated for the terms of the estimator and, unless left out, for |rate| and rate³, "
    "which determine asymmetry and nonlinearity. Each recording has the declared noise of the sensor. Efficiencies refer to the criterion, "
    "per coefficient."
)


def study(found: FoundRates, subject: Subject) -> Study:
    """Makes the study of designed rates: a headline, tables, notes and plots."""
    about = facts(found)
    said = notes(found)
    return Study(
        subject,
        "rates",
        f"{found.estimate}: {about['Searched for']} for {', '.join(found.terms)}",
        about,
        tables(found),
        said,
        FOOTER,
        _data(found, said),
        found.text,
        plots=plots(found),
    )


def facts(found: FoundRates) -> dict[str, str]:
    return {
        "Estimate": f"{found.estimate} ({found.output})",
        "Terms": ", ".join(found.terms),
        "Searched for": f"{found.asked.criterion}-optimal sets of {len(found.sets['planned'].rates)} rates",
        "Repeats": str(found.repeats),
    }


def tables(found: FoundRates) -> tuple[Table, ...]:
    """Makes tables of the efficiencies, the rates with their recording times, and the expected uncertainties."""
    compared = tuple(
        (TITLES[name], _percent(one.efficiency), _percent(one.per_hour), words.duration(one.total))
        for name, one in found.sets.items()
    )
    return (
        Table(
            "Information from the rates",
            (
                *alike(Role.LABEL, "Rates"),
                *alike(Role.SHARE, "Relative to the best found", "Relative to the best design of equal duration"),
                *alike(Role.LABEL, "Plan takes"),
            ),
            compared,
        ),
        _rates(found),
        *_uncertainties(found),
    )


def _rates(found: FoundRates) -> Table:
    planned, best = found.sets["planned"], found.sets["best"]
    recorded = TableColumn("recorded for")
    columns = (TableColumn("As planned", Role.NUMBER), recorded, TableColumn("Best found", Role.NUMBER), recorded)
    rows = [
        (_degrees(a), words.duration(x), _degrees(b), words.duration(y))
        for a, x, b, y in zip(planned.rates, planned.dwells, best.rates, best.dwells, strict=True)
    ]
    return Table("Rates [°/s]", columns, tuple(rows))


def _pairs(found: FoundRates) -> dict[str, tuple[Coefficient, Coefficient]]:
    """Maps the name of each coefficient to a pair: the coefficient expected with the planned rates, and with the best rates."""
    after = {item.name: item for item in found.sets["best"].predicted}
    return {item.name: (item, after[item.name]) for item in found.sets["planned"].predicted if item.name in after}


def _alike(before: Coefficient, now: Coefficient) -> bool:
    return abs(now.standard_uncertainty - before.standard_uncertainty) <= 0.01 * before.standard_uncertainty


def _uncertainties(found: FoundRates) -> list[Table]:
    """Returns a table of the coefficients whose uncertainty changes; an empty list if no uncertainty changes."""
    rows = [
        (name, f"{before.standard_uncertainty:.3g}", f"{now.standard_uncertainty:.3g}", now.unit)
        for name, (before, now) in _pairs(found).items()
        if not _alike(before, now)
    ]
    columns = (
        TableColumn("Coefficient"),
        *alike(Role.STANDARD_UNCERTAINTY, "as planned", "best found"),
        TableColumn("Unit"),
    )
    return [Table("Expected standard uncertainties that change", columns, tuple(rows))] if rows else []


def notes(found: FoundRates) -> tuple[str, ...]:
    """Explains the numbers in sentences."""
    planned, best = found.sets["planned"], found.sets["best"]
    said = []
    if len(planned.variance) and len(best.variance):
        said.append(
            "Compared with the planned rates, the worst variance of a predicted output over the rates is "
            f"{best.variance.max() / planned.variance.max():.3g} times as large, and the mean is "
            f"{best.variance.mean() / planned.variance.mean():.3g} times."
        )
    stay = [name for name, (before, now) in _pairs(found).items() if _alike(before, now)]
    if stay:
        more = f" and {len(stay) - 6} more" if len(stay) > 6 else ""
        said.append(
            f"{', '.join(stay[:6])}{more} stay within 1 %: their uncertainty is dominated by something other than "
            f"noise; the budgets in the estimate's report show the contributions."
        )
    said.append(
        "For a straight line alone, only the largest rates would be used; smaller rates determine asymmetry and "
        "nonlinearity, and the lowest rate determines threshold and resolution."
    )
    if found.excess > 1e-4:
        said.append(f"The bound is certified to {found.excess:.2g} only.")
    if found.asked.time is not None:
        said.append(
            "Recording times are whole turns; every rate keeps at least a quarter of an equal share, or one turn."
        )
    return tuple(said)


def plots(found: FoundRates) -> tuple[Plot, ...]:
    series = {
        TITLES[name]: tuple(np.round(one.variance, 6).tolist()) for name, one in found.sets.items() if len(one.variance)
    }
    if not series:
        return ()
    x = tuple(np.round(np.degrees(found.course), 6).tolist())
    words_y = "variance, of one recording at the largest rate = 1"
    return (Plot("Variance of a predicted output over rate", "rate [°/s]", words_y, x, series, lines=True),)


def _data(found: FoundRates, said: tuple[str, ...]) -> dict[str, object]:
    return {
        "estimate": found.estimate,
        "output": found.output,
        "terms": list(found.terms),
        "criterion": found.asked.criterion,
        "sets": {
            name: {
                "rates_deg_per_s": [round(math.degrees(rate), 9) for rate in one.rates],
                "dwells_s": list(one.dwells),
                "efficiency": one.efficiency,
                "efficiency_per_time": one.per_hour,
                "total_s": one.total,
                "standard_uncertainties": {item.name: [item.standard_uncertainty, item.unit] for item in one.predicted},
            }
            for name, one in found.sets.items()
        },
        "excess": found.excess,
        "notes": list(said),
    }


def _degrees(rate: float) -> str:
    return f"±{round(math.degrees(rate), 6):g}"


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %"
