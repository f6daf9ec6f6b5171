"""Computes gauge repeatability and reproducibility: the contributions of device, operator, bench and repetition to the variance of
a measurement.

The model is a balanced, fully crossed random-effects model with all interactions, for one to three factors. Each mean square has
the expectation

    E(MS_S) = σ² + r·Σ_{T ⊇ S} σ_T²·∏_{f ∉ T} a_f

with r repetitions and a_f levels of factor f. The variance components follow from these expectations. A negative component is
replaced by zero, also in sums of components. Reproducibility is the variance that is attributed neither to the device nor to
repeatability. Confidence intervals come from the modified large-sample method. The formulas come from Graybill and Wang (Journal of
the American Statistical Association 75, 1980) for sums of mean squares, and from Ting et al. (Journal of Statistical Computation
and Simulation 35, 1990) for differences. They are applied as in Burdick, Borror and Montgomery (Design and Analysis of Gauge R&R
Studies, 2005).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from scipy.stats import chi2, f

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject

CONFIDENCE = 0.95
ITEM = "device"
"""The factor that distinguishes the measured items."""


class UnbalancedError(ValueError):
    """Reports that values do not fill all cells of the design. The message states which values are missing."""


@dataclass(frozen=True, slots=True)
class MeanSquare:
    """Contains one mean square of the analysis of variance.

    `factors`: the factors whose effect or interaction the mean square measures; empty for the mean square of the repetitions. `df`:
    degrees of freedom of the mean square."""

    factors: tuple[str, ...]
    sum_of_squares: float
    df: int

    @property
    def value(self) -> float:
        return self.sum_of_squares / self.df


@dataclass(frozen=True, slots=True)
class VarianceComponent:
    """One component of variance. `variance`: the variance, in the squared unit of the values; never negative. `lower`, `upper`:
    limits of the 95 % confidence interval of the variance."""

    name: str
    variance: float
    lower: float
    upper: float

    @property
    def standard_deviation(self) -> float:
        return math.sqrt(self.variance)


GAUGE_FORMAT = 1


@dataclass(frozen=True, slots=True)
class GaugeStudy:
    """Result of a gauge study.

    `components`: repeatability, every factor and interaction, reproducibility, gauge (repeatability and reproducibility together),
    and total. `levels`: maps each factor to its number of levels. `repetitions`: number of values used in each cell. `unused`:
    number of values that are not used, because other cells have fewer values.
    """

    anova: tuple[MeanSquare, ...]
    components: tuple[VarianceComponent, ...]
    levels: Mapping[str, int]
    repetitions: int
    unused: int

    def to_json(self, quantity: str, unit: str) -> JsonObject:
        """Returns JSON data according to schemas/gauge.schema.json."""
        return {
            "planrunner_gauge": GAUGE_FORMAT,
            "quantity": quantity,
            "unit": unit,
            "levels": dict(self.levels),
            "repetitions": self.repetitions,
            "unused": self.unused,
            "anova": [
                {"factors": list(one.factors), "sum_of_squares": one.sum_of_squares, "degrees_of_freedom": one.df}
                for one in self.anova
            ],
            "components": [
                {"name": one.name, "variance": one.variance, "lower": one.lower, "upper": one.upper}
                for one in self.components
            ],
        }


def gauge_study(factors: Mapping[str, Sequence[str]], values: Sequence[float], *, pooled: bool = False) -> GaugeStudy:
    """Makes the gauge study of n values.

    `factors`: maps each factor to the labels of the n values; a factor with only one level is left out. The factor `ITEM`
    distinguishes the measured items. If a cell has more values than others, only its first values are used. `pooled`: True if
    interactions are counted as repeatability. This setting is usual if the interactions are not significant. Raises
    `UnbalancedError` if a cell has no value.
    """
    used = {name: list(labels) for name, labels in factors.items() if len(set(labels)) > 1}
    levels = {name: sorted(set(labels)) for name, labels in used.items()}
    cells: dict[tuple[int, ...], list[float]] = {}
    for k, value in enumerate(values):
        key = tuple(levels[name].index(labels[k]) for name, labels in used.items())
        cells.setdefault(key, []).append(value)
    shape = tuple(len(found) for found in levels.values())
    for key in np.ndindex(*shape):
        if key not in cells:
            place = ", ".join(f"{name} {levels[name][k]}" for name, k in zip(levels, key, strict=True))
            raise UnbalancedError(f"there is no value of {place}")
    r = min(map(len, cells.values()))
    if r < 2:
        raise UnbalancedError(
            "a combination has only one value, but repeatability needs at least two values of each combination"
        )
    data = np.empty((*shape, r))
    for key, found in cells.items():
        data[key] = found[:r]
    unused = len(values) - data.size
    anova = _anova(data, tuple(levels))
    if pooled:
        anova = _pooled(anova)
    return GaugeStudy(
        tuple(anova),
        tuple(_components(anova, dict(zip(levels, shape, strict=True)), r)),
        dict(zip(levels, shape, strict=True)),
        r,
        unused,
    )


def _anova(data: Array, names: tuple[str, ...]) -> list[MeanSquare]:
    """Returns the mean squares of all effects, for a complete table of values, shape (a₁, …, a_m, r)."""
    m = len(names)
    effects: dict[tuple[int, ...], Array] = {}
    found = []
    for size in range(m + 1):
        for axes in combinations(range(m), size):
            others = tuple(axis for axis in range(data.ndim) if axis not in axes)
            mean = data.mean(axis=others, keepdims=True)
            effect = mean - sum((effects[part] for n in range(size) for part in combinations(axes, n)), np.zeros(()))
            effects[axes] = effect
            if axes:
                share = data.size / effect.size
                df = math.prod(data.shape[axis] - 1 for axis in axes)
                found.append(MeanSquare(tuple(names[axis] for axis in axes), float(share * (effect**2).sum()), df))
    rest = data - data.mean(axis=-1, keepdims=True)
    return [*found, MeanSquare((), float((rest**2).sum()), data.size - data.size // data.shape[-1])]


def _pooled(anova: Sequence[MeanSquare]) -> list[MeanSquare]:
    inner = [one for one in anova if len(one.factors) != 1]
    error = MeanSquare((), sum(one.sum_of_squares for one in inner), sum(one.df for one in inner))
    return [*(one for one in anova if len(one.factors) == 1), error]


def _components(anova: Sequence[MeanSquare], levels: Mapping[str, int], r: int) -> list[VarianceComponent]:
    """Returns the components of variance. Each component is a linear combination of mean squares; the equations are solved from the
    highest interaction downwards."""
    squares = {one.factors: one for one in anova}
    combos: dict[tuple[str, ...], dict[tuple[str, ...], float]] = {(): {(): 1.0}}
    for factors in sorted((one for one in squares if one), key=len, reverse=True):
        terms = {factors: 1.0, (): -1.0}
        for wider in combos:
            if wider and set(factors) < set(wider):
                for key, c in combos[wider].items():
                    terms[key] = terms.get(key, 0.0) - r * _cells(wider, levels) * c
        size = r * _cells(factors, levels)
        combos[factors] = {key: c / size for key, c in terms.items()}
    found = [_estimated("repeatability", combos[()], squares)]
    found += [_estimated(" × ".join(one.factors), combos[one.factors], squares) for one in anova if one.factors]
    own = {(): found[0].variance, **{one.factors: part.variance for one, part in zip(anova, found[1:], strict=False)}}
    gauge = [key for key in combos if key and key != (ITEM,)]
    for name, parts in (("reproducibility", gauge), ("gauge R&R", [(), *gauge]), ("total", list(combos))):
        if parts:
            made = _estimated(name, _sum([combos[part] for part in parts]), squares)
            variance = sum(own[part] for part in parts)
            found.append(VarianceComponent(name, variance, min(made.lower, variance), max(made.upper, variance)))
    return found


def _cells(factors: tuple[str, ...], levels: Mapping[str, int]) -> int:
    return math.prod(count for name, count in levels.items() if name not in factors)


def _sum(combos: Sequence[Mapping[tuple[str, ...], float]]) -> dict[tuple[str, ...], float]:
    found: dict[tuple[str, ...], float] = {}
    for one in combos:
        for key, c in one.items():
            found[key] = found.get(key, 0.0) + c
    return found


def _estimated(
    name: str, combo: Mapping[tuple[str, ...], float], squares: Mapping[tuple[str, ...], MeanSquare]
) -> VarianceComponent:
    terms = [(c, squares[key].value, squares[key].df) for key, c in combo.items() if abs(c) > 1e-12]
    estimate = sum(c * ms for c, ms, _ in terms)
    lower, upper = _interval(terms, estimate)
    return VarianceComponent(name, max(0.0, estimate), max(0.0, lower), max(0.0, upper))


def _interval(terms: Sequence[tuple[float, float, int]], estimate: float) -> tuple[float, float]:
    """Returns the two-sided confidence limits of Σ c·E(MS) by the modified large-sample method. `terms`: for each term of the sum,
    the coefficient c, the mean square MS and the degrees of freedom of MS."""
    a = (1 - CONFIDENCE) / 2
    plus, minus = [t for t in terms if t[0] > 0], [t for t in terms if t[0] < 0]
    below = sum((_g(a, n) * c * ms) ** 2 for c, ms, n in plus) + sum((_h(a, n) * c * ms) ** 2 for c, ms, n in minus)
    above = sum((_h(a, n) * c * ms) ** 2 for c, ms, n in plus) + sum((_g(a, n) * c * ms) ** 2 for c, ms, n in minus)
    for c, ms, n in plus:
        for d, other, k in minus:
            product = c * abs(d) * ms * other
            high, low = float(f.isf(a, n, k)), float(f.ppf(a, n, k))
            below += ((high - 1) ** 2 - (_g(a, n) * high) ** 2 - _h(a, k) ** 2) / high * product
            above += ((1 - low) ** 2 - (_h(a, n) * low) ** 2 - _g(a, k) ** 2) / low * product
    return estimate - math.sqrt(max(0.0, below)), estimate + math.sqrt(max(0.0, above))


def _g(a: float, n: int) -> float:
    """Returns the coefficient 1 − 1/F(1 − a; n, ∞)."""
    return 1 - n / float(chi2.isf(a, n))


def _h(a: float, n: int) -> float:
    """Returns the coefficient 1/F(a; n, ∞) − 1."""
    return n / float(chi2.ppf(a, n)) - 1
