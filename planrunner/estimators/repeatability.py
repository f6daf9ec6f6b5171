"""Determines repeatability: how much coefficients or means scatter from run to run, and between days or switch-ons. Each standard
deviation is given with its degrees of freedom.

    one level     s(K_q)/mean(K_q) over q repeats (IEEE Std 952 and 1431: repeatability)
    two levels    one-way analysis of variance of groups (ISO 5725-2, JCGM 100:2008, H.5): within groups, between groups, and both together,
                  the intermediate precision

The intervals of standard deviations are χ² intervals. The interval for the sum of the variances within and between groups is from
Graybill and Wang (J. Am. Stat. Assoc. 75, 1980, 869), because the χ² interval with Satterthwaite's degrees of freedom contains the
true value in only 91 % instead of 95 % of tests that last five days.

There are five warnings. The first is about repeats that scatter more than their own standard uncertainties allow (χ² test). The
second is about repeats that form different groups although the plan names no groups; the groups are formed by labels, by pauses or
by thirds of the sequence (`groupings`, F test). The third is about repeats whose sequence is not random, as with a drift (von
Neumann, Ann. Math. Stat. 12, 1941, 367). The fourth is about groups whose scatter differs (Bartlett's test). The fifth is about
correlated coefficients of one estimate.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.base.said import Said, said
from planrunner.estimators.interface import (
    Coefficient,
    CoefficientRole,
    Design,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    UnfitDataError,
)
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.root_of_square import root_of
from planrunner.estimators.tables import Cell, Plot, Role, Table, TableColumn, by_columns, known
from planrunner.observation.observations import SIGNIFICANCE, recorded_times, variances_differ
from planrunner.plan.kinds import CHANNEL, ListOf, MapOf, Record, Text, key
from planrunner.plan.selection import matches

PROBABILITY = 0.95
_ORDERED = 8  # fewest repeats whose order is tested
_NAMED = 4  # most groups named in a sentence
_TO_COMPARE = 3  # fewest repeats of a group whose scatter is compared with other groups
_PAUSE = 3.0  # a pause this many times as long as the median pause separates groups
_LEAST = 4  # fewest repeats in each third
_CORRELATED = 0.1  # with n equally correlated repeats, their standard deviation is then about 5 % too small


class RepeatabilityParameters(Record):
    """Declares the plan keys of the estimator `repeatability`."""

    coefficients: tuple[str, ...] = key(
        ListOf(Text("", "a coefficient's name or a pattern"), minimum=1, single=True),
        "Names of coefficients of the estimates in `uses`, or patterns with the wildcards * and ?; "
        "by default all coefficients that they have in common.",
        "K_gyro_*",
        default_factory=tuple,
    )
    channels: tuple[str, ...] = key(
        ListOf(CHANNEL, minimum=1, single=True),
        "Channels whose segment means are compared; use this in place of `coefficients` of other estimates.",
        ["gyro_x"],
        default_factory=tuple,
    )
    quantities: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text("", "a name of the form estimate.coefficient"), minimum=2)),
        "Coefficients that have different names but determine the same quantity, such as the position of a triad from each of "
        "its accelerometers. Each key is a name for the quantity; its list names the coefficients, each with its estimate in "
        "`uses`. Use this in place of `coefficients`.",
        {"position_x": ["unit_x.lever_arm_r_x_accel_x", "unit_y.lever_arm_r_x_accel_y"]},
        default_factory=dict,
    )
    groups: dict[str, tuple[str, ...]] = key(
        MapOf(ListOf(Text("", "a name or a pattern"), minimum=1, single=True)),
        "Groups, such as a day or a switch-on: labels of segments, or names of estimates in `uses`, "
        "or patterns with the wildcards * and ?.",
        {"monday": "monday*", "tuesday": ["tuesday*"]},
        default_factory=dict,
    )


@dataclass(frozen=True, slots=True)
class Repeats:
    """The n repeated values of one quantity.

    `group`: array of shape (n,), index of the group of each value. `own`: array of shape (n,), standard uncertainty of each value,
    NaN if it is not known. `expected`: for expected values, the variance that noise alone would cause; NaN for measured values.
    `pauses`: array of shape (n − 1,), time between successive repeats, s; None if this is not known. `correlation`: correlation
    coefficient of the two most correlated values that come from the same estimate; zero if there are none.
    """

    name: str
    unit: str
    labels: tuple[str, ...]
    value: Array
    own: Array
    group: NDArray[np.int64]
    period: float = math.inf
    expected: float = math.nan
    pauses: Array | None = None
    correlation: float = 0.0

    def on_circle(self, value: float) -> float:
        """Converts the value of a circular quantity to the equivalent value in the range from 0 to `period`. Returns the value of
        any other quantity unchanged."""
        if math.isinf(self.period):
            return value
        return 0.0 if abs(math.remainder(value, self.period)) < 1e-9 * self.period else value % self.period


@dataclass(frozen=True, slots=True)
class Variance:
    """Contains the result of a one-way analysis of variance. n values are divided into k groups.

    `mean`: mean of the group means. `within`: variance within groups. `between`: component of variance between groups, which can be
    negative. `total`: sum of `within` and `between`. Other fields give the standard uncertainty or the degrees of freedom of these
    values, such as `mean_uncertainty` or `within_freedom`. `terms`: array of shape (2,), the contributions to `total` of the mean
    square between groups and of the mean square within groups. `ratio`: the statistic F, which is the mean square between groups
    divided by the mean square within groups.
    """

    mean: float
    mean_uncertainty: float
    mean_freedom: float
    within: float
    within_freedom: float
    between: float = math.nan
    between_uncertainty: float = math.nan
    total: float = math.nan
    total_freedom: float = math.nan
    terms: tuple[float, float] = (math.nan, math.nan)
    ratio: float = math.nan

    @property
    def total_interval(self) -> tuple[float, float]:
        """Returns the confidence interval of the total variance, with the confidence level `PROBABILITY`."""
        return _interval_of_sum(self.terms, (self.mean_freedom, self.within_freedom))

    @property
    def probability(self) -> float:
        """Returns the probability of an F at least as large as `ratio` if the groups do not differ."""
        from scipy.special import fdtrc

        return float(fdtrc(self.mean_freedom, self.within_freedom, self.ratio))


@dataclass(frozen=True, slots=True, kw_only=True)
class ScatterQuantities(Quantities):
    """Contains the analysis of variance of each quantity, and the reported coefficients."""

    splits: tuple[tuple[Repeats, Variance], ...]


class Repeatability(Method[RepeatabilityParameters, ScatterQuantities]):
    """Implements the estimator `repeatability`."""

    name = "repeatability"
    summary = "Scatter of coefficients or means between repeats, and between days or switch-ons"
    Parameters = RepeatabilityParameters

    def design(self, request: DesignRequest[RepeatabilityParameters]) -> Design:
        """Checks that the plan repeats something. Raises `EstimationError` if there is nothing to compare or the groups do not fit."""
        parameters = request.parameters
        names = _items(parameters, [segment.label for segment in request.segments], list(request.uses))
        _grouped(names, parameters.groups, bool(parameters.channels))
        return Design(())

    def quantities(self, request: EstimateRequest[RepeatabilityParameters]) -> ScatterQuantities:
        """Computes the scatter of every quantity. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        names = _items(parameters, [recorded.label for recorded in request.segments], list(request.uses))
        group = _grouped(names, parameters.groups, bool(parameters.channels))
        if parameters.quantities:
            found = _quantities(request)
        else:
            found = _channels(request, group) if parameters.channels else _coefficients(request, group)
        splits = tuple((one, analysis_of_variance(one.value, one.group, one.expected)) for one in found)
        coefficients = tuple(item for pair in splits for item in _reported(*pair))
        spread = np.array([item.standard_uncertainty for item in coefficients])
        return ScatterQuantities(coefficients=coefficients, covariance=np.diag(spread**2), splits=splits)

    def words(self, request: EstimateRequest[RepeatabilityParameters], found: ScatterQuantities) -> Words:
        """Makes the tables of the repeated values and of their variances."""
        groups: Mapping[str, Sequence[str]] = request.parameters.groups
        tables = [(_values(one, list(groups)), _variances(one, split)) for one, split in found.splits]
        notes = [note for pair in found.splits for note in _notes(*pair)]
        return Words(
            headline=tuple(item.name for item in found.coefficients if item.role is CoefficientRole.SCALE),
            settings={"groups": {name: list(patterns) for name, patterns in groups.items()}},
            tables=tuple(table for pair in tables for table in pair),
            plots=tuple(_plot(one) for one, _ in found.splits),
            notes=tuple(dict.fromkeys(notes)),
            warnings=tuple(warning for pair in found.splits for warning in _warnings(*pair)),
            segments=tuple(recorded.label for recorded in request.segments),
        )


