"""Where the gap lives: energy of the whitened residual by channel and place.

Places are orientation, rate, temperature, time, band and harmonic of the table's angle.

A place's energy has its own degrees of freedom under pure noise, and there are many places to look at. So every place is scored by the
standardised energy, and its p-value is the chance that the highest score anywhere comes out so high: from residuals of noise alone, freed
of the nominal parameters like the data (max-statistic parametric bootstrap; Westfall and Young, Resampling-Based Multiple Testing, 1993).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.gap.candidates import Weighing

Array = NDArray[np.float64]
REPLICATES = 400
SEED = 20
_LEVELS = 4  # bins of temperature and time


@dataclass(frozen=True, slots=True)
class Place:
    """A part of the recording. share: of all energy above the noise, at most 1. p: adjusted for the number of places."""

    channel: str
    factor: str
    level: str
    share: float
    p: float


def places(weighing: Weighing) -> list[Place]:
    """All places, the most remarkable first."""
    channels = [channel.name for channel in weighing.observed.channels]
    listed = list(_masks(weighing))
    masks = np.array([mask for _, _, mask in listed], dtype=float)
    data = np.array([weights[0].residual for weights in weighing.weights])
    squares = _replicates(weighing)
    energy, noise = masks @ (data**2).T, np.einsum("lm,rcm->rlc", masks, squares)
    mean, spread = noise.mean(0), noise.std(0) + 1e-12
    score = (energy - mean) / spread
    highest = ((noise - mean) / spread).reshape(len(noise), -1).max(1)
    excess = np.maximum(energy - mean, 0.0)
    total = max(float((data**2).sum() - mean[:1].sum()), float(excess.max()), 1e-300)
    found = []
    for row, (factor, level, _) in enumerate(listed):
        for c, name in enumerate(channels):
            p = (1 + np.count_nonzero(highest >= score[row, c])) / (1 + len(highest))
            found.append((float(score[row, c]), Place(name, factor, level, float(excess[row, c] / total), float(p))))
    return [place for _, place in sorted(found, key=lambda item: -item[0])]


def _replicates(weighing: Weighing) -> Array:
    """Squared residuals of pure noise, (replicates, K, M), projected like the data."""
    draw = np.random.default_rng(SEED)
    rows = len(weighing.spectrum.segment)
    out = np.empty((REPLICATES, len(weighing.weights), rows))
    for c, weights in enumerate(weighing.weights):
        noise = draw.standard_normal((rows, REPLICATES))
        basis = weights[0].basis
        out[:, c] = ((noise - basis @ (basis.T @ noise)) ** 2).T
    return out


def _masks(weighing: Weighing) -> Iterator[tuple[str, str, NDArray[np.bool_]]]:
    """Factor, level and the coefficients (M,) that belong to it. The first is everything."""
    observed, spectrum = weighing.observed, weighing.spectrum
    segment = spectrum.segment
    yield "channel", "all", np.ones(len(segment), dtype=bool)
    middles = (observed.bounds[:-1] + observed.bounds[1:] - 1) // 2
    orientations = [_words(attitude) if observed.along is None else _up(attitude) for attitude in observed.attitude]
    rates = np.degrees(observed.rate[middles])
    moving = np.array([bool(np.any(observed.acceleration[part])) for part in observed.segments()])
    motion = ["rocking" if m else f"{r:.6g} deg/s" for m, r in zip(moving, rates, strict=True)]
    factors = {"orientation": orientations, "rate": motion}
    for name, values, unit in (
        ("temperature", observed.temperature[middles], "degC"),
        ("time", observed.time[middles], "s"),
    ):
        factors[name] = _binned(values, unit)
    for factor, levels in factors.items():
        for level in dict.fromkeys(levels):
            mask = np.array([item == level for item in levels])
            if 0 < mask.sum() < len(mask):
                yield factor, level, mask[segment]
    yield "band", "segment means", spectrum.frequency == 0
    yield "band", "slow change within segments", (spectrum.frequency > 0) & (spectrum.harmonic == 0)
    for h in sorted(set(spectrum.harmonic[spectrum.harmonic > 0])):
        yield "table angle", f"{h} per turn or period", spectrum.harmonic == h


def _binned(values: Array, unit: str) -> list[str]:
    edges = np.linspace(values.min(), values.max(), _LEVELS + 1)
    if edges[-1] - edges[0] <= 0:
        return [""] * len(values)
    index = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _LEVELS - 1)
    return [f"{edges[i]:.4g} to {edges[i + 1]:.4g} {unit}" for i in index]


def _up(attitude: Array) -> str:
    """Where up lies in the sensor's axes: all that is known of a pose."""
    return "up at " + ", ".join(f"{letter} {value:.2f}" for letter, value in zip("xyz", attitude[:, 2], strict=True))


def _words(attitude: Array) -> str:
    names = {0: ("east", "west"), 1: ("north", "south"), 2: ("up", "down")}
    words = []
    for letter, row in zip("xyz", attitude, strict=True):
        axis = int(np.argmax(np.abs(row)))
        if abs(row[axis]) < 0.999:
            return "oblique " + " ".join(f"{value:.2f}" for value in attitude[2])
        words.append(f"{letter} {names[axis][0 if row[axis] > 0 else 1]}")
    return ", ".join(words)
