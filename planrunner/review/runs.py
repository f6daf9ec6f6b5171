"""Computes the difference between the results of two runs: for every coefficient, the difference and its significance.

The two results of a coefficient have independent random errors. On the same bench, they also have common errors, which do not
change between the runs. For example, if the azimuth of the site is wrong by an arc minute, it is wrong in both runs. The effect of
a common input on the difference is proportional to the difference between its two sensitivity coefficients. Let c₁ᵢuᵢ and c₂ᵢuᵢ be
the contributions of the common input i in runs 1 and 2. The standard uncertainty of the difference is then

    u² = u₁² + u₂² − 2·Σ (c₁ᵢuᵢ)(c₂ᵢuᵢ)                 (JCGM 100:2008, 5.2.2, equation 16, with r = 1)

An input is common if both budgets state, as type B, the same quantity with the same value, uncertainty and source. p is the
two-sided probability of a larger difference if the sensor has not changed. The probability p is computed from Student's t with the
effective degrees of freedom of the contributions that are not common (Welch-Satterthwaite, G.4). Holm's correction (Scandinavian
Journal of Statistics 6, 1979) allows for the number of coefficients compared.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import Coefficient, CoefficientRole, Estimate
from planrunner.uncertainty.influences import BudgetLine


@dataclass(frozen=True, slots=True)
class CoefficientDifference:
    """Contains the difference of one coefficient between two runs, in `unit`.

    `difference`: value in the second run minus value in the first. `common`: the fraction of the variances that comes from common
    inputs, 2·Σ (c₁u)(c₂u)/(u₁² + u₂²). `p`: the probability defined in the docstring of the module; NaN if it cannot be computed,
    for example for a standard deviation. `holm`: `p`, corrected for the number of coefficients compared.
    """

    estimate: str
    coefficient: str
    unit: str
    values: tuple[float, float]
    uncertainties: tuple[float, float]
    difference: float
    standard_uncertainty: float
    degrees_of_freedom: float
    common: float
    p: float
    holm: float = math.nan


@dataclass(frozen=True, slots=True)
class RunDifference:
    """The difference between two runs. `coefficients`: the coefficients that both runs have. `only`: names of the coefficients that
    only the first run has, and names of the coefficients that only the second run has."""

    coefficients: tuple[CoefficientDifference, ...]
    only: tuple[tuple[str, ...], tuple[str, ...]]


def run_difference(before: Mapping[str, Estimate], after: Mapping[str, Estimate], same_bench: bool) -> RunDifference:
    """Returns the differences of all coefficients between two runs. `same_bench`: True if the bench files of both runs have the
    same meaning. An error that both runs declare with the same values is then treated as one error that is common to both runs;
    otherwise, the errors of the two runs are treated as independent."""
    found = []
    only: tuple[list[str], list[str]] = ([], [])
    for name in dict.fromkeys([*before, *after]):
        pair = _coefficients(before.get(name)), _coefficients(after.get(name))
        for key in dict.fromkeys([*pair[0], *pair[1]]):
            one, other = pair[0].get(key), pair[1].get(key)
            if one is None or other is None or one.unit != other.unit:
                for side, has in ((0, one), (1, other)):
                    if has is not None:
                        only[side].append(f"{name}.{key}")
                continue
            lines = _lines(before[name], key), _lines(after[name], key)
            found.append(_difference(name, one, other, lines if same_bench else ({}, {})))
    return RunDifference(tuple(_with_holm(found)), (tuple(only[0]), tuple(only[1])))


def _coefficients(estimate: Estimate | None) -> dict[str, Coefficient]:
    return {} if estimate is None else {item.name: item for item in estimate.coefficients}


Lines = Mapping[tuple[object, ...], BudgetLine]


def _lines(estimate: Estimate, coefficient: str) -> Lines:
    """Returns the type B lines of a coefficient's budget that each represent a single input. Lines of two runs with the same input
    have the same key."""
    return {
        (line.quantity, line.value, line.unit, line.standard_uncertainty, line.distribution, line.source): line
        for budget in estimate.budgets
        if budget.coefficient == coefficient
        for line in budget.lines
        if line.kind == "B" and line.added and line.count == 1
    }


def _difference(name: str, one: Coefficient, other: Coefficient, lines: tuple[Lines, Lines]) -> CoefficientDifference:
    u = one.standard_uncertainty, other.standard_uncertainty
    shared = lines[0].keys() & lines[1].keys()
    signed = [
        [lines[k][key].sensitivity * lines[k][key].standard_uncertainty for key in sorted(shared, key=repr)]
        for k in (0, 1)
    ]
    twice = 2 * math.fsum(a * b for a, b in zip(*signed, strict=True))
    total = u[0] ** 2 + u[1] ** 2
    variance = max(0.0, total - twice)
    apart = other.near(one.value) - one.value
    own = [max(0.0, u[k] ** 2 - math.fsum(part**2 for part in signed[k])) for k in (0, 1)]
    freedom = _effective(own, (one.degrees_of_freedom, other.degrees_of_freedom), variance)
    location = one.role is CoefficientRole.LOCATION and other.role is CoefficientRole.LOCATION
    p = _p(apart, math.sqrt(variance), freedom) if location else math.nan
    common = twice / total if total > 0 and math.isfinite(total) else 0.0
    return CoefficientDifference(
        name,
        one.name,
        one.unit,
        (one.value, other.value),
        u,
        apart,
        math.sqrt(variance) if math.isfinite(variance) else math.inf,
        freedom,
        common,
        p,
    )


def _effective(variances: Sequence[float], freedoms: Sequence[float], total: float) -> float:
    """Returns the effective degrees of freedom according to the Welch-Satterthwaite formula, ν = u⁴/Σ(uᵢ⁴/νᵢ); infinite if no
    contribution has finite degrees of freedom."""
    parts = [v**2 / nu for v, nu in zip(variances, freedoms, strict=True) if nu > 0 and math.isfinite(nu)]
    below = math.fsum(parts)
    return total**2 / below if below > 0 and math.isfinite(total) else math.inf


def _p(apart: float, u: float, freedom: float) -> float:
    if not (math.isfinite(u) and math.isfinite(apart)) or u <= 0:
        return math.nan
    if not math.isfinite(freedom) or freedom > 1e8:
        return math.erfc(abs(apart) / u / math.sqrt(2))
    from scipy.special import stdtr

    return float(2 * stdtr(max(freedom, 1.0), -abs(apart) / u))


def _with_holm(found: Sequence[CoefficientDifference]) -> list[CoefficientDifference]:
    order = sorted((k for k, item in enumerate(found) if not math.isnan(item.p)), key=lambda k: found[k].p)
    adjusted: dict[int, float] = {}
    worst = 0.0
    for place, k in enumerate(order):
        worst = max(worst, min(1.0, (len(order) - place) * found[k].p))
        adjusted[k] = worst
    return [replace(item, holm=adjusted.get(k, math.nan)) for k, item in enumerate(found)]
