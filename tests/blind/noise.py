"""Noise of the true device, and distances measured in it.

Flicker is a sum of sinusoids with Gaussian amplitudes at logarithmically spaced frequencies, so its covariance has low rank
and λ (the energy of a signature in units of the noise, after the nominal parameters took what they can) needs only dense
linear algebra: amplitudes of the flicker enter as parameters with a Gaussian prior, matrix and bias as parameters without one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tests.blind.device import Sensor, Triad
from tests.blind.motion import Array, Schedule, stimulus

FREQUENCIES = np.geomspace(2e-5, 0.5, 36)  # Hz; of the flicker
FLAT = 1e-12  # of the Gram matrix's scale: columns that the plan cannot see are dropped


def flicker_basis(time: Array) -> Array:
    """Cosines and sines of the flicker's frequencies, shape (n, 72)."""
    phase = 2 * np.pi * np.outer(time, FREQUENCIES)
    return np.hstack([np.cos(phase), np.sin(phase)])


def flicker_variance(triad: Triad) -> Array:
    """Variance of each amplitude: one-sided density B²/(πf) times the band that a frequency stands for."""
    band = FREQUENCIES * np.log(FREQUENCIES[1] / FREQUENCIES[0])
    return np.tile(triad.instability**2 / (np.pi * FREQUENCIES) * band, 2)


def noise(schedule: Schedule, sensor: Sensor, factors: Array, rng: np.random.Generator) -> Array:
    """White noise (declared × `factors` per channel) and declared flicker, shape (n, channels)."""
    found = rng.standard_normal((len(schedule.time), 3 * len(sensor.triads))) * sensor.sigma() * factors
    for i, triad in enumerate(sensor.triads):
        if triad.instability:
            amplitudes = np.sqrt(flicker_variance(triad))[:, None] * rng.standard_normal((2 * len(FREQUENCIES), 3))
            found[:, 3 * i : 3 * i + 3] += flicker_basis(schedule.time) @ amplitudes
    return found


def outliers(values: Array, sigma: Array, rng: np.random.Generator) -> Array:
    """Spikes of 8 to 40 σ added to one sample in some 3000; the copy is returned."""
    found = values.copy()
    for channel, size in enumerate(sigma):
        hit = rng.choice(len(found), max(1, rng.poisson(len(found) / 3000)), replace=False)
        found[hit, channel] += size * rng.uniform(8, 40, len(hit)) * rng.choice([-1, 1], len(hit))
    return found


@dataclass(frozen=True)
class Metric:
    """Inner products of signatures (n, channels) in units of the true noise, with the nominal parameters projected out."""

    schedule: Schedule
    sensor: Sensor
    factors: tuple[float, ...]  # true ÷ declared white noise, per triad

    @cached_property
    def _triads(self) -> list[tuple[float, Array, Array]]:
        felt = stimulus(self.schedule, {})
        found = []
        for i, triad in enumerate(self.sensor.triads):
            sigma = self.sensor.sigma()[3 * i] * self.factors[i]
            columns = np.column_stack([felt.rate if i == 0 else felt.force, np.ones(len(felt.time))])
            prior = np.zeros(4)
            if triad.instability:
                columns = np.hstack([columns, flicker_basis(felt.time)])
                prior = np.concatenate([prior, sigma**2 / flicker_variance(triad)])
            scale = np.linalg.norm(columns, axis=0)
            scale = np.maximum(scale, 1e-9 * scale.max())
            columns = columns / scale
            values, vectors = np.linalg.eigh(columns.T @ columns + np.diag(prior / scale**2))
            kept = values > FLAT * values[-1]
            found.append((sigma, columns, (vectors[:, kept] / values[kept]) @ vectors[:, kept].T))
        return found

    def clear(self, signature: Array) -> Array:
        """Signature ÷ σ with what nominal parameters and flicker explain taken out: ⟨u, v⟩ = (u ÷ σ)·clear(v)."""
        found = np.empty_like(signature)
        for i, (sigma, columns, inverse) in enumerate(self._triads):
            part = signature[:, 3 * i : 3 * i + 3]
            found[:, 3 * i : 3 * i + 3] = (part - columns @ (inverse @ (columns.T @ part))) / sigma
        return found

    def scaled(self, signature: Array) -> Array:
        """Signature ÷ σ."""
        return signature / np.repeat([triad[0] for triad in self._triads], 3)

    def energy(self, signature: Array) -> float:
        """λ of a signature."""
        return max(0.0, float(np.sum(self.scaled(signature) * self.clear(signature))))
