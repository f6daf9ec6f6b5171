"""Describes the gap of a recording, independently of its explanation: the size of the gap and the noise of each channel, the place of
the gap, the form of a gap whose cause is not in the catalogue, and the data for plots. The noise is only reported; it does not
compete with the effects as an explanation.

The place of the gap is the channel, the factor that the gap follows, and the most conspicuous level of this factor. The factors are
orientation, rate, temperature, time, angle of the table, and frequency band. A level of a factor is one value or range of it, such
as one orientation. The open set (`hypotheses.open_set`) contains patterns of the whitened residual that effects of the catalogue do
not cause. Each pattern implies the factor that the gap follows. The evidence for these patterns determines which factor the
whitened residual of a channel follows. The levels of a factor are compared by a score. The score of a level states by how many
standard deviations its energy exceeds the energy that pure noise would have. Many levels are examined, so a single high score may
be chance. Therefore, pure noise is simulated, and the part that the nominal parameters absorb is projected out, as in the data. The
p-value of a level is the probability that, in pure noise, the highest score of all levels reaches the score of this level
(max-statistic parametric bootstrap; Westfall and Young, Resampling-Based Multiple Testing, 1993).

The patterns of the open set compete with the effects of the catalogue. The most probable pattern determines the factor that an
unknown gap follows. The residuals of the simulation give the form of this gap.

In array shapes, M is the number of coefficients of a channel, and K is the number of channels.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.documents import JsonObject
from planrunner.error_model.observed import Observed
from planrunner.gap.answer.posterior import Posterior
from planrunner.gap.answer.verdict import matrix
from planrunner.gap.evidence.bayes_factors import log_mean_exp
from planrunner.gap.evidence.noise_levels import excess_by_channel
from planrunner.gap.evidence.spectrum import RESPONSE
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.gap.hypotheses.outside import TONE, Line
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Sort, sorts
from planrunner.plan.directions import word_of

REPLICATES = 400
SEED = 20
_LEVELS = 4  # number of bins of temperature and time
_NEAR = math.sqrt(2 - 2 * 0.999)
"""If the difference between the unit vectors of an axis and of a direction is shorter than this length, the axis is described by
the word for the direction. The cosine of the angle between the two is then above 0.999."""


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Describes the noise of a channel, in the channel's unit.

    `white`, `declared`: measured and declared standard deviation of a single sample due to white noise. `declared` includes the
    rounding to `declared_count`; it is 0 if no noise is declared. `count`, `declared_count`: measured and declared size of one
    count; 0 if the values are not rounded to counts. `slow`: amplitude density at the lowest measured frequency, divided by the
    amplitude density of the white noise; 1 if there is only white noise. `quietest`, `loudest`: standard deviation of the noise in
    the quietest and in the loudest segment, divided by the standard deviation of the white noise. `line`: the strongest tone, None
    if there is none.
    """

    channel: str
    unit: str
    white: float
    declared: float
    count: float
    declared_count: float
    slow: float
    quietest: float
    loudest: float
    line: Line | None


def noise_found(weighing: Weighing, lines: Sequence[Line]) -> tuple[NoiseFound, ...]:
    """Returns the noise of every channel. `lines`: tones in the recording, at most one per channel."""
    declared, noise = weighing.declared, weighing.noise
    by_channel = {line.channel: line for line in lines}
    found = []
    for index, channel in enumerate(declared.channels):
        sample = np.sqrt(channel.sample_variance(declared.sample_rate)) if channel.white else 0.0
        level = np.sqrt(noise.level[:, index])
        still = noise.spectrum[int(noise.moving.min()), 0, index]
        found.append(
            NoiseFound(
                channel.name,
                channel.unit,
                float(weighing.white[index] / channel.factor),
                float(sample / channel.factor),
                float(weighing.steps[index] / channel.factor),
                float(channel.resolution / channel.factor),
                float(np.sqrt(still)),
                float(level.min()),
                float(level.max()),
                by_channel.get(channel.name),
            )
        )
    return tuple(found)


def gap_by_channel(weighing: Weighing) -> dict[str, JsonObject]:
    """Returns, for each channel: the gap, the gap that noise alone would cause, and the unit. The gap is the root mean square of
    the residuals of the nominal simulation over the samples. The part of the residuals that the coefficients do not represent is
    left out. The gap does not depend on the sampling rate. A constant offset contributes its full size."""
    found = {}
    for index, channel in enumerate(weighing.observed.channels):
        gap, noise = weighing.weights[index][0].gap_and_noise()
        size = 1 / np.sqrt(weighing.observed.counts.sum()) / channel.factor
        found[channel.name] = {
            "before": float(np.sqrt(gap) * size),
            "noise_floor": float(np.sqrt(max(noise, 0.0)) * size),
            "unit": channel.unit,
        }
    return found


