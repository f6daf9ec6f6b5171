"""Defines the structure of most estimators. A result is a function of observations, and the same function predicts the results of a
run.

    found = method.quantities(request)      the formula: coefficients, their covariance and their influences
    words = method.words(request, found)    tables, plots and notes for readers

`estimate` calls both functions. The prediction of a run calls only the first function, with the observations expected from the
schedule. The check of a plan therefore gives every coefficient of the run with its uncertainty, and uses the same formula as the
run. If this takes too long, or if the formula needs samples, the estimator has a separate prediction (`ForeseesResults`). Tests
compare such a prediction with a run.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cache
from typing import Generic, Protocol, TypeVar, cast, runtime_checkable

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json
from planrunner.base.findings import InputError
from planrunner.base.said import Said
from planrunner.estimators.expected import ASSUMPTIONS, Expected, Known, expected_recording
from planrunner.estimators.interface import (
    Coefficient,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Estimator,
    Foresight,
    Unpredicted,
)
from planrunner.estimators.tables import Plot, Table
from planrunner.estimators.unstated_flicker import UnstatedFlicker
from planrunner.plan.kinds import Record
from planrunner.plan.meaning import channels_of
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.influences import Influence

_ALIKE = 1e-6  # relative: results that differ less between two assumptions do not depend on the assumptions


@dataclass(frozen=True, slots=True, kw_only=True)
class Quantities:
    """The result of an estimator's formula.

    `covariance`: array of shape (m, m), covariance of the coefficients due to the data, in the products of the coefficients' units.
    `influences`: contributions of inputs whose errors the data do not show. `unstated`: flicker whose size the bench file does not
    state. `extra`: plain data for other estimates that use this one; see `interface.Estimate`.
    """

    coefficients: tuple[Coefficient, ...]
    covariance: Array
    influences: tuple[Influence, ...] = ()
    unstated: tuple[UnstatedFlicker, ...] = ()
    extra: Mapping[str, Json] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """Contains the tables, plots and notes that explain an estimate to readers. The fields are described in `interface.Estimate`."""

    headline: tuple[str, ...] = ()
    settings: Mapping[str, Json] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    plots: tuple[Plot, ...] = ()
    notes: tuple[Said, ...] = ()
    warnings: tuple[Said, ...] = ()
    segments: tuple[str, ...] = ()


P = TypeVar("P", bound=Record)
Q = TypeVar("Q", bound=Quantities)


class Method(ABC, Generic[P, Q]):
    """Base class of an estimator that consists of a formula and of explanations for readers. P: type of the record that contains
    the values of its keys; Q: type of the result of its formula."""

    summary: str
    Parameters: type[P]

    name: str
    """Name of the estimator in plans."""

    @abstractmethod
    def quantities(self, request: EstimateRequest[P]) -> Q:
        """Computes the coefficients from the observations. Raises `EstimationError` if the plan or the data are not suitable."""

    @abstractmethod
    def words(self, request: EstimateRequest[P], found: Q) -> Words:
        """Makes tables, plots and notes for readers."""

    def known(self, request: DesignRequest[P]) -> Known:
        """Returns what this estimator knows about the outputs. Everything else is derived from the names and units of the outputs.
        This function does not reject unsuitable segments; `design` does."""
        return Known()

    def estimate(self, request: EstimateRequest[P]) -> Estimate:
        """Computes the estimate from a recording. Raises `EstimationError` if the plan or the data are not suitable."""
        found = self.quantities(request)
        words = self.words(request, found)
        return Estimate(
            request.name,
            self.name,
            found.coefficients,
            found.covariance,
            headline=words.headline,
            settings=words.settings,
            tables=words.tables,
            plots=words.plots,
            notes=words.notes,
            warnings=words.warnings,
            segments=words.segments,
            extra=found.extra,
            influences=found.influences,
            unstated=found.unstated,
        )


F = TypeVar("F", bound=Record, contravariant=True)


@runtime_checkable
class ForeseesResults(Protocol[F]):
    """An estimator that predicts the results of a run by a separate method instead of by its formula."""

    def foresee(self, request: DesignRequest[F]) -> Foresight: ...


def designed(estimator: Estimator[P], request: DesignRequest[P]) -> Design:
    """Checks the planned segments for an estimator and predicts the results of a run. Returns the remarks and the predictions as a
    `Design`. Raises `EstimationError` if the segments are unsuitable."""
    design = estimator.design(request) or Design(())
    if any(remark.error for remark in design.remarks):
        return design
    if _foresees(type(estimator)):
        seen = cast(ForeseesResults[P], estimator).foresee(request)  # may raise an error for unsuitable segments
        return replace(design, foresight=lambda: seen)

    @cache
    def foresight() -> Foresight:
        try:
            return by_expectation(estimator, request)
        except (EstimationError, InputError):
            return Foresight()

    return replace(design, foresight=foresight)


@cache
def _foresees(estimator: type) -> bool:
    """Returns True if an estimator class has its own method for predictions. The answer is cached, because the check of a protocol
    inspects every attribute and is therefore slow."""
    return issubclass(estimator, ForeseesResults)


def by_expectation(estimator: Estimator[P], request: DesignRequest[P]) -> Foresight:
    """Predicts the results of any estimator by applying its formula to the expected recording."""
    used = channels_of(request.parameters) or tuple(one.name for one in request.sensor.outputs if not one.constant)
    known = estimator.known(request) if isinstance(estimator, Method) else Known()
    first, *others = ASSUMPTIONS
    expected = expected_recording(request, known, used, first)
    tried = [_evaluated(estimator, request, expected, 0)]
    if expected.assumed or any(len(design.expected) > 1 for design in request.uses.values()):
        for number, other in enumerate(others, start=1):
            tried.append(_evaluated(estimator, request, expected_recording(request, known, used, other), number))
    made = [one for one in tried if one is not None]
    if len(made) < len(tried):
        return Foresight()
    why = " and ".join(expected.assumed[:2]) or "an estimate in `uses` has no prediction"
    if not isinstance(estimator, Method):
        why = "its estimator predicts none"
    predicted, unpredicted = [], []
    for k, item in enumerate(made[0].coefficients):
        alike = isinstance(estimator, Method) and all(_alike(item, one.coefficients[k : k + 1]) for one in made[1:])
        if alike and math.isfinite(item.value) and math.isfinite(item.standard_uncertainty):
            predicted.append(item)
        else:
            reason = "the planned segments do not show it" if alike else why
            unpredicted.append(Unpredicted(item.name, item.unit, reason, item.description, item.role))
    return Foresight(tuple(predicted), tuple(unpredicted), tuple(made))


def _alike(one: Coefficient, others: Sequence[Coefficient]) -> bool:
    return bool(others) and all(
        other.name == one.name
        and math.isclose(other.standard_uncertainty, one.standard_uncertainty, rel_tol=_ALIKE)
        and math.isclose(other.value, one.value, rel_tol=_ALIKE, abs_tol=one.standard_uncertainty)
        for other in others
    )


def _evaluated(estimator: Estimator[P], request: DesignRequest[P], expected: Expected, number: int) -> Estimate | None:
    """Returns the estimate from an expected recording, with its complete uncertainty; None if the formula fails."""
    uses = {
        name: design.expected[min(number, len(design.expected) - 1)]
        for name, design in request.uses.items()
        if design.expected
    }
    if len(uses) < len(request.uses):
        return None
    asked = EstimateRequest(
        request.name,
        expected.segments,
        request.parameters,
        request.site,
        request.sensor,
        uses,
        request.detection,
        request.setup,
    )
    try:
        with np.errstate(all="ignore"):
            if not isinstance(estimator, Method):
                return estimator.estimate(asked)
            found: Quantities = estimator.quantities(asked)
            return _whole(
                Estimate(
                    request.name,
                    estimator.name,
                    found.coefficients,
                    found.covariance,
                    extra=found.extra,
                    influences=found.influences,
                )
            )
    except (EstimationError, InputError):
        return None
    except Exception:  # an estimator may come from anywhere
        if isinstance(estimator, Method):
            raise
        return None


def _whole(made: Estimate) -> Estimate:
    """Returns the estimate with a covariance that includes the contribution of the data and all influences. The degrees of freedom
    are infinite, because the noise is declared."""
    covariance = np.array(made.covariance, dtype=float)
    for item in merged(one for one in made.influences if not one.in_scatter):
        covariance += item.covariance
    spreads = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    coefficients = tuple(
        Coefficient(item.name, item.value, item.unit, u, math.inf, item.description, item.period, item.role)
        for item, u in zip(made.coefficients, spreads.tolist(), strict=True)
    )
    return replace(
        made, coefficients=coefficients, covariance=covariance, data_covariance=made.covariance, expected=True
    )