def _items(parameters: RepeatabilityParameters, labels: Sequence[str], uses: Sequence[str]) -> list[str]:
    """Returns the repeated items: segments if the plan names channels, otherwise estimates. Raises `EstimationError` if the plan
    names both channels and estimates or neither, or if there are fewer than two items."""
    if parameters.channels and uses:
        raise EstimationError("both `channels` and `uses` are given: compare either segment means or other estimates")
    if not parameters.channels and not uses:
        raise EstimationError("nothing to compare: name `channels`, or several estimates in `uses`")
    if parameters.coefficients and parameters.channels:
        raise EstimationError(
            "`coefficients` selects from other estimates: name these in `uses`, or leave `coefficients` out"
        )
    if parameters.quantities and (parameters.coefficients or parameters.channels or parameters.groups):
        raise EstimationError(
            "`quantities` names all coefficients itself: leave `coefficients`, `channels` and `groups` out"
        )
    for name, texts in parameters.quantities.items():
        if len(set(texts)) < len(texts):
            twice = next(text for text in texts if texts.count(text) > 1)
            raise EstimationError(f"the quantity '{name}' contains '{twice}' twice: list each coefficient once")
    items = list(labels) if parameters.channels else list(uses)
    if parameters.quantities:
        return items
    if len(items) < 2:
        what = "segment" if parameters.channels else "estimate"
        raise EstimationError(f"one {what} is not enough for repeatability: choose two or more")
    return items


