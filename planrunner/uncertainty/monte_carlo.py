"""Propagates distributions by the adaptive Monte Carlo method, and validates the interval ± k·u by this method (JCGM 101:2008).

Random draws are made in blocks of 10⁴ until the results have stabilised. The results are the estimate, the standard uncertainty,
and the two ends of the interval, each averaged over the blocks. The results have stabilised when twice the standard deviation of
each average is smaller than the numerical tolerance (7.9.4). This tolerance is a fifth of the tolerance of the validation (8.2).
With four or fewer degrees of freedom, Student's t has no fourth moment, so the uncertainty of the standard deviation of the draws
cannot be estimated. In this case, the standard uncertainty need not stabilise. The ends of the interval must still stabilise,
because they are the values to be validated.

The random numbers of a block depend only on the seed and the number of the block. The results of the blocks are used in the order
of their numbers. Several workers can therefore share the blocks without an effect on the results.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.workers import ALONE, Workers, results_in_order
from planrunner.uncertainty.decision import coverage_factor
from planrunner.uncertainty.influences import Influence, InputQuantity

BLOCK = 10_000
HEAVY = 4.0  # degrees of freedom up to which t has no finite fourth moment

Draws = Callable[["np.random.Generator", int], Array]  # quoted, so that checking a plan does not import the generators
"""Function that draws n random values of m coefficients from a generator. It returns an array of shape (m, n), in the units of the
coefficients. Workers can share the draws only if the function can be pickled: a function of a module, or a `partial` of such a
function."""


@dataclass(frozen=True, slots=True)
class Interval:
    """The Monte Carlo result for one coefficient. `low`, `high`: ends of the probabilistically symmetric interval. `shortest`: ends
    of the shortest interval."""

    mean: float
    standard_deviation: float
    low: float
    high: float
    shortest: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Propagated:
    """Contains the result of a propagation of distributions.

    `intervals`: the result for each coefficient. `draws`: number of draws that were made. `stabilised`: True if the results
    stabilised before the largest number of draws was reached. `spread`: array of shape (m,), the uncertainty of the ends of each
    coefficient's interval. For each end of an interval, the half-width of the 95 % confidence interval is computed (Student's t
    over the blocks). `spread` is the larger of the two values; it is infinite if there is only one block.
    """

    intervals: tuple[Interval, ...]
    draws: int
    stabilised: bool
    spread: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Validation:
    """Contains the result of the validation by clause 8 for one coefficient. `low`, `high`: distances between the ends of value ± U
    and the ends of the Monte Carlo interval. `tolerance`: the tolerance δ of clause 8."""

    low: float
    high: float
    tolerance: float

    @property
    def validated(self) -> bool:
        return self.low <= self.tolerance and self.high <= self.tolerance


def propagate(
    draw: Draws,
    tolerances: Sequence[float] | Array,
    probability: float = 0.95,
    seed: int = 0,
    most: int = 1_000_000,
    heavy: Sequence[bool] = (),
    workers: Workers = ALONE,
) -> Propagated:
    """Makes draws in blocks until the results have stabilised, or until `most` draws have been made. A result has stabilised when
    twice the standard deviation of its average over the blocks is smaller than its tolerance. The results are the mean, the
    standard deviation and the two ends of the interval.

    `tolerances`: array of shape (m,), numerical tolerance of the results of each coefficient, in the unit of the coefficient.
    `probability`: coverage probability of the interval. `heavy`: array of shape (m,), True for coefficients whose standard
    deviation need not stabilise. `workers`: processes that share the blocks; with the same seed, the results are identical for any
    number of workers.
    """
    limit = np.asarray(tolerances, dtype=float)
    light = ~np.asarray(heavy, dtype=bool) if len(heavy) else np.ones(len(limit), dtype=bool)
    blocks: list[Array] = []
    found: list[Array] = []
    stabilised = False
    for values, figures in results_in_order(
        partial(_block, draw, probability, seed), range(math.ceil(most / BLOCK)), workers
    ):
        blocks.append(values)
        found.append(figures)
        count = len(found)
        if count > 1:
            spread = 2 * _of_averages(found)
            stabilised = bool(np.all(spread[[0, 2, 3]] <= limit) and np.all(spread[1, light] <= limit[light]))
        if stabilised:
            break
    together = np.concatenate(blocks, axis=1)
    together.sort(axis=1)
    intervals = tuple(_interval(row, probability) for row in together)
    ends = math.inf if len(found) == 1 else coverage_factor(len(found) - 1) * _of_averages(found)[2:].max(axis=0)
    return Propagated(intervals, together.shape[1], stabilised, tuple(np.broadcast_to(ends, limit.shape).tolist()))


def _of_averages(found: Sequence[Array]) -> Array:
    """Returns the standard deviations of the averages of the results over the blocks, in the shape of one result. `found`: the
    results of each block."""
    return np.asarray(np.std(found, axis=0, ddof=1) / math.sqrt(len(found)))


def _block(draw: Draws, probability: float, seed: int, number: int) -> tuple[Array, Array]:
    """Returns two arrays: the draws (m, BLOCK) of one block; and the mean, the standard deviation and the two ends of the interval
    of each coefficient (4, m). The computation uses only one thread, because the last digits of matrix products may depend on the
    number of threads."""
    from threadpoolctl import threadpool_limits

    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))
    with threadpool_limits(limits=1, user_api="blas"):
        values = draw(rng, BLOCK)
        return values, np.array([values.mean(axis=1), values.std(axis=1, ddof=1), *_ends(values, probability)])


def numerical_tolerance(standard_uncertainty: float, digits: int) -> float:
    """Returns the tolerance δ = ½·10^l for an uncertainty u = c·10^l, where c is an integer with `digits` digits (JCGM 101:2008,
    7.9.2)."""
    if not (standard_uncertainty > 0 and math.isfinite(standard_uncertainty)):
        return 0.0
    power = math.floor(math.log10(standard_uncertainty)) - digits + 1
    if round(standard_uncertainty / 10.0**power) >= 10**digits:  # such as 0.0996 in two digits
        power += 1
    return 0.5 * 10.0**power


def validate(value: float, expanded: float, found: Interval, tolerance: float) -> Validation:
    """Compares the interval value ± expanded with the probabilistically symmetric interval of Monte Carlo (JCGM 101:2008, 8.1).
    `tolerance`: the tolerance δ, in the unit of the value."""
    return Validation(abs(value - expanded - found.low), abs(value + expanded - found.high), tolerance)


def influence_draws(influences: Sequence[Influence], m: int) -> Draws:
    """Draws the first-order contributions of inputs to m coefficients from the distributions of the inputs. Inputs that the scatter
    of the data already contains are left out.

    Normal inputs are drawn together from their joint covariance.
    """
    acting = [one for one in influences if not one.in_scatter]
    gaussian = [one for one in acting if one.quantity.distribution == "normal" and _infinite(one.quantity)]
    others = [one for one in acting if one not in gaussian]
    root = square_root(sum((one.covariance for one in gaussian), np.zeros((m, m))))
    return partial(_influences, root, others)


def _influences(root: Array, others: Sequence[Influence], rng: np.random.Generator, n: int) -> Array:
    total = root @ rng.standard_normal((root.shape[1], n))
    for one in others:
        total += one.sensitivities @ _inputs(one.quantity, rng, one.sensitivities.shape[1], n)
    return np.asarray(total)


def t_draws(
    covariance: Array, degrees_of_freedom: Sequence[float] | Array, variances: Sequence[int] | None = None
) -> Draws:
    """Draws m coefficients about zero. The draws are jointly normal with the covariance (m, m), and are then scaled to Student's t
    with the degrees of freedom of each coefficient (JCGM 101:2008, 6.4.9.2).

    `variances`: array of shape (m,), index of the estimated variance on which each coefficient depends; coefficients that depend on
    the same variance have the same scale. By default, coefficients with the same degrees of freedom have the same scale.
    """
    root = square_root(np.asarray(covariance, dtype=float))
    freedoms = np.asarray(degrees_of_freedom, dtype=float)
    keys = freedoms if variances is None else np.asarray(variances, dtype=float)
    groups = [np.flatnonzero((keys == one) & np.isfinite(freedoms)) for one in np.unique(keys)]
    return partial(_scaled_to_t, root, [(rows, float(freedoms[rows[0]])) for rows in groups if len(rows)])


def _scaled_to_t(
    root: Array, groups: Sequence[tuple[NDArray[np.intp], float]], rng: np.random.Generator, n: int
) -> Array:
    """Draws jointly normal values and scales them to Student's t, group by group. Returns n draws of m values, shape (m, n).
    `root`: matrix L for which L·Lᵀ is the covariance (m, m). `groups`: for each estimated variance, its degrees of freedom and the
    rows that depend on it."""
    values = root @ rng.standard_normal((root.shape[1], n))
    for rows, freedom in groups:
        scale = t_scale(rng, freedom, n)
        for row in rows:
            values[row] *= scale
    return np.asarray(values)


def about(centre: Array, *parts: Draws) -> Draws:
    """Adds independent draws about zero to the values `centre` (m, 1)."""
    return partial(_about, centre, parts)


def _about(centre: Array, parts: Sequence[Draws], rng: np.random.Generator, n: int) -> Array:
    total = centre
    for part in parts:
        total = total + part(rng, n)
    return total


def t_scale(rng: np.random.Generator, degrees_of_freedom: float, n: int) -> Array:
    """Returns the factors √(ν/χ²) for n draws, shape (n,), where ν is `degrees_of_freedom`. The products of these factors and
    standard normal draws follow Student's t."""
    return np.asarray(np.sqrt(degrees_of_freedom / rng.chisquare(degrees_of_freedom, n)))


