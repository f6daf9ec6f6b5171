"""Fits curves as functions of temperature, and chooses their order by the error of held-out values.

    polynomial   powers of T − T₀, with coefficients as used in compensation tables
    spline       natural cubic regression spline: straight beyond its ends, coefficients are its values at the knots (Hastie, Tibshirani
                 and Friedman, The Elements of Statistical Learning, 2nd ed., 5.2.1)

The order is chosen by the errors of held-out values (cross-validation): the temperatures are divided into folds, and the values of
each fold are predicted by a curve that is fitted to all other values. All values at a temperature belong to the same fold, because
values at one temperature have common errors. The one-standard-error rule (Hastie et al., 7.10.1) starts from the curve with the
smallest held-out error. The rule selects the simplest curve whose error exceeds this smallest error by at most the standard error
of the smallest error. The number of coefficients is at most half of the number of temperatures, rounded up, because otherwise, with
few temperatures, one of the many possible curves would fit by chance.

If the data select the order, the usual interval is too narrow. A term that was not selected may still be as large as its own
standard uncertainty, and the usual interval ignores it. The uncertainty of a selected curve is therefore computed from the curve of
the highest order tried, which does not depend on the selection. The difference between the selected curve and the curve of the
highest order is added as an uncorrected systematic error (JCGM 100:2008, F.2.4.5).

The noise of values may be correlated over time by the flicker that the bench declares. The values and the columns of the design
matrix are then whitened with the covariance of the noise, and held-out errors are computed from the whitened values.

Further columns may be fitted together with the curve, for example for the difference between rising and falling temperature
(`branches`). Ramps differ from one another by more than noise, because each ramp has an offset and a slope of random size. The
variances of these offsets and slopes are part of all uncertainties. These variances are estimated from the decrease of the sum of
squares in a fit in which every ramp has its own offset and slope (Henderson's method 3: Searle, Casella and McCulloch, Variance
Components, 5.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property, partial

import numpy as np

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass
from planrunner.estimators import least_squares
from planrunner.estimators.interface import EstimationError

FORMS = ("polynomial", "spline")
FEWEST = 3  # fewest temperatures from which an order can be chosen
RULES = ("one_standard_error", "smallest_error")
_FREE = 1e-6  # of the size of columns: smaller values are rounding errors
_RESIDUALS = 2  # fewest degrees of freedom that remain after all coefficients and ramps
_EXACT, _TINY = (
    1e-24,
    1e-300,
)  # of the mean square of the values: a variance of noise below this is rounding; and above zero


@dataclass(frozen=True)
class Curve:
    """Describes the form of a curve, without its coefficients.

    `form`: one of `FORMS`. `order`: the order of a polynomial, or the number of knots of a spline minus one. Order 1 is a straight
    line in either form. `reference`: reference temperature T₀ of a polynomial, degC. `knots`: knots of a spline, degC, ascending.
    """

    form: str
    order: int
    reference: float
    knots: Array

    def columns(self, temperature: Array) -> Array:
        """Returns the design matrix at n temperatures [degC], shape (n, order + 1)."""
        if self.form == "polynomial":
            return np.asarray((temperature - self.reference)[:, None] ** np.arange(self.order + 1))
        return natural_spline(self.knots, temperature)


def curve(form: str, order: int, reference: float, temperatures: Array) -> Curve:
    """Chooses the form of a curve for data at `temperatures` [degC]. The knots of a spline are quantiles of the distinct
    temperatures, which include the lowest and the highest temperature. `reference`: reference temperature T₀ of a polynomial,
    degC."""
    knots = np.quantile(np.unique(temperatures), np.linspace(0, 1, order + 1)) if form == "spline" else np.zeros(0)
    return Curve(form, order, reference, knots)


def natural_spline(knots: Array, at: Array) -> Array:
    """Returns the matrix that computes a natural cubic spline from its values at k knots, shape (n, k). The spline is computed at
    the n points `at`. A spline with two knots is a straight line.

    Let h_i be the distances between neighbouring knots, and M_i the second derivatives at the knots, which are zero at both ends.
    Then h_i·M_i + 2·(h_i + h_{i+1})·M_{i+1} + h_{i+1}·M_{i+2} = 6·(difference of adjacent slopes).
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
    """States how well a curve of one order predicts held-out values. `error`: mean square error over the held-out folds, in the
    squared unit of the values. `standard_error`: standard error of this mean."""

    order: int
    error: float
    standard_error: float


