"""Combines uncertainties: the scatter of the data (type A) and stated uncertainties (type B), with a budget for each coefficient.

The law of propagation of uncertainty for independent inputs (JCGM 100:2008, 5.1.2) is applied to all coefficients together, which
also gives their covariance (H.2.4). Effective degrees of freedom follow from the Welch–Satterthwaite formula (G.4.1). An input that
acts on the coefficients in several ways counts as one input: its sensitivities are added before they are squared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import Budget, BudgetLine, Influence, InputQuantity

NEGLIGIBLE = 1e-6  # of the combined uncertainty: smaller contributions are not listed


@dataclass(frozen=True, slots=True)
class Measured:
    """Describes a coefficient that was estimated from the data, with its type A standard uncertainty and degrees of freedom."""

    name: str
    value: float
    unit: str
    standard_uncertainty: float
    degrees_of_freedom: float = math.inf


@dataclass(frozen=True, slots=True)
class Combined:
    """Contains the combined uncertainties of m coefficients. `covariance`: array of shape (m, m). `standard_uncertainties`,
    `degrees_of_freedom`: arrays of shape (m,)."""

    covariance: Array
    standard_uncertainties: Array
    degrees_of_freedom: Array
    budgets: tuple[Budget, ...]


def combine(
    measured: Sequence[Measured], covariance: Array, influences: Iterable[Influence] = (), source: str = ""
) -> Combined:
    """Adds the covariance of the influences to the type A `covariance` (m, m) of the coefficients.

    `source`: a text that states the source of the type A part; the budgets show this text in the row of this part. Raises
    ValueError if the sensitivities do not fit the coefficients or are not finite.
    """
    acting = merged(influences)
    m = len(measured)
    for item in acting:
        if item.sensitivities.shape[0] != m or not np.isfinite(item.sensitivities).all():
            raise ValueError(f"the sensitivities to '{item.quantity.name}' do not fit the {m} coefficients")
    added = [item for item in acting if not item.in_scatter]
    total = np.array(covariance, dtype=float)
    for item in added:
        total = total + item.covariance
    # Contribution of each input to each coefficient, (m, inputs).
    sizes = np.array([item.quantity.standard_uncertainty * _root_sum(item.sensitivities) for item in acting])
    budgets = tuple(_budget(one, k, acting, sizes.reshape(-1, m)[:, k], source) for k, one in enumerate(measured))
    return Combined(
        total,
        np.array([budget.standard_uncertainty for budget in budgets]),
        np.array([budget.degrees_of_freedom for budget in budgets]),
        budgets,
    )


def merged(influences: Iterable[Influence]) -> tuple[Influence, ...]:
    """Merges influences, so that there is one influence for each input. Sensitivities to the same input, or to the same named part
    of an input, are added; sensitivities to different parts become separate columns. Raises ValueError if the sensitivities of an
    influence do not fit its parts."""
    together: dict[tuple[InputQuantity, bool], list[Influence]] = {}
    for item in influences:
        if item.sensitivities.ndim != 2 or (item.parts and len(item.parts) != item.sensitivities.shape[1]):
            raise ValueError(f"the sensitivities to '{item.quantity.name}' must have a column for each of its parts")
        if item.sensitivities.shape[1]:
            together.setdefault((item.quantity, item.in_scatter), []).append(item)
    return tuple(_added(same) for same in together.values())


def _added(same: Sequence[Influence]) -> Influence:
    """Returns the sum of several influences of one input."""
    if len(same) == 1 and len(set(same[0].parts)) == len(same[0].parts) != 1:
        return same[0]
    held: dict[object, Array] = {}
    for item in same:
        parts: Sequence[object] = item.parts or (
            [""] if item.sensitivities.shape[1] == 1 else _unnamed(item.sensitivities)
        )
        for part, column in zip(parts, item.sensitivities.T, strict=True):
            held[part] = held[part] + column if part in held else column
    return Influence(same[0].quantity, np.column_stack(list(held.values())), same[0].in_scatter, _named(held))


def effective_degrees_of_freedom(contributions: Sequence[float], degrees_of_freedom: Sequence[float]) -> float:
    """Returns the effective degrees of freedom by the Welch–Satterthwaite formula (JCGM 100:2008, G.4.1). The result is infinite if
    nothing contributes, and zero if a contribution has no degrees of freedom."""
    pairs = [(size, freedom) for size, freedom in zip(contributions, degrees_of_freedom, strict=True) if size]
    if any(not freedom > 0 for _, freedom in pairs):
        return 0.0
    whole = math.fsum(size**2 for size, _ in pairs)
    inverse = math.fsum((size**2 / whole) ** 2 / freedom for size, freedom in pairs)
    return 1.0 / inverse if inverse else math.inf


def _budget(one: Measured, k: int, acting: Sequence[Influence], sizes: Array, source: str) -> Budget:
    parts = [(float(size), item) for size, item in zip(sizes, acting, strict=True)]
    added = [(size, item.quantity) for size, item in parts if size and not item.in_scatter]
    combined, freedom = one.standard_uncertainty, one.degrees_of_freedom
    if added:
        combined = math.hypot(combined, *(size for size, _ in added))
        # Welch–Satterthwaite applies only to independent contributions, so contributions from residuals count as one.
        shown = math.hypot(one.standard_uncertainty, *(size for size, own in added if own.from_residuals))
        others = [(size, own.degrees_of_freedom) for size, own in added if not own.from_residuals]
        freedom = effective_degrees_of_freedom(
            [shown, *(size for size, _ in others)], [freedom, *(own for _, own in others)]
        )
    data = BudgetLine(
        "data",
        "A",
        one.value,
        one.unit,
        one.standard_uncertainty,
        "t" if math.isfinite(one.degrees_of_freedom) else "normal",
        one.degrees_of_freedom,
        1.0,
        one.standard_uncertainty,
        source,
    )
    lines = (data, *(_line(item, k, size) for size, item in parts if size > NEGLIGIBLE * combined))
    return Budget(one.name, one.unit, lines, combined, freedom, coverage_factor(freedom))


def _line(item: Influence, k: int, contribution: float) -> BudgetLine:
    """Makes the row of a budget for one input. The sensitivity and the input are in the unit in which budgets show the input. `k`:
    index of the coefficient. `contribution`: contribution of the input to the standard uncertainty of the coefficient."""
    quantity, row = item.quantity, item.sensitivities[k]
    factor = quantity.shown_factor if quantity.shown else 1.0
    return BudgetLine(
        quantity.name,
        "B",
        quantity.value / factor,
        quantity.shown or quantity.unit,
        quantity.standard_uncertainty / factor,
        quantity.distribution,
        quantity.degrees_of_freedom,
        factor * float(row[0] if len(row) == 1 else _root_sum(row[None, :])[0]),
        contribution,
        quantity.source,
        not item.in_scatter,
        len(row),
        quantity.calibrated,
    )


def _root_sum(sensitivities: Array) -> Array:
    lengths: Array = np.sqrt(np.einsum("ij,ij->i", sensitivities, sensitivities))
    return lengths


def _unnamed(sensitivities: Array) -> list[object]:
    return [object() for _ in range(sensitivities.shape[1])]


def _named(parts: Iterable[object]) -> tuple[str, ...]:
    names = list(parts)
    return tuple(str(name) for name in names) if len(names) > 1 and all(isinstance(name, str) for name in names) else ()