def square_root(covariance: Array) -> Array:
    """Returns a matrix L for which L·Lᵀ is the covariance (m, m), which may be singular. L is computed from the eigenvectors of the
    correlation matrix, so that the units of the quantities do not matter."""
    size = np.sqrt(np.maximum(covariance.diagonal(), 0.0))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(covariance / (size[:, None] * size))
    kept = values > 1e-13 * max(1.0, float(values.max(initial=0.0)))
    return np.asarray(size[:, None] * vectors[:, kept] * np.sqrt(values[kept]))


def _infinite(quantity: InputQuantity) -> bool:
    return math.isinf(quantity.degrees_of_freedom)


def _inputs(quantity: InputQuantity, rng: np.random.Generator, r: int, n: int) -> Array:
    """Draws n deviations of each of r inputs from its value, shape (r, n). The distribution is that of `quantity` (JCGM 101:2008,
    6.4), scaled to the standard uncertainty of `quantity`."""
    u = quantity.standard_uncertainty
    match quantity.distribution:
        case "rectangular":
            return u * math.sqrt(3) * rng.uniform(-1, 1, (r, n))
        case "triangular":
            return u * math.sqrt(1.5) * (rng.uniform(-1, 1, (r, n)) + rng.uniform(-1, 1, (r, n)))
        case "u-shaped":
            return u * math.sqrt(2) * np.sin(rng.uniform(-math.pi, math.pi, (r, n)))
        case _:
            values = u * rng.standard_normal((r, n))
            return values if _infinite(quantity) else values * t_scale(rng, quantity.degrees_of_freedom, n)


def _ends(values: Array, probability: float) -> tuple[Array, Array]:
    """Returns the ends of the probabilistically symmetric interval in each row of `values` (m, n) (JCGM 101:2008, 7.7.2)."""
    below, above = _places(values.shape[1], probability)
    parted = np.partition(values, (below, above), axis=1)
    return parted[:, below], parted[:, above]


def _places(n: int, probability: float) -> tuple[int, int]:
    width = int(probability * n + 0.5)
    below = (n - width) // 2
    return below, min(below + width, n - 1)


def _interval(row: Array, probability: float) -> Interval:
    """Returns the Monte Carlo result for one coefficient. `row`: array of shape (n,), sorted draws."""
    below, above = _places(len(row), probability)
    width = above - below
    start = int(np.argmin(row[width:] - row[: len(row) - width]))
    shortest = float(row[start]), float(row[start + width])
    return Interval(float(row.mean()), float(row.std(ddof=1)), float(row[below]), float(row[above]), shortest)
