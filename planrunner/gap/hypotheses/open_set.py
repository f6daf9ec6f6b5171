"""Competitors outside the catalogue, so that a diagnosis can report "something that the catalogue does not hold".

Each is a pattern of the whitened residual: offsets, scale-like errors, transients and waveforms per turn or per rocking period that differ
at random from segment to segment, or change smoothly with rate, gravity, temperature or time, in one channel or in a triad; one odd
segment; a periodic bias; bursts; and a tone that keeps its phase over the whole run. They are evaluated like
effects, individually and in combination.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.gap.evidence.bayes_factors import STRONGEST, WEAKEST, averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.weighing import ChannelWeights, Eigen, Left, eigen
from planrunner.gap.hypotheses.bursts import BURSTS, bursts
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Rows, Sort, designs, factors, sorts
from planrunner.gap.hypotheses.repeating import PERIODIC, Repeating
from planrunner.plan.schedule import Rest, Spin

Array = NDArray[np.float64]
PLAIN = 8.0  # nats of one sort at and above which the others are evaluated on the remainder
ODD_SEGMENT = Pattern("one odd segment", Sort.MEANS, Factor.TIME)
TONE = Pattern("a tone", Sort.TONE, Factor.BAND)
LONGEST_SCAN = 1 << 22  # points of the line scan's time grid
BLOCK = 1024  # frequencies over which the local level of a periodogram is taken


@dataclass(frozen=True, slots=True)
class Line:
    """A tone that keeps its phase over the run. frequency: Hz; amplitude: in the unit of the channel. evidence: log Bayes factor."""

    channel: str
    frequency: float
    amplitude: float
    evidence: float


@dataclass(frozen=True)
class Kinds:
    """Competitors. log_bayes: (G,) of each against none over the settings of the noise, −∞ for
    settings with a random walk of the gyros' bias; several: (G,), of several sorts at once. by_channel: (K,), of each in one channel alone,
    at the first setting. outside: log BF of the patterns outside the coefficients, on which no effect of the catalogue acts; they are
    therefore independent of every effect. lines: the strongest tone of each channel that has one."""

    log_bayes: dict[Pattern, Array]
    several: Array
    by_channel: dict[Pattern, Array]
    outside: float
    lines: tuple[Line, ...]


def competitors(weighing: Weighing) -> Kinds:
    """All competitors weighed."""
    settings = np.flatnonzero(np.isfinite(weighing.log_prior[0]))
    whole = {id(weight): Left.whole(weight) for each in weighing.weights for weight in each}
    patterns, (outside, lines) = _Patterns(weighing), _outside(weighing)
    several = np.full(len(weighing.base), -np.inf)
    each = {}
    for g in settings:
        channels = [whole[id(weight)] for weight in _weights(weighing, int(g))]
        each[g] = patterns.weighed(channels) | outside
        several[g] = _several(patterns, channels, each[g])
    found = {pattern: np.full(len(weighing.base), -np.inf) for pattern in each[settings[0]]}
    for g, values in each.items():
        for pattern, value in values.items():
            found[pattern][g] = float(log_mean_exp(value, 0))
    count = len(weighing.observed.channels)
    alone = {pattern: value[:count] for pattern, value in each[settings[0]].items() if len(value) >= count}
    first = [whole[id(weight)] for weight in _weights(weighing, 0)]
    for pattern, per_channel in factors(weighing):
        spectra = [eigen(left, design) for left, design in zip(first, per_channel, strict=True)]
        alone[pattern] = np.array(_by_scope(spectra, [[index] for index in range(count)]))
    beside = float(log_mean_exp(np.array([log_mean_exp(value, 0) for value in outside.values()]), 0))
    return Kinds(found, several, alone, beside, lines)


def something_else(weighing: Weighing) -> float:
    """log BF of patterns of the coefficients, alone and in combination, against none at the likeliest setting of the noise. Of a weighing
    beside effects: the evidence for something else beside these."""
    at = int(np.argmax(weighing.base + weighing.log_prior[0]))
    channels = [Left.whole(weight) for weight in _weights(weighing, at)]
    patterns = _Patterns(weighing)
    each = patterns.weighed(channels)
    kinds = [float(log_mean_exp(value, 0)) for value in each.values()]
    return float(log_mean_exp(np.array([*kinds, _several(patterns, channels, each)]), 0))


def unknown(kinds: Kinds) -> Array:
    """log BF (G,) of "something else": the mean over its kinds and over combinations of them."""
    return log_mean_exp(np.array([*kinds.log_bayes.values(), kinds.several]), 0)


def _weights(weighing: Weighing, g: int) -> list[ChannelWeights]:
    """The channels' weights under one setting of the noise."""
    at = dict(zip(("gyro", "accel"), divmod(g, weighing.shape[1]), strict=True))
    return [each[at[channel.kind]] for each, channel in zip(weighing.weights, weighing.observed.channels, strict=True)]