@dataclass(frozen=True, slots=True)
class MisfitPlace:
    """Describes a part of the recording in which the gap appears.

    `share`: fraction of the energy that exceeds the noise. Every factor divides the same energy into levels. The shares of all
    levels of one factor, over all channels, add up to at most 1; the shares of different factors overlap. `of`: the quantity of
    which `share` is a fraction. It is `gap` for energy in the coefficients of the segments. It is `noise` for energy outside the
    basis of these coefficients, which is compared with the noise of the channel. `p`: p-value, adjusted for the number of parts of
    the recording that are examined.
    """

    channel: str
    factor: Factor
    level: str
    share: float
    p: float
    of: Literal["gap", "noise"] = "gap"


def places(weighing: Weighing, kinds: Mapping[Pattern, Array]) -> list[MisfitPlace]:
    """Lists all parts of the recording that were examined, the most conspicuous first. `kinds`: for each pattern outside the
    catalogue, the log Bayes factor (K,) of the pattern in each channel alone.

    The list begins with the best level of each channel and factor. These levels are ranked by the evidence that the residual of the
    channel follows the factor. This evidence is averaged over the patterns of the factor, which penalises factors with many levels.
    The other levels follow in the order of their scores.
    """
    outside = _outside(weighing, kinds)
    evidence = _by_factor(outside[1], kinds)
    listed = list(levels(weighing))
    found = []
    for c, channel in enumerate(weighing.observed.channels):
        for factor, values in evidence.items():
            own = [(score, place) for place, score in listed if (place.channel, place.factor) == (channel.name, factor)]
            own.sort(key=lambda item: -item[0])
            if factor is Factor.BAND and np.argmax(outside[:, c]) > 0:
                own.insert(0, (0.0, _of_noise(weighing, c, float(values[c]), len(listed))))
            found += [
                (float(values[c]) if rank == 0 else -np.inf, score, place) for rank, (score, place) in enumerate(own)
            ]
    return [place for *_, place in sorted(found, key=lambda item: (-item[0], -item[1]))]


def _by_factor(noisier: Array, kinds: Mapping[Pattern, Array]) -> dict[Factor, Array]:
    """Returns the log Bayes factor of each factor in each channel, shape (K,). `noisier`: array of shape (K,), log Bayes factor of
    the hypothesis that the white noise is larger than declared. `kinds`: the same as in `places`."""
    sorted_: dict[Factor, list[Array]] = {Factor.BAND: [noisier]}
    for pattern, values in kinds.items():
        sorted_.setdefault(pattern.factor, []).append(values)
    return {factor: log_mean_exp(np.array(values), 0) for factor, values in sorted_.items()}


def _outside(weighing: Weighing, kinds: Mapping[Pattern, Array]) -> Array:
    """Returns the log Bayes factors, shape (3, K), of three hypotheses: slow changes within segments, more white noise than
    declared, and a tone outside the basis of the coefficients. `kinds`: the same as in `places`."""
    none = np.full(len(weighing.observed.channels), -np.inf)
    more = excess_by_channel(weighing.declared, weighing.white, weighing.white_degrees)
    return np.array([kinds.get(WHOLE[Sort.TRANSIENT], none), more, kinds.get(TONE, none)])


def _of_noise(weighing: Weighing, channel: int, evidence: float, places_: int) -> MisfitPlace:
    """Returns the entry for noise or a tone outside the basis of the coefficients. The p-value of this entry follows from Markov's
    inequality: if there is only noise, the probability of a Bayes factor of B or more is at most 1/B. `channel`: index of the
    channel. `evidence`: logarithm of B. `places_`: number of parts of the recording that were examined, for Bonferroni's
    correction."""
    declared = weighing.declared.channels[channel]
    level = declared.sample_variance(weighing.observed.sample_rate) / weighing.white[channel] ** 2
    p = min(1.0, places_ * float(np.exp(-evidence)))
    return MisfitPlace(declared.name, Factor.BAND, "noise or a tone", float(np.clip(1 - level, 0.0, 1.0)), p, "noise")