def _grouped(names: Sequence[str], groups: Mapping[str, Sequence[str]], labels: bool) -> NDArray[np.int64]:
    """Returns the index of the group to which each name belongs, shape (n,). `labels`: True if the names are labels of segments.
    Raises `EstimationError` for a name that belongs to no group or to two groups, and for an empty group."""
    number = np.zeros(len(names), dtype=np.int64)
    if not groups:
        return number
    fits = matches if labels else fnmatchcase
    held = [
        {k for k, patterns in enumerate(groups.values()) if any(fits(name, one) for one in patterns)} for name in names
    ]
    for name, own in zip(names, held, strict=True):
        if len(own) != 1:
            listed = " and ".join(list(groups)[k] for k in sorted(own))
            why = f"belongs to {listed}" if own else "belongs to no group"
            raise EstimationError(
                f"'{name}' {why}: correct the patterns in `groups` so that each is in exactly one group"
            )
    number[:] = [own.pop() for own in held]
    empty = [name for k, name in enumerate(groups) if k not in number]
    if empty:
        raise EstimationError(f"the group '{empty[0]}' is empty: correct its patterns")
    if len(groups) < 2 or len(names) == len(groups):
        raise EstimationError(
            "give at least two groups, one of them with at least two members, to separate the scatter within "
            "groups from the scatter between groups"
        )
    return number


