"""Attributes one amplitude, which was estimated in several runs, to its sources. The sources are the device, the bench, the
occasion (one switch-on of the device), and everything that all runs have in common (the type of device, the plan, the site, the
declarations).

The estimate in run r is y_r = b[bench of r] + d[device of r] + o[occasion of r] + c + e_r, where e_r ~ N(0, s_r²). The standard
uncertainty s_r is known from the fit of the run. The parts of one kind of source, such as those of all devices, are independent
draws from N(0, σ²); each kind has its own σ. The model is a random-effects model (Searle, Casella and McCulloch, Variance
Components, 1992, chapters 3 and 9). The common part c has a σ as well. The common part has no flat prior, because zero is a special
value: if c = 0, the runs have no common deviation from the simulation.

The hypotheses are all subsets of the sources, including the empty set. For given σ, the evidence is Gaussian:

    log p(y | σ) = −½ (n·log 2π + log det V + yᵀ V⁻¹ y),    V = S + Z G Zᵀ

Z assigns the runs to their groups, and the diagonal matrix G contains the variances σ² of the parts. The diagonal matrix S contains
the variances s². If each run forms its own group for a source, the σ² of this source is added to S instead. With M = I + G^½ ZᵀS⁻¹Z
G^½, log det V = log det S + log det M and yᵀV⁻¹y = yᵀS⁻¹y − hᵀG^½ M⁻¹ G^½h, where h = ZᵀS⁻¹y (matrix inversion lemma). Each σ has a
log-uniform prior. Each σ is integrated out on a grid, which is finer where the evidence is large.

Sources that group the runs in the same way cannot be distinguished. Examples are the device and the bench if only one device was
tested on only one bench, or the device and the occasion if each device has only one run. Such sources form one component.

In array shapes, n is the number of runs, C is the number of components, P is the number of points of the grid, Q is the number of
points with a noticeable weight, and m is the number of parts (groups) of a component.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array


class Source(Enum):
    """Names a source from which a part of an amplitude comes. OCCASION: a part that is drawn anew at each switch-on. COMMON: a part
    that is the same in all runs."""

    DEVICE = "device"
    BENCH = "bench"
    OCCASION = "occasion"
    COMMON = "common"


ALL_RUNS = "all runs"
"""Label of the only group of `Source.COMMON`."""
PRIOR = 0.5
"""Prior probability that a component contributes. This probability does not depend on the other components, because their causes
are independent."""
WEAKEST = 4.0
"""Smallest expected energy σ²·Σ 1/s_r² of a component; a weaker component cannot be distinguished from none and counts as absent."""
LARGEST = 10.0
"""Largest σ of a component, relative to the weighted root mean square of the estimates."""
SURE = 0.95
"""A source is named if its probability is at least this value, and excluded if its probability is below 1 − SURE."""
COVERAGE = 0.95
_POINTS = (1, 33, 17, 11, 9)  # number of points of the grid of one σ, for 0 to 4 components
_ROUNDS = 5
_REACH = 12.0  # nats; the next grid covers all points whose log evidence is below the maximum by less than this
_SHRINKING = 0.7  # if a new grid is wider than this fraction of the old one, the search ends
_CONSIDERED = 1e-4  # smallest weight, relative to the largest, of a grid point that contributes to the parts
_HELD = 0.999  # fraction of the posterior probability that the points used for the parts contain
_BISECTIONS = 22
_NUMBERS = 2_000_000  # largest number of matrix elements in memory at once


@dataclass(frozen=True)
class Estimates:
    """Estimates of one amplitude in n runs.

    `values`, `standard_uncertainties`: arrays of shape (n,), in one unit; all are finite, and the uncertainties are positive.
    `groups`: for each source except `COMMON`, the labels (n) of the groups to which the runs belong. `since`: for each source with
    steps (`fleet.changes`), n texts, one for each run. The text states the moment of the latest step of the run's group at or
    before this run; it is empty if there was no such step. After each step, the group counts as a new group.
    """

    values: Array
    standard_uncertainties: Array
    groups: Mapping[Source, Sequence[str]]
    since: Mapping[Source, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.values).all() and (self.standard_uncertainties > 0).all()):
            raise ValueError("values must be finite and standard uncertainties positive")


@dataclass(frozen=True, eq=False)
class Component:
    """Describes one or more sources that group the runs in the same way. `labels`: for each of the m groups, its label and the
    moment of the step with which the group begins; the moment is empty if there is no step. `members`: array of shape (n,), index
    of the group of each run."""

    sources: tuple[Source, ...]
    labels: tuple[tuple[str, str], ...]
    members: NDArray[np.int64] = field(repr=False)

    @property
    def name(self) -> str:
        """Returns the name of the component, such as `bench`, or `device or occasion`."""
        return " or ".join(source.value for source in self.sources)


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A value with its uncertainty. `expanded`: half-width of the interval about `value`; the interval has the probability
    `COVERAGE`."""

    value: float
    expanded: float


