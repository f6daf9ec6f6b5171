"""Evaluates patterns outside the catalogue of known effects. The patterns compete with these effects. Thus a diagnosis can report
"something that the catalogue does not contain". Such a pattern is called a competitor. It is a pattern of the whitened residual, in
one channel or in a triad. Patterns of the coefficients lie in the span of the basis that describes each segment
(`evidence.spectrum`); bursts and tones lie outside it. Some patterns differ at random from segment to segment, or change smoothly
with rate, gravity, temperature or time: offsets, scale-like errors, transients, and waveforms per turn or per rocking period.
Further patterns are a deviation in a single segment, a periodic bias, bursts, and a tone that keeps its phase over the whole run.
The competitors are evaluated like effects, individually and in combination.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import STRONGEST, WEAKEST, averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.noise_levels import HOLDS
from planrunner.gap.evidence.weighing import ChannelWeights, Eigen, Left, eigen
from planrunner.gap.hypotheses.bursts import BURSTS, bursts
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Rows, Sort, designs, factors, sizes, sorts
from planrunner.gap.hypotheses.repeating import PERIODIC, Repeating
from planrunner.plan.schedule import Rest, Spin

PLAIN = 8.0  # nats of one sort at and above which the others are evaluated on the remainder
ODD_SEGMENT = Pattern("one odd segment", Sort.MEANS, Factor.TIME)
TONE = Pattern("a tone", Sort.TONE, Factor.BAND)
LONGEST_SCAN = 1 << 22  # points of the line scan's time grid
BLOCK = 1024  # frequencies over which the local level of a periodogram is taken
MATERIAL = float(np.expm1(2 * HOLDS))
"""If the power of a tone, divided by the variance of the noise, is at least this value, the tone is not a part of correctly
declared noise."""
_TUNINGS = 4  # corrections of the frequency of a fitted tone
_NEAR = 8  # spacings of a periodogram about its highest frequency, between which finer values are tried
_BLOCKS = 1024  # of time, over which shifted samples are summed


@dataclass(frozen=True, slots=True)
class Line:
    """Describes a tone that keeps its phase over the whole run.

    `frequency`: frequency of the tone, Hz. `amplitude`: in the unit of the channel. `evidence`: log Bayes factor of the tone.
    """

    channel: str
    frequency: float
    amplitude: float
    evidence: float


@dataclass(frozen=True)
class Kinds:
    """Contains the evidence for the patterns outside the catalogue (competitors). `log_bayes`: for each competitor, an array of
    shape (G,): the log Bayes factor of the competitor, relative to no pattern, at each setting of the noise (levels of flicker and
    random walk). The factor is −∞ for settings with a random walk of the gyros' bias. `several`: array of shape (G,), log Bayes
    factor of combinations of patterns of different kinds. `by_channel`: for each competitor, an array of shape (K,): the log Bayes
    factor of the competitor in each channel alone, at the first setting of the noise. `outside`: log Bayes factor of the patterns
    outside the coefficients. No effect of the catalogue acts outside the coefficients, so these patterns are independent of every
    effect. `lines`: the strongest tone of each channel that shows a tone.
    """

    log_bayes: dict[Pattern, Array]
    several: Array
    by_channel: dict[Pattern, Array]
    outside: float
    lines: tuple[Line, ...]


def competitors(weighing: Weighing, outside_: Outside | None = None) -> Kinds:
    """Evaluates all patterns outside the catalogue. `outside_`: evidence for the patterns outside the basis, if this evidence has
    already been computed."""
    settings = np.flatnonzero(np.isfinite(weighing.log_prior[0]))
    whole = {id(weight): Left.whole(weight) for each in weighing.weights for weight in each}
    patterns, beyond = _Patterns(weighing), outside_ or outside(weighing)
    several = np.full(len(weighing.base), -np.inf)
    each = {}
    for g in settings:
        channels = [whole[id(weight)] for weight in _weights(weighing, int(g))]
        each[g] = patterns.weighed(channels) | beyond.log_bayes
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
    beside = float(log_mean_exp(np.array([log_mean_exp(value, 0) for value in beyond.log_bayes.values()]), 0))
    return Kinds(found, several, alone, beside, beyond.lines)


def something_else(weighing: Weighing, signatures: Sequence[Array] = (), explained: float = np.inf) -> float:
    """Returns the log Bayes factor of the patterns that lie in the coefficients, single and in combination, against no pattern. The
    factor is computed at the most probable setting of the noise. If the weighing includes effects (`Weighing.beside`), this is the
    evidence for something else in addition to these effects. `signatures`: for each channel, the coefficients (M,) that these
    effects cause. `explained`: log evidence of these effects. The effects may seem to have different sizes in different motions. If
    such differences explain more than the effects themselves, they are not a property of the effects and are left out."""
    channels = [Left.whole(weight) for weight in _weights(weighing, weighing.likeliest[0])]
    patterns = _Patterns(weighing)
    each = patterns.weighed(channels)
    if signatures:
        pattern, designs_ = sizes(weighing, signatures)
        spectra = [eigen(left, own) for left, own in zip(channels, designs_, strict=True)]
        varying = np.array(_by_scope(spectra, patterns.scopes))
        if any(len(values) for values, _ in spectra) and float(log_mean_exp(varying, 0)) <= explained:
            each[pattern] = varying
    kinds = [float(log_mean_exp(value, 0)) for value in each.values()]
    return float(log_mean_exp(np.array([*kinds, _several(patterns, channels, each)]), 0))


def unknown(kinds: Kinds) -> Array:
    """Returns the log Bayes factor of "something else", shape (G,): the mean over single patterns and over combinations of
    patterns. A periodic bias is also evaluated in combination with the patterns outside the coefficients."""
    periodic = kinds.log_bayes[PERIODIC] + _maybe(kinds.outside)
    return log_mean_exp(np.array([*kinds.log_bayes.values(), kinds.several, periodic]), 0)


def _weights(weighing: Weighing, g: int) -> list[ChannelWeights]:
    """Returns the weights of all channels at one setting of the noise."""
    return [weighing.weights_at(g, channel) for channel in range(len(weighing.weights))]


def _several(patterns: _Patterns, channels: list[Left], found: dict[Pattern, Array]) -> float:
    """Returns the log Bayes factor of combinations of patterns of several sorts, where each sort is present with probability ½. A
    sort is a kind of coefficients, such as the segment means. A cause outside the catalogue often appears in more than one sort.

    Only the nominal parameters connect coefficients of different sorts. Through these parameters, a strong sort influences all
    other sorts. Therefore, the strongest sort is evaluated first, and its coefficients are then removed. These steps are repeated
    until the remaining sorts are weak.
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
    """Returns the log Bayes factor of each sort. Patterns that consist of several sorts are omitted, because they would count
    twice."""
    sorts: dict[Sort, list[float]] = {}
    for pattern, value in found.items():
        if pattern.sort is not Sort.SEVERAL:
            sorts.setdefault(pattern.sort, []).append(float(log_mean_exp(value, 0)))
    return {sort: float(log_mean_exp(np.array(values), 0)) for sort, values in sorts.items()}