def _channels(request: EstimateRequest[RepeatabilityParameters], group: NDArray[np.int64]) -> list[Repeats]:
    found = []
    for channel in request.parameters.channels:
        values, own, units = [], [], set()
        for recorded in request.segments:
            statistics = recorded.statistics
            if channel not in statistics.channels:
                hint = closest(channel, statistics.channels)
                raise EstimationError(f"segment '{recorded.label}' has no channel '{channel}': {hint}")
            if not statistics.count:
                raise UnfitDataError(f"segment '{recorded.label}' has no usable samples: leave it out of `segments`")
            values.append(float(statistics.mean[statistics.of(channel)]))
            own.append(float(statistics.standard_error[statistics.of(channel)]))
            units.add(recorded.units[channel])
        if len(units) > 1:
            raise EstimationError(f"channel '{channel}' is recorded in different units ({', '.join(sorted(units))})")
        labels = tuple(recorded.label for recorded in request.segments)
        noise = float(np.mean(np.square(own))) if all(recorded.expected for recorded in request.segments) else math.nan
        start, end = recorded_times(request.segments)
        pauses = np.maximum(start[1:] - end[:-1], 0.0) if (np.diff(start) > 0).all() else None
        found.append(
            Repeats(channel, units.pop(), labels, np.array(values), np.array(own), group, expected=noise, pauses=pauses)
        )
    return found


def _coefficients(request: EstimateRequest[RepeatabilityParameters], group: NDArray[np.int64]) -> list[Repeats]:
    patterns: Sequence[str] = request.parameters.coefficients
    each = [{item.name: item for item in estimate.coefficients} for estimate in request.uses.values()]
    shared = [name for name in each[0] if all(name in own for own in each)]
    wanted = [name for name in shared if not patterns or any(fnmatchcase(name, one) for one in patterns)]
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in shared):
            raise EstimationError(
                f"no coefficient common to all estimates matches '{pattern}': {closest(pattern, shared)}"
            )
    if not wanted:
        raise EstimationError("the estimates in `uses` have no coefficient in common: use estimates of the same kind")
    found = []
    for name in wanted:
        units = {own[name].unit for own in each}
        if len(units) > 1:
            raise EstimationError(f"'{name}' is given in different units ({', '.join(sorted(units))})")
        values = together([own[name] for own in each])
        spread = np.array([own[name].standard_uncertainty for own in each])
        noise = _expected_variance([name] * len(each), tuple(request.uses.values()))
        found.append(
            Repeats(name, units.pop(), tuple(request.uses), values, spread, group, each[0][name].period, noise)
        )
    for one in found:
        if not np.isfinite(one.value).all() and math.isnan(one.expected):
            raise UnfitDataError(f"'{one.name}' is not a finite number in every estimate")
    return found


def _quantities(request: EstimateRequest[RepeatabilityParameters]) -> list[Repeats]:
    """Returns the repeats of quantities whose coefficients have different names."""
    found = []
    for name, texts in request.parameters.quantities.items():
        items, noise, places = [], [], []
        for text in texts:
            estimate, _, wanted = text.partition(".")
            if estimate not in request.uses:
                raise EstimationError(
                    f"'{text}' in `quantities`: `uses` has no '{estimate}': {closest(estimate, request.uses)}"
                )
            used = request.uses[estimate]
            known = {item.name: item for item in used.coefficients}
            if wanted not in known:
                raise EstimationError(f"'{estimate}' has no coefficient '{wanted}': {closest(wanted, known)}")
            items.append(known[wanted])
            noise.append(_expected_variance([wanted], [used]))
            places.append((estimate, list(known).index(wanted)))
        units = {item.unit for item in items}
        if len(units) > 1:
            raise EstimationError(f"the coefficients of '{name}' have different units ({', '.join(sorted(units))})")
        values, own = together(items), np.array([item.standard_uncertainty for item in items])
        expected = float(np.mean(noise))
        if not np.isfinite(values).all() and math.isnan(expected):
            raise UnfitDataError(f"'{name}' is not a finite number in every estimate")
        group = np.zeros(len(items), dtype=np.int64)
        shared = _correlation(places, request.uses)
        found.append(
            Repeats(name, units.pop(), texts, values, own, group, items[0].period, expected, correlation=shared)
        )
    return found


def _correlation(places: Sequence[tuple[str, int]], uses: Mapping[str, Estimate]) -> float:
    """Returns the correlation coefficient of the two most correlated coefficients of one estimate; zero if no two coefficients come
    from the same estimate. `places`: for each coefficient, the name of its estimate and its index there."""
    largest = 0.0
    for (one, i), (other, j) in combinations(places, 2):
        if one != other:
            continue
        covariance = uses[one].covariance
        size = math.sqrt(float(covariance[i, i] * covariance[j, j]))
        found = float(covariance[i, j]) / size if size > 0 else 0.0
        largest = max(largest, found, key=abs)
    return largest