@dataclass(frozen=True, slots=True)
class SourcePart:
    """Describes the part of an amplitude that belongs to one device, one bench or one occasion. The values are valid under the
    condition that parts of this kind contribute at all.

    `level`: the sum of this part and of the part that all runs have in common; the data often determine this sum better than its
    two parts. `difference`: this part minus the average of the parts of the other devices (or benches, or occasions). `level` and
    `difference` are None if every device (or bench, or occasion) has only one run; `difference` is also None if there is only one
    device (or bench, or occasion). `runs`: number of runs that contain the part. `since`: if the part is valid only after a step,
    the moment of this step; empty if it is valid from the first run on.
    """

    label: str
    since: str
    part: Uncertain
    level: Uncertain | None
    difference: Uncertain | None
    runs: int


@dataclass(frozen=True, slots=True)
class Contribution:
    """Describes what one component contributes to an amplitude.

    `probability`: probability that the component contributes. `share`: the fraction of an amplitude's mean square over the runs
    that the component explains. Noise is not counted. The shares of all components add up to 1, or all are 0. `spread`: posterior
    median of the σ of the component under the condition that it contributes. `spread_interval`: limits of the central 95 % of this
    posterior. `parts`: the parts of the component's groups, in the order of the labels.
    """

    component: Component
    probability: float
    share: float
    spread: float
    spread_interval: tuple[float, float]
    parts: tuple[SourcePart, ...]


@dataclass(frozen=True)
class Attribution:
    """Contains the attribution of an amplitude to sources. `none`: probability that no component contributes. `probability`:
    probability that exactly a certain subset of the components contributes. The key of a subset consists of the names of its
    components, joined by '+'."""

    none: float
    probability: Mapping[str, float]
    contributions: tuple[Contribution, ...]

    def of(self, source: Source) -> Contribution:
        """Returns the contribution of the component that contains this source; sources that cannot be distinguished share a
        component."""
        return next(one for one in self.contributions if source in one.component.sources)

    @property
    def named(self) -> tuple[Contribution, ...]:
        """Returns the components that contribute with a probability of at least `SURE`."""
        return tuple(one for one in self.contributions if one.probability >= SURE)

    @property
    def open(self) -> tuple[Contribution, ...]:
        """Returns the components that are neither named nor excluded, because the data do not decide about them."""
        return tuple(one for one in self.contributions if 1 - SURE < one.probability < SURE)


def components(
    groups: Mapping[Source, Sequence[str]], since: Mapping[Source, Sequence[str]] | None = None
) -> tuple[Component, ...]:
    """Combines sources into components: the sources that group the runs in the same way form one component. `groups`, `since`: the
    same as in `Estimates`."""
    found: dict[tuple[int, ...], tuple[list[Source], list[tuple[str, str]]]] = {}
    n = len(groups[Source.OCCASION])
    for source in Source:
        names = [ALL_RUNS] * n if source is Source.COMMON else groups[source]
        given = list(zip(names, (since or {}).get(source, [""] * n), strict=True))
        labels = list(dict.fromkeys(given))
        members = tuple(labels.index(label) for label in given)
        found.setdefault(members, ([], labels))[0].append(source)
    return tuple(
        Component(tuple(sources), tuple(labels), np.array(members, dtype=np.int64))
        for members, (sources, labels) in found.items()
    )


