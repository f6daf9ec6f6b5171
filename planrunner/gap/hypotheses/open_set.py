"""Evaluates patterns outside the catalogue of known effects. The patterns compete with these effects. Thus a diagnosis can report
"something that the catalogue does not contain". Such a pattern is called a competitor. It is a pattern of the whitened residual, in
one channel or in a triad. Patterns of the coefficients lie in the span of the basis that describes each segment
(`evidence.spectrum`); bursts and tones lie outside it (`outside`). Some patterns of the coefficients differ at random from segment
to segment, or change smoothly with rate, gravity, temperature or time: offsets, changes of the scale factor, transients, and
waveforms per turn or per rocking period (`patterns`). Further patterns of the coefficients are a deviation in a single segment,
offsets of a few seconds (`short_offsets`), and a bias that repeats with an unknown period. The competitors are evaluated like
effects, individually and in combination.

In array shapes, M is the number of coefficients of a channel, K is the number of channels, S is the number of segments, G is the
number of settings of the noise (levels of flicker and random walk), and Q is the number of rates of events. A scope is a channel or a
triad.
"""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.gap.evidence.bayes_factors import averaged, from_eigen, log_mean_exp
from planrunner.gap.evidence.covariance import lasting
from planrunner.gap.evidence.weighing import ChannelWeights, DesignColumns, Eigen, Left, eigen, visible
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.outside import PLAIN, Line, Outside, outside, scopes_of
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Sort, designs, factors, sizes, sorts
from planrunner.gap.hypotheses.short_offsets import (
    RATES,
    SHORT_OFFSETS,
    Events,
    ShortOffsets,
    averaged_over_rates,
)

PERIODIC = Pattern("offset periodic in time", Sort.SEVERAL, Factor.TIME)
ODD_SEGMENT = Pattern("one odd segment", Sort.MEANS, Factor.TIME)
_WITH_BURSTS = (PERIODIC, SHORT_OFFSETS)  # patterns that are also evaluated in combination with bursts and tones
WAVEFORM = 4  # harmonics of a smooth waveform
_AT_ONCE = 1 << 18  # number of complex coefficients of waves that are whitened at once: 4 MB
EDGED = 16  # harmonics of a waveform with edges
MOST = 400  # largest number of periods of a bias that are tried
CYCLES = 2  # number of cycles in a segment at the shortest period
FINER = 8  # factor by which the grid near a likely period is finer
PEAKS = 3  # number of likely periods of a scope
NOTABLE = 4.0  # log evidence of the best period above which waveforms with edges are evaluated
NODES = 24  # number of points of a segment at which waves are evaluated


@dataclass(frozen=True)
class Kinds:
    """Contains the evidence for the patterns outside the catalogue (competitors). `log_bayes`: for each competitor, an array of
    shape (G,): the log Bayes factor of the competitor, relative to no pattern, at each setting of the noise (levels of flicker and
    random walk). The factor is −∞ for settings with a random walk of the gyros' bias. `several`: array of shape (G,), log Bayes
    factor of combinations of patterns of different kinds. `by_channel`: for each competitor, an array of shape (K,): the log Bayes
    factor of the competitor in each channel alone, at the first setting of the noise. `outside`: log Bayes factor of the patterns
    outside the coefficients. No effect of the catalogue acts outside the coefficients, so these patterns are independent of every
    effect. `lines`: the strongest tone of each channel that shows a tone. `events`: array of shape (G, Q), log Bayes factor of the
    events of the noise in the coefficients, at each rate (`short_offsets.RATES`). `no_events`: array of shape (Q,), log probability
    that the coefficients contain no event. `events_outside`: array of shape (Q,), log Bayes
    factor of the events outside the coefficients, which are the same for every effect. `with_events`: array of shape (G,), log Bayes
    factor of "something else" in noise with events (`unknown` states it in noise without events)."""

    log_bayes: dict[Pattern, Array]
    several: Array
    by_channel: dict[Pattern, Array]
    outside: float
    lines: tuple[Line, ...]
    events: Array
    no_events: Array
    events_outside: Array
    with_events: Array


