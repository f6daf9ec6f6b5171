"""Locates the gap: the channel, the factor that the gap follows, and the most conspicuous level of this factor.

Factors are orientation, rate, temperature, time, angle of the table, and frequency band. The evidence for the patterns of the open
set determines which factor the whitened residual of a channel follows. Levels are compared by a score, which is their energy in
standard deviations of the energy of pure noise. With pure noise, levels have different degrees of freedom, and many levels are
examined. The p-value of a place is therefore the probability that, for pure noise projected like the data, the highest score of all
places is at least as high as the score of this place (max-statistic parametric bootstrap; Westfall and Young, Resampling-Based
Multiple Testing, 1993).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import log_mean_exp
from planrunner.gap.evidence.noise_levels import excess_by_channel
from planrunner.gap.evidence.spectrum import RESPONSE
from planrunner.gap.hypotheses.candidates import Weighing
from planrunner.gap.hypotheses.open_set import TONE
from planrunner.gap.hypotheses.patterns import WHOLE, Factor, Pattern, Sort
from planrunner.plan.directions import word_of

REPLICATES = 400
SEED = 20
_LEVELS = 4  # bins of temperature and time
_NEAR = math.sqrt(2 - 2 * 0.999)
"""Smallest cosine between an axis and a direction for which the direction's word is used."""


@dataclass(frozen=True, slots=True)
class MisfitPlace:
    """A part of the recording in which the gap appears.

    `share`: fraction of the energy above the noise. Every factor divides the same energy: the shares of one factor, over all
    channels, add up to at most 1; shares of different factors overlap. `of`: the quantity of which `share` is a fraction. It is
    `gap`, or `noise` for energy outside the basis, which is compared with the noise of the channel. `p`: p-value, adjusted for the
    number of places that are examined.
    """

    channel: str
    factor: Factor
    level: str
    share: float
    p: float
    of: Literal["gap", "noise"] = "gap"


def places(weighing: Weighing, kinds: Mapping[Pattern, Array]) -> list[MisfitPlace]:
    """Lists all places, the most conspicuous first. `kinds`: for each pattern outside the catalogue, the log Bayes factor (K,) of
    the pattern in each channel alone.

    The best level of each channel and factor is ranked by the evidence that the residual of the channel follows the factor. This
    evidence is the mean over the patterns of the factor, which penalises factors with many levels. The other levels of a factor
    follow in the order of their scores.
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
    """Log Bayes factor (K,) of each factor. `noisier`: log Bayes factor (K,) that the white noise is larger than declared."""
    sorted_: dict[Factor, list[Array]] = {Factor.BAND: [noisier]}
    for pattern, values in kinds.items():
        sorted_.setdefault(pattern.factor, []).append(values)
    return {factor: log_mean_exp(np.array(values), 0) for factor, values in sorted_.items()}


def _outside(weighing: Weighing, kinds: Mapping[Pattern, Array]) -> Array:
    """Log Bayes factor (3, K) of three hypotheses: slow changes within segments, more white noise than declared, and a tone outside
    the basis."""
    none = np.full(len(weighing.observed.channels), -np.inf)
    more = excess_by_channel(weighing.declared, weighing.white, weighing.white_degrees)
    return np.array([kinds.get(WHOLE[Sort.TRANSIENT], none), more, kinds.get(TONE, none)])


def _of_noise(weighing: Weighing, channel: int, evidence: float, places_: int) -> MisfitPlace:
    """The place that represents noise or a tone outside the basis. The p-value of this place is Markov's bound: for noise alone, a
    Bayes factor of B or more has at most the probability 1/B."""
    declared = weighing.declared.channels[channel]
    level = (declared.white**2 * weighing.observed.sample_rate + declared.resolution**2 / 12) / weighing.white[
        channel
    ] ** 2
    p = min(1.0, places_ * float(np.exp(-evidence)))
    return MisfitPlace(declared.name, Factor.BAND, "noise or a tone", float(np.clip(1 - level, 0.0, 1.0)), p, "noise")


def levels(weighing: Weighing) -> Iterator[tuple[MisfitPlace, float]]:
    """Yields, for every channel and level, the place and its score, which is the energy in standard deviations of the energy of
    pure noise."""
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
    """Yields, for each channel, the squared residuals (M, replicates) of simulated pure noise that is projected like the data."""
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
    """Describes the vertical direction in the sensor's axes; nothing else is known of a pose."""
    return "up at " + ", ".join(f"{letter} {value:.2f}" for letter, value in zip("xyz", attitude[:, 2], strict=True))


def _words(attitude: Array) -> str:
    words = [word_of(row, _NEAR) for row in attitude]
    if None in words:
        return "oblique " + " ".join(f"{value:.2f}" for value in attitude[2])
    return ", ".join(f"{letter} {word}" for letter, word in zip("xyz", words, strict=True))
