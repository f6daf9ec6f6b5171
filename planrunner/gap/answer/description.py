"""Computes results that a diagnosis reports in addition to the explanation: the gap and the noise of each channel, in the unit of
the channel, and the data for plots. The noise is only reported; it does not compete with the effects as an explanation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.documents import JsonObject
from planrunner.gap.answer.verdict import matrix
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing
from planrunner.gap.hypotheses.outside import Line


@dataclass(frozen=True, slots=True)
class NoiseFound:
    """Describes the noise of a channel, in the channel's unit.

    `white`, `declared`: standard deviation of a single sample due to white noise, as found in the recording and as declared.
    `declared` includes the rounding to `declared_count`; it is 0 if no noise is declared. `count`, `declared_count`: size of one
    count, as found in the recording and as declared; 0 if the values are not rounded to counts. `slow`: amplitude density at the
    lowest measured frequency, divided by the amplitude density of the white noise; 1 if there is only white noise. `quietest`,
    `loudest`: standard deviation of the noise in the quietest and in the loudest segment, divided by the standard deviation of the
    white noise. `line`: the strongest tone, None if there is none.
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


def pictures(weighing: Weighing, candidates: Sequence[Candidate], after: Weighed | None) -> JsonObject:
    """Returns the data for all plots: a heat map of the energy by segment and channel, in units of the noise; the confusability;
    the segment means before and after the effects are fitted; and the spectra."""
    observed, spectrum = weighing.observed, weighing.spectrum
    segments = len(observed)
    amplitudes = None if after is None else after.amplitudes[0]
    degrees = np.bincount(spectrum.segment, minlength=segments)
    heat, means = [], {}
    for index, channel in enumerate(observed.channels):
        weight = weighing.weights[index][0]
        heat.append((np.bincount(spectrum.segment, weight.residual**2, segments) / degrees).tolist())
        root = np.sqrt(observed.counts)
        sigma = np.sqrt(np.diag(weight.covariance(spectrum.frequency == 0))) / root / channel.factor
        rest = (
            weight.residual
            if amplitudes is None or after is None
            else weight.residual - after.by_channel[index] @ amplitudes
        )
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
        "spectrum": _spectra(weighing, after, amplitudes),
    }


def _spectra(weighing: Weighing, after: Weighed | None, amplitudes: Array | None) -> JsonObject:
    """Returns the one-sided amplitude spectral density in each frequency band, before and after the effect is fitted, and the
    density of the white noise. Segment means are not included, because their frequency is zero. If the bins of the segments have
    different sizes, only the segments with the largest bins are used. The spectrum then ends at half the rate of these bins."""
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
        rest = residual if after is None or amplitudes is None else residual - after.by_channel[index] @ amplitudes
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