def competitors(weighing: Weighing, outside_: Outside | None = None) -> Kinds:
    """Evaluates all patterns outside the catalogue. `outside_`: evidence for the patterns outside the basis, if this evidence has
    already been computed."""
    settings = np.flatnonzero(np.isfinite(weighing.log_prior[0]))
    whole = {id(weight): Left.whole(weight) for each in weighing.weights for weight in each}
    patterns, beyond = _Patterns(weighing), outside_ or outside(weighing)
    several, with_events = np.full(len(weighing.base), -np.inf), np.full(len(weighing.base), -np.inf)
    events, no_events = np.zeros((len(weighing.base), len(RATES))), np.zeros(len(RATES))
    tones_or_bursts = float(log_mean_exp(np.array([log_mean_exp(value, 0) for value in beyond.log_bayes.values()]), 0))
    each = {}
    for g in settings:
        channels = [whole[id(weight)] for weight in _weights(weighing, int(g))]
        each[g] = patterns.weighed(channels) | beyond.log_bayes
        several[g] = _several(patterns, channels, each[g])
        found_events = patterns.short_offsets.events(patterns.scopes, channels)
        events[g], no_events = found_events.log_bayes(), found_events.none
        with_events[g] = _with_events(patterns, each[g], several[g], found_events, beyond.events, tones_or_bursts)
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
    return Kinds(found, several, alone, tones_or_bursts, beyond.lines, events, no_events, beyond.events, with_events)


def _with_events(
    patterns: _Patterns, each: dict[Pattern, Array], several: float, events: Events, outside_: Array, beside: float
) -> float:
    """Returns the log Bayes factor of "something else" in noise with events. Beside a pattern, only events in other channels count:
    they are independent of the pattern, so the result is a lower limit. Beside a pattern of all channels, no events count.
    Bursts explain the events outside the coefficients, and combinations of patterns may contain bursts.

    `each`: log Bayes factor of each pattern in each scope. `several`: log Bayes factor of combinations of patterns. `events`: the events
    in the coefficients. `outside_`: array of shape (Q,), log Bayes factor of the events outside them. `beside`: log Bayes factor of
    tones and bursts."""
    elsewhere = np.array([events.log_bayes(scope) for scope in patterns.scopes])
    forms = [several]
    for pattern, value in each.items():
        own = elsewhere if len(value) == len(patterns.scopes) else events.none[None]
        if pattern.sort in (Sort.TONE, Sort.BURSTS):
            own = events.log_bayes()[None]
        further = np.zeros(len(RATES)) if pattern.sort is Sort.BURSTS else outside_
        forms.append(float(log_mean_exp(value + averaged_over_rates(own + further), 0)))
        if pattern in _WITH_BURSTS:
            forms.append(float(log_mean_exp(value + averaged_over_rates(own), 0)) + _maybe(beside))
    return float(log_mean_exp(np.array(forms), 0))


def events_beside(weighing: Weighing, setting: int, short_offsets: ShortOffsets) -> Array:
    """Returns the log Bayes factor of the events of the noise in the coefficients, at each rate, shape (Q,). If the weighing includes
    effects (`Weighing.beside`), these are events in addition to them. `setting`: index of the setting of the noise. `short_offsets`:
    the windows of the same recording."""
    channels = [Left.whole(weight) for weight in _weights(weighing, setting)]
    return short_offsets.events(scopes_of(weighing), channels).log_bayes()


def something_else(
    weighing: Weighing, signatures: Sequence[Array] = (), explained: float = np.inf
) -> tuple[float, Array]:
    """Returns two results at the most probable setting of the noise. The first is the log Bayes factor of the patterns of the
    coefficients, relative to no pattern: the mean over single patterns and over combinations of patterns. The second is the log Bayes
    factor of the events of the noise in the coefficients that lie outside the channels of the most probable pattern, at each rate,
    shape (Q,). If the weighing includes effects (`Weighing.beside`), both factors describe something else in addition to these
    effects. `signatures`: for each channel, the coefficients (M,) that these effects cause.
    `explained`: log evidence of these effects. One further pattern is a separate size of the effects in each motion. If this
    pattern explains more than the effects themselves, it is not a property of the effects, and the pattern is left out."""
    channels = [Left.whole(weight) for weight in _weights(weighing, weighing.likeliest[0])]
    patterns = _Patterns(weighing)
    each = patterns.weighed(channels)
    if signatures:
        pattern, designs_ = sizes(weighing, signatures)
        spectra = [eigen(left, own) for left, own in zip(channels, designs_, strict=True)]
        varying = np.array(_by_scope(spectra, patterns.scopes))
        if any(len(values) for values, _ in spectra) and float(log_mean_exp(varying, 0)) <= explained:
            each[pattern] = varying
    events = patterns.short_offsets.events(patterns.scopes, channels)
    best = max(each.values(), key=lambda value: float(value.max()))
    acting = patterns.scopes[int(np.argmax(best))] if len(best) == len(patterns.scopes) else range(len(channels))
    return _in_coefficients(patterns, channels, each), events.log_bayes(acting)


