"""Curves over temperature, and the choice of their order by held-out error.

    polynomial powers of T − T₀, with coefficients as used in compensation tables
    spline       natural cubic regression spline: straight beyond its ends, coefficients are its values at the knots (Hastie, Tibshirani
                 and Friedman, The Elements of Statistical Learning, 2nd ed., 5.2.1)

The order is chosen by leaving out whole temperatures, never single values, because values at one temperature have common errors. The
one-standard-error rule takes the simplest curve whose held-out error is within one standard error of the smallest (the same book, 7.10.1).
No more coefficients are tried than half of the temperatures: with few temperatures, one of many curves fits by chance.

If the data select the order, the usual interval is too narrow, because terms of about one standard deviation that were not selected are
missing. The uncertainty of a selected curve is therefore that of the highest order tried, which does not depend on the selection; its
distance from that curve is added as an uncorrected systematic error (JCGM 100:2008, F.2.4.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.interface import EstimationError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

FORMS = ("polynomial", "spline")
FEWEST = 3  # temperatures from which an order can be chosen
RULES = ("one_standard_error", "smallest_error")


@dataclass(frozen=True)
class Curve:
    """form: of `FORMS`. order: of the polynomial, or the number of knots minus one, so that order 1 is a straight line in either form.
    reference: T₀, degC; knots: degC, ascending, of a spline."""

    form: str
    order: int
    reference: float
    knots: Array

    def columns(self, temperature: Array) -> Array:
        """The design matrix, shape (n, order + 1), at temperatures [degC] (n,)."""
        if self.form == "polynomial":
            return np.asarray((temperature - self.reference)[:, None] ** np.arange(self.order + 1))
        return natural_spline(self.knots, temperature)


def curve(form: str, order: int, reference: float, temperatures: Array) -> Curve:
    """A curve for data at `temperatures` [degC]; the knots of a spline are quantiles of the distinct temperatures, including both ends."""
    knots = np.quantile(np.unique(temperatures), np.linspace(0, 1, order + 1)) if form == "spline" else np.zeros(0)
    return Curve(form, order, reference, knots)


def natural_spline(knots: Array, at: Array) -> Array:
    """Values of a natural cubic spline at `at` (n,) from its values at `knots` (k,): a matrix (n, k). Two knots make a straight line.

    With h the distances of the knots and M the second derivatives there, zero at both ends, h_i·M_i + 2·(h_i + h_{i+1})·M_{i+1} +
    h_{i+1}·M_{i+2} = 6·(difference of adjacent slopes).
    """
    k, h = len(knots), np.diff(knots)
    slopes = np.zeros((k - 1, k))
    slopes[range(k - 1), range(k - 1)], slopes[range(k - 1), range(1, k)] = -1 / h, 1 / h
    second = np.zeros((k, k))
    if k > 2:
        inner = np.diag(2 * (h[:-1] + h[1:])) + np.diag(h[1:-1], 1) + np.diag(h[1:-1], -1)
        second[1:-1] = np.linalg.solve(inner, 6 * np.diff(slopes, axis=0))
    i = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, k - 2)
    inside = np.clip(at, knots[0], knots[-1])
    left, right = (inside - knots[i])[:, None], (knots[i + 1] - inside)[:, None]
    width = h[i][:, None]
    one = np.eye(k)
    found = (right * one[i] + left * one[i + 1]) / width
    found += (right**3 / width - right * width) / 6 * second[i] + (left**3 / width - left * width) / 6 * second[i + 1]
    slope = slopes[i] + ((3 * left**2 / width - width) * second[i + 1] - (3 * right**2 / width - width) * second[i]) / 6
    return np.asarray(found + (at - inside)[:, None] * slope)


@dataclass(frozen=True, slots=True)
class HeldOut:
    """How well a curve of one order predicts held-out values. error: mean square over the held-out temperatures, in the value's unit
    squared; standard_error: of that mean."""

    order: int
    error: float
    standard_error: float


def held_out(
    form: str, orders: Sequence[int], reference: float, temperature: Array, value: Array, sigma: Array, fold: Integers
) -> tuple[HeldOut, ...]:
    """Held-out errors of each order. sigma: (n,), for weights; fold: (n,), the fold with which each value is held out."""
    weight = 1 / sigma**2
    found = []
    for order in orders:
        errors = []
        for one in np.unique(fold):
            out = fold == one
            made = curve(form, order, reference, temperature[~out])
            fit = least_squares.fit(made.columns(temperature[~out]), value[~out], sigma[~out])
            missed = value[out] - made.columns(temperature[out]) @ fit.coefficients
            errors.append(float(np.sum(weight[out] * missed**2) / np.sum(weight[out])))
        spread = float(np.std(errors, ddof=1) / np.sqrt(len(errors))) if len(errors) > 1 else 0.0
        found.append(HeldOut(order, float(np.mean(errors)), spread))
    return tuple(found)


def chosen(errors: Sequence[HeldOut], rule: str) -> HeldOut:
    """The order that a rule of `RULES` selects."""
    best = min(errors, key=lambda one: one.error)
    if rule == "smallest_error":
        return best
    return next(one for one in errors if one.error <= best.error + best.standard_error)


def fold_of(group: Integers, folds: int) -> Integers:
    """The fold with which each temperature group is held out: each group alone for folds = 0, otherwise `folds` adjoining ranges of
    temperature, so that neighbours with a common slow drift do not predict each other."""
    return group if folds == 0 else group * folds // (int(group.max()) + 1)


def correlation_time(residuals: Sequence[Array]) -> float:
    """Factor, at least one, by which correlation between consecutive residuals increases the variance of the fit.

    1 + 2·Σ r_k over the lags up to the first at which the autocorrelation r, pooled over the series, is not positive (Geyer, Statistical
    Science 7, 1992, 473).
    """
    total = sum(float(one @ one) for one in residuals)
    longest = max((len(one) for one in residuals), default=0)
    time = 1.0
    for lag in range(1, longest):
        r = sum(float(one[lag:] @ one[:-lag]) for one in residuals if len(one) > lag) / total if total > 0 else 0.0
        if r <= 0:
            break
        time += 2 * r
    return time


def groups_of(temperature: Array, width: float) -> Integers:
    """Group number of each temperature, ascending: a temperature within `width` [K] of the lowest of a group belongs to that group."""
    order = np.argsort(temperature, kind="stable")
    group, number, first = np.zeros(len(temperature), dtype=np.int64), -1, -np.inf
    for index in order:
        if temperature[index] > first + width:
            number, first = number + 1, temperature[index]
        group[index] = number
    return group


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fitted curve. covariance: (p, p) of its coefficients, degrees_of_freedom: of the covariance; correlation: factor by which it was
    widened because consecutive residuals are correlated. fullest: for a chosen curve, the curve of the highest order tried, if it is a
    different one."""

    curve: Curve
    coefficients: Array
    covariance: Array
    degrees_of_freedom: float
    errors: tuple[HeldOut, ...] = ()
    correlation: float = 1.0
    fullest: CurveFit | None = None

    def predict(self, temperature: Array) -> tuple[Array, Array]:
        """The curve and its standard uncertainty at temperatures [degC], both (n,)."""
        columns = self.curve.columns(temperature)
        value = columns @ self.coefficients
        if self.fullest is None:
            variance = np.einsum("ni,ij,nj->n", columns, self.covariance, columns)
            return value, np.sqrt(variance.clip(min=0.0))
        full, u = self.fullest.predict(temperature)
        return value, np.hypot(u, value - full)

    def warmer(self, by: float) -> Array:
        """Coefficients (p,) of the curve at T + by: those of a run whose true temperatures are higher by this amount [K]."""
        if self.curve.form == "spline":
            return np.asarray(self.curve.columns(self.curve.knots + by) @ self.coefficients)
        moved = np.polynomial.Polynomial(self.coefficients)(np.polynomial.Polynomial([by, 1.0])).coef
        return np.pad(moved, (0, len(self.coefficients) - len(moved)))


