"""Compares an estimate's intervals with Monte Carlo draws, if the plan requests this (`validate: monte_carlo`).

An estimator may have the following method. It computes coefficients, without linear approximation, from draws of the data and of
the declared inputs:

    def chain(self, request: EstimateRequest[MyParameters], estimate: Estimate) -> Draws

Without this method, the draws are computed from the covariance and the sensitivities of the estimate. Such draws test the
distributions and the effective degrees of freedom, but not the linearity. The draws are divided among worker processes; therefore,
the function that makes the draws must support pickling.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.said import Said, said
from planrunner.base.workers import ALONE, Workers
from planrunner.estimators.interface import Estimate, EstimateRequest
from planrunner.estimators.tables import Cell, Role, Table, TableColumn
from planrunner.plan.kinds import Record
from planrunner.plan.model import MonteCarloSpec
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.monte_carlo import (
    HEAVY,
    Draws,
    about,
    influence_draws,
    numerical_tolerance,
    propagate,
    t_draws,
    validate,
)

TITLE = "Intervals validated by Monte Carlo (JCGM 101)"
_FIGURES = ("y − U", "y + U", "low", "high", "shortest low", "shortest high", "s", "d low", "d high", "δ")
COLUMNS = (
    TableColumn("coefficient"),
    TableColumn("unit"),
    *(TableColumn(title, Role.VALUE) for title in _FIGURES),
    TableColumn("validated"),
)
_SHARE = 5.0  # tolerance of the validation divided by the numerical tolerance of the draws (JCGM 101:2008, 8.2)


R = TypeVar("R", bound=Record, contravariant=True)


@runtime_checkable
class Chains(Protocol[R]):
    """An estimator that defines its own Monte Carlo draws."""

    def chain(self, request: EstimateRequest[R], estimate: Estimate) -> Draws: ...


def linear_chain(estimate: Estimate) -> Draws:
    """Returns draws of all coefficients of an estimate that includes its influences. All dependences are approximated to first
    order."""
    data = estimate.covariance if estimate.data_covariance is None else estimate.data_covariance
    scatter = t_draws(data, [budget.lines[0].degrees_of_freedom for budget in estimate.budgets])
    stated = influence_draws(estimate.influences, len(estimate.coefficients))
    values = np.array([item.value for item in estimate.coefficients])[:, None]
    return about(values, scatter, stated)


def _rows_of(rows: Sequence[int], draws: Draws, rng: np.random.Generator, n: int) -> Array:
    return draws(rng, n)[rows]


def validated(
    estimate: Estimate, draws: Draws, asked: MonteCarloSpec, first_order: bool, workers: Workers = ALONE
) -> Estimate:
    """Adds a table of Monte Carlo results to an estimate. The table contains the headline coefficients, or all coefficients if the
    estimate has no headline.

    `first_order`: True if `draws` come from `linear_chain`. `workers`: processes that share the work of drawing.
    """
    names = estimate.headline or tuple(item.name for item in estimate.coefficients)
    rows = [k for k, item in enumerate(estimate.coefficients) if item.name in names and item.standard_uncertainty > 0]
    shown = [estimate.coefficients[k] for k in rows]
    if not shown:
        return estimate
    tolerances = np.array([numerical_tolerance(item.standard_uncertainty, asked.digits) for item in shown])
    heavy = [estimate.budgets[k].lines[0].degrees_of_freedom <= HEAVY for k in rows]
    found = propagate(
        partial(_rows_of, rows, draws), tolerances / _SHARE, seed=asked.seed, most=asked.draws, heavy=heavy,
        workers=workers,
    )  # fmt: skip
    cells: list[tuple[Cell, ...]] = []
    verdicts: dict[str, list[str]] = {"yes": [], "no": [], "undecided": []}
    for item, interval, tolerance, spread in zip(shown, found.intervals, tolerances, found.spread, strict=True):
        expanded = expanded_uncertainty(item.standard_uncertainty, item.degrees_of_freedom)
        judged = validate(item.value, expanded, interval, float(tolerance))
        verdict = (
            "yes" if judged.validated else "no" if max(judged.low, judged.high) - spread > tolerance else "undecided"
        )
        verdicts[verdict].append(item.name)
        cells.append(
            (
                item.name,
                item.unit,
                item.value - expanded,
                item.value + expanded,
                interval.low,
                interval.high,
                *interval.shortest,
                interval.standard_deviation,
                judged.low,
                judged.high,
                judged.tolerance,
                verdict,
            )
        )
    table = Table(TITLE, COLUMNS, tuple(cells))
    notes, warnings = _words(found.draws, found.stabilised, first_order, verdicts)
    settings = {"validate": "monte_carlo", "draws": found.draws, "seed": asked.seed, "digits": asked.digits}
    return replace(
        estimate,
        tables=(*estimate.tables, table),
        notes=(*estimate.notes, *notes),
        warnings=(*estimate.warnings, *warnings),
        settings={**estimate.settings, **settings},
    )


def _words(
    draws: int, stabilised: bool, first_order: bool, verdicts: Mapping[str, Sequence[str]]
) -> tuple[list[Said], list[Said]]:
    notes = [
        said(
            "{draws} Monte Carlo draws compare the intervals at 95 % with the declared distributions.",
            draws=draws,
        )
    ]
    if not stabilised:
        notes.append(
            said(
                "At the largest requested number of draws, the results had not stabilised to within a fifth of "
                "the tolerance δ."
            )
        )
    if first_order:
        notes.append(
            said(
                "The draws use the sensitivities of this estimate, so they do not test whether the linear "
                "approximation is sufficient."
            )
        )
    if undecided := tuple(verdicts["undecided"]):
        notes.append(
            said(
                "This number of draws gives no verdict on {undecided}: the ends of the intervals from the draws "
                "are too uncertain for a comparison with δ. Increase `draws`.",
                undecided=undecided,
            )
        )
    warnings = []
    if names := tuple(verdicts["no"]):
        warnings.append(
            said(
                "Monte Carlo does not validate the stated interval of {names}: its ends differ by more than δ. "
                "The table gives both; use the Monte Carlo interval.",
                names=names,
            )
        )
    return notes, warnings
