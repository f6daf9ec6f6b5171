"""Computes rounding errors in the means of many samples that are rounded to counts.

Noise of half a count or more dithers the rounding, so that its errors average out. With smaller noise, an error remains, which
depends on the position of the mean within a count. Repetition does not average out this error. The scatter of rounded samples does
not show how small the noise is: readings that alternate between two counts scatter by half a count even if the noise is very small.
The number of samples at each count does show the size of the noise, because only sufficiently large noise reaches a third count.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.plan.schedule import Rest

NOISES = np.geomspace(0.02, 1.0, 24)  # standard deviations that are compared, in counts
PLACES = np.linspace(-1.0, 1.0, 801)  # positions of a true mean about a count, in counts
DITHERED = 0.5  # noise, in counts, below which rounding makes the noise depend on the reading
DOUBT = float(np.log(2.0))  # standard deviation of the logarithm of the declared noise
STRAY = 1e-4  # share of samples that are not explained by the noise
HARMONICS = np.arange(1, 101)  # of the saw-tooth
_MOST = 60  # counts that a segment at rest may reach


def is_coarse(white: Array | float, count: Array | float) -> NDArray[np.bool_]:
    """Returns True if the counts of a channel are so coarse that the noise does not dither the rounding. `white`: standard
    deviation of a rounded sample. Its square includes the variance count²/12 of the rounding."""
    return np.asarray(np.square(white) < np.square(count) * (1 / 12 + DITHERED**2))


def dithering(sigma: Array | float) -> Array:
    """Returns the variance of the rounding error in the mean of many samples, divided by its value without noise. `sigma`: standard
    deviation of the noise, in counts.

    The error is a saw-tooth function of the mean's position within a count. Gaussian noise multiplies harmonic number k of this
    function by exp(−2π²k²σ²) (Widrow and Kollár, Quantization Noise, 2008, section 19.3). Without noise, the variance is 1/12 of a
    squared count.
    """
    weight = 6 / (np.pi * HARMONICS) ** 2
    return np.asarray(np.exp(-4 * (np.pi * np.multiply.outer(sigma, HARMONICS)) ** 2) @ weight)


def undithered(observed: Observed, white: Array, coarse: NDArray[np.bool_]) -> Array:
    """Returns the variance of the rounding error in the mean of many samples, SI², shape (K,). `white`: array of shape (K,) in SI
    units, standard deviation of a rounded sample. `coarse`: array of shape (K,), True if the noise of a channel is too small to
    dither the rounding. For coarse channels, the variance is averaged over all noise levels, weighted by their agreement with the
    declared noise and with the number of samples at each count in segments at rest. If samples were averaged over bins, these
    numbers are unknown and are not used."""
    found = np.zeros(len(observed.channels))
    for index, channel in enumerate(observed.channels):
        count = channel.resolution
        if count <= 0:
            continue
        if coarse[index] and (observed.bins is None or channel.white > 0):
            log = _of_declared(channel.white * np.sqrt(observed.sample_rate) / count) + _of_counts(observed, index)
            share = np.exp(log - log.max())
            factor = float(share @ dithering(NOISES) / share.sum())
        else:
            before = np.sqrt(max(white[index] ** 2 - count**2 / 12, 0.0)) / count
            factor = float(dithering(before))
        found[index] = count**2 / 12 * factor
    return found


def _of_declared(sigma: float) -> Array:
    """Returns the log prior (S,) of the noise levels `NOISES`, which are in counts. The prior is concentrated near the declared
    level, or uniform if no level is declared."""
    return np.zeros(len(NOISES)) if sigma <= 0 else -0.5 * (np.log(NOISES / sigma) / DOUBT) ** 2


def _of_counts(observed: Observed, index: int) -> Array:
    """Returns the log likelihood (S,) of the noise levels `NOISES`, computed from the numbers of samples at each count in segments
    at rest. For each noise level, the true mean of a segment is assumed to be the value that would give the observed mean
    reading."""
    found = np.zeros(len(NOISES))
    if observed.bins is not None:
        return found
    count = observed.channels[index].resolution
    readings = [_reading(sigma) for sigma in NOISES]
    for motion, part in zip(observed.motions, observed.segments(), strict=True):
        levels = np.round((observed.values[part, index] - observed.values[part.start, index]) / count)
        reached, times = np.unique(levels, return_counts=True)
        if not isinstance(motion, Rest) or len(reached) > _MOST:
            continue
        mean = float(levels.mean())
        nearest = np.round(mean)
        for place, sigma in enumerate(NOISES):
            true = nearest + np.interp(mean - nearest, readings[place], PLACES)
            found[place] += np.log(STRAY + (1 - STRAY) * _chances(reached - true, sigma)) @ times
    return found


def _reading(sigma: float) -> Array:
    """Returns the mean readings (P,) for the true means `PLACES` and noise of the standard deviation `sigma`, all in counts."""
    levels = np.arange(-4, 5) - PLACES[:, None]
    return np.asarray(PLACES + (_chances(levels, sigma) * levels).sum(axis=1))


def _chances(away: Array, sigma: float) -> Array:
    """Returns the probability that a sample is rounded to a certain count. `away`: distance of this count from the true mean, in
    counts. `sigma`: standard deviation of the noise, in counts."""
    from scipy.special import ndtr

    return np.asarray(ndtr((away + 0.5) / sigma) - ndtr((away - 0.5) / sigma))