def _maybe(log_bayes: float) -> float:
    """Returns the log Bayes factor of a pattern that is present with probability ½."""
    return float(np.logaddexp(log_bayes, 0.0) - np.log(2.0))


def scopes_of(weighing: Weighing) -> list[list[int]]:
    """Returns the scopes of patterns, as lists of channel indices: every single channel, then the triads."""
    triads = [members for kind in ("gyro", "accel") if len(members := weighing.observed.of_kind(kind)) > 1]
    return [[index] for index in range(len(weighing.observed.channels))] + triads


class _Patterns:
    """Evaluates all patterns of the coefficients. Caches the results, because several settings of the noise use the same weights
    for a triad."""

    def __init__(self, weighing: Weighing):
        self.designs, self.repeating, self.sorts = list(designs(weighing)), Repeating(weighing), sorts(weighing)
        self.means, self.scopes = weighing.spectrum.means, scopes_of(weighing)
        self._known: dict[tuple[Pattern, Left], Eigen] = {}

    def weighed(self, channels: list[Left], among: Container[Sort] | None = None) -> dict[Pattern, Array]:
        """Returns the log Bayes factor of each pattern in each scope, and the log Bayes factor of a deviation in a single segment
        of any channel. `among`: the sorts to evaluate, by default all."""
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
    """Returns the log Bayes factor of a design (the columns of a pattern) in the channels of each scope; −∞ for scopes in which the
    design has no effect. `spectra`: for each channel, the eigenvalues and the squared scores of the design."""
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


@dataclass(frozen=True)
class Outside:
    """Contains the evidence for the patterns outside the basis of the coefficients.

    `log_bayes`: log Bayes factor of each pattern in each scope. `lines`: the strongest tone of each channel that shows a tone.
    `causes`: those of these tones that count as separate causes.
    """

    log_bayes: dict[Pattern, Array]
    lines: tuple[Line, ...]
    causes: tuple[Line, ...]


