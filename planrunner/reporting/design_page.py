"""Output of a design study of positions: tables for the terminal, plain data, and a page with pictures of the positions before and
after."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.design.efficiency import Efficiency, Merit
from planrunner.estimators.interface import Coefficient, Role, Table, TableColumn
from planrunner.reporting import words
from planrunner.reporting.columns import alike
from planrunner.reporting.orientations import orientation_svg
from planrunner.reporting.templates import render
from planrunner.reporting.view import named, table_view

Array = NDArray[np.float64]

TITLES = {"planned": "as planned", "cardinal": "best cardinal", "free": "best free"}


@dataclass(frozen=True, slots=True)
class DesignedSet:
    """One set of positions. labels, texts, attitudes: one per position; seconds: duration of the whole plan; ratios: expected ratios of
    residual sums of squares by name; predicted: expected uncertainties of the coefficients."""

    labels: tuple[str, ...]
    texts: tuple[str, ...]
    attitudes: tuple[Array, ...]
    merit: Merit
    of_found: Efficiency | None
    of_bound: Efficiency
    of_cardinal: Efficiency | None
    seconds: float
    ratios: Mapping[str, float] = field(default_factory=dict)
    predicted: tuple[Coefficient, ...] = ()


@dataclass(frozen=True, slots=True)
class DesignContext:
    """sets: planned, cardinal, free, if available; best, bounds, certificates: by domain (free, cardinal). dwells: s, of the chosen set,
    empty if they were not optimised; dwell_gain: efficiency of equal dwells relative to them."""

    title: str
    estimate: str
    outputs: tuple[str, ...]
    terms: tuple[str, ...]
    criterion: str
    chosen: str
    sets: Mapping[str, DesignedSet]
    best: Mapping[str, Merit]
    bounds: Mapping[str, Merit]
    certificates: Mapping[str, float]
    search: str
    dwells: tuple[float, ...] = ()
    dwell_gain: float = 1.0
    facts: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    spins: int = 0


def render_page(context: DesignContext, folder: Path | None = None) -> str:
    """One self-contained HTML page. Raises `ReportError`."""
    return render("design.html", design_view(context), folder)


def design_view(context: DesignContext) -> dict[str, Any]:
    from markupsafe import Markup

    pictures = [
        {
            "title": TITLES[name].capitalize(),
            "figures": [
                {"svg": Markup(orientation_svg(attitude, label)), "label": label, "words": text}
                for label, attitude, text in zip(one.labels, one.attitudes, one.texts, strict=True)
            ],
        }
        for name, one in context.sets.items()
        if name in ("planned", context.chosen)
    ]
    return {
        "title": context.title,
        "facts": named({**context.facts, **facts(context)}),
        "tables": [table_view(table) for table in tables(context)],
        "pictures": pictures,
        "notes": notes(context),
    }


def facts(context: DesignContext) -> dict[str, str]:
    return {
        "Estimate": f"{context.estimate} ({', '.join(context.outputs)})",
        "Terms": ", ".join(context.terms),
        "Searched for": f"{context.criterion}-optimal sets of {len(context.sets['planned'].labels)} positions",
        "Search": context.search,
    }


def tables(context: DesignContext) -> list[Table]:
    """Criteria, efficiencies, the chosen positions, expected uncertainties and residual ratios."""
    found = [_criteria(context), _efficiencies(context), _positions(context)]
    return [*found, *_uncertainties(context), *_ratios(context)]


def _criteria(context: DesignContext) -> Table:
    figures = alike(Role.VALUE, "Determinant", "Trace of M⁻¹", "Worst variance", "Mean variance")
    columns = (*alike(Role.LABEL, "Positions", "Rank"), *figures, TableColumn("Plan takes"))
    p = len(context.terms)
    rows: list[tuple[str, ...]] = [
        (TITLES[name], f"{one.merit.rank} of {p}", *_figures(one.merit), words.duration(one.seconds))
        for name, one in context.sets.items()
    ]
    for domain, title in (("cardinal", "no cardinal set passes"), ("free", "no set passes")):
        if domain in context.bounds:
            rows.append((title, f"{p} of {p}", *_figures(context.bounds[domain]), "–"))
    return Table("Information from the positions", columns, tuple(rows))


def _figures(merit: Merit) -> tuple[str, ...]:
    values = (merit.determinant, merit.trace, merit.worst, merit.mean)
    return tuple("–" if math.isnan(value) else words.number(value, 6) for value in values)


def _efficiencies(context: DesignContext) -> Table:
    columns = (*alike(Role.LABEL, "Positions", "Measured against"), *alike(Role.SHARE, "D", "A", "G", "I"))
    rows = []
    for name, one in context.sets.items():
        against = (
            ("best cardinal found", one.of_cardinal), ("best found", one.of_found), ("continuous bound", one.of_bound),
        )  # fmt: skip
        for title, shares in against:
            if shares is not None:
                rows.append((TITLES[name], title, *(_percent(value) for value in _four(shares))))
    return Table("Efficiencies", columns, tuple(rows))


def _four(shares: Efficiency) -> tuple[float, float, float, float]:
    return shares.D, shares.A, shares.G, shares.I


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.2f} %"


def _positions(context: DesignContext) -> Table:
    before, after = context.sets["planned"], context.sets[context.chosen]
    title = f"Positions: {TITLES[context.chosen]}"
    titles = ["Label", "As planned", TITLES[context.chosen].capitalize()]
    cells: list[Sequence[str]] = [before.labels, before.texts, after.texts]
    if context.dwells:
        titles.append("Dwell")
        cells.append([words.duration(seconds) for seconds in context.dwells])
    return Table(title, alike(Role.LABEL, *titles), tuple(zip(*cells, strict=True)))


def _uncertainties(context: DesignContext) -> list[Table]:
    shown = {name: one.predicted for name, one in context.sets.items() if one.predicted}
    if not shown:
        return []
    first = next(iter(shown.values()))
    rows = [
        (item.name, *(f"{values[index].standard_uncertainty:.3g}" for values in shown.values()), item.unit)
        for index, item in enumerate(first)
    ]
    sets = alike(Role.STANDARD_UNCERTAINTY, *(TITLES[name] for name in shown))
    columns = (TableColumn("Coefficient"), *sets, TableColumn("Unit"))
    return [Table("Expected standard uncertainties, with the dwells of the plan", columns, tuple(rows))]


def _ratios(context: DesignContext) -> list[Table]:
    names = list(context.sets["planned"].ratios)
    if not names:
        return []
    rows = [
        (name, *(words.number(one.ratios[name], 4) if name in one.ratios else "–" for one in context.sets.values()))
        for name in names
    ]
    columns = (TableColumn("Ratio"), *alike(Role.VALUE, *(TITLES[name] for name in context.sets)))
    return [Table("Expected residual sums of squares, compared with the set of this estimate", columns, tuple(rows))]


def heading(context: DesignContext) -> str:
    return f"{context.estimate}: {facts(context)['Searched for']}; {context.search}"


def notes(context: DesignContext) -> list[str]:
    """Explanations of the plan's estimates and of the figures, in sentences."""
    chosen, planned = context.sets[context.chosen], context.sets["planned"]
    said = list(context.notes)
    if not planned.merit.sound:
        said.append(
            f"The planned positions have rank {planned.merit.rank} of {len(context.terms)}: they cannot separate all "
            "terms."
        )
    if "cardinal" not in context.sets:
        said.append("No set of cardinal positions separates all terms.")
    certificate = context.certificates["free"]
    p = len(context.terms)
    if context.spins:
        said.append(
            f"{context.spins} segments of the estimate spin: they stay unchanged and contribute to every set. The "
            f"bound of the worst variance is then not known."
        )
    else:
        said.append(
            "Bound: at the continuous D-optimum the largest variance over all reachable orientations is "
            f"{certificate:.6g}; it is {p} "
            "at the optimum itself (Kiefer and Wolfowitz), and the bound allows for the difference."
        )
    share = chosen.of_bound.D
    if share > 0.9999:
        said.append(
            "The chosen positions reach the bound to within 0.01 %: no other set of the same number of positions on "
            "this bench is noticeably better by D."
        )
    if context.dwells:
        said.append(
            f"Equal dwells would be {_percent(context.dwell_gain)} as efficient as the distributed ones; every "
            "position keeps at least a "
            "quarter of an equal share."
        )
    said.append(
        "Efficiencies assume equal noise in all positions. A set with a D-efficiency of 97 % needs 3 % more recording "
        "time for the same determinant."
    )
    return said