def held_out(
    form: str,
    orders: Sequence[int],
    reference: float,
    temperature: Array,
    value: Array,
    sigma: Array,
    fold: Integers,
    beside: Array | None = None,
    whitening: Array | None = None,
) -> tuple[HeldOut, ...]:
    """Computes the held-out errors of the curves of each order.

    `sigma`: array of shape (n,), standard uncertainties for the weights. `fold`: array of shape (n,), index of the fold in which
    each value is held out. `beside`: array of shape (n, q), columns that are fitted together with each curve. `whitening`: array of
    shape (n, n), matrix that whitens correlated values; if it is not given, values are divided by `sigma`. `reference`: reference
    temperature T₀, degC. `temperature`, `value`: arrays of shape (n,), temperatures [degC] and values.
    """
    whitened = _white(value, sigma, whitening)
    further = np.zeros((len(value), 0)) if beside is None else beside
    weight = 1 / sigma**2
    found = []
    for order in orders:
        errors = []
        for one in np.unique(fold):
            out = fold == one
            made = curve(form, order, reference, temperature[~out])
            columns = _white(np.column_stack([made.columns(temperature), further]), sigma, whitening)
            fit = least_squares.fit(columns[~out], whitened[~out])
            missed = whitened[out] - columns[out] @ fit.coefficients
            errors.append(float(np.sum(missed**2) / np.sum(weight[out])))
        spread = float(np.std(errors, ddof=1) / np.sqrt(len(errors))) if len(errors) > 1 else 0.0
        found.append(HeldOut(order, float(np.mean(errors)), spread))
    return tuple(found)


def chosen(errors: Sequence[HeldOut], rule: str) -> HeldOut:
    """Returns the entry of `errors` for the order that is selected by a rule of `RULES`."""
    best = min(errors, key=lambda one: one.error)
    if rule == "smallest_error":
        return best
    return next(one for one in errors if one.error <= best.error + best.standard_error)


def fold_of(group: Integers, folds: int) -> Integers:
    """Returns the index of the fold in which each group of temperatures is held out. If `folds` is 0, each group is a separate
    fold. Otherwise there are `folds` folds, which are adjacent ranges of temperature. Neighbouring temperatures, which share a slow
    drift, are then held out together and do not predict each other."""
    return group if folds == 0 else group * folds // (int(group.max()) + 1)