def levels(weighing: Weighing) -> Iterator[tuple[MisfitPlace, float]]:
    """Yields the place and its score for every channel and level. The score states by how many standard deviations the energy
    exceeds the energy that pure noise would have."""
    channels = [channel.name for channel in weighing.observed.channels]
    listed = list(_masks(weighing))
    masks = np.array([mask for _, _, mask in listed], dtype=float)
    data = np.array([weights[0].residual for weights in weighing.weights])
    energy, noise = masks @ (data**2).T, np.stack([masks @ squares for squares in _replicates(weighing)], axis=1).T
    noise = np.swapaxes(noise, 1, 2)
    mean, spread = noise.mean(0), noise.std(0) + 1e-12
    score = (energy - mean) / spread
    highest = ((noise - mean) / spread).reshape(len(noise), -1).max(1)
    excess = np.maximum(energy - mean, 0.0)
    whole = float((data**2).sum() - mean[:1].sum())
    factors = np.array([factor for factor, _, _ in listed])
    for row, (factor, level, _) in enumerate(listed):
        total = max(whole, float(excess[factors == factor].sum()), 1e-300)
        for c, name in enumerate(channels):
            p = (1 + np.count_nonzero(highest >= score[row, c])) / (1 + len(highest))
            yield MisfitPlace(name, factor, level, float(excess[row, c] / total), float(p)), float(score[row, c])


def _replicates(weighing: Weighing) -> Iterator[Array]:
    """Simulates pure noise, and projects out the part that the nominal parameters absorb, as in the data. Yields the squared
    residuals of each channel, shape (M, replicates)."""
    draw = np.random.default_rng(SEED)
    rows = len(weighing.spectrum.segment)
    for weights in weighing.weights:
        noise, basis = draw.standard_normal((rows, REPLICATES)), weights[0].basis
        noise -= basis @ (basis.T @ noise)
        yield np.square(noise, out=noise)


def _masks(weighing: Weighing) -> Iterator[tuple[Factor, str, NDArray[np.bool_]]]:
    """Yields each factor, each of its levels, and a mask (M,) of the coefficients that belong to the level. The first mask contains
    all coefficients."""
    observed, spectrum = weighing.observed, weighing.spectrum
    segment = spectrum.segment
    yield Factor.CHANNEL, "all", np.ones(len(segment), dtype=bool)
    middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
    factors = state_labels(observed)
    for name, values, unit in (
        (Factor.TEMPERATURE, observed.temperature[middles], "degC"),
        (Factor.TIME, observed.time[middles], "s"),
    ):
        factors[name] = _binned(values, unit)
    for factor, levels in factors.items():
        for level in dict.fromkeys(levels):
            mask = np.array([item == level for item in levels])
            if 0 < mask.sum() < len(mask):
                yield factor, level, mask[segment]
    yield Factor.BAND, "slow change within segments", (spectrum.frequency > 0) & (spectrum.harmonic == 0)
    response = spectrum.harmonic == RESPONSE
    if response.any():
        yield Factor.BAND, "response to the motion of the encoder", response
    for h in sorted(set(spectrum.harmonic[spectrum.harmonic > 0])):
        yield Factor.TABLE_ANGLE, f"{h} per turn or period", spectrum.harmonic == h


def state_labels(observed: Observed) -> dict[Factor, list[str]]:
    """Describes the orientation and the motion of each segment in words."""
    middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
    orientations = [_words(attitude) if observed.along is None else _up(attitude) for attitude in observed.attitude]
    rates = np.degrees(observed.rate[middles])
    motion = ["rocking" if m else f"{r:.6g} deg/s" for m, r in zip(observed.unsteady, rates, strict=True)]
    return {Factor.ORIENTATION: orientations, Factor.RATE: motion}


def _binned(values: Array, unit: str) -> list[str]:
    edges = np.linspace(values.min(), values.max(), _LEVELS + 1)
    if edges[-1] - edges[0] <= 0:
        return [""] * len(values)
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _LEVELS - 1)
    return [f"{edges[i]:.4g} to {edges[i + 1]:.4g} {unit}" for i in index]


def _up(attitude: Array) -> str:
    """Describes the direction of the vertical in the sensor's axes. This function is used for poses in an unknown orientation, for
    which only the direction of the vertical is known. `attitude`: array of shape (3, 3), whose last column is the vertical."""
    return "up at " + ", ".join(f"{letter} {value:.2f}" for letter, value in zip("xyz", attitude[:, 2], strict=True))