def outside(weighing: Weighing) -> Outside:
    """Evaluates the patterns outside the basis of the coefficients.

    Real noise often contains lines (supply, dither, resonances). A line counts as a separate cause only if it is a single tone with
    a power of at least `MATERIAL`. Other lines belong to the noise and are only reported.
    """
    scopes, scans = scopes_of(weighing), [_scan(weighing, index) for index in range(len(weighing.observed.channels))]
    periodograms = [_Periodogram.of(scan, scan.samples) for scan in scans]
    tones = np.array([_tone([periodograms[index].power for index in scope]) for scope in scopes])
    lines, causes = [], dict[int, Line]()
    for index, (scan, periodogram, evidence) in enumerate(zip(scans, periodograms, tones, strict=False)):
        if evidence > PLAIN:
            top = int(np.argmax(periodogram.power))
            amplitude, channel = float(periodogram.amplitude[top]), weighing.observed.channels[index]
            frequency = float(periodogram.frequency[top])
            rest, frequency = _without_tone(weighing, scan, frequency, float(periodogram.frequency[0]))
            lines.append(Line(channel.name, frequency, amplitude / channel.factor, float(evidence)))
            material = scan.energy(scan.samples) >= (1 + MATERIAL) * scan.energy(rest)
            if material and _tone([_Periodogram.of(scan, rest).power]) <= PLAIN:
                causes[index] = lines[-1]
    tones = np.where([bool(causes.keys() & set(scope)) for scope in scopes], tones, np.minimum(tones, 0.0))
    return Outside({TONE: tones, BURSTS: bursts(weighing, scopes)}, tuple(lines), tuple(causes.values()))


@dataclass(frozen=True)
class _Scan:
    """Contains the remainder of a channel (samples minus their components in the basis) in segments at rest and turning, prepared
    for a periodogram.

    `chosen`: array of shape (n,), indices of the samples that are used. `weight`: array of shape (n,), number of raw samples that
    each of these samples combines. `samples`: array of shape (n,), the samples in SI units, each divided by the level of the noise
    of its segment. `slot`: array of shape (n,), position of each sample on a time grid of `length` steps of `step` seconds.
    `level`: array of shape (n,), level of the noise, as a standard deviation relative to `white`. `coloured`: True if the spectrum
    of the noise is not white. If the run is too long or too short, or if the counts (digital steps) of the channel are coarse, the
    scan has no samples.
    """

    chosen: NDArray[np.int64]
    weight: Array
    samples: Array
    slot: NDArray[np.int64]
    length: int
    step: float
    level: Array
    white: float
    coloured: bool

    def energy(self, samples: Array) -> float:
        """Returns the energy of samples (n,), summed over the raw samples, SI². `samples`: samples divided by the level of the
        noise, as in the attribute `samples`."""
        return float(self.weight @ samples**2)