def _expected_variance(names: Sequence[str], uses: Sequence[Estimate]) -> float:
    """Returns the variance that noise alone causes in coefficients of expected estimates; NaN for estimates from a recording.
    `names`: the name of the coefficient in each estimate."""
    found = []
    for name, used in zip(names, uses, strict=True):
        if not used.expected or used.data_covariance is None:
            return math.nan
        place = [item.name for item in used.coefficients].index(name)
        found.append(float(used.data_covariance[place, place]))
    return float(np.mean(found))


def together(repeats: Sequence[Coefficient]) -> Array:
    """Returns the values of a repeated coefficient, shape (n,). For a circular quantity, these are the equivalent values nearest to
    the circular mean (Mardia and Jupp, Directional Statistics, 2.2)."""
    period = repeats[0].period
    if math.isinf(period) or not all(math.isfinite(one.value) for one in repeats):
        return np.array([one.value for one in repeats])
    phase = 2 * math.pi / period
    mean = math.atan2(
        sum(math.sin(phase * one.value) for one in repeats), sum(math.cos(phase * one.value) for one in repeats)
    )
    return np.array([one.near(mean / phase) for one in repeats])


def analysis_of_variance(value: Array, group: NDArray[np.int64], expected: float = math.nan) -> Variance:
    """Computes a one-way analysis of variance of values in groups. For a single group, it gives only the mean and the scatter.

    The overall mean is the mean of the group means. The variance component between groups is (M_b − M_w)/n₀. M_b and M_w are the
    mean squares between and within the k groups. For groups of n_i values, n₀ = (n − Σn_i²/n)/(k − 1). `expected`: for expected
    values, the variance that noise alone would cause; it is used instead of the scatter of the values. NaN for measured values.
    """
    numbers = np.unique(group)
    n, k = len(value), len(numbers)
    means = np.array([value[group == one].mean() for one in numbers])
    sizes = np.array([np.sum(group == one) for one in numbers], dtype=float)
    place = np.searchsorted(numbers, group)
    within_freedom, shown = float(n - k), math.isnan(expected)
    within = float(np.sum((value - means[place]) ** 2)) / within_freedom if shown else expected
    if k == 1:
        return Variance(float(means[0]), math.sqrt(within / n), within_freedom, within, within_freedom)
    between_square = float(np.sum(sizes * (means - value.mean()) ** 2)) / (k - 1) if shown else expected
    spread_of_means = float(np.std(means, ddof=1)) if shown else math.sqrt(expected * float(np.mean(1 / sizes)))
    effective = float(n - np.sum(sizes**2) / n) / (k - 1)
    terms = (between_square / effective, within * (1 - 1 / effective))
    spread = math.sqrt(2 * between_square**2 / (k - 1) + 2 * within**2 / within_freedom) / effective
    total = sum(terms)
    squares = terms[0] ** 2 / (k - 1) + terms[1] ** 2 / within_freedom
    return Variance(
        float(means.mean()),
        spread_of_means / math.sqrt(k),
        float(k - 1),
        within,
        within_freedom,
        (between_square - within) / effective,
        spread,
        total,
        total**2 / squares if squares > 0 else within_freedom,
        terms,
        between_square / within if within > 0 else math.inf,
    )


def _interval_of_sum(terms: Sequence[float], freedom: Sequence[float]) -> tuple[float, float]:
    """Returns the confidence interval, with the confidence level `PROBABILITY`, of a sum of independent mean squares, each
    multiplied by a positive factor (Graybill and Wang). `terms`: the mean squares, multiplied by their factors."""
    low, high = 0.0, 0.0
    for term, own in zip(terms, freedom, strict=True):
        below, above = deviation_interval(1.0, own)
        low, high = low + ((1 - below**2) * term) ** 2, high + ((above**2 - 1) * term) ** 2
    total = float(sum(terms))
    return max(0.0, total - math.sqrt(low)), total + math.sqrt(high)


