"""Plain data for the plots of a diagnosis, and the gap of each channel in the channel's unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.documents import JsonObject
from planrunner.gap.answer.confusability import matrix
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing


def gap_by_channel(weighing: Weighing) -> dict[str, JsonObject]:
    """For each channel: the gap, the gap that noise alone would cause, and the unit. The gap is the root mean square over the
    samples of the residual of the nominal simulation, as far as the coefficients represent this residual. The gap does not depend
    on the sampling rate, and a constant offset enters with its full size."""
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
    """Data for all plots. The data are: a heat map of the energy by segment and channel, in units of the noise; the confusability;
    segment means before and after the effects are fitted; spectra."""
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
    """One-sided amplitude spectral density in each frequency band, before and after the effect is fitted, and the density of the
    white noise. Segment means are omitted, because their frequency is zero. If segments have bins of different sizes, only those
    with the largest bins are used; the spectrum ends at half their bin rate."""
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