@dataclass(frozen=True)
class _Periodogram:
    """Contains the periodogram of a scan.

    `frequency`: array of shape (F,) in Hz. `power`: array of shape (F,), power at each frequency in units of the noise power.
    `amplitude`: array of shape (F,) in SI units, amplitude of a sine with this power.
    """

    frequency: Array
    power: Array
    amplitude: Array

    @classmethod
    def of(cls, scan: _Scan, samples: Array) -> _Periodogram:
        """Computes the periodogram of samples (n,) that have the positions of the samples of a scan."""
        from scipy.fft import next_fast_len, rfft

        if not len(samples):
            return cls(np.empty(0), np.empty(0), np.empty(0))
        length = next_fast_len(scan.length, real=True)
        grid = np.bincount(scan.slot, samples * scan.weight, length)
        total = float(scan.weight.sum())
        frequency = np.arange(1, length // 2) / (length * scan.step)
        seen = np.abs(rfft(grid)[1 : length // 2])
        power = seen**2 / (scan.white**2 * total)
        if scan.coloured:
            power /= _local_level(power)
        return cls(frequency, power, 2 * seen / total * float(np.sqrt(np.mean(scan.level**2))))


def _one_segment(means: NDArray[np.int64], channels: Sequence[Left]) -> float:
    """Returns the log Bayes factor of the hypothesis that the mean of one channel deviates in one segment. Neither the channel nor
    the segment is known."""
    each = []
    for left in channels:
        at, whitened = left.whitened(np.eye(len(means)), means)
        size = np.maximum((whitened**2).sum(0) - ((left.basis[at].T @ whitened) ** 2).sum(0), 0.0)
        score = (whitened.T @ left.residual[at]) ** 2
        each.append(averaged(from_eigen(size[:, None], score[:, None], float(size.max()))))
    return float(log_mean_exp(np.concatenate(each), 0))


def _scan(weighing: Weighing, index: int) -> _Scan:
    observed, noise = weighing.observed, weighing.noise
    moved = np.array([isinstance(motion, Rest | Spin) for motion in observed.motions])
    step = (float(observed.bin_size[moved].max()) if moved.any() else 1.0) / observed.sample_rate
    slot = np.round((observed.time - observed.time[0]) / step).astype(np.int64)
    chosen = np.flatnonzero(moved[observed.owner])
    if weighing.coarse[index] or slot[-1] >= LONGEST_SCAN or slot[-1] < 16:
        chosen = chosen[:0]
    owner = observed.owner[chosen]
    weight = np.ones(len(chosen)) if observed.bins is None else observed.bin_size[owner].astype(float)
    level = np.sqrt(noise.level[owner, index])
    return _Scan(
        chosen,
        weight,
        weighing.spectrum.remainder[chosen, index] / (level * np.sqrt(weight)),
        slot[chosen],
        int(slot[-1]) + 1,
        step,
        level,
        float(weighing.white[index]),
        bool(noise.coloured[:, index].any()),
    )


def _without_tone(weighing: Weighing, scan: _Scan, frequency: float, spacing: float) -> tuple[Array, float]:
    """Fits a sine to the samples of a scan, with Gauss–Newton steps in the frequency, and subtracts the part of the sine that lies
    outside the basis of the coefficients. Returns the remaining samples (n,) and the fitted frequency, Hz. `frequency`: approximate
    frequency of the sine, Hz. `spacing`: distance between the frequencies of the periodogram, Hz. The search starts at the
    frequency with the highest power among closely spaced frequencies around `frequency`. The closely spaced frequencies are
    necessary because gaps between segments make neighbouring values of the periodogram almost as high as the highest one."""
    observed, spectrum = weighing.observed, weighing.spectrum
    time = observed.time - observed.time.mean()
    root = np.sqrt(scan.weight)
    found = scan.samples
    frequency += _highest(time[scan.chosen], scan.samples * scan.weight, frequency, spacing)
    for _ in range(_TUNINGS):
        phase = 2 * np.pi * frequency * time
        waves = np.column_stack([np.cos(phase), np.sin(phase)])
        waves = spectrum.outside(observed, np.column_stack([waves, waves * time[:, None] / time[-1]]))
        columns = waves[scan.chosen] / scan.level[:, None] * root[:, None]
        fitted = np.linalg.lstsq(columns, scan.samples * root, rcond=None)[0]
        found = scan.samples - columns @ fitted / root
        cosine, sine, cosine_drift, sine_drift = fitted
        turned = (sine * cosine_drift - cosine * sine_drift) / (cosine**2 + sine**2)
        frequency += float(turned / time[-1] / (2 * np.pi))
    return np.asarray(found), frequency


def _highest(time: Array, samples: Array, frequency: float, spacing: float) -> float:
    """Searches closely spaced frequencies around `frequency` for the highest power. Returns the distance of the best frequency from
    `frequency`, Hz. The samples (n,) are first shifted to frequency zero. The shifted samples change little within a block of time,
    so sums over blocks are sufficient."""
    place = ((time - time[0]) * (_BLOCKS / (time[-1] - time[0]) * (1 - 1e-9))).astype(np.int64)
    shifted = samples * np.exp(-2j * np.pi * frequency * time)
    sums = np.bincount(place, shifted.real, _BLOCKS) + 1j * np.bincount(place, shifted.imag, _BLOCKS)
    middles = time[0] + (np.arange(_BLOCKS) + 0.5) / _BLOCKS * (time[-1] - time[0])
    about = spacing * np.linspace(-_NEAR, _NEAR, 20 * _NEAR + 1)
    return float(about[int(np.argmax(np.abs(np.exp(-2j * np.pi * np.outer(about, middles)) @ sums)))])


def _local_level(power: Array) -> Array:
    """Returns the level of coloured noise in a periodogram (F,), shape (F,). The level is interpolated linearly, in logarithms,
    between medians over blocks. A line does not raise the median of its block."""
    blocks = np.array_split(power, max(len(power) // BLOCK, 1))
    middles = np.cumsum([len(block) for block in blocks]) - [len(block) / 2 for block in blocks]
    levels = [np.log(np.median(block) / np.log(2.0) + 1e-300) for block in blocks]
    return np.asarray(np.exp(np.interp(np.arange(len(power)), middles, levels)))


def _tone(powers: list[Array]) -> float:
    """Returns the log Bayes factor of a tone of unknown frequency that keeps its phase and appears in several channels. `powers`:
    for each channel, the powers of its periodogram."""
    powers = [power for power in powers if len(power)]
    if not powers:
        return -np.inf
    power = np.sum(powers, axis=0)
    s2 = np.geomspace(WEAKEST, STRONGEST, 12) / len(powers)
    each = [float(log_mean_exp(power * s / (1 + s), 0)) - len(powers) * np.log1p(s) for s in s2]
    return float(log_mean_exp(np.array(each), 0))