def deviation_interval(variance: float, freedom: float) -> tuple[float, float]:
    """Returns the χ² confidence interval of a standard deviation, with the confidence level `PROBABILITY`."""
    from scipy.special import chdtri

    low = math.sqrt(variance * freedom / float(chdtri(freedom, (1 - PROBABILITY) / 2)))
    return low, math.sqrt(variance * freedom / float(chdtri(freedom, (1 + PROBABILITY) / 2)))


def _of_deviation(variance: float, freedom: float) -> tuple[float, float]:
    """Returns the standard deviation s and its standard uncertainty, s/√(2ν) for ν degrees of freedom (JCGM 100:2008, E.4.3)."""
    value = math.sqrt(variance)
    return value, value / math.sqrt(2 * freedom)


def _reported(one: Repeats, split: Variance) -> list[Coefficient]:
    name, text = one.name, one.unit
    s, u = _of_deviation(split.within, split.within_freedom)
    scale = CoefficientRole.SCALE
    where = said("within groups") if math.isfinite(split.between) else said("from repeat to repeat")
    found = [
        Coefficient(
            f"mean_{name}",
            one.on_circle(split.mean),
            text,
            split.mean_uncertainty,
            split.mean_freedom,
            said("{name}: mean", name=name),
            one.period,
        ),
        Coefficient(
            f"s_{name}",
            s,
            text,
            u,
            split.within_freedom,
            said("{name}: standard deviation {where}", name=name, where=where),
            role=scale,
        ),
    ]
    foreseen = not math.isnan(one.expected)
    if (split.mean or foreseen) and math.isinf(one.period):
        # A value that is expected to be zero has no expected relative scatter.
        zero = foreseen and abs(split.mean) <= split.mean_uncertainty
        mean = math.nan if zero else split.mean
        relative = 1e6 / abs(mean)
        own = relative * math.hypot(u, s * split.mean_uncertainty / mean)
        words = said("{name}: standard deviation {where}, divided by the mean", name=name, where=where)
        found.append(
            Coefficient(f"repeatability_{name}", s * relative, "ppm", own, split.within_freedom, words, role=scale)
        )
    if math.isfinite(split.between):
        value, spread = root_of(split.between, split.between_uncertainty)
        words = said("{name}: standard deviation between groups", name=name)
        found.append(Coefficient(f"s_between_{name}", value, text, spread, split.mean_freedom, words, role=scale))
        total, u_total = _of_deviation(split.total, split.total_freedom)
        words = said(
            "{name}: standard deviation within and between groups together (intermediate precision)", name=name
        )
        found.append(Coefficient(f"s_total_{name}", total, text, u_total, split.total_freedom, words, role=scale))
    return found


def _values(one: Repeats, groups: Sequence[str]) -> Table:
    return by_columns(
        f"Repeats of {one.name}",
        (TableColumn("from"), one.labels),
        *([(TableColumn("group"), [groups[number] for number in one.group])] if groups else []),
        (TableColumn(one.name, Role.VALUE, one.unit), one.value),
        (TableColumn("own u", Role.STANDARD_UNCERTAINTY, one.unit), known(one.own)),
    )


def _variances(one: Repeats, split: Variance) -> Table:
    columns = (
        TableColumn("scatter"),
        TableColumn("s", Role.VALUE, one.unit),
        TableColumn("degrees of freedom", Role.DEGREES_OF_FREEDOM),
        TableColumn("lower 95 %", Role.VALUE, one.unit),
        TableColumn("upper 95 %", Role.VALUE, one.unit),
    )
    rows: list[tuple[Cell, ...]] = [
        (
            "repeatability",
            math.sqrt(split.within),
            split.within_freedom,
            *deviation_interval(split.within, split.within_freedom),
        )
    ]
    if math.isfinite(split.between):
        rows.append(("between groups", math.sqrt(max(0.0, split.between)), split.mean_freedom, None, None))
        rows.append(
            (
                "both together",
                math.sqrt(split.total),
                split.total_freedom,
                *map(math.sqrt, split.total_interval),
            )
        )
    return Table(f"Scatter of {one.name}", columns, tuple(rows))


