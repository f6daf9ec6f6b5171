"""Numbers for the drawings of a diagnosis, and the gap by channel, as plain data in the channels' units."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from planrunner.gap.candidates import Candidate, Weighed, Weighing
from planrunner.gap.confusability import matrix
from planrunner.gap.evidence import best_amplitudes
from planrunner.gap.spectrum import band_edges


def gap_by_channel(weighing: Weighing) -> dict[str, dict[str, Any]]:
    """By channel: root mean square of what the nominal simulation leaves of the coefficients, what noise alone leaves, and the unit."""
    found = {}
    for index, channel in enumerate(weighing.observed.channels):
        weight = weighing.weights[index][0]
        rest = weight.residual
        degrees = max(len(rest) - weight.basis.shape[1], 1)
        level = weighing.white[index] / channel.factor
        found[channel.name] = {
            "before": float(level * np.sqrt(rest @ rest / degrees)),
            "noise_floor": float(level),
            "unit": channel.unit,
        }
    return found


def pictures(weighing: Weighing, candidates: Sequence[Candidate], after: Weighed | None) -> dict[str, Any]:
    """heat: energy per segment and channel in times of the noise; confusability; means before and after; spectra."""
    observed, spectrum = weighing.observed, weighing.spectrum
    segments = len(observed)
    amplitudes = None if after is None else best_amplitudes(after.gram[0], after.score[0], after.trace)[0]
    degrees = np.bincount(spectrum.segment, minlength=segments)
    heat, means = [], {}
    for index, channel in enumerate(observed.channels):
        weight = weighing.weights[index][0]
        heat.append((np.bincount(spectrum.segment, weight.residual**2, segments) / degrees).tolist())
        root = np.sqrt(np.diff(observed.bounds))
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
        "spectrum": _spectra(weighing),
    }


def _spectra(weighing: Weighing) -> dict[str, Any]:
    """One-sided density by band of what the basis leaves, root of power, beside the white level. An effect's columns lie in the basis,
    so that
    what is left after it is the same."""
    observed, spectrum = weighing.observed, weighing.spectrum
    edges = band_edges(1 << 12) / (1 << 12) * observed.sample_rate / 2
    middle = (edges[:-1] + edges[1:]) / 2
    found = {}
    for index, channel in enumerate(observed.channels):
        scale = np.sqrt(2 / observed.sample_rate) / channel.factor
        power = spectrum.energy[:, :, index].sum(0) / np.maximum(spectrum.count.sum(0), 1.0)
        found[channel.name] = {
            "frequency_hz": middle.tolist(),
            "before": (np.sqrt(power) * scale).tolist(),
            "after": (np.sqrt(power) * scale).tolist(),
            "noise": [float(weighing.white[index] * scale)] * len(middle),
            "unit": f"{channel.unit}/sqrt(Hz)",
        }
    return found