def _several(patterns: _Patterns, channels: list[Left], found: dict[Pattern, Array]) -> float:
    """log BF of patterns of several sorts together, each sort present with probability ½. A cause outside the catalogue often appears in
    more than one sort.

    The coefficients of different sorts share only the nominal parameters, so a strong sort affects all others through these. Therefore the
    strongest is evaluated first, and the others without its coefficients, until the rest is weak.
    """
    left, total = _by_sort(found), 0.0
    while True:
        top = max((sort for sort in left if sort in WHOLE), key=lambda sort: left[sort], default=None)
        if top is None or left[top] < PLAIN:
            return total + sum(map(_maybe, left.values()))
        total += _maybe(left.pop(top))
        channels = [channel.without(patterns.sorts[top]) for channel in channels]
        left |= _by_sort(patterns.weighed(channels, left))


def _by_sort(found: dict[Pattern, Array]) -> dict[Sort, float]:
    """The evidence by sort, without patterns that span several sorts, because these would count twice."""
    sorts: dict[Sort, list[float]] = {}
    for pattern, value in found.items():
        if pattern.sort is not Sort.SEVERAL:
            sorts.setdefault(pattern.sort, []).append(float(log_mean_exp(value, 0)))
    return {sort: float(log_mean_exp(np.array(values), 0)) for sort, values in sorts.items()}


def _maybe(log_bayes: float) -> float:
    """log BF of a pattern that is present with probability ½."""
    return float(np.logaddexp(log_bayes, 0.0) - np.log(2.0))


def _scopes(weighing: Weighing) -> list[list[int]]:
    """Scopes: every channel alone, then triads."""
    triads = [members for kind in ("gyro", "accel") if len(members := weighing.observed.of_kind(kind)) > 1]
    return [[index] for index in range(len(weighing.observed.channels))] + triads


class _Patterns:
    """All patterns of the coefficients, with their results: settings of the noise share the weights of a triad."""

    def __init__(self, weighing: Weighing):
        self.designs, self.repeating, self.sorts = list(designs(weighing)), Repeating(weighing), sorts(weighing)
        self.means, self.scopes = weighing.spectrum.means, _scopes(weighing)
        self._known: dict[tuple[Pattern, Left], Eigen] = {}

    def weighed(self, channels: list[Left], among: Container[Sort] | None = None) -> dict[Pattern, Array]:
        """log BF of each pattern by scope; of one odd segment in any scope. among: the requested sorts, by default all."""
        found: dict[Pattern, list[float]] = {}
        for pattern, per_channel in self.designs:
            if among is None or pattern.sort in among:
                spectra = [self._eigen(pattern, left, own) for left, own in zip(channels, per_channel, strict=True)]
                if any(len(values) for values, _ in spectra):
                    found[pattern] = _by_scope(spectra, self.scopes)
        if among is None or Sort.MEANS in among:
            found[ODD_SEGMENT] = [_one_segment(self.means, channels)]
        if among is None:
            found[PERIODIC] = self.repeating.weighed(self.scopes, channels)
        return {pattern: np.array(each) for pattern, each in found.items()}

    def _eigen(self, pattern: Pattern, left: Left, design: Array | Rows) -> Eigen:
        if (pattern, left) not in self._known:
            self._known[pattern, left] = eigen(left, design)
        return self._known[pattern, left]


def _by_scope(spectra: Sequence[Eigen], scopes: Sequence[Sequence[int]]) -> list[float]:
    """log BF of a design in the channels of each scope; −∞ if the design is not visible there."""
    size = np.zeros((len(scopes), max(sum(len(spectra[index][0]) for index in scope) for scope in scopes)))
    along = np.zeros_like(size)
    for row, scope in enumerate(scopes):
        for table, part in ((size, 0), (along, 1)):
            joined = np.concatenate([spectra[index][part] for index in scope])
            table[row, : len(joined)] = joined
    unit = size.sum(1)
    seen = unit > 0
    found = np.full(len(scopes), -np.inf)
    if seen.any():
        found[seen] = averaged(from_eigen(size[seen] / unit[seen, None], along[seen] / unit[seen, None], 1.0))
    return [float(value) for value in found]


