"""Describes a bias that differs for a few seconds at a time, at random times in a run, and the rare events in the noise.

An offset of a few seconds changes the mean of its segment and the slow changes within it. The flexible patterns of these
coefficients need one amplitude for each coefficient of the run. A few short offsets need only one amplitude each, so the evidence
for them from the same data is stronger. The part of such an offset that lies outside the coefficients is evaluated with the bursts
(`hypotheses.outside`).

Every window of the run contains an offset with the same small probability. The windows are found one at a time: the best window is
chosen, its offset is fitted, and the next window is evaluated on the remaining data. The result is the evidence of the chosen
windows. It is therefore a lower limit of the evidence of all possible choices.

The noise of real sensors contains rare events, for example knocks. An event lasts for a few seconds. It appears in the coefficients as
a short offset, or outside them as a burst (`hypotheses.outside`). Every hypothesis contains such events, so they are no evidence for a
cause. Their times follow a Poisson process. The rate of this process is not known. Each event has its own size and channels,
independently of the other events. A cause outside the catalogue differs from these events: it acts in the same channels each time, it
may be larger, and it may recur more often. Events are found in the same way as short offsets.

A window acts only on the m coefficients of its own segment. Therefore, whitened windows are never stored: the products of two of
them follow from the m × m products of the whitened coefficients of a segment, and their products with a column y follow from Gᵀ·y,
where G is the whitening matrix.

In array shapes, S is the number of segments, M of coefficients of a channel, m of coefficients of a segment, W of windows, q of basis
vectors, E of events, and Q of rates of events.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.weighing import Left
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import Factor, Pattern, Sort

SHORT_OFFSETS = Pattern("offset for a few seconds", Sort.SEVERAL, Factor.TIME)
LENGTHS = (1.0, 2.0, 4.0)  # s, lengths of the windows in which offsets and bursts are searched for
CHANCES = (0.005, 0.02, 0.08)  # probability of an offset or a burst in a window
KEPT = 0.5  # smallest fraction of the energy of an offset that must be left after the other parameters are fitted
RATES = np.array([1e-5, 1e-4, 1e-3, 1e-2])
"""Possible rates of events, 1/s: from one event in a day to one in 100 s. All are equally probable."""
LARGEST = 50.0
"""Nats, half the energy of an event of 10 standard deviations. A larger event does not count as noise, so an event has at most this
evidence."""
LONGER = 8.0  # s, length of further windows: an offset of such a window is too long for an event of the noise
STEPS = 2  # number of windows that begin within the length of a window, as far as whole samples allow
MOST = 16  # largest number of offsets that are fitted
COMPARED = 8  # number of windows with the largest energy of the fit, for which the evidence is computed
LONGEST = (
    1 << 24
)  # largest number of windows of one length times coefficients of a channel; longer runs are not examined

_AT_ONCE = 16  # number of segments whose coefficients are whitened together
_ROUNDING = 1e-6  # s, by which events may last longer than allowed
_NOTHING = 1e-9  # fraction of the largest energy of a window; smaller energies are rounding errors


@dataclass(frozen=True)
class Events:
    """Contains the events that the coefficients show.

    `gains`: array of shape (E,), log Bayes factor of each event, multiplied by the seconds in which it can begin (the sum over all
    windows of the same kind is the duration of the run). `channels`: for each event, the indices of its channels. `seconds`: duration
    of the run, s.
    """

    gains: Array
    channels: tuple[frozenset[int], ...]
    seconds: float

    @property
    def none(self) -> Array:
        """Returns the log probability of no event at each rate, shape (Q,)."""
        return np.asarray(-RATES * self.seconds)

    def log_bayes(self, without: Collection[int] = ()) -> Array:
        """Returns the log Bayes factor of the events at each rate, relative to noise without events, shape (Q,). Events in the channels
        `without` do not count."""
        used = np.array([own.isdisjoint(without) for own in self.channels], dtype=bool)
        grown = np.log(RATES)[:, None] + self.gains[used]
        return np.asarray(np.logaddexp(0.0, grown).sum(1) + self.none)


def averaged_over_rates(log_bayes: Array) -> Array:
    """Returns the log Bayes factor of noise with events of an unknown rate, shape (…). It is zero if noise without events is more
    probable. `log_bayes`: array of shape (…, Q), sum of the log Bayes factors of the events in the coefficients and outside them."""
    return np.asarray(np.maximum(log_mean_exp(log_bayes, -1), 0.0))


@dataclass(frozen=True)
class _Windows:
    """Contains windows of one length.

    `length`: length of the windows, s. `coefficients`: array of shape (W, m), the coefficients that an offset of 1 in each window causes
    in its segment; zero beyond the number of coefficients of the segment. `segment`: array of shape (W,), index of the segment of each
    window. `share`: array of shape (W,), the distance between the beginnings of successive windows, divided by their length. `rows`:
    array of shape (S, m), indices of the coefficients of each segment, −1 beyond their number.
    """

    length: float
    coefficients: Array
    segment: NDArray[np.int64]
    share: Array
    rows: NDArray[np.int64]

    @property
    def count(self) -> float:
        """Returns the number of windows that do not overlap."""
        return float(self.share.sum())

    def products(self, column: Array) -> Array:
        """Returns the product of each window with a column (M,), shape (W,)."""
        padded = np.append(column, 0.0)[self.rows]  # −1 selects the zero
        return np.asarray(np.einsum("wj,wj->w", self.coefficients, padded[self.segment]))

    def energies(self, products: Array) -> Array:
        """Returns the energy of each window, shape (W,). `products`: array of shape (S, m, m), the products of the whitened coefficients
        of each segment with each other."""
        found = np.empty(len(self.segment))
        ends = np.searchsorted(self.segment, np.arange(len(products) + 1))
        for index, (low, high) in enumerate(pairwise(ends)):
            own = self.coefficients[low:high]
            found[low:high] = np.einsum("wj,wj->w", own @ products[index], own)
        return found

    def of(self, window: int) -> tuple[Array, NDArray[np.int64]]:
        """Returns the coefficients of one window, and their indices among all coefficients."""
        rows = self.rows[self.segment[window]]
        inside = rows >= 0
        return self.coefficients[window, inside], rows[inside]


class ShortOffsets:
    """Evaluates offsets of a few seconds. Caches the results, because settings of the noise that differ only in one triad use the
    same weights for the other triad."""

    def __init__(self, weighing: Weighing):
        made = (_windows(weighing, length) for length in (*LENGTHS, LONGER))
        self._windows = [windows for windows in made if windows is not None]
        self._lasting = weighing.observed.counts / weighing.observed.sample_rate
        self._known: dict[tuple[Left, ...], float] = {}
        self._channels: dict[Left, list[_Channel]] = {}

    def weighed(self, scopes: Sequence[Sequence[int]], channels: Sequence[Left]) -> Array:
        """Returns the log Bayes factor of short offsets in the channels of each scope, shape (scopes,). It is −∞ if the run has no
        windows."""
        found = []
        for scope in scopes:
            key = tuple(channels[index] for index in scope)
            if key not in self._known:
                parts = zip(*map(self._of, key), strict=True)
                each = [_evidence(windows, own) for windows, own in zip(self._windows, parts, strict=False)]
                self._known[key] = float(log_mean_exp(np.array(each), 0)) if each else -np.inf
            found.append(self._known[key])
        return np.array(found)

    def events(self, scopes: Sequence[Sequence[int]], channels: Sequence[Left]) -> Events:
        """Returns the events of the noise. The most probable event is found first. It is fitted, and the next one is then found in the
        remaining data. All scopes and lengths are equally probable. The events of a segment together last for at most 4 s, and at most
        for half of the segment: longer ones may be an offset of the segment."""
        lasting, most = self._lasting, np.minimum(self._lasting / 2, max(LENGTHS))
        parts = [self._of(left) for left in channels]
        short = [number for number, windows in enumerate(self._windows) if windows.length <= max(LENGTHS)]
        forms = [(scope, length) for scope in range(len(scopes)) for length in short]
        whole = {form: np.sum([parts[c][form[1]].size for c in scopes[form[0]]], axis=0) for form in forms}
        cost = np.log(max(len(forms), 1)) - np.log(RATES.max())
        covered, stale = np.zeros(len(lasting)), set(forms)
        likeliest: dict[tuple[int, int], tuple[float, int]] = {}
        gains: list[float] = []
        acting: list[frozenset[int]] = []
        while forms and len(gains) < MOST:
            for form in stale:
                scope, length = form
                windows = self._windows[length]
                free = (covered + windows.length <= most + _ROUNDING)[windows.segment]
                prior = np.where(free, np.log(windows.share * windows.length), -np.inf)
                likeliest[form] = _best([parts[c][length] for c in scopes[scope]], whole[form], prior, cost)
            best = max(forms, key=lambda form: likeliest[form][0])
            gain, window = likeliest[best]
            if gain <= cost:
                break
            windows = self._windows[best[1]]
            segment, seconds = int(windows.segment[window]), float(np.log(windows.share[window] * windows.length))
            gains.append(min(gain - seconds, LARGEST) + seconds - float(np.log(len(forms))))
            acting.append(frozenset(scopes[best[0]]))
            covered[segment] += windows.length
            column = [(c, *parts[c][best[1]].column(window)) for c in scopes[best[0]]]
            for channel, fitted, amount in column:
                parts[channel] = [part.fitted(fitted, amount) for part in parts[channel]]
            stale = {
                form
                for form in forms
                if acting[-1] & set(scopes[form[0]])
                or int(self._windows[form[1]].segment[likeliest[form][1]]) == segment
            }
        return Events(np.array(gains), tuple(acting), float(lasting.sum()))

    def _of(self, left: Left) -> list[_Channel]:
        """Returns the windows of each length in a channel."""
        if left not in self._channels:
            products = _products(left, self._windows[0].rows) if self._windows else np.empty(0)
            self._channels[left] = [_Channel.of(left, windows, products) for windows in self._windows]
        return self._channels[left]


def _windows(weighing: Weighing, length: float) -> _Windows | None:
    """Divides every segment into windows of `length` seconds, of which at least two must fit into the segment. Returns None if there
    are no windows or too many."""
    observed, spectrum = weighing.observed, weighing.spectrum
    coefficients, owners, shares, total = [], [], [], 0
    sums: dict[int, Array] = {}
    widest = max(basis.vectors.shape[1] for basis in spectrum.bases)
    for index, basis in enumerate(spectrum.bases):
        samples = len(basis.vectors)
        size = round(length * observed.sample_rate / int(observed.bin_size[index]))
        step = max(size // STEPS, 1)
        starts = np.arange(0, samples - size + 1, step)
        if size < 1 or samples < 2 * size:
            continue
        total += len(starts)
        if total * len(spectrum.segment) > LONGEST:
            return None
        if id(basis) not in sums:
            sums[id(basis)] = np.zeros((samples + 1, widest))
            np.cumsum(basis.vectors, axis=0, out=sums[id(basis)][1:, : basis.vectors.shape[1]])
        own = sums[id(basis)]
        coefficients.append((own[starts + size] - own[starts]) * np.sqrt(int(observed.bin_size[index])))
        owners.append(np.full(len(starts), index))
        shares.append(np.full(len(starts), step / size))
    if not coefficients:
        return None
    return _Windows(
        length, np.concatenate(coefficients), np.concatenate(owners), np.concatenate(shares), _rows(weighing)
    )


def _rows(weighing: Weighing) -> NDArray[np.int64]:
    """Returns the indices of the coefficients of each segment, shape (S, m); −1 beyond the number of coefficients of a segment."""
    rows = weighing.spectrum.rows
    found = np.full((len(rows), max(own.stop - own.start for own in rows)), -1)
    for index, own in enumerate(rows):
        found[index, : own.stop - own.start] = np.arange(own.start, own.stop)
    return found


def _products(left: Left, rows: NDArray[np.int64]) -> Array:
    """Returns the products of the whitened coefficients of each segment with each other, shape (S, m, m). `rows`: the same as in
    `_Windows`."""
    found = np.zeros((*rows.shape, rows.shape[1]))
    for first in range(0, len(rows), _AT_ONCE):
        inside = rows[first : first + _AT_ONCE] >= 0
        own = rows[first : first + _AT_ONCE][inside]
        _, whitened = left.whitened(np.eye(len(own)), own)
        gram = whitened.T @ whitened
        ends = np.cumsum([0, *inside.sum(axis=1)])
        for index, (low, high) in enumerate(pairwise(ends)):
            found[first + index, : high - low, : high - low] = gram[low:high, low:high]
    return found


def _evidence(windows: _Windows, parts: Sequence[_Channel]) -> float:
    """Returns the log Bayes factor of offsets in the same windows of several channels (`parts`). With equal probability, each offset has
    its own size, or all offsets have the same size: a cause that acts for a few seconds at a time often has the same strength each
    time."""
    whole, prior, first = np.sum([part.size for part in parts], axis=0), np.log(windows.share), parts
    gains: list[float] = []
    found: list[int] = []
    least = -_odds(max(CHANCES))
    while len(gains) < MOST:
        gain, best = _best(parts, whole, prior, least)
        if gain <= least:
            break
        gains.append(gain)
        found.append(best)
        parts = [part.without(best) for part in parts]
    alike = _alike(first, found) + np.cumsum(prior[np.array(found, dtype=int)])
    total = []
    for chance in CHANCES:
        own = np.maximum(np.array(gains) + _odds(chance), 0.0).sum()
        same = alike + np.arange(1, len(found) + 1) * _odds(chance)
        both = np.logaddexp.reduce([own, 0.0, *same]) - np.log(2.0)
        total.append(windows.count * np.log1p(-chance) + both)
    return float(log_mean_exp(np.array(total), 0))


def _alike(parts: Sequence[_Channel], found: Sequence[int]) -> Array:
    """Returns the log Bayes factor of offsets of the same size in the first windows of `found`, for each number of windows, shape
    (len(found),)."""
    size, score = np.zeros((len(found), len(parts))), np.zeros((len(found), len(parts)))
    for index, part in enumerate(parts):
        column = np.zeros(len(part.residual))
        for number, window in enumerate(found):
            column = column + part.outside(window)
            size[number, index], score[number, index] = column @ column, column @ part.residual
    unit = np.maximum(size.sum(1, keepdims=True), 1e-300)
    return averaged(from_eigen(size / unit, score**2 / unit, 1.0))


def _best(parts: Sequence[_Channel], whole: Array, prior: Array, least: float) -> tuple[float, int]:
    """Returns the log Bayes factor of an offset in the most probable window, multiplied by its prior probability, and the index of this
    window. The first is −∞ if no window reaches `least`. `whole`: array of shape (W,), energy of each window before any offset has been
    fitted. `prior`: array of shape (W,), log prior probability of each window, up to a constant."""
    size, score = (np.column_stack([getattr(part, name) for part in parts]) for name in ("size", "score"))
    unit = size.sum(1)
    most = 0.5 * (score**2 / np.maximum(size, _NOTHING * unit.max())).sum(1)
    most = np.where(unit > KEPT * whole, most, 0.0) + prior
    top = np.argsort(-most)[:COMPARED]
    top = top[most[top] > least]
    if not len(top):
        return -np.inf, 0
    each = averaged(from_eigen(size[top] / unit[top, None], score[top] ** 2 / unit[top, None], 1.0)) + prior[top]
    return float(each.max()), int(top[np.argmax(each)])


def _odds(chance: float) -> float:
    """Returns the log prior odds of an offset in a window. `chance`: probability that a window contains an offset."""
    return float(np.log(chance / (1 - chance)))


@dataclass(frozen=True)
class _Channel:
    """Contains the windows of a channel after some offsets have been fitted. `left`: the weighted coefficients of the channel. `basis`:
    array of shape (M, q), orthonormal basis of the nominal columns and of the fitted offsets. `residual`: array of shape (M,). `size`,
    `score`: arrays of shape (W,), energy of each whitened window outside the basis, and its product with the residual."""

    left: Left
    windows: _Windows
    basis: Array
    residual: Array
    size: Array
    score: Array

    @classmethod
    def of(cls, left: Left, windows: _Windows, products: Array) -> _Channel:
        """Evaluates the windows without fitted offsets. `products`: the same as in `_Windows.energies`."""
        size = windows.energies(products)
        for column in left.weight.transposed(left.basis).T:
            size -= windows.products(column) ** 2
        score = windows.products(left.weight.transposed(left.residual[:, None])[:, 0])
        return cls(left, windows, left.basis, left.residual, np.maximum(size, 0.0), score)

    def without(self, window: int) -> _Channel:
        """Returns the channel after the offset of a window has been fitted."""
        return self.fitted(*self.column(window))

    def column(self, window: int) -> tuple[Array, float]:
        """Returns the whitened offset of a window outside the basis, with the norm 1, as an array (M,), and its product with the
        residual."""
        column = self.outside(window)
        column /= max(float(np.linalg.norm(column)), 1e-300)
        return column, float(column @ self.residual)

    def outside(self, window: int) -> Array:
        """Returns the whitened offset of a window outside the basis, shape (M,)."""
        coefficients, rows = self.windows.of(window)
        at, whitened = self.left.whitened(coefficients[:, None], rows)
        column = np.zeros(len(self.residual))
        column[at] = whitened[:, 0]
        return np.asarray(column - self.basis @ (self.basis.T @ column))

    def fitted(self, column: Array, amount: float) -> _Channel:
        """Returns the channel after an offset has been fitted. `column`, `amount`: the results of the method `column`, for a window of
        any length."""
        along = self.windows.products(self.left.weight.transposed(column[:, None])[:, 0])
        return _Channel(
            self.left,
            self.windows,
            np.column_stack([self.basis, column]),
            self.residual - amount * column,
            np.maximum(self.size - along**2, 0.0),
            self.score - amount * along,
        )
