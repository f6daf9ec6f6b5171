"""Chooses the best n candidates of a list. If there are few possible choices, all of them are tried; otherwise, exchange is used
from many starts.

In an exchange (Fedorov 1972; in the form of Cook & Nachtsheim, Technometrics 22, 1980), each point in turn is replaced by the
candidate that is best together with the other points. The exchange ends when no replacement improves the set. Let S be the inverse
information of the other points, and d = xᵀSx. Adding the candidate x then multiplies the determinant by 1 + d, and reduces
tr(W·M⁻¹) by xᵀSWSx/(1 + d). `fixed`, shape (p, p), is information that does not depend on the choice.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array

Indices = NDArray[np.intp]
Progress = Callable[[float], None]

MOST_CHOICES = 1_000_000
"""If there are at most this many choices, all of them are tried."""
_CHUNK = 50_000
_RIDGE = 1e-10  # keeps the information matrix of the other points invertible if they are too few


@dataclass(frozen=True, slots=True)
class Chosen:
    """The result of a choice among candidates.

    `indices`: array of shape (n,), indices of the chosen candidates, ascending. `loss`: −ln|M| (criterion D) or tr(W·M⁻¹); infinite
    if no choice determines all terms. `tried`: number of choices or restarts that were tried. `exhaustive`: True if all choices
    were tried.
    """

    indices: Indices
    loss: float
    tried: int
    exhaustive: bool


def loss(rows: Array, weighting: Array | None = None, fixed: Array | None = None) -> float:
    """Returns the loss, −ln|M| or tr(W·M⁻¹), of one set of rows (n, p)."""
    if fixed is not None:
        rows = np.concatenate([rows, root(fixed)])
    singular = np.linalg.svd(rows, compute_uv=False)
    if len(rows) < rows.shape[1] or singular[-1] <= 1e-9 * singular[0]:
        return math.inf
    if weighting is None:
        return float(-2.0 * np.sum(np.log(singular)))
    return float(np.trace(weighting @ np.linalg.inv(rows.T @ rows)))


def root(information: Array) -> Array:
    """Returns p rows, shape (p, p), that have the given information matrix."""
    values, vectors = np.linalg.eigh(information)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


def choose(
    rows: Array,
    count: int,
    weighting: Array | None = None,
    *,
    seed: int = 0,
    fixed: Array | None = None,
    progress: Progress | None = None,
) -> Chosen:
    """Returns the best set of `count` different candidates among `rows` (N, p), by exhaustive search if feasible, otherwise by
    exchange. `weighting`: the matrix W (p, p), None for criterion D. Raises ValueError if there are too few candidates."""
    if math.comb(len(rows), count) <= MOST_CHOICES:
        return exhaust(rows, count, weighting, progress, fixed)
    return exchange(rows, count, weighting, seed=seed, fixed=fixed, progress=progress)[0]


def exhaust(
    rows: Array,
    count: int,
    weighting: Array | None = None,
    progress: Progress | None = None,
    fixed: Array | None = None,
) -> Chosen:
    """Returns the best of all choices of `count` different candidates among `rows` (N, p). `weighting`: the matrix W (p, p), None
    for criterion D."""
    p = rows.shape[1]
    outers = np.einsum("ni,nj->nij", rows, rows).reshape(len(rows), p * p)
    total = math.comb(len(rows), count)
    best, best_loss, done = np.arange(count), math.inf, 0
    for chunk in _chunks(len(rows), count):
        member = np.zeros((len(chunk), len(rows)))
        np.put_along_axis(member, chunk, 1.0, axis=1)
        matrices = (member @ outers).reshape(-1, p, p)
        losses = _losses(matrices if fixed is None else matrices + fixed, weighting)
        least = int(np.argmin(losses))
        if losses[least] < best_loss:
            best, best_loss = chunk[least], float(losses[least])
        done += len(chunk)
        if progress:
            progress(done / total)
    return Chosen(best, best_loss, total, True)


def _chunks(size: int, count: int) -> Iterator[Indices]:
    choices = itertools.combinations(range(size), count)
    while taken := list(itertools.islice(choices, _CHUNK)):
        yield np.fromiter(itertools.chain.from_iterable(taken), dtype=np.intp, count=len(taken) * count).reshape(
            -1, count
        )


def _losses(matrices: Array, weighting: Array | None) -> Array:
    """Returns the losses of many information matrices (N, p, p); the loss of a singular matrix is infinite."""
    p = matrices.shape[-1]
    sign, logarithm = np.linalg.slogdet(matrices)
    size = np.log(np.maximum(np.trace(matrices, axis1=1, axis2=2) / p, 1e-300))
    sound = (sign > 0) & (logarithm - p * size > 2 * math.log(1e-9))
    result = np.full(len(matrices), math.inf)
    if weighting is None:
        result[sound] = -logarithm[sound]
    elif sound.any():
        result[sound] = np.einsum("ij,nji->n", weighting, np.linalg.inv(matrices[sound]))
    return result


def exchange(
    rows: Array,
    count: int,
    weighting: Array | None = None,
    *,
    restarts: int = 30,
    seed: int = 0,
    repeats: bool = False,
    fixed: Array | None = None,
    progress: Progress | None = None,
) -> list[Chosen]:
    """Returns the sets of `count` candidates among `rows` (N, p) that exchange finds from `restarts` random sets, the best first.
    The same seed gives the same sets. `weighting`: the matrix W (p, p), None for criterion D. `repeats`: True if a set may contain
    a candidate more than once. Raises ValueError if there are too few candidates for a set without repeats."""
    if not repeats and count > len(rows):
        raise ValueError(f"{count} different positions cannot be chosen from {len(rows)}")
    random = np.random.default_rng(seed)
    found = []
    for turn in range(restarts):
        start = random.choice(len(rows), size=count, replace=repeats or count > len(rows))
        indices = np.sort(_settle(rows, start, weighting, repeats, fixed))
        found.append(Chosen(indices, loss(rows[indices], weighting, fixed), restarts, False))
        if progress:
            progress((turn + 1) / restarts)
    return sorted(found, key=lambda chosen: (chosen.loss, *chosen.indices.tolist()))


def _settle(rows: Array, start: Indices, weighting: Array | None, repeats: bool, fixed: Array | None = None) -> Indices:
    indices = start.copy()
    ridge = _RIDGE * max(float(np.mean(rows**2)), 1e-300) * np.eye(rows.shape[1])
    if fixed is not None:
        ridge = ridge + fixed
    matrix = rows[indices].T @ rows[indices] + ridge
    for _ in range(200):
        before = indices.copy()
        for place in range(len(indices)):
            others = matrix - np.outer(rows[indices[place]], rows[indices[place]])
            worth = _worth(rows, others, weighting)
            if not repeats:
                worth[np.delete(indices, place)] = -math.inf
            best = int(np.argmax(worth))
            if worth[best] > worth[indices[place]] * (1 + 1e-10):
                indices[place] = best
            matrix = others + np.outer(rows[indices[place]], rows[indices[place]])
        matrix = rows[indices].T @ rows[indices] + ridge  # computed again, because repeated differences lose digits
        if np.array_equal(indices, before):
            break
    return indices


def _worth(rows: Array, others: Array, weighting: Array | None) -> Array:
    """Returns, for each candidate, a measure of the information that the candidate adds to the information of the other points.
    Only the order of these values matters."""
    values, vectors = np.linalg.eigh(others)
    inverse = (vectors / np.maximum(values, 1e-13 * max(values[-1], 1e-300))) @ vectors.T
    carried = rows @ inverse
    variance = np.einsum("ij,ij->i", carried, rows)
    if weighting is None:
        return np.asarray(variance)
    return np.asarray(np.einsum("ij,ij->i", carried @ weighting, carried) / (1.0 + variance))
