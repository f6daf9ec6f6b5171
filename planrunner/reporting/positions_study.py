"""Makes the output of a design study of positions: criteria, efficiencies, and the positions before and after the design."""

from __future__ import annotations

import math
from collections.abc import Sequence

from planrunner.base.documents import finite
from planrunner.design.efficiency import Efficiency, Merit
from planrunner.design.study import FoundPositions, Pose, PositionSet, Study, Subject
from planrunner.estimators.interface import Coefficient
from planrunner.estimators.tables import Role, Table, TableColumn, alike
from planrunner.reporting import words

TITLES = {"planned": "as planned", "cardinal": "best cardinal", "free": "best free"}
FOOTER = (
    "M is the information matrix for normalised columns and equal noise in every position. D: determinant; A: trace of "
    "the inverse; G: worst and I: mean variance of a predicted output over the reachable orientations, in units of one "
    "position’s variance."
)


def study(found: FoundPositions, subject: Subject) -> Study:
    """Makes the study of designed positions: a headline, tables, notes and plots."""
    about = facts(found)
    said = notes(found)
    return Study(
        subject,
        "positions",
        f"{found.sight.name}: {about['Searched for']}; {found.search}",
        about,
        tables(found),
        said,
        FOOTER,
        _data(found, said),
        found.text,
        poses={
            TITLES[name].capitalize(): tuple(map(Pose, _labels(found), one.attitudes, one.texts))
            for name, one in found.sets.items()
            if name in ("planned", found.asked.orientations)
        },
    )


def _labels(found: FoundPositions) -> tuple[str, ...]:
    return tuple(place.label for place in found.places)


def facts(found: FoundPositions) -> dict[str, str]:
    return {
        "Estimate": f"{found.sight.name} ({', '.join(found.sight.others)})",
        "Terms": ", ".join(found.sight.terms),
        "Searched for": f"{found.asked.criterion}-optimal sets of {len(found.places)} positions",
        "Search": found.search,
    }


def tables(found: FoundPositions) -> tuple[Table, ...]:
    """Makes tables of the criteria, the efficiencies, the chosen positions, the expected uncertainties and the residual ratios."""
    return (_criteria(found), _efficiencies(found), _positions(found), *_uncertainties(found), *_ratios(found))


def _criteria(found: FoundPositions) -> Table:
    figures = alike(Role.VALUE, "Determinant", "Trace of M⁻¹", "Worst variance", "Mean variance")
    columns = (*alike(Role.LABEL, "Positions", "Rank"), *figures, TableColumn("Plan takes"))
    p = len(found.sight.terms)
    rows: list[tuple[str, ...]] = [
        (TITLES[name], f"{one.merit.rank} of {p}", *_figures(one.merit), words.duration(one.schedule.total))
        for name, one in found.sets.items()
    ]
    for domain, title in (("cardinal", "bound of cardinal sets"), ("free", "bound of all sets")):
        if domain in found.bounds:
            rows.append((title, f"{p} of {p}", *_figures(found.bounds[domain].merit), "–"))
    return Table("Information from the positions", columns, tuple(rows))


def _figures(merit: Merit) -> tuple[str, ...]:
    values = (merit.determinant, merit.trace, merit.worst, merit.mean)
    return tuple("–" if math.isnan(value) else words.number(value, 6) for value in values)


def _efficiencies(found: FoundPositions) -> Table:
    columns = (*alike(Role.LABEL, "Positions", "Measured against"), *alike(Role.SHARE, "D", "A", "G", "I"))
    rows = []
    for name, one in found.sets.items():
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


def _positions(found: FoundPositions) -> Table:
    before, after = found.sets["planned"], found.chosen
    title = f"Positions: {TITLES[found.asked.orientations]}"
    titles = ["Label", "As planned", TITLES[found.asked.orientations].capitalize()]
    cells: list[Sequence[str]] = [_labels(found), before.texts, after.texts]
    if found.dwells:
        titles.append("Dwell")
        cells.append([words.duration(seconds) for seconds in found.dwells])
    return Table(title, alike(Role.LABEL, *titles), tuple(zip(*cells, strict=True)))


def _predicted(found: FoundPositions, one: PositionSet) -> tuple[Coefficient, ...]:
    """Returns the coefficients of the estimate with the standard uncertainties that a set of positions gives."""
    design = one.designs.get(found.sight.name)
    return design.predicted if design is not None else ()


