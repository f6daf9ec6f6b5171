"""Computes sums of squared differences of a phase record: the inner loops of Allan and Hadamard variances, compiled by numba.

The module is imported only where such sums are needed (see `planrunner.base.compiled`).

For the overlapping sums, the record is processed in short pieces, and each piece is used for all averaging times before the next
piece. A second difference needs three places of the record. If the averaging times are octaves, two of these places were already
read for the previous averaging time and are still in the cache of the processor. Only one of the three is then read from the
memory.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from planrunner.base.arrays import Array, Integers
from planrunner.base.compiled import compiled

PIECE = 2048  # phase points, 16 kB: a few dozen of them stay in a core's second-level cache
SHARED = 2**19  # phase points from which a computation on several cores is faster


@compiled()
def _integrate(values, offset, carry, out):  # type: ignore[no-untyped-def]
    total = carry
    for i in range(values.size):
        total += values[i] - offset
        out[i] = total
    return total


@compiled(fastmath={"reassoc", "nsz"})
def _second_piece(x, factors, piece, partial):  # type: ignore[no-untyped-def]
    low = piece * PIECE
    for k in range(factors.size):
        m = factors[k]
        length = min(low + PIECE, x.size - 2 * m) - low
        if length <= 0:
            continue
        first, middle, last = x[low : low + length], x[low + m :], x[low + 2 * m :]
        total = 0.0
        for i in range(length):
            step = (last[i] - 2.0 * middle[i]) + first[i]
            total += step * step
        partial[piece, k] = total


@compiled(fastmath={"reassoc", "nsz"})
def _third_piece(x, factors, piece, partial):  # type: ignore[no-untyped-def]
    low = piece * PIECE
    for k in range(factors.size):
        m = factors[k]
        length = min(low + PIECE, x.size - 3 * m) - low
        if length <= 0:
            continue
        first, second = x[low : low + length], x[low + m :]
        third, fourth = x[low + 2 * m :], x[low + 3 * m :]
        total = 0.0
        for i in range(length):
            step = (fourth[i] - first[i]) - 3.0 * (third[i] - second[i])
            total += step * step
        partial[piece, k] = total


@compiled()
def _modified_sum(x, m):  # type: ignore[no-untyped-def]
    n = x.size
    if n - 3 * m + 1 <= 0:
        return 0.0
    inner = 0.0
    for i in range(m):
        inner += (x[i + 2 * m] - 2.0 * x[i + m]) + x[i]
    total = inner * inner
    for j in range(n - 3 * m):
        inner += (x[j + 3 * m] - x[j]) - 3.0 * (x[j + 2 * m] - x[j + m])
        total += inner * inner
    return total


@compiled(parallel=True)
def _second_parallel(x, factors, partial):  # type: ignore[no-untyped-def]
    for piece in prange(partial.shape[0]):
        _second_piece(x, factors, piece, partial)


@compiled()
def _second_serial(x, factors, partial):  # type: ignore[no-untyped-def]
    for piece in range(partial.shape[0]):
        _second_piece(x, factors, piece, partial)


@compiled(parallel=True)
def _third_parallel(x, factors, partial):  # type: ignore[no-untyped-def]
    for piece in prange(partial.shape[0]):
        _third_piece(x, factors, piece, partial)


@compiled()
def _third_serial(x, factors, partial):  # type: ignore[no-untyped-def]
    for piece in range(partial.shape[0]):
        _third_piece(x, factors, piece, partial)


@compiled(parallel=True)
def _modified_parallel(x, factors, sums):  # type: ignore[no-untyped-def]
    for k in prange(factors.size):
        sums[k] = _modified_sum(x, factors[k])


@compiled()
def _modified_serial(x, factors, sums):  # type: ignore[no-untyped-def]
    for k in range(factors.size):
        sums[k] = _modified_sum(x, factors[k])


def integrate(values: Array, offset: float, carry: float, out: Array) -> float:
    """Writes the running sum of `values − offset` to `out` and returns its last value. `carry`: the value at which the sum starts."""
    return float(_integrate(values, offset, carry, out))


def second_differences(x: Array, factors: Integers) -> Array:
    """Computes Σ_i (x_{i+2m} − 2x_{i+m} + x_i)² over all i, for each averaging factor m. `x`: array of shape (n,), phase.
    `factors`: array of shape (k,), the averaging factors m. The result has the shape (k,)."""
    partial = np.zeros((max(1, -(-x.size // PIECE)), factors.size))
    (_second_parallel if x.size >= SHARED else _second_serial)(x, factors, partial)
    return np.asarray(partial.sum(axis=0))


def third_differences(x: Array, factors: Integers) -> Array:
    """Computes Σ_i (x_{i+3m} − 3x_{i+2m} + 3x_{i+m} − x_i)² over all i, for each averaging factor m. `x`: array of shape (n,),
    phase. `factors`: array of shape (k,), the averaging factors m. The result has the shape (k,)."""
    partial = np.zeros((max(1, -(-x.size // PIECE)), factors.size))
    (_third_parallel if x.size >= SHARED else _third_serial)(x, factors, partial)
    return np.asarray(partial.sum(axis=0))


def averaged_second_differences(x: Array, factors: Integers) -> Array:
    """Computes Σ_j (Σ_{i=j}^{j+m−1} (x_{i+2m} − 2x_{i+m} + x_i))² over all j, for each averaging factor m. `x`: array of shape
    (n,), phase. `factors`: array of shape (k,), the averaging factors m. The result has the shape (k,)."""
    sums = np.zeros(factors.size)
    (_modified_parallel if x.size >= SHARED else _modified_serial)(x, factors, sums)
    return sums