def _notes(one: Repeats, split: Variance) -> list[Said]:
    found = []
    if math.isfinite(split.between):
        verdict = (
            said("groups differ")
            if split.probability < 0.05
            else said("the differences between the groups do not exceed the scatter within them")
        )
        found.append(
            said(
                "{name}: variance ratio F = {ratio:.3g} between and within groups (probability of a larger ratio by chance: "
                "{chance:.2g}): {verdict}.",
                name=one.name,
                ratio=split.ratio,
                chance=split.probability,
                verdict=verdict,
            )
        )
    if np.isfinite(one.own).all() and (one.own > 0).all():
        own = math.sqrt(float(np.mean(one.own**2)))
        found.append(
            said(
                "{name}: the standard uncertainties of the repeats are {own:.3g} {unit} (root mean square), and their "
                "scatter is {scatter:.3g}; influences common to all repeats, such as a fixture's angle, contribute to the "
                "uncertainties but not to the scatter.",
                name=one.name,
                own=own,
                unit=one.unit,
                scatter=math.sqrt(split.within),
            )
        )
    return found


def chance_of_order(value: Array, group: NDArray[np.int64]) -> float:
    """Tests whether the order of the values is random. Returns the probability that successive values within groups would be at
    least as similar if the order were random; NaN for fewer than eight values within groups.

    The ratio η = Σ(x_{i+1} − x_i)²/Σ(x_i − x̄)² of n independent normal values has the mean 2 and the variance 4·(n − 2)/(n² − 1)
    (von Neumann); η/4 is close to a symmetric beta variable with these moments. In each group, x̄ is the mean of the group.
    """
    from scipy.special import betainc

    means = {one: value[group == one].mean() for one in np.unique(group)}
    rest = value - np.array([means[one] for one in group])
    n, total = len(rest) - len(means) + 1, float(rest @ rest)
    if n < _ORDERED or total == 0:
        return math.nan
    steps = float(np.sum(np.diff(rest)[group[1:] == group[:-1]] ** 2))
    shape = ((n**2 - 1) / (n - 2) - 1) / 2
    return float(betainc(shape, shape, min(1.0, steps / total / 4)))


def _warnings(one: Repeats, split: Variance) -> list[Said]:
    from scipy.special import chdtrc

    found = []
    if np.isfinite(one.own).all() and (one.own > 0).all() and math.isnan(one.expected):
        own = float(np.mean(one.own**2))
        chance = float(chdtrc(split.within_freedom, split.within_freedom * split.within / own))
        if chance < SIGNIFICANCE:
            found.append(
                said(
                    "{name}: the repeats scatter {ratio:.3g} times as much as their standard uncertainties "
                    "allow (probability by chance: {chance:.2g}). Those uncertainties do not include changes "
                    "from repeat to repeat: use the standard deviation of the repeats.",
                    name=one.name,
                    ratio=math.sqrt(split.within / own),
                    chance=chance,
                )
            )
    if abs(one.correlation) > _CORRELATED:
        found.append(
            said(
                "{name}: coefficients of the same estimate are compared, and their errors are correlated (largest correlation "
                "coefficient: {correlation:.2g}). Their scatter does not show errors that they have in common. Compare "
                "coefficients of separate estimates.",
                name=one.name,
                correlation=one.correlation,
            )
        )
    unnamed = _unnamed_groups(one)
    chance = chance_of_order(one.value, one.group)
    if unnamed:
        found.append(unnamed)
    elif chance < SIGNIFICANCE:
        found.append(
            said(
                "{name}: successive values are more alike than values that vary at random (probability by "
                "chance: {chance:.2g}): the quantity drifts, or the repeats consist of groups, such as days or "
                "switch-ons. Name them in `groups`.",
                name=one.name,
                chance=chance,
            )
        )
    if _scatter_differs(one):
        found.append(
            said(
                "{name}: the scatter within the groups differs significantly from group to group (Bartlett's "
                "test): one standard deviation does not describe all groups. Examine each group separately.",
                name=one.name,
            )
        )
    return found