def _uncertainties(found: FoundPositions) -> list[Table]:
    shown = {name: predicted for name, one in found.sets.items() if (predicted := _predicted(found, one))}
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


def _ratios(found: FoundPositions) -> list[Table]:
    ratios = {name: one.residual_ratios for name, one in found.sets.items()}
    if not ratios["planned"]:
        return []
    rows = [
        (name, *(words.number(own[name], 4) if name in own else "–" for own in ratios.values()))
        for name in ratios["planned"]
    ]
    columns = (TableColumn("Ratio"), *alike(Role.VALUE, *(TITLES[name] for name in ratios)))
    return [Table("Expected residual sums of squares, compared with the set of this estimate", columns, tuple(rows))]


def notes(found: FoundPositions) -> tuple[str, ...]:
    """Explains the plan's estimates and the numbers in sentences."""
    chosen, planned = found.chosen, found.sets["planned"]
    said = [
        note
        for name, design in planned.designs.items()
        if name != found.sight.name and not design.blocks
        for note in design.all_notes
    ]
    if not planned.merit.sound:
        said.append(
            f"The planned positions have rank {planned.merit.rank} of {len(found.sight.terms)}: they cannot separate all "
            "terms."
        )
    if "cardinal" not in found.sets:
        said.append("No set of cardinal positions separates all terms.")
    certificate = found.bounds["free"].certificate
    p = len(found.sight.terms)
    if len(found.sight.fixed):
        said.append(
            f"Segments of the estimate that spin: {len(found.sight.fixed)}. They stay unchanged and contribute to every set. The "
            f"bound of the worst variance is therefore not known."
        )
    else:
        said.append(
            "Check of the bound (Kiefer and Wolfowitz): at the continuous D-optimum the largest variance over all "
            f"reachable orientations is {p}. The value found is {certificate:.6g}; the bound includes an allowance for the difference."
        )
    share = chosen.of_bound.D
    if share > 0.9999:
        said.append(
            "The chosen positions reach the bound to within 0.01 %: on this bench, no other set with the "
            "same number of positions has a noticeably better determinant."
        )
    if found.dwells:
        said.append(
            f"Equal dwells have {_percent(found.dwell_gain)} of the efficiency of the distributed dwells; every "
            "position keeps at least a "
            "quarter of an equal share."
        )
    said.append(
        "Efficiencies assume equal noise in all positions. A set with a D-efficiency of 97 % needs 3 % more recording "
        "time for the same determinant."
    )
    return tuple(said)


def _data(found: FoundPositions, said: tuple[str, ...]) -> dict[str, object]:
    return {
        "estimate": found.sight.name,
        "outputs": list(found.sight.others),
        "terms": list(found.sight.terms),
        "criterion": found.asked.criterion,
        "chosen": found.asked.orientations,
        "search": found.search,
        "sets": {name: _set_json(found, one) for name, one in found.sets.items()},
        "best_found": {name: _merit_json(one) for name, one in found.best.items()},
        "bounds": {
            name: {**_merit_json(one.merit), "largest_variance": one.certificate} for name, one in found.bounds.items()
        },
        "dwells_s": list(found.dwells),
        "equal_dwells_efficiency": found.dwell_gain,
        "notes": list(said),
    }


def _merit_json(merit: Merit) -> dict[str, object]:
    values = {
        "determinant": merit.determinant, "trace_of_inverse": merit.trace, "worst_variance": merit.worst,
        "mean_variance": merit.mean,
    }  # fmt: skip
    return {"rank": merit.rank, **{name: finite(value) for name, value in values.items()}}


def _set_json(found: FoundPositions, one: PositionSet) -> dict[str, object]:
    against = {"cardinal": one.of_cardinal, "found": one.of_found, "bound": one.of_bound}
    return {
        **_merit_json(one.merit),
        "efficiency": {
            name: dict(zip("DAGI", map(finite, _four(shares)), strict=True))
            for name, shares in against.items()
            if shares is not None
        },
        "plan_time_s": one.schedule.total,
        "positions": [
            {"label": label, "orientation": text, "attitude": attitude.tolist()}
            for label, text, attitude in zip(_labels(found), one.texts, one.attitudes, strict=True)
        ],
        "expected_ratios": one.residual_ratios,
        "standard_uncertainties": {
            item.name: [item.standard_uncertainty, item.unit] for item in _predicted(found, one)
        },
    }