def _words(attitude: Array) -> str:
    words = [word_of(row, _NEAR) for row in attitude]
    if None in words:
        return "oblique " + " ".join(f"{value:.2f}" for value in attitude[2])
    return ", ".join(f"{letter} {word}" for letter, word in zip("xyz", words, strict=True))


SEEN = 3.0
"""If the log Bayes factor of a pattern in a channel is above this value, the channel shows the pattern."""


@dataclass(frozen=True)
class FormPoint:
    """Contains the offsets of the channels at one level of the factor, and the standard uncertainties of these offsets due to
    noise, in the units of the channels."""

    level: str
    values: tuple[float, ...]
    uncertainties: tuple[float, ...]


@dataclass(frozen=True)
class UnknownForm:
    """Describes the form of an unknown cause. `pattern`: name of the pattern in words. `factor`: the factor that the gap follows.
    `channels`, `units`: channels that show the gap, and their units. `share`: fraction of the gap's energy, summed over all
    channels, that the pattern explains. `share` is None for noise and tones, which lie outside the coefficients. `points`: the
    offsets at each level; empty if the pattern does not consist of offsets.
    """

    pattern: str
    factor: Factor
    channels: tuple[str, ...]
    units: tuple[str, ...]
    share: float | None
    points: tuple[FormPoint, ...]

    def to_json(self) -> JsonObject:
        """Returns JSON data according to `unknown_form` of `schemas/diagnosis.schema.json`."""
        return {
            "pattern": self.pattern,
            "factor": self.factor.value,
            "channels": list(self.channels),
            "units": list(self.units),
            "share": self.share,
            "points": [
                {"level": one.level, "values": list(one.values), "standard_uncertainties": list(one.uncertainties)}
                for one in self.points
            ],
        }


def unknown_form(weighing: Weighing, found: Posterior) -> UnknownForm | None:
    """Returns the form of the most probable pattern outside the catalogue; None if no channel shows a pattern."""
    usual = [pattern for pattern, value in found.kinds.items() if np.isfinite(value) and pattern in found.by_channel]
    if not usual:
        return None
    best = max(usual, key=lambda pattern: found.kinds[pattern])
    seen = [index for index, value in enumerate(found.by_channel[best]) if value > SEEN]
    if not seen:
        return None
    rows = sorts(weighing).get(best.sort)
    share: float | None = None
    points: tuple[FormPoint, ...] = ()
    if best.sort is Sort.MEANS:
        labels = _labels(weighing, best.factor)
        share, points = _of_levels(weighing, labels, seen), _points(weighing, labels, seen)
    elif rows is not None:
        share = _share(weighing, sum(_excess(weighing, index, rows) for index in seen))
    channels = [weighing.observed.channels[index] for index in seen]
    return UnknownForm(
        best.name, best.factor, tuple(c.name for c in channels), tuple(c.unit for c in channels), share, points
    )


def _labels(weighing: Weighing, factor: Factor) -> list[str]:
    """Returns the level of the factor in each segment, as text. For a factor without common levels, each segment has its own level."""
    observed = weighing.observed
    if factor is Factor.TEMPERATURE:
        middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
        return [f"{value:.0f} degC" for value in observed.temperature[middles]]
    return state_labels(observed).get(factor) or list(observed.labels)


def _excess(weighing: Weighing, index: int, rows: NDArray[np.bool_]) -> float:
    """Returns the energy of the selected coefficients (`rows`) of a channel, minus the energy that noise alone would have."""
    residual = weighing.weights[index][0].residual[rows]
    return float(residual @ residual) - len(residual)


def _share(weighing: Weighing, part: float) -> float:
    """Converts a part of the gap's energy to a fraction of the total energy, limited to 0 … 1."""
    every = np.ones(len(weighing.spectrum.segment), dtype=bool)
    whole = sum(_excess(weighing, index, every) for index in range(len(weighing.weights)))
    return float(np.clip(part / max(whole, 1e-300), 0.0, 1.0))


def _of_levels(weighing: Weighing, labels: Sequence[str], seen: Sequence[int]) -> float:
    """Returns the fraction of the gap's energy that a constant offset at each level of the factor explains. `labels`: level of each
    segment. `seen`: indices of the channels that show the gap."""
    _, which = np.unique(np.array(labels), return_inverse=True)
    count = np.bincount(which)
    total = 0.0
    for index in seen:
        means = weighing.weights[index][0].residual[weighing.spectrum.means]
        total += float((np.bincount(which, means) ** 2 / count).sum()) - len(count)
    return _share(weighing, total)


