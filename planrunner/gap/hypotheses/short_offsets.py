"""Describes a bias that differs for a few seconds at a time, at random times in a run.

An offset of a few seconds changes the mean of its segment and the slow changes within it. The flexible patterns of these
coefficients need one amplitude for each coefficient of the run. A few short offsets need only one amplitude each, so the evidence
for them from the same data is stronger. The part of such an offset that lies outside the coefficients is evaluated with the bursts
(`hypotheses.outside`).

Every window of the run contains an offset with the same small probability. The windows are found one at a time: the best window is
chosen, its offset is fitted, and the next window is evaluated on the remaining data. The result is the evidence of the chosen
windows. It is therefore a lower limit of the evidence of all possible choices. As for bursts, the evidence of a single window is
also stated separately.

In array shapes, M is the number of coefficients of a channel, W is the number of windows, and q is the number of basis vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.weighing import Left
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.outside import CHANCES, KEPT, LENGTHS, whole_and_largest
from planrunner.gap.hypotheses.patterns import Factor, Pattern, Sort

SHORT_OFFSETS = Pattern("offset for a few seconds", Sort.SEVERAL, Factor.TIME)
STEPS = 2  # number of windows of one length that begin within this length
MOST = 16  # largest number of offsets that are fitted
COMPARED = 8  # number of windows with the largest energy of the fit, for which the evidence is computed
LARGEST = 1 << 24  # largest number of coefficients of all windows of one length; longer runs are not examined

_NOTHING = 1e-9  # fraction of the largest energy of a window; smaller energies are rounding errors


@dataclass(frozen=True)
class _Windows:
    """Contains windows of one length. `columns`: array of shape (M, W), the coefficients of an offset of 1 in each window."""

    columns: Array

    @property
    def count(self) -> float:
        """Returns the number of windows that do not overlap."""
        return float(self.columns.shape[1] / STEPS)


class ShortOffsets:
    """Evaluates offsets of a few seconds. Caches the results, because settings of the noise that differ only in one triad use the
    same weights for the other triad."""

    def __init__(self, weighing: Weighing):
        made = (_windows(weighing, length) for length in LENGTHS)
        self._windows = [windows for windows in made if windows is not None]
        self._known: dict[tuple[Left, ...], Array] = {}

    def weighed(self, scopes: Sequence[Sequence[int]], channels: Sequence[Left]) -> tuple[Array, Array]:
        """Returns two log Bayes factors for the channels of each scope, each of shape (scopes,). The first is for any number of
        short offsets, the second for one short offset. Both are −∞ if the run has no windows."""
        found = []
        for scope in scopes:
            key = tuple(channels[index] for index in scope)
            if key not in self._known:
                each = [_evidence(windows, key) for windows in self._windows]
                self._known[key] = log_mean_exp(np.array(each), 0) if each else np.full(2, -np.inf)
            found.append(self._known[key])
        several, single = np.array(found).T
        return np.asarray(several), np.asarray(single)


def _windows(weighing: Weighing, length: float) -> _Windows | None:
    """Divides every segment into windows of `length` seconds, of which at least two must fit into the segment. Returns None if there
    are no windows or too many."""
    observed, spectrum = weighing.observed, weighing.spectrum
    placed: list[tuple[int, Array]] = []
    total = 0
    for index, basis in enumerate(spectrum.bases):
        samples = len(basis.vectors)
        size = round(length * observed.sample_rate / int(observed.bin_size[index]))
        starts = np.arange(0, samples - size + 1, max(size // STEPS, 1))
        if size < 1 or samples < 2 * size:
            continue
        total += len(starts)
        if total * len(spectrum.segment) > LARGEST:
            return None
        sums = np.vstack([np.zeros(basis.vectors.shape[1]), np.cumsum(basis.vectors, axis=0)])
        placed.append((index, (sums[starts + size] - sums[starts]).T * np.sqrt(int(observed.bin_size[index]))))
    if not placed:
        return None
    columns = np.zeros((len(spectrum.segment), total))
    owner = np.repeat([index for index, _ in placed], [own.shape[1] for _, own in placed])
    for index, own in placed:
        columns[np.ix_(spectrum.segment == index, owner == index)] = own
    return _Windows(columns)


def _evidence(windows: _Windows, channels: Sequence[Left]) -> Array:
    """Returns two log Bayes factors of offsets in the same windows of all `channels`, shape (2,): the first for all windows, the
    second for a single window. Several windows of one segment do not count as a single event, because together they may be an
    offset of the whole segment."""
    rows = np.arange(len(windows.columns))
    parts = [_Channel.of(left, *left.whitened(windows.columns, rows)) for left in channels]
    whole = np.sum([part.size for part in parts], axis=0)
    gains: list[float] = []
    while len(gains) < MOST:
        size, score = (np.column_stack([getattr(part, name) for part in parts]) for name in ("size", "score"))
        unit = size.sum(1)
        free = unit > KEPT * whole
        most = np.where(free, 0.5 * (score**2 / np.maximum(size, _NOTHING * unit.max())).sum(1), 0.0)
        top = np.argsort(-most)[:COMPARED]
        top = top[most[top] + _odds(max(CHANCES)) > 0]
        if not len(top):
            break
        each = averaged(from_eigen(size[top] / unit[top, None], score[top] ** 2 / unit[top, None], 1.0))
        best = int(top[np.argmax(each)])
        if each.max() + _odds(max(CHANCES)) <= 0:
            break
        gains.append(float(each.max()))
        parts = [part.without(best) for part in parts]
    total = []
    for chance in CHANCES:
        more = np.maximum(np.array(gains) + _odds(chance), 0.0)
        total.append(windows.count * np.log1p(-chance) + whole_and_largest(more))
    return np.asarray(log_mean_exp(np.array(total), 0))


def _odds(chance: float) -> float:
    """Returns the log prior odds of an offset in one of the `STEPS` positions of a window. `chance`: probability that a window
    contains an offset."""
    return float(np.log(chance / (1 - chance) / STEPS))


@dataclass(frozen=True)
class _Channel:
    """Contains the windows of a channel after some offsets have been fitted. `at`: array of shape (n,), rows in which the whitened
    `columns` (n, W) are not zero. `basis`: array of shape (M, q), orthonormal basis of the nominal columns and of the fitted
    offsets. `residual`: array of shape (M,). `size`, `score`: arrays of shape (W,), energy of each column outside the basis, and
    its product with the residual."""

    at: NDArray[np.int64]
    columns: Array
    basis: Array
    residual: Array
    size: Array
    score: Array

    @classmethod
    def of(cls, left: Left, at: NDArray[np.int64], columns: Array) -> _Channel:
        size = (columns**2).sum(0) - ((left.basis[at].T @ columns) ** 2).sum(0)
        score = columns.T @ left.residual[at]
        return cls(at, columns, left.basis, left.residual, np.maximum(size, 0.0), score)

    def without(self, window: int) -> _Channel:
        """Returns the channel after the offset of a window has been fitted."""
        column = np.zeros(len(self.residual))
        column[self.at] = self.columns[:, window]
        column -= self.basis @ (self.basis.T @ column)
        column /= max(float(np.linalg.norm(column)), 1e-300)
        along, amount = column[self.at] @ self.columns, float(column @ self.residual)
        return _Channel(
            self.at,
            self.columns,
            np.column_stack([self.basis, column]),
            self.residual - amount * column,
            np.maximum(self.size - along**2, 0.0),
            self.score - amount * along,
        )