def to_json(context: DesignContext) -> dict[str, Any]:
    """The study as plain data."""
    return {
        "estimate": context.estimate,
        "outputs": list(context.outputs),
        "terms": list(context.terms),
        "criterion": context.criterion,
        "chosen": context.chosen,
        "search": context.search,
        "sets": {name: _set_json(one) for name, one in context.sets.items()},
        "best_found": {name: _merit_json(one) for name, one in context.best.items()},
        "bounds": {
            name: {**_merit_json(one), "largest_variance": context.certificates[name]}
            for name, one in context.bounds.items()
        },
        "dwells_s": list(context.dwells),
        "equal_dwells_efficiency": context.dwell_gain,
        "notes": notes(context),
    }


def _merit_json(merit: Merit) -> dict[str, Any]:
    values = {
        "determinant": merit.determinant, "trace_of_inverse": merit.trace, "worst_variance": merit.worst,
        "mean_variance": merit.mean,
    }  # fmt: skip
    return {"rank": merit.rank, **{name: value if math.isfinite(value) else None for name, value in values.items()}}


def _set_json(one: DesignedSet) -> dict[str, Any]:
    against = {"cardinal": one.of_cardinal, "found": one.of_found, "bound": one.of_bound}
    return {
        **_merit_json(one.merit),
        "efficiency": {
            name: dict(zip("DAGI", _four(shares), strict=True))
            for name, shares in against.items()
            if shares is not None
        },
        "plan_time_s": one.seconds,
        "positions": [
            {"label": label, "orientation": text, "attitude": attitude.tolist()}
            for label, text, attitude in zip(one.labels, one.texts, one.attitudes, strict=True)
        ],
        "expected_ratios": dict(one.ratios),
        "standard_uncertainties": {item.name: [item.standard_uncertainty, item.unit] for item in one.predicted},
    }
