"""Noise with known coefficients, made without anything from the package: white, flicker, random walk and white phase."""

from __future__ import annotations

import numpy as np

Array = np.ndarray


def flicker(draw: np.random.Generator, samples: int, coefficient: float) -> Array:
    """S_y(f) = B²/(π·f), one-sided (IEEE Std 952), by fractional integration of order one half (Kasdin, Proc. IEEE 83, 1995, 802).

    The response is h_k = h_{k−1}·(k − 1/2)/k; seven eighths of what is made are thrown away, so that the beginning does not show.
    """
    total = 8 * samples
    k = np.arange(1, total, dtype=float)
    response = np.concatenate([[1.0], np.cumprod((k - 0.5) / k)])
    spectrum = np.fft.rfft(response, 2 * total) * np.fft.rfft(draw.standard_normal(total), 2 * total)
    return coefficient * np.fft.irfft(spectrum, 2 * total)[total - samples : total]


def rate(
    draw: np.random.Generator, samples: int, interval: float, N: float = 0, B: float = 0, K: float = 0, Q: float = 0
) -> Array:
    """Samples of an output [unit], each the mean over one interval [s]; coefficients in unit·√s, unit, unit/√s and unit·s."""
    y = N / np.sqrt(interval) * draw.standard_normal(samples)
    if B:
        y = y + flicker(draw, samples, B)
    if K:
        y = y + K * np.sqrt(interval) * np.cumsum(draw.standard_normal(samples))
    if Q:
        y = y + Q / interval * np.diff(draw.standard_normal(samples + 1))
    return y