def _unnamed_groups(one: Repeats) -> Said | None:
    """Returns a warning about repeats that form different groups although the plan treats them as one group; None if they do not.
    If m divisions into groups are tried, each of them is tested at 1/m of the significance level."""
    if len(np.unique(one.group)) > 1 or not math.isnan(one.expected):
        return None
    tried = groupings(one.labels, one.pauses)
    splits = [(analysis_of_variance(one.value, own.group), own) for own in tried]
    chance, split, own = min(
        ((split.probability, split, own) for split, own in splits), key=lambda item: item[0], default=(1.0, None, None)
    )
    if split is None or own is None or not chance * len(tried) < SIGNIFICANCE:
        return None
    shown: str | tuple[str, ...] = tuple(own.names[:_NAMED])
    if len(own.names) > _NAMED:
        shown = said("{names} and {more} more", names=shown, more=len(own.names) - _NAMED)
    return said(
        "{name}: the repeats are treated as one group, but differ between these groups: {groups} (variance ratio F = "
        "{ratio:.3g}, probability of a larger ratio by chance: {chance:.2g}). The uncertainty of their mean is too small. Name "
        "the groups in `groups`.",
        name=one.name,
        groups=shown,
        ratio=split.ratio,
        chance=chance,
    )


def _scatter_differs(one: Repeats) -> bool:
    """Returns True if the scatter within groups differs from group to group; only groups of at least three repeats are compared."""
    held = [one.value[one.group == number] for number in np.unique(one.group)]
    held = [values for values in held if len(values) >= _TO_COMPARE]
    variances = np.array([float(np.var(values, ddof=1)) for values in held])
    if len(held) < 2 or not (variances > 0).all():
        return False
    degrees = np.array([len(values) - 1.0 for values in held])
    return variances_differ(variances, degrees, float(variances @ degrees / degrees.sum()))


def _plot(one: Repeats) -> Plot:
    own = {one.name: tuple(map(float, one.own))} if np.isfinite(one.own).all() else {}
    deviations = tuple(map(float, one.value - one.value.mean()))
    title = f"Repeats of {one.name}"
    return Plot(title, "repeat", f"difference from the mean [{one.unit}]", one.labels, {one.name: deviations}, own)


@dataclass(frozen=True, slots=True)
class Grouping:
    """A division of n repeats into groups. `group`: array of shape (n,), index of the group of each repeat. `names`: names of the
    groups, for messages."""

    group: Integers
    names: tuple[str, ...]


def groupings(labels: Sequence[str], pauses: Array | None) -> list[Grouping]:
    """Returns the divisions into groups that a test can use if the plan names no groups: by the labels of the repeats, by long
    pauses, and by thirds of the sequence. If the day, the switch-on or the mounting changed between two groups, repeats of one
    group agree better than repeats of different groups. The repeats must be in chronological order. Every returned division has
    at least two groups, and on average more than two repeats per group.

    `labels`: labels of the repeats, such as day1/r2 or startup-b-07. The last number in a label counts the repeats of a group.
    `pauses`: array of shape (n − 1,), time between successive repeats, s; None if this is not known.
    """
    stems = [re.sub(r"\d+$", "", label) for label in labels]
    found = [
        Grouping(
            np.array([list(dict.fromkeys(stems)).index(stem) for stem in stems]),
            tuple(f"{one}*" for one in dict.fromkeys(stems)),
        )
    ]
    if pauses is not None and len(pauses):
        found.append(
            _ranges(labels, np.concatenate([[0], np.cumsum(pauses > _PAUSE * np.median(pauses))]).astype(np.int64))
        )
    if len(labels) >= 3 * _LEAST:
        found.append(_ranges(labels, np.arange(len(labels)) * 3 // len(labels)))
    distinct = {one.group.tobytes(): one for one in reversed(found)}
    return [one for one in reversed(distinct.values()) if 1 < len(one.names) < len(labels) / 2]


def _ranges(labels: Sequence[str], group: Integers) -> Grouping:
    """Makes groups of neighbouring repeats, and names each group by its first and last repeat."""
    held = [
        [label for label, own in zip(labels, group, strict=True) if own == one] for one in range(int(group[-1]) + 1)
    ]
    return Grouping(group, tuple(one[0] if len(one) == 1 else f"{one[0]} … {one[-1]}" for one in held))