def log_evidence(given: Estimates, chosen: Sequence[Component], spreads: Array) -> Array:
    """Computes the log evidence log p(y | σ), shape (P,). `spreads`: array of shape (P, C), P sets of the standard deviations σ of
    the C chosen components, in the unit of the estimates."""
    return _Model(given, chosen).log_evidence(spreads)


def attribute(given: Estimates) -> Attribution:
    """Attributes an amplitude to its sources."""
    every = components(given.groups, given.since)
    subsets = [chosen for size in range(len(every) + 1) for chosen in combinations(every, size)]
    models = [_Model(given, chosen) for chosen in subsets]
    prior = [len(chosen) * np.log(PRIOR) + (len(every) - len(chosen)) * np.log(1 - PRIOR) for chosen in subsets]
    log = np.array([model.integrated for model in models]) + np.array(prior)
    posterior = np.exp(log - np.logaddexp.reduce(log))
    having = {
        one: [(float(p), model) for p, model in zip(posterior, models, strict=True) if one in model.chosen]
        for one in every
    }
    power = {one: sum(p * model.power(one) for p, model in having[one]) for one in every}
    whole = sum(power.values()) or 1.0
    common = next(one for one in every if Source.COMMON in one.sources)
    contributions = tuple(
        Contribution(
            one,
            min(1.0, sum(p for p, _ in having[one])),
            power[one] / whole,
            *_spread(one, having[one]),
            _parts(one, having[one], None if one is common else common),
        )
        for one in every
    )
    names = ["+".join(one.name for one in chosen) or "none" for chosen in subsets]
    return Attribution(float(posterior[0]), dict(zip(names, map(float, posterior), strict=True)), contributions)