def _in_coefficients(patterns: _Patterns, channels: list[Left], each: dict[Pattern, Array]) -> float:
    """Returns the log Bayes factor of the patterns that lie in the coefficients: the mean over single patterns and over combinations
    of patterns. `each`: log Bayes factor of each pattern in each scope."""
    kinds = [float(log_mean_exp(value, 0)) for value in each.values()]
    return float(log_mean_exp(np.array([*kinds, _several(patterns, channels, each)]), 0))


def unknown(kinds: Kinds) -> Array:
    """Returns the log Bayes factor of "something else", shape (G,): the mean over single patterns and over combinations of
    patterns. A periodic bias and short offsets are also evaluated in combination with bursts and tones, which the coefficients do
    not represent."""
    return log_mean_exp(np.array(_forms(kinds)), 0)


def forms_of_unknown(kinds: Kinds) -> int:
    """Returns the number of patterns and combinations of patterns among which the probability of "something else" is divided."""
    return len(_forms(kinds))


def _forms(kinds: Kinds) -> list[Array]:
    both = [kinds.log_bayes[pattern] + _maybe(kinds.outside) for pattern in _WITH_BURSTS]
    return [*kinds.log_bayes.values(), kinds.several, *both]


def look_alike(weighing: Weighing, signatures: Sequence[Array]) -> float:
    """Returns the log Bayes factor of a cause outside the catalogue that resembles an effect, relative to this effect. The cause has
    a separate size in each motion. In addition, other patterns may act, with probability ½. `signatures`: for each channel, the
    coefficients (M,) that the effect causes. The result is −∞ if the effect acts in fewer than two motions."""
    channels = [Left.whole(weight) for weight in _weights(weighing, weighing.likeliest[0])]
    _, by_motion = sizes(weighing, signatures)
    if np.any([design.any(axis=0) for design in by_motion], axis=0).sum() < 2:
        return -np.inf
    everywhere = [list(range(len(channels)))]
    free, alike = (
        _by_scope([eigen(left, own) for left, own in zip(channels, each, strict=True)], everywhere)[0]
        for each in (by_motion, [own[:, None] for own in signatures])
    )
    beside = [
        Left.whole(left.weight.beside(np.asarray(own, dtype=float)))
        for left, own in zip(channels, by_motion, strict=True)
    ]
    patterns = _Patterns(weighing)
    return free - alike + _maybe(_in_coefficients(patterns, beside, patterns.weighed(beside)))


def _weights(weighing: Weighing, g: int) -> list[ChannelWeights]:
    """Returns the weights of all channels at the setting of the noise with the index `g`."""
    return [weighing.weights_at(g, channel) for channel in range(len(weighing.weights))]


def _several(patterns: _Patterns, channels: list[Left], found: dict[Pattern, Array]) -> float:
    """Returns the log Bayes factor of combinations of patterns of several sorts, where each sort is present with probability ½. A
    sort is a kind of coefficients, such as the segment means. A cause outside the catalogue often appears in more than one sort.

    Only the nominal parameters connect coefficients of different sorts. Through these parameters, a strong sort influences all
    other sorts. Therefore, the strongest sort is evaluated first, and its coefficients are then removed. These steps are repeated
    until the remaining sorts are weak. `found`: for each pattern, its log Bayes factor in each scope.
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
    twice. `found`: the same as in `_several`."""
    sorts: dict[Sort, list[float]] = {}
    for pattern, value in found.items():
        if pattern.sort is not Sort.SEVERAL:
            sorts.setdefault(pattern.sort, []).append(float(log_mean_exp(value, 0)))
    return {sort: float(log_mean_exp(np.array(values), 0)) for sort, values in sorts.items()}


def _maybe(log_bayes: float) -> float:
    """Returns the log Bayes factor of a pattern that is present with probability ½. `log_bayes`: its log Bayes factor if it is
    certainly present."""
    return float(np.logaddexp(log_bayes, 0.0) - np.log(2.0))