def _points(weighing: Weighing, labels: Sequence[str], seen: Sequence[int]) -> tuple[FormPoint, ...]:
    """Returns the mean offset at each level, weighted by the noise of the segments, in the order of the recording. `labels`,
    `seen`: the same as in `_of_levels`."""
    order = list(dict.fromkeys(labels))
    which = np.array([order.index(label) for label in labels])
    values, uncertainties = [], []
    for index in seen:
        weight, spectrum = weighing.weights[index][0], weighing.spectrum
        factor = weighing.observed.channels[index].factor
        root = np.sqrt(weighing.observed.counts)
        sigma = np.sqrt(weight.variances[spectrum.means]) / root / factor
        weights = np.bincount(which, 1 / sigma**2)
        values.append(np.bincount(which, weight.residual[spectrum.means] / sigma) / weights)
        uncertainties.append(1 / np.sqrt(weights))
    return tuple(
        FormPoint(label, tuple(float(v[k]) for v in values), tuple(float(u[k]) for u in uncertainties))
        for k, label in enumerate(order)
    )


def pictures(weighing: Weighing, candidates: Sequence[Candidate], after: Weighed | None) -> JsonObject:
    """Returns the data for all plots: a heat map of the energy by segment and channel, in units of the noise; the confusability of
    every two effects (`answer.verdict`); the segment means before and after the effects are fitted; and the spectra. `after`: the
    fitted effects, or None if there are none."""
    observed, spectrum = weighing.observed, weighing.spectrum
    segments = len(observed)
    explained = None if after is None else [own @ after.amplitudes[0] for own in after.by_channel]
    degrees = np.bincount(spectrum.segment, minlength=segments)
    heat, means = [], {}
    for index, channel in enumerate(observed.channels):
        weight = weighing.weights[index][0]
        heat.append((np.bincount(spectrum.segment, weight.residual**2, segments) / degrees).tolist())
        root = np.sqrt(observed.counts)
        sigma = np.sqrt(weight.variances[spectrum.means]) / root / channel.factor
        rest = weight.residual if explained is None else weight.residual - explained[index]
        means[channel.name] = {
            "before": (weight.residual[spectrum.means] * sigma).tolist(),
            "after": (rest[spectrum.means] * sigma).tolist(),
            "noise": sigma.tolist(),
            "unit": channel.unit,
        }
    names, shares = matrix(candidates)
    return {
        "heat": {"channels": [c.name for c in observed.channels], "segments": list(observed.labels), "values": heat},
        "confusability": {"effects": names, "shares": shares.tolist()},
        "means": {"segments": list(observed.labels), "channels": means},
        "spectrum": _spectra(weighing, explained),
    }


def _spectra(weighing: Weighing, explained: Sequence[Array] | None) -> JsonObject:
    """Returns the one-sided amplitude spectral density in each frequency band, before and after the effect is fitted, and the
    density of the white noise. Segment means are not included, because their frequency is zero. If the bins of the segments have
    different sizes, only the segments with the largest bins are used. The spectrum then ends at half the rate of these bins.
    `explained`: for each channel, the whitened coefficients (M,) that the effect explains; None if there is no effect."""
    observed, spectrum = weighing.observed, weighing.spectrum
    size = observed.bin_size.max()
    shown = observed.bin_size == size
    middle = (spectrum.edges[:-1] + spectrum.edges[1:]) / 2
    within = (spectrum.frequency > 0) & shown[spectrum.segment]
    band = np.searchsorted(spectrum.edges, spectrum.frequency[within], side="right") - 1
    count = np.maximum(spectrum.count[shown].sum(0), 0.0) + np.bincount(band, minlength=len(middle))
    used = count > 0
    found = {}
    for index, channel in enumerate(observed.channels):
        scale = np.sqrt(2 / observed.sample_rate) / channel.factor
        level, residual = float(weighing.white[index]), weighing.weights[index][0].residual
        rest = residual if explained is None else residual - explained[index]
        outside = spectrum.energy[shown][:, :, index].sum(0)
        curves = [
            outside + np.bincount(band, (level * values[within]) ** 2, len(middle)) for values in (residual, rest)
        ]
        before, afterwards = (np.sqrt(power[used] / count[used]) * scale for power in curves)
        found[channel.name] = {
            "frequency_hz": middle[used].tolist(),
            "before": before.tolist(),
            "after": afterwards.tolist(),
            "noise": [float(level * scale)] * int(used.sum()),
            "unit": f"{channel.unit}/sqrt(Hz)",
        }
    return found