class _Model:
    """A model in which one subset of the components contributes."""

    def __init__(self, given: Estimates, chosen: Sequence[Component]):
        self.chosen = tuple(chosen)
        self._y, self._variance = given.values, given.standard_uncertainties**2
        n = len(self._y)
        self._alone = next((k for k, one in enumerate(self.chosen) if len(one.labels) == n), None)
        self._grouping = [k for k in range(len(self.chosen)) if k != self._alone]
        sizes = [len(self.chosen[k].labels) for k in self._grouping]
        self._column = np.repeat(np.array(self._grouping, dtype=np.int64), sizes)
        z = [self.chosen[k].members[:, None] == np.arange(len(self.chosen[k].labels)) for k in self._grouping]
        self._z = np.hstack([np.zeros((n, 0)), *z])
        energies = np.array([WEAKEST, LARGEST**2 * max(WEAKEST, float((self._y**2 / self._variance).sum()))])
        self._limits = 0.5 * np.log(energies / float((1 / self._variance).sum()))

    def _weighed(self, spreads: Array) -> tuple[Array, Array, Array, Array]:
        """Returns the arrays S (P, n), G^½ (P, g), M (P, g, g) and G^½h (P, g) of the formulas in the module docstring. `spreads`:
        array of shape (P, C), P sets of the standard deviations σ of the C chosen components. g: number of the groups of these
        components. If each run forms its own group of a component, this component is not counted."""
        s = np.broadcast_to(self._variance, (len(spreads), len(self._y)))
        if self._alone is not None:
            s = s + spreads[:, [self._alone]] ** 2
        n, m = self._z.shape
        root = spreads[:, self._column]
        products = (self._z[:, :, None] * self._z[:, None, :]).reshape(n, m * m)
        gram = ((1 / s) @ products).reshape(len(spreads), m, m)
        inner = np.eye(m) + root[:, :, None] * gram * root[:, None, :]
        return s, root, inner, root * ((self._y / s) @ self._z)

    def log_evidence(self, spreads: Array) -> Array:
        """Returns the log evidence log p(y | σ), shape (P,). `spreads`: the same as in `_weighed`."""
        at_once = max(1, _NUMBERS // (1 + self._z.shape[1] ** 2))
        return np.concatenate(
            [self._log_evidence(spreads[first : first + at_once]) for first in range(0, len(spreads), at_once)]
        )

    def _log_evidence(self, spreads: Array) -> Array:
        s, _, inner, score = self._weighed(spreads)
        m = score.shape[1]
        whole = np.empty((len(spreads), m + 1, m + 1))  # its last pivot is yᵀV⁻¹y, plus 1 for readings of zero
        whole[:, :m, :m], whole[:, m, :m], whole[:, :m, m] = inner, score, score
        whole[:, m, m] = (self._y**2 / s).sum(1) + 1
        pivots = np.diagonal(np.linalg.cholesky(whole), axis1=1, axis2=2)
        log_det = np.log(s).sum(1) + 2 * np.log(pivots[:, :m]).sum(1)
        return np.asarray(-0.5 * (s.shape[1] * np.log(2 * np.pi) + log_det + pivots[:, m] ** 2 - 1))

    @cached_property
    def _grid(self) -> tuple[Array, Array, float]:
        """Returns the points of the grid, σ (P, C); their posterior weights (P,), whose sum is 1; and the logarithm of the evidence
        averaged over the prior."""
        lowest, highest = self._limits
        low, high = (np.full(len(self.chosen), limit) for limit in (lowest, highest))
        count = _POINTS[len(self.chosen)]
        for _ in range(_ROUNDS):
            axes = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
            points = (
                np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], 1) if axes else np.zeros((1, 0))
            )
            log, step = self.log_evidence(np.exp(points)), (high - low) / max(count - 1, 1)
            at_ends = ((points < low + step / 2) | (points > high - step / 2)).sum(1)
            near = points[log > log.max() - _REACH]
            closer = np.maximum(near.min(0) - step, lowest), np.minimum(near.max(0) + step, highest)
            if (closer[1] - closer[0] > _SHRINKING * (high - low)).all():
                break
            low, high = closer
        log += np.log(step / (highest - lowest)).sum() - np.log(2.0) * at_ends  # trapezoidal rule
        whole = float(np.logaddexp.reduce(log))
        return np.exp(points), np.exp(log - whole), whole

    @property
    def integrated(self) -> float:
        """Returns the log evidence log p(y), averaged over the prior of σ."""
        return self._grid[2]

    def spread(self, component: Component) -> tuple[Array, Array]:
        """Returns the σ of a component at each of the P points of the grid, and the posterior weight of each point, both of shape
        (P,)."""
        points, weights, _ = self._grid
        return points[:, self.chosen.index(component)], weights

    @cached_property
    def _moments(self) -> tuple[Array, list[Array], list[Array], Array, Array]:
        """Returns the weights (Q,) of the Q points of the grid whose weight is noticeable. For each component, it also returns the
        means (Q, m) and variances (Q, m) of the component's m parts at these points. A part is the contribution of one group of
        runs, such as all runs of one device. The last two results are the joint mean (Q, g) and covariance (Q, g, g) of the parts
        of all components, with g groups as in `_weighed`."""
        points, weights, _ = self._grid
        kept = weights > _CONSIDERED * weights.max()
        points, weights = points[kept], weights[kept] / weights[kept].sum()
        s, root, inner, score = self._weighed(points)
        inverse = np.linalg.inv(inner)
        mean = root * (inverse @ score[:, :, None])[:, :, 0]
        covariance = root[:, :, None] * inverse * root[:, None, :]
        variance = np.diagonal(covariance, axis1=1, axis2=2)
        means = [mean[:, self._column == k] for k in range(len(self.chosen))]
        variances = [variance[:, self._column == k] for k in range(len(self.chosen))]
        if self._alone is not None:  # given the other parts, each of these depends on its own run alone
            share = 1 - self._variance / s
            means[self._alone] = share * (self._y - mean @ self._z.T)
            of_others = np.einsum("ni,qij,nj->qn", self._z, covariance, self._z)
            variances[self._alone] = share**2 * of_others + share * self._variance
        return weights, means, variances, mean, covariance

    def parts(self, component: Component) -> tuple[Array, Array, Array]:
        """Returns, for Q points of the grid, the weights (Q,), and the means (Q, m) and variances (Q, m) of the m parts of a
        component."""
        weights, means, variances, _, _ = self._moments
        place = self.chosen.index(component)
        return weights, means[place], variances[place]

    def combined(self, component: Component, combinations: Array, also: Component | None) -> tuple[Array, Array, Array]:
        """Returns, for Q points of the grid, the weights (Q,), and the means (Q, m) and variances (Q, m) of m linear combinations
        of the parts of a component. `combinations`: array of shape (m, groups of the component), coefficients. The single part of
        the component `also` is added to each combination if the model contains this component."""
        weights, _, _, mean, covariance = self._moments
        design = np.zeros((len(combinations), len(self._column)))
        design[:, self._column == self.chosen.index(component)] = combinations
        if also is not None and also in self.chosen:
            design[:, self._column == self.chosen.index(also)] = 1
        return weights, mean @ design.T, np.einsum("ai,qij,aj->qa", design, covariance, design)

    def power(self, component: Component) -> float:
        """Returns the expected mean square of the parts of a component over the runs."""
        weights, means, variances = self.parts(component)
        runs = np.bincount(component.members, minlength=len(component.labels))
        return float(weights @ (means**2 + variances) @ runs / runs.sum())