class _Patterns:
    """Evaluates all patterns of the coefficients. Caches the results, because settings of the noise that differ only in one triad
    use the same weights for the other triad."""

    def __init__(self, weighing: Weighing):
        self.designs, self.repeating, self.sorts = list(designs(weighing)), Repeating(weighing), sorts(weighing)
        self.short_offsets = ShortOffsets(weighing)
        self.means, self.scopes = weighing.spectrum.means, scopes_of(weighing)
        self._known: dict[tuple[Pattern, Left], Eigen] = {}

    def weighed(self, channels: list[Left], among: Container[Sort] | None = None) -> dict[Pattern, Array]:
        """Returns, for each pattern, its log Bayes factor in each scope, shape (scopes,). For a deviation in a single segment, the
        array has a single value, which covers all channels. `among`: the sorts to evaluate, by default all."""
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
            found[SHORT_OFFSETS] = list(self.short_offsets.weighed(self.scopes, channels))
        return {pattern: np.array(each) for pattern, each in found.items()}

    def _eigen(self, pattern: Pattern, left: Left, design: DesignColumns) -> Eigen:
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


def _one_segment(means: NDArray[np.int64], channels: Sequence[Left]) -> float:
    """Returns the log Bayes factor of the hypothesis that the mean of one channel deviates in one segment. Neither the channel nor
    the segment is known."""
    each = []
    for left in channels:
        at, whitened = left.whitened(np.eye(len(means)), means)
        whole = (whitened**2).sum(0)
        size = whole - ((left.basis[at].T @ whitened) ** 2).sum(0)
        seen = visible(size, float(whole.max(initial=0.0)))
        found = np.zeros(len(size))
        if seen.any():
            score = (whitened[:, seen].T @ left.residual[at]) ** 2
            found[seen] = averaged(from_eigen(size[seen, None], score[:, None], float(size[seen].max())))
        each.append(found)
    return float(log_mean_exp(np.concatenate(each), 0))


