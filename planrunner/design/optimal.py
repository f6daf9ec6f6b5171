"""Searches for positions that need not be in a list of candidates, by local optimisation over continuous settings from many seeded
starts.

A setting is a row of k numbers within bounds, such as the joint angles of a table; the table can therefore reach every result. The
function `rows_of` computes rows of the design matrix (m, p) from settings (m, k); the columns are divided by their magnitudes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.workers import ALONE, Workers, results_in_order
from planrunner.design import exchange
from planrunner.design.continuous import Continuous, derivative, solve, solve_with_climbing

RowsOf = Callable[[Array], Array]
Progress = Callable[[float], None]

DIFFERENCE = 1e-5  # rad, step of central differences, whose error is then about 1e-10 for smooth rows
LEAST_SHARE = 0.25  # fraction of the time that each position would have if all times were equal
CLIMBERS = 24  # number of points from which the search climbs


@dataclass(frozen=True, slots=True)
class Region:
    """The region in which a search looks for the best settings.

    `settings`: array of shape (N, k), candidates spread over the region. `rows`: array of shape (N, p), rows of the design matrix
    at these candidates. `bounds`: lowest and highest value of each of the k numbers, infinite where there is no bound.
    """

    rows_of: RowsOf
    settings: Array
    rows: Array
    bounds: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class Found:
    """The result of a search for settings.

    `settings`: array of shape (n, k), the best settings. `loss`: −ln|M| or tr(W·M⁻¹). `starts`: number of local optimisations.
    `agreeing`: number of local optimisations whose loss differs from the smallest loss by at most 1e-4 (for tr(W·M⁻¹), relative to
    the smallest loss).
    """

    settings: Array
    loss: float
    starts: int
    agreeing: int


def region(rows_of: RowsOf, settings: Array, bounds: Sequence[tuple[float, float]]) -> Region:
    settings = np.asarray(settings, dtype=float)
    return Region(rows_of, settings, rows_of(settings), tuple(bounds))


def spread(bounds: Sequence[tuple[float, float]], count: int, seed: int) -> Array:
    """Returns random settings, shape (count, k), which are uniformly distributed within the bounds. An angle without bounds covers
    one turn."""
    low = np.array([-math.pi if math.isinf(low) else low for low, _ in bounds])
    high = np.array([math.pi if math.isinf(high) else high for _, high in bounds])
    return np.asarray(low + (high - low) * np.random.default_rng(seed).random((count, len(bounds))))


def search(
    over: Region,
    count: int,
    weighting: Array | None = None,
    *,
    restarts: int = 30,
    seed: int = 0,
    starts: Sequence[Array] = (),
    fixed: Array | None = None,
    progress: Progress | None = None,
    workers: Workers = ALONE,
) -> Found:
    """Searches for the best `count` settings. Exchange among the candidates of the region gives several sets of settings, and local
    optimisation improves each set.

    `starts`: additional settings (count, k) to improve, such as the settings of a plan. `fixed`: array of shape (p, p), information
    that does not depend on the choice. `workers`: number of processes that share the sets to improve. The same seed gives the same
    settings for any number of workers.
    """
    sets = exchange.exchange(over.rows, count, weighting, restarts=restarts, seed=seed, repeats=True, fixed=fixed)
    begun = [*starts, *(over.settings[chosen.indices] for chosen in sets)]
    best, losses = begun[0], []
    for settings, loss in results_in_order(partial(_refined, over, weighting, fixed), begun, workers, progress):
        losses.append(loss)
        if losses[-1] <= min(losses):
            best = settings
    least = min(losses)
    near = least + 1e-4 * (1.0 if weighting is None else abs(least))
    return Found(best, least, len(begun), sum(one <= near for one in losses))


def _refined(over: Region, weighting: Array | None, fixed: Array | None, start: Array) -> tuple[Array, float]:
    settings = refine(over, start, weighting, fixed)
    return settings, exchange.loss(over.rows_of(settings), weighting, fixed)


def refine(over: Region, start: Array, weighting: Array | None = None, fixed: Array | None = None) -> Array:
    """Returns the local optimum that L-BFGS-B reaches from `start` (n, k), in the same shape. The derivatives of the criterion with
    respect to the rows are exact."""
    from scipy.optimize import minimize

    shape = start.shape
    always = 1e-12 * np.eye(over.rows.shape[1]) + (0.0 if fixed is None else fixed)

    def value(flat: Array) -> tuple[float, Array]:
        rows, slopes = with_slopes(over.rows_of, flat.reshape(shape))
        matrix = rows.T @ rows + always
        inverse = np.linalg.inv(matrix)
        if weighting is None:
            return -float(np.linalg.slogdet(matrix)[1]), -2.0 * np.einsum("nkp,np->nk", slopes, rows @ inverse).ravel()
        middle = inverse @ weighting @ inverse
        return float(np.trace(weighting @ inverse)), -2.0 * np.einsum("nkp,np->nk", slopes, rows @ middle).ravel()

    done = minimize(
        value, start.ravel(), jac=True, method="L-BFGS-B", bounds=boxed(over, shape[0]), options={"maxiter": 300}
    )
    return np.asarray(done.x).reshape(shape)


def climb(over: Region, matrix: Array, weighting: Array | None = None) -> tuple[Array, Array]:
    """Finds local maxima of the derivative of the criterion by climbing from candidates with a large derivative. Returns the rows
    (m, p) at the maxima, and the values (m,) of the derivative there. `matrix`: the information matrix M (p, p). `weighting`: the
    matrix W (p, p), None for criterion D."""
    from scipy.optimize import minimize

    inverse = np.linalg.inv(matrix)
    middle = inverse if weighting is None else inverse @ weighting @ inverse
    height = derivative(over.rows, matrix, weighting)
    # Starts from the highest candidate of each part of the list. The highest candidates of the whole list would climb the same hill.
    top = np.array(
        [part[np.argmax(height[part])] for part in np.array_split(np.arange(len(height)), CLIMBERS) if len(part)]
    )
    start = over.settings[top]

    def value(flat: Array) -> tuple[float, Array]:
        rows, slopes = with_slopes(over.rows_of, flat.reshape(start.shape))
        carried = rows @ middle
        return -float(np.sum(carried * rows)), -2.0 * np.einsum("nkp,np->nk", slopes, carried).ravel()

    done = minimize(
        value,
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=boxed(over, len(start)),
        options={"maxiter": 100, "ftol": 1e-12},
    )
    rows = over.rows_of(np.asarray(done.x).reshape(start.shape))
    return rows, derivative(rows, matrix, weighting)


def bound(
    over: Region,
    begin: Array,
    weighting: Array | None = None,
    *,
    tolerance: float = 1e-5,
    fixed: Array | None = None,
) -> Continuous:
    """Returns the continuous optimum over the region, with its certificate. The certificate is valid if climbing from the
    candidates finds all maxima.

    `begin`: array of shape (m, k), settings to begin with, such as the best sets found. The closer these settings are to the
    optimum, the sooner the optimum is certified.
    """
    spots = over.rows[np.argsort(-np.sum(over.rows**2, axis=1), kind="stable")[: len(over.rows) // 20]]
    rows = np.vstack([over.rows_of(begin), spots])
    return solve_with_climbing(
        rows, lambda matrix, w: climb(over, matrix, w), weighting, tolerance=tolerance, fixed=fixed
    )


def allocate(rows: Array, weighting: Array | None = None, *, fixed: Array | None = None) -> Array:
    """Returns the fractions of the total recording time for the positions with the rows `rows` (n, p). The result has the shape
    (n,), and its sum is 1. The variance of an observation is inversely proportional to its time. Each fraction is at least
    `LEAST_SHARE`/n. All positions therefore remain in the plan, so that the model can be checked."""
    return solve(rows, weighting, least=LEAST_SHARE / len(rows), tolerance=1e-9, fixed=fixed).shares


def with_slopes(rows_of: RowsOf, settings: Array) -> tuple[Array, Array]:
    """Returns the rows (n, p) of the design matrix, and their derivatives (n, k, p) with respect to the settings, computed by
    central differences."""
    n, k = settings.shape
    steps = DIFFERENCE * np.eye(k)
    moved = np.concatenate([settings[:, None] + steps, settings[:, None] - steps], axis=1)
    rows = rows_of(np.concatenate([settings, moved.reshape(-1, k)]))
    pairs = rows[n:].reshape(n, 2, k, -1)
    return rows[:n], (pairs[:, 0] - pairs[:, 1]) / (2 * DIFFERENCE)


def boxed(over: Region, count: int) -> list[tuple[float | None, float | None]]:
    """Returns the bounds of `count` settings in sequence, as scipy expects them: None where there is no bound."""
    own = [(None if math.isinf(low) else low, None if math.isinf(high) else high) for low, high in over.bounds]
    return own * count