def _spread(component: Component, having: Sequence[tuple[float, _Model]]) -> tuple[float, tuple[float, float]]:
    """Returns the median of the σ of a component and the limits of its central 95 %, averaged over the models that contain the
    component. `having`: these models, each with its probability."""
    found = [(p * weights, values) for p, model in having for values, weights in [model.spread(component)]]
    weights, values = np.concatenate([w for w, _ in found]), np.concatenate([v for _, v in found])
    order = np.argsort(values)
    share = np.cumsum(weights[order]) - weights[order] / 2
    tail = (1 - COVERAGE) / 2
    low, median, high = np.exp(np.interp([tail, 0.5, 1 - tail], share / weights.sum(), np.log(values[order])))
    return float(median), (float(low), float(high))


def _parts(
    component: Component, having: Sequence[tuple[float, _Model]], common: Component | None
) -> tuple[SourcePart, ...]:
    """Returns the parts of a component, averaged over the models that contain it. `common`: the component of `Source.COMMON`, or
    None if `component` is this component. `having`: the same as in `_spread`."""
    m = len(component.labels)
    parts = _averaged([(p, *model.parts(component)) for p, model in having])
    levels: list[Uncertain | None] = [None] * m
    differences: list[Uncertain | None] = [None] * m
    if m < len(component.members):
        levels[:] = _averaged([(p, *model.combined(component, np.eye(m), common)) for p, model in having])
        if m > 1:
            others = (m * np.eye(m) - 1) / (m - 1)
            differences[:] = _averaged([(p, *model.combined(component, others, None)) for p, model in having])
    runs = np.bincount(component.members, minlength=m).tolist()
    names, since = zip(*component.labels, strict=True)
    return tuple(map(SourcePart, names, since, parts, levels, differences, runs))


def _averaged(found: Sequence[tuple[float, Array, Array, Array]]) -> list[Uncertain]:
    """Averages values and their intervals over models. `found`: for every model, its probability, weights (Q,), means (Q, m) and
    variances (Q, m)."""
    weights = np.concatenate([p * w for p, w, _, _ in found])
    means, variances = np.vstack([m for _, _, m, _ in found]), np.vstack([v for _, _, _, v in found])
    order = np.argsort(-weights)
    kept = order[: 1 + int(np.searchsorted(np.cumsum(weights[order]), _HELD * weights.sum()))]
    weights, means, variances = weights[kept] / weights[kept].sum(), means[kept], variances[kept]
    centre = weights @ means
    half = _half_width(weights, means - centre, np.sqrt(np.maximum(variances, 0.0)))
    return [Uncertain(float(value), float(width)) for value, width in zip(centre, half, strict=True)]


def _half_width(weights: Array, offsets: Array, spreads: Array) -> Array:
    """Finds, by bisection, the half-widths (m,) of the intervals about 0 that have the probability `COVERAGE`. The distributions
    are mixtures of Gaussians with the given weights (Q,), means `offsets` (Q, m) and standard deviations `spreads` (Q, m)."""
    from scipy.special import ndtr

    spreads = np.maximum(spreads, 1e-300)
    low = np.zeros(offsets.shape[1])
    high = (np.abs(offsets) + 10 * spreads).max(0)
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        inside = weights @ (ndtr((middle - offsets) / spreads) - ndtr((-middle - offsets) / spreads))
        low, high = np.where(inside < COVERAGE, middle, low), np.where(inside < COVERAGE, high, middle)
    return np.asarray((low + high) / 2)
