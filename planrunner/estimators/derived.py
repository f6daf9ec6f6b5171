"""Computes the results of an estimate from a formula of the fitted coefficients. The same formula gives the values, covariance,
degrees of freedom, influences and Monte Carlo draws.

An estimator gives only the formula and the names of its quantities. The derivatives of the formula are computed automatically
(`uncertainty.derivatives`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import partial

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said
from planrunner.estimators.interface import Coefficient
from planrunner.estimators.outputs_fit import OutputsFit
from planrunner.estimators.unstated_flicker import UnstatedFlicker
from planrunner.uncertainty.derivatives import Formula, value_and_jacobian
from planrunner.uncertainty.influences import Influence
from planrunner.uncertainty.monte_carlo import Draws, about, influence_draws, t_draws


@dataclass(frozen=True, slots=True)
class Reported:
    """States the name and the unit of one derived quantity. `unit`: unit of the value. `period`: period of a circular quantity such
    as an angle, in this unit."""

    name: str
    unit: str
    description: Said
    period: float = math.inf


@dataclass(frozen=True, slots=True)
class Derived:
    """Contains q quantities that are computed from the coefficients of several fits. The r coefficients of all fits form one
    sequence.

    `values`: array of shape (q,), in the quantities' units. `gradient`: array of shape (q, r), derivatives with respect to the
    fitted coefficients. `between`: for each kind of uncertainty, the covariance (r, r) between the coefficients of different fits;
    by default, the fits are independent.
    """

    quantities: tuple[Reported, ...]
    formula: Formula
    values: Array
    gradient: Array
    fits: tuple[OutputsFit, ...]
    between: Mapping[str, Array] = field(default_factory=dict)

    def covariance(self, basis: str) -> Array:
        """Returns the covariance matrix of the quantities due to the data, shape (q, q)."""
        data = independent([fit.covariance(basis) for fit in self.fits])
        if basis in self.between:
            data = data + self.between[basis]
        return np.asarray(self.gradient @ data @ self.gradient.T)

    def spread(self, basis: str) -> tuple[Array, Array]:
        """Returns two arrays of shape (q,): the standard uncertainties of the quantities due to the data, and their effective
        degrees of freedom. The degrees of freedom of the quantities follow from the degrees of freedom of the fits by the
        Welch–Satterthwaite formula."""
        variance, squares = np.zeros(len(self.values)), np.zeros(len(self.values))
        least = np.full(len(self.values), math.inf)
        for fit, own in zip(self.fits, self._by_fit(), strict=True):
            share = np.sum((own @ fit.covariance(basis)) * own, axis=1).clip(min=0.0)
            freedom = fit.degrees_of_freedom(own, basis)
            variance, squares = variance + share, squares + share**2 / freedom
            least = np.where(np.abs(own).max(axis=1) > 0, np.minimum(least, freedom), least)
        with np.errstate(divide="ignore", invalid="ignore"):
            freedom = np.where(squares > 0, variance**2 / squares, least)
        if basis in self.between:
            variance = variance + np.einsum("qi,ij,qj->q", self.gradient, self.between[basis], self.gradient)
        return np.sqrt(variance.clip(min=0.0)), freedom

    def coefficients(self, basis: str) -> tuple[Coefficient, ...]:
        u, freedom = self.spread(basis)
        return tuple(
            Coefficient(one.name, float(value), one.unit, float(own), float(dof), one.description, one.period)
            for one, value, own, dof in zip(self.quantities, self.values, u, freedom, strict=True)
        )

    def influences(self, acting: Sequence[Sequence[Influence]]) -> tuple[Influence, ...]:
        """Computes the influences on the quantities from the influences on the coefficients of each fit. An input that acts on
        several fits counts as one input."""
        by_fit = zip(acting, self._by_fit(), strict=True)
        return tuple(one.through(gradient) for influences, gradient in by_fit for one in influences)

    @property
    def unstated(self) -> tuple[UnstatedFlicker, ...]:
        """Computes how the quantities change due to flicker that the bench file neither states nor excludes."""
        by_fit = zip(self.fits, self._by_fit(), strict=True)
        return tuple(one.through(gradient) for fit, gradient in by_fit for one in fit.unstated_flicker())

    def draws(self, basis: str, acting: Sequence[Sequence[Influence]]) -> Draws:
        """Draws the quantities by the Monte Carlo method; each draw is computed with the formula. Only the influences are
        approximated to first order.

        The contribution of each fit is drawn from Student's t distribution, with the degrees of freedom of the variance of this
        fit. Outputs that are pooled share one variance.
        """
        parts = [_draws(fit, basis, influences) for fit, influences in zip(self.fits, acting, strict=True)]
        return partial(_through, self.formula, parts)

    def _by_fit(self) -> list[Array]:
        if len(self.fits) == 1:
            return [self.gradient]
        ends = np.cumsum([fit.coefficients.size for fit in self.fits])
        return np.split(self.gradient, ends[:-1], axis=1)


def derived(
    quantities: Sequence[Reported],
    formula: Formula,
    *fits: OutputsFit,
    at: Array | None = None,
    between: Mapping[str, Array] | None = None,
) -> Derived:
    """Evaluates a formula of fitted coefficients, with its derivatives.

    `formula`: a function that converts an array (r, n) of coefficients to an array (q, n) of quantities; its argument contains the
    coefficients of all outputs in sequence. `at`: array of shape (r,), values of the coefficients at which the formula is
    evaluated, by default the fitted coefficients. `at` is given if the coefficients of the fits are only small changes of these
    values. `between`: for each kind of uncertainty, the covariance (r, r) between the coefficients of different fits. Exceptions
    that the formula raises are not caught.
    """
    where = np.concatenate([fit.coefficients.ravel() for fit in fits]) if at is None else at
    return Derived(tuple(quantities), formula, *value_and_jacobian(formula, where), fits, between or {})


def _draws(fit: OutputsFit, basis: str, influences: Sequence[Influence]) -> Draws:
    m, p = fit.coefficients.shape
    freedom = np.repeat(fit.degrees_of_freedom(np.eye(m * p)[::p], basis), p)
    pooled = basis == "residual" and fit.pooled and not fit.by_noise.any()
    groups = [0 if pooled else output for output in range(m) for _ in range(p)]
    scatter, inputs = t_draws(fit.covariance(basis), freedom, groups), influence_draws(influences, m * p)
    centre = fit.coefficients.reshape(-1, 1)
    return about(centre, scatter, inputs)


def _through(formula: Formula, parts: Sequence[Draws], rng: np.random.Generator, n: int) -> Array:
    return formula(np.concatenate([part(rng, n) for part in parts]))


def independent(blocks: Sequence[Array]) -> Array:
    """Returns the joint covariance matrix of several independent groups of quantities, shape (Σn, Σn). `blocks`: for each group of
    n quantities, its covariance matrix, shape (n, n)."""
    if len(blocks) == 1:
        return blocks[0]
    size = sum(len(block) for block in blocks)
    whole, start = np.zeros((size, size)), 0
    for block in blocks:
        end = start + len(block)
        whole[start:end, start:end] = block
        start = end
    return whole
