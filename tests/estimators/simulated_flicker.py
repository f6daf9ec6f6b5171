"""Flicker of batch means through a whole test, by synthesis in the frequency domain; nothing from the package.

One-sided density B²/(π·f): IEEE 952's bias instability B, whose Allan deviation has its floor at 0.664·B. A batch mean is the average
of the noise over its batch: its density is that of the noise times sinc², with what lies above the Nyquist frequency folded down.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

_FOLDS = 16  # Nyquist zones whose noise is folded into the batch means


def flicker_series(
    rng: np.random.Generator, shape: tuple[int, ...], floor: float, step: float, count: int
) -> np.ndarray:
    """Batch means, shape (*shape, count), `step` s long each, one after the other; without the part that is constant over all of them."""
    size = floor * _amplitudes(step, count)
    drawn = rng.standard_normal((*shape, 2 * len(size)))
    spectrum = np.zeros((*shape, len(size) + 1), dtype=complex)
    spectrum[..., 1:] = size * drawn.view(complex)
    return np.fft.irfft(spectrum, count) * (count / 2)


@lru_cache(maxsize=4)
def _amplitudes(step: float, count: int) -> np.ndarray:
    """Root mean square of the cosine and of the sine at each frequency but zero, for B = 1."""
    frequency = np.fft.rfftfreq(count, step)[1:]
    density = np.zeros(len(frequency))
    for fold in range(-_FOLDS, _FOLDS + 1):
        shifted = np.abs(frequency + fold / step)
        density += np.sinc(shifted * step) ** 2 / (math.pi * shifted)
    return np.sqrt(density * frequency[0])