def fit_curve(
    form: str,
    order: int | None,
    highest: int,
    reference: float,
    temperature: Array,
    value: Array,
    sigma: Array,
    group: Integers,
    folds: int,
    rule: str,
    scatter: bool,
    series: Integers,
) -> CurveFit:
    """Fit a curve of the given order, or of the order up to `highest` that held-out errors select.

    scatter: whether the covariance is based on the scatter of the residuals, otherwise on `sigma`. series: (n,), number of the ramp of each
    value, in order; −1 for a single value. Raises `EstimationError`.
    """
    distinct = int(group.max()) + 1

    def fitted(one: int) -> CurveFit:
        if distinct < one + 1:
            raise EstimationError(
                f"{distinct} temperatures cannot determine a {form} of order {one}: lower `order` or add temperatures"
            )
        return _fitted(curve(form, one, reference, temperature), temperature, value, sigma, scatter, series)

    if order is not None:
        return fitted(order)
    fold = fold_of(group, folds)
    left = distinct - max(len(np.unique(group[fold == one])) for one in np.unique(fold))
    most = min(highest, left - 1, (distinct + 1) // 2 - 1)
    orders = range(0 if form == "polynomial" else 1, most + 1)
    if distinct < FEWEST or len(np.unique(fold)) < 2 or not len(orders):
        raise EstimationError(
            f"{distinct} temperatures are too few to choose an order: give `order` or add temperatures"
        )
    errors = held_out(form, orders, reference, temperature, value, sigma, fold)
    simple = replace(fitted(chosen(errors, rule).order), errors=errors)
    return simple if simple.curve.order == most else _as_chosen(simple, fitted(most))


def _fitted(made: Curve, temperature: Array, value: Array, sigma: Array, scatter: bool, series: Integers) -> CurveFit:
    """A curve through all values. Raises `EstimationError` if there is no basis for its uncertainty."""
    fit = least_squares.fit(made.columns(temperature), value, sigma)
    if not scatter:
        return CurveFit(made, fit.coefficients, fit.cofactor, np.inf)
    if not fit.degrees_of_freedom:
        raise EstimationError(
            f"{len(value)} values for {made.order + 1} coefficients leave no residuals from which an uncertainty could be estimated: "
            "lower `order`, add "
            "temperatures or write `uncertainty: propagated`"
        )
    weighted = fit.residuals / sigma
    time = correlation_time([weighted[series == one] for one in np.unique(series[series >= 0])])
    freedom = max(1.0, len(value) / time - (made.order + 1))
    factor = fit.chi_squared / fit.degrees_of_freedom * time
    return CurveFit(
        made,
        fit.coefficients,
        fit.cofactor * factor,
        freedom if time > 1 else float(fit.degrees_of_freedom),
        correlation=time,
    )


def _as_chosen(simple: CurveFit, full: CurveFit) -> CurveFit:
    """The simple curve with an uncertainty that combines that of the full curve and the distance between the two."""
    if simple.curve.form == "polynomial":
        reads = np.eye(simple.curve.order + 1, full.curve.order + 1)
    else:
        reads = full.curve.columns(simple.curve.knots)
    away = simple.coefficients - reads @ full.coefficients
    return replace(
        simple,
        covariance=reads @ full.covariance @ reads.T + np.outer(away, away),
        degrees_of_freedom=full.degrees_of_freedom,
        correlation=full.correlation,
        fullest=full,
    )