class Repeating:
    """Evaluates a bias that repeats with an unknown period: as a sine, a smooth waveform, or a waveform with edges such as a
    saw-tooth.

    The periods range from twice the duration of the run to half a segment; at most `MOST` periods are tried. A waveform is a sum of
    harmonics whose amplitudes decrease as 1/order. A waveform with edges has many harmonics, which remain coherent over the run
    only if the period is accurate. Such a waveform is therefore evaluated on a finer grid of periods. This grid covers only periods
    near those that are likely for a sine or a smooth waveform.
    """

    def __init__(self, weighing: Weighing):
        observed, spectrum = weighing.observed, weighing.spectrum
        self.starts, self.ends = lasting(observed)
        self.rows = np.flatnonzero(spectrum.harmonic == 0)
        self._segment = spectrum.segment[self.rows]
        self._order = self.rows - spectrum.means[self._segment]
        self._root = np.sqrt(observed.counts)
        self._run = float(self.ends[-1] - self.starts[0])
        self.frequencies = np.arange(2, min(4 * CYCLES * len(self.starts), MOST + 2)) / (4 * self._run)

    def weighed(self, scopes: Sequence[Sequence[int]], channels: Sequence[Left]) -> list[float]:
        """Returns the log Bayes factor of a bias with an unknown period in the channels of each scope."""
        parts = self._eigen(channels, self.frequencies, WAVEFORM, (2, 2 * WAVEFORM))
        found = []
        for scope in scopes:
            sine, smooth = (_evidence([parts[index][form] for index in scope]) for form in (0, 1))
            edged = float(log_mean_exp(smooth, 0))
            likely = np.maximum(sine, smooth)
            if likely.max() > NOTABLE:
                edged = self._edged(np.argsort(-likely)[:PEAKS], [channels[index] for index in scope])
            found.append(float(log_mean_exp(np.array([*(log_mean_exp(each, 0) for each in (sine, smooth)), edged]), 0)))
        return found

    def _edged(self, peaks: NDArray[np.int64], channels: Sequence[Left]) -> float:
        """Returns the log Bayes factor of a waveform with edges. `peaks`: indices of likely periods. The waveform is evaluated only
        near these periods. In the mean over the finer grid, all other periods count with a Bayes factor of zero."""
        steps = (np.arange(FINER) - (FINER - 1) / 2) / FINER
        near = (self.frequencies[peaks, None] + steps / (4 * self._run)).ravel()
        each = _evidence([found for (found,) in self._eigen(channels, near, EDGED, (2 * EDGED,))])
        return float(log_mean_exp(each, 0) + np.log(len(near) / (FINER * len(self.frequencies))))

    def waves(self, frequencies: Array, harmonics: int) -> Array:
        """Returns the cosines and sines of the H harmonics of each of F frequencies, as coefficients in the n `rows`, shape (n, F,
        H, 2)."""
        orders = np.arange(1, harmonics + 1)
        pulses = 2 * np.pi * np.outer(frequencies, orders)
        within = _within(np.round(self.ends - self.starts, 9), pulses.ravel(), int(self._order.max()) + 1)
        beginning = np.exp(1j * np.outer(self.starts - self.starts[0], pulses.ravel())) * self._root[:, None]
        raw = beginning[self._segment]
        raw *= within[self._segment, self._order]
        raw /= np.broadcast_to(orders, pulses.shape).ravel()
        return raw.view(float).reshape(len(self.rows), *pulses.shape, 2)

    def _eigen(
        self, channels: Sequence[Left], frequencies: Array, harmonics: int, counts: Sequence[int]
    ) -> list[list[Eigen]]:
        """Returns, for each channel, one item for each number n in `counts`: the eigenvalues (F, n) and the squared scores (F, n) of
        the first n columns at each of F frequencies. The columns are those that `waves` returns. Only the waves of a few
        frequencies are in memory at a time, because all waves and their whitened values need much memory."""
        size = len(self.rows) * len(frequencies) * harmonics
        parts = np.array_split(frequencies, min(-(-size // _AT_ONCE), len(frequencies)))
        each = []
        for part in parts:
            waves = self.waves(part, harmonics)
            each.append([self._of_part(left, waves, counts) for left in channels])
        return [
            [
                (np.concatenate([values for values, _ in own]), np.concatenate([along for _, along in own]))
                for own in zip(*of_channel, strict=True)
            ]
            for of_channel in zip(*each, strict=True)
        ]

    def _of_part(self, left: Left, waves: Array, counts: Sequence[int]) -> list[Eigen]:
        """Does the same as `_eigen` for one channel and for the frequencies of the columns `waves`."""
        periods = waves.shape[1]
        at, whitened = left.whitened(waves.reshape(len(self.rows), -1), self.rows)
        size = whitened.shape[1] // periods
        taken = (left.basis[at].T @ whitened).reshape(-1, periods, size).transpose(1, 0, 2)
        score = (whitened.T @ left.residual[at]).reshape(periods, size)
        own = np.ascontiguousarray(whitened.reshape(-1, periods, size).transpose(1, 0, 2))
        gram = np.swapaxes(own, 1, 2) @ own - np.swapaxes(taken, 1, 2) @ taken
        found = []
        for count in counts:
            values, vectors = np.linalg.eigh(gram[:, :count, :count])
            along = np.einsum("fji,fj->fi", vectors, score[:, :count]) ** 2
            found.append((np.maximum(values, 0.0), along))
        return found


def _evidence(parts: Sequence[Eigen]) -> Array:
    """Returns the log Bayes factor of each frequency in several channels together, with one prior for the total energy, shape (F,)."""
    size, along = (np.concatenate([part[k] for part in parts], axis=1) for k in (0, 1))
    unit = np.maximum(size.sum(1, keepdims=True), 1e-300)
    return averaged(from_eigen(size / unit, along / unit, 1.0))


def _within(lasting_: Array, pulses: Array, orders: int) -> Array:
    """Returns the coefficients of the cosine transform of exp(iωt) at P angular frequencies ω, shape (S, orders, P). The time t
    starts at zero in every segment. `lasting_`: array of shape (S,), durations of the segments, s; segments of equal duration are
    computed once. `pulses`: array of shape (P,), the angular frequencies ω, rad/s."""
    middles = (np.arange(NODES) + 0.5) / NODES
    cosines = (
        np.cos(np.pi * np.arange(orders)[:, None] * middles)
        * np.where(np.arange(orders) == 0, 1.0, np.sqrt(2.0))[:, None]
    )
    spans, which = np.unique(lasting_, return_inverse=True)
    found = np.empty((len(spans), orders, len(pulses)), dtype=complex)
    for index, span in enumerate(spans):  # one after the other: the values at all points need much memory
        found[index] = cosines / NODES @ np.exp(1j * (span * middles[:, None] * pulses))
    return found[which]