def _outside(weighing: Weighing) -> tuple[dict[Pattern, Array], tuple[Line, ...]]:
    """log BF by scope of patterns outside the basis, and the lines."""
    periodograms, scopes = (
        [_line(weighing, index) for index in range(len(weighing.observed.channels))],
        _scopes(weighing),
    )
    tones = np.array([_tone([periodograms[index].power for index in scope]) for scope in scopes])
    lines = []
    for channel, periodogram, evidence in zip(weighing.observed.channels, periodograms, tones, strict=False):
        if evidence > PLAIN:
            top = int(np.argmax(periodogram.power))
            amplitude = periodogram.amplitude[top] / channel.factor
            lines.append(Line(channel.name, float(periodogram.frequency[top]), float(amplitude), float(evidence)))
    return {TONE: tones, BURSTS: bursts(weighing, scopes)}, tuple(lines)


@dataclass(frozen=True)
class _Periodogram:
    """frequency (F,), Hz; power (F,), in units of the noise; amplitude (F,), SI, of a sine with that power."""

    frequency: Array
    power: Array
    amplitude: Array


def _one_segment(means: NDArray[np.int64], channels: Sequence[Left]) -> float:
    """The means of all channels deviate in one segment, whichever it is."""
    each = []
    for left in channels:
        at, whitened = left.whitened(np.eye(len(means)), means)
        size = np.maximum((whitened**2).sum(0) - ((left.basis[at].T @ whitened) ** 2).sum(0), 0.0)
        score = (whitened.T @ left.residual[at]) ** 2
        each.append(averaged(from_eigen(size[:, None], score[:, None], float(size.max()))))
    return float(log_mean_exp(np.concatenate(each), 0))


def _line(weighing: Weighing, index: int) -> _Periodogram:
    """Periodogram, in units of the noise, of the remainder outside the basis, for segments at rest and turning; empty if the run is
    too long."""
    observed, spectrum = weighing.observed, weighing.spectrum
    chosen = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])
    step = (float(observed.bin_size[chosen].max()) if chosen.any() else 1.0) / observed.sample_rate
    slot = np.round((observed.time - observed.time[0]) / step).astype(np.int64)
    chosen = chosen[observed.owner]
    if weighing.coarse[index] or slot[-1] >= LONGEST_SCAN or slot[-1] < 16 or not chosen.any():
        return _Periodogram(np.empty(0), np.empty(0), np.empty(0))
    from scipy.fft import next_fast_len, rfft

    noise = weighing.noise
    remainder = spectrum.remainder[:, index] / np.sqrt(noise.level[observed.owner, index])
    grid = np.zeros(next_fast_len(int(slot[-1]) + 1, real=True))
    if observed.bins is None:
        grid[slot[chosen]] = remainder[chosen]
        samples = float(chosen.sum())
    else:
        size = observed.bin_size[observed.owner][chosen]
        grid += np.bincount(slot[chosen], remainder[chosen] * np.sqrt(size), len(grid))
        samples = float(size.sum())
    frequency = np.arange(1, len(grid) // 2) / (len(grid) * step)
    seen = np.abs(rfft(grid)[1 : len(grid) // 2])
    power = seen**2 / (weighing.white[index] ** 2 * samples)
    if noise.coloured[:, index].any():
        power /= _local_level(power)
    return _Periodogram(frequency, power, 2 * seen / samples * float(np.sqrt(np.mean(noise.level[:, index]))))


def _local_level(power: Array) -> Array:
    """Level (F,) of a periodogram (F,) of coloured noise: medians over blocks, which a line in a block does not raise, and straight lines
    in logarithms between them."""
    blocks = np.array_split(power, max(len(power) // BLOCK, 1))
    middles = np.cumsum([len(block) for block in blocks]) - [len(block) / 2 for block in blocks]
    levels = [np.log(np.median(block) / np.log(2.0) + 1e-300) for block in blocks]
    return np.asarray(np.exp(np.interp(np.arange(len(power)), middles, levels)))


def _tone(powers: list[Array]) -> float:
    """log BF of a tone of any frequency that keeps its phase, in the same way in several channels, from their periodograms."""
    powers = [power for power in powers if len(power)]
    if not powers:
        return -np.inf
    power = np.sum(powers, axis=0)
    s2 = np.geomspace(WEAKEST, STRONGEST, 12) / len(powers)
    each = [float(log_mean_exp(power * s / (1 + s), 0)) - len(powers) * np.log1p(s) for s in s2]
    return float(log_mean_exp(np.array(each), 0))