def correlation_time(residuals: Sequence[Array]) -> float:
    """Returns the factor, at least one, by which the correlation of successive residuals increases the variance of fitted
    coefficients.

    The factor is 1 + 2·Σ r_k, where r_k is the autocorrelation of all series together at the lag k. The sum ends before the first
    lag at which r_k is not positive (Geyer, Statistical Science 7, 1992, 473).
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
    """Returns the index of the group to which each temperature belongs. Groups are numbered by ascending temperature; a group
    contains the temperatures within `width` [K] of its lowest temperature."""
    order = np.argsort(temperature, kind="stable")
    group, number, first = np.zeros(len(temperature), dtype=np.int64), -1, -np.inf
    for index in order:
        if temperature[index] > first + width:
            number, first = number + 1, temperature[index]
        group[index] = number
    return group


@dataclass(frozen=True, slots=True)
class RampScatter:
    """Describes one random difference between ramps, in their offset or in their slope.

    `size`: standard deviation of the offset or slope, in the value's unit; zero if noise explains it. `degrees_of_freedom`: degrees
    of freedom of `size`. `ratio`: the statistic F, which is the mean square due to the ramps divided by the mean square due to
    noise. `probability`: probability that noise alone gives a ratio at least this large.
    """

    size: float
    degrees_of_freedom: int
    ratio: float
    probability: float


@dataclass(frozen=True, slots=True)
class SummedCovariance:
    """Contains the covariance of m coefficients as a sum of independent mean squares. The mean squares come from noise and from the
    scatter of ramps; each mean square has its own degrees of freedom. `parts`: pairs of a matrix (m, m) and its degrees of freedom,
    one pair for each mean square; the first matrix may have negative eigenvalues."""

    parts: tuple[tuple[Array, float], ...]

    @property
    def covariance(self) -> Array:
        return np.asarray(sum(own for own, _ in self.parts))

    def of(self, rows: Array) -> tuple[Array, Array]:
        """Returns two arrays of shape (k,) for k linear functions of the coefficients: the standard uncertainties, and the
        effective degrees of freedom (Welch and Satterthwaite). `rows`: array of shape (k, m), the linear functions."""
        shares = np.array([np.einsum("ki,ij,kj->k", rows, own, rows) for own, _ in self.parts])
        freedom = np.array([own for _, own in self.parts])
        variance = np.maximum(shares.sum(axis=0), 0.0)
        squares = (shares**2 / freedom[:, None]).sum(axis=0)
        known = (squares > 0) & (variance > 0)
        return np.sqrt(variance), np.where(known, variance**2 / np.where(known, squares, 1.0), freedom[0])

    def through(self, rows: Array, away: Array | None = None) -> SummedCovariance:
        """Computes the covariance of k linear functions of the coefficients, again as a sum of mean squares. `rows`: array of shape
        (k, m), the linear functions. `away`: array of shape (k,), uncorrected errors of these functions."""
        (noise, freedom), *others = [(rows @ own @ rows.T, own_freedom) for own, own_freedom in self.parts]
        return SummedCovariance(((noise if away is None else noise + np.outer(away, away), freedom), *others))


@dataclass(frozen=True, slots=True)
class CurveFit:
    """A fitted curve with its uncertainty.

    `spread`: covariance of the coefficients (p,) as a sum of mean squares. `correlation`: factor by which the variance of the noise
    was multiplied, because successive residuals are correlated. `beside`: coefficients (q,) of the columns that are fitted together
    with the curve. `beside_spread`: covariance of these coefficients. `ramps`: how the offsets and slopes of ramps scatter; empty
    if there are too few ramps to determine this. `fullest`: the curve of the highest order that was tried, if the order was
    selected and is lower; otherwise None. `gains`: array of shape (p, n), derivatives of the coefficients with respect to the n
    values.
    """

    curve: Curve
    coefficients: Array
    spread: SummedCovariance
    errors: tuple[HeldOut, ...] = ()
    correlation: float = 1.0
    beside: Array = field(default_factory=partial(np.zeros, 0))
    beside_spread: SummedCovariance | None = None
    ramps: tuple[RampScatter, ...] = ()
    fullest: CurveFit | None = None
    gains: Array = field(default_factory=partial(np.zeros, (0, 0)))

    @property
    def covariance(self) -> Array:
        """Returns the covariance of the coefficients, shape (p, p)."""
        return self.spread.covariance

    def uncertainties(self) -> tuple[Array, Array]:
        """Returns two arrays of shape (p,): the standard uncertainties of the coefficients, and their degrees of freedom."""
        return self.spread.of(np.eye(len(self.coefficients)))

    def predict(self, temperature: Array) -> tuple[Array, Array, Array]:
        """Computes the curve at n temperatures [degC]. Returns three arrays of shape (n,): the values, their standard uncertainties
        and their degrees of freedom."""
        columns = self.curve.columns(temperature)
        value = columns @ self.coefficients
        if self.fullest is None:
            return value, *self.spread.of(columns)
        full, u, freedom = self.fullest.predict(temperature)
        return value, np.hypot(u, value - full), freedom

    def warmer(self, by: float) -> Array:
        """Returns the coefficients of a curve that is shifted by `by` [K], shape (p,). At T, the shifted curve has the value that
        this curve has at T + `by`. These coefficients describe a run in which the true temperatures are higher by this amount."""
        if self.curve.form == "spline":
            return np.asarray(self.curve.columns(self.curve.knots + by) @ self.coefficients)
        moved = np.polynomial.Polynomial(self.coefficients)(np.polynomial.Polynomial([by, 1.0])).coef
        return np.pad(moved, (0, len(self.coefficients) - len(moved)))


@dataclass(frozen=True)
class OverTemperature:
    """Contains the n values at different temperatures to which a curve is fitted.

    `temperature`: array of shape (n,) in degC. `sigma`: array of shape (n,), standard uncertainties for the weights. `group`: array
    of shape (n,), number of the temperature at which each value was measured; values at the same temperature have equal numbers.
    `series`: array of shape (n,), index of the ramp on which the value was measured, if this ramp gives a series of values; −1 for
    a single value. `ramp`: array of shape (n,), index of the ramp or sweep whose values have a common offset; −1 if there is none.
    `direction`: array of shape (n,), +1 on a rising ramp, −1 on a falling ramp. `beside`: array of shape (n, q), columns that are
    fitted together with the curve. `covariance`: array of shape (n, n), covariance of the values if they are correlated. In this
    case, `sigma` describes only the uncorrelated part.
    """

    temperature: Array
    value: Array
    sigma: Array
    group: Integers
    series: Integers
    ramp: Integers
    direction: Integers
    beside: Array
    covariance: Array | None = None

    @cached_property
    def whitening(self) -> Array | None:
        """Returns the matrix W that makes correlated values uncorrelated with variance one, shape (n, n); None if the values are
        not correlated."""
        return None if self.covariance is None else least_squares.whitener(self.covariance)

    def white(self, columns: Array, transposed: bool = False) -> Array:
        """Multiplies the columns (n, …) by `whitening`, or divides them by `sigma` if the values are not correlated. `transposed`:
        True to multiply by the transpose of `whitening`."""
        whitening = self.whitening
        return _white(columns, self.sigma, whitening.T if transposed and whitening is not None else whitening)


def _white(columns: Array, sigma: Array, whitening: Array | None) -> Array:
    """Returns the columns (n, …) multiplied by `whitening` (n, n), or divided by `sigma` (n,) if `whitening` is None."""
    if whitening is not None:
        return np.asarray(whitening @ columns)
    return np.asarray(columns / (sigma if columns.ndim == 1 else sigma[:, None]))


def fit_curve(
    form: str,
    order: int | None,
    highest: int,
    reference: float,
    values: OverTemperature,
    folds: int,
    rule: str,
    scatter: bool,
) -> CurveFit:
    """Fits a curve of a given order. If `order` is None, it first selects, by the held-out errors, an order of at most `highest`.

    `scatter`: True if the covariance is computed from the scatter of the residuals, False if it is computed from sigma. Raises
    `EstimationError` if there are too few temperatures or values. `reference`: reference temperature T₀, degC. `folds`: number of
    folds; 0 if each temperature is a separate fold.
    """
    temperature, group = values.temperature, values.group
    distinct = int(group.max()) + 1

    def fitted(one: int) -> CurveFit:
        if distinct < one + 1:
            raise EstimationError(
                f"{distinct} temperatures cannot determine a {form} of order {one}: lower `order` or add temperatures"
            )
        return _fitted(curve(form, one, reference, temperature), values, scatter)

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
    errors = held_out(
        form, orders, reference, temperature, values.value, values.sigma, fold, values.beside, values.whitening
    )
    simple = replace(fitted(chosen(errors, rule).order), errors=errors)
    return simple if simple.curve.order == most else _as_chosen(simple, fitted(most))


def _fitted(made: Curve, values: OverTemperature, scatter: bool) -> CurveFit:
    """Fits a curve of a given form to all values. Raises `EstimationError` if the uncertainty must come from residuals, but there
    are none. `scatter`: the same as in `fit_curve`."""
    columns = np.column_stack([made.columns(values.temperature), values.beside])
    fit = least_squares.fit(columns, values.value, values.sigma, covariance=values.covariance)
    gains = values.white((fit.cofactor @ values.white(columns).T).T, transposed=True).T
    p = made.order + 1
    if not scatter:
        return _parted(CurveFit(made, fit.coefficients, SummedCovariance(((fit.cofactor, np.inf),)), gains=gains), p)
    if not fit.degrees_of_freedom:
        raise EstimationError(
            f"{len(values.value)} values for {columns.shape[1]} coefficients leave no residuals from which an uncertainty could be "
            "estimated: lower `order`, add temperatures or write `uncertainty: propagated`"
        )
    ways = _ways(columns, values)
    if ways:
        return _parted(_with_ramps(made, columns, values, ways), p)
    time = _correlation(values.white(fit.residuals), values.series)
    freedom = max(1.0, len(values.value) / time - columns.shape[1]) if time > 1 else float(fit.degrees_of_freedom)
    covariance = fit.cofactor * (fit.chi_squared / fit.degrees_of_freedom * time)
    spread = SummedCovariance(((covariance, freedom),))
    return _parted(CurveFit(made, fit.coefficients, spread, correlation=time, gains=gains), p)


def _correlation(weighted: Array, series: Integers) -> float:
    """Returns the factor `correlation_time` for the weighted residuals (n,) within each series."""
    return correlation_time([weighted[series == one] for one in np.unique(series[series >= 0])])


def _parted(whole: CurveFit, p: int) -> CurveFit:
    """Separates the p coefficients of the curve from the coefficients of the columns that were fitted together with it."""
    if len(whole.coefficients) == p:
        return whole
    pick = np.eye(len(whole.coefficients))
    return replace(
        whole,
        coefficients=whole.coefficients[:p],
        spread=whole.spread.through(pick[:p]),
        beside=whole.coefficients[p:],
        beside_spread=whole.spread.through(pick[p:]),
        gains=whole.gains[:p],
    )


@dataclass(frozen=True)
class _Way:
    """One possible difference between ramps: in their offset or in their slope. `columns`: array of shape (n, r), weighted columns,
    one for each of r ramps. `by_direction`: array of shape (n, d), for each of d directions, the sum of the columns of its ramps."""

    columns: Array
    by_direction: Array


def _ways(columns: Array, values: OverTemperature) -> list[_Way]:
    """Returns the possible differences between ramps of one direction: in their offset and, if values follow each other along
    ramps, in their slope. A difference is used only if the values determine both the difference and the fitted columns, and if at
    least two residuals remain."""
    numbers, first = np.unique(values.ramp[values.ramp >= 0], return_index=True)
    senses = values.direction[values.ramp >= 0][first]
    each = (values.ramp[:, None] == numbers).astype(float)
    away = values.temperature - values.temperature.mean()
    own = values.white(each)
    slopes = values.white(each * (away / max(float(np.std(away)), _TINY))[:, None])
    alike = (senses[:, None] == np.unique(senses)).astype(float)  # ramps to directions
    fitted = values.white(columns)
    found: list[_Way] = []
    for way in (own, slopes) if (values.series >= 0).any() else (own,):
        together = [fitted, way @ alike, *(one.columns for one in found)]
        k = _free(np.column_stack(together), way).shape[1]
        taken = columns.shape[1] + k + alike.shape[1] + sum(one.columns.shape[1] for one in found)
        if k and len(values.value) - taken >= _RESIDUALS:
            found.append(_Way(way, way @ alike))
    return found


def _free(fitted: Array, further: Array) -> Array:
    """Removes from the columns `further` (n, r) their parts in the space of the columns `fitted` (n, m). Returns orthonormal
    columns (n, k) that span the rest."""
    if not further.size:
        return np.zeros((len(fitted), 0))
    base = _space(fitted)
    free, size, _ = np.linalg.svd(further - base @ (base.T @ further), full_matrices=False)
    return np.asarray(free[:, size > _FREE * np.linalg.norm(further)])


def _space(columns: Array) -> Array:
    """Returns an orthonormal basis of the space of the columns (n, m), which may be linearly dependent."""
    size = np.linalg.norm(columns, axis=0)
    base, found, _ = np.linalg.svd(columns / np.where(size > 0, size, 1.0), full_matrices=False)
    return np.asarray(base[:, found > _FREE * found[0]])


def _with_ramps(made: Curve, columns: Array, values: OverTemperature, ways: Sequence[_Way]) -> CurveFit:
    """Fits a curve together with random differences between ramps. `ways`: the kinds of differences that `_ways` returns.

    Let y be the weighted values, A the columns of the curve, and Z the columns of one difference. The projector M removes A, the
    sum of the columns of Z over the rising ramps, their sum over the falling ramps, and the columns of the other differences. The
    number k is the rank of M·Z. The reduction of the sum of squares by Z has k degrees of freedom and the expectation k·φ +
    τ²·tr(ZᵀMZ). Here, φ is the variance of the noise, and τ is the standard deviation of the difference. The weighted values then
    have the covariance V = φ·I + Σ τ²·Z·Zᵀ.
    """
    from scipy.special import fdtrc

    y, A = values.white(values.value), values.white(columns)
    everything = _space(np.column_stack([A, *(one.columns for one in ways)]))
    rest = y - everything @ (everything.T @ y)
    left = len(y) - everything.shape[1]
    time = _correlation(rest, values.series)
    freedom = max(1.0, len(y) / time - everything.shape[1]) if time > 1 else float(left)
    phi = max(float(rest @ rest) / left * time, _EXACT * float(y @ y) / len(y), _TINY)
    squares, traces, counts = [], [], []
    for own in ways:
        others = [one.columns for one in ways if one is not own]
        free = _free(np.column_stack([A, own.by_direction, *others]), own.columns)
        counts.append(max(1, free.shape[1]))
        squares.append(float(np.sum((free.T @ y) ** 2)) / counts[-1])
        traces.append(max(float(np.sum((free.T @ own.columns) ** 2)), _TINY))
    tau2 = [max(0.0, (s - phi) * k / tr) for s, k, tr in zip(squares, counts, traces, strict=True)]
    roots = np.column_stack([np.sqrt(one) * way.columns for one, way in zip(tau2, ways, strict=True)])
    scale = np.sqrt(np.mean(A**2, axis=0))
    scaled = A / np.where(scale > 0, scale, 1.0)
    inner = phi * np.eye(roots.shape[1]) + roots.T @ roots
    weighted = scaled - roots @ np.linalg.solve(inner, roots.T @ scaled)  # φ·V⁻¹·A, by Woodbury's formula
    gain = np.linalg.solve(weighted.T @ scaled, weighted.T) / np.where(scale > 0, scale, 1.0)[:, None]
    noise = phi * gain @ gain.T
    parts, seen = [], []
    for s, k, tr, variance, way in zip(squares, counts, traces, tau2, ways, strict=True):
        if variance:
            through = gain @ way.columns
            common = through @ through.T * (k / tr)
            noise = noise - phi * common
            parts.append((s * common, float(k)))
        seen.append(RampScatter(float(np.sqrt(variance)), k, s / phi, float(fdtrc(k, freedom, s / phi))))
    gains = values.white(gain.T, transposed=True).T
    spread = SummedCovariance(((noise, freedom), *parts))
    return CurveFit(made, gain @ y, spread, correlation=time, ramps=tuple(seen), gains=gains)


def _as_chosen(simple: CurveFit, full: CurveFit) -> CurveFit:
    """Returns the selected curve, whose order is below the highest order tried, with its uncertainty. This uncertainty combines the
    uncertainty of the curve of the highest order with the difference between the two curves."""
    if simple.curve.form == "polynomial":
        reads = np.eye(simple.curve.order + 1, full.curve.order + 1)
    else:
        reads = full.curve.columns(simple.curve.knots)
    away = simple.coefficients - reads @ full.coefficients
    return replace(
        simple,
        spread=full.spread.through(reads, away),
        correlation=full.correlation,
        beside=full.beside,
        beside_spread=full.beside_spread,
        ramps=full.ramps,
        fullest=full,
    )
