"""Computes rounding errors in the means of many samples that are rounded to counts, the steps of a digital output. Noise of half a
count or more dithers the rounding, so that the rounding errors average out. With smaller noise, an error remains that depends on
the position of the mean within a count. This error does not average out in repetitions. The scatter of rounded samples does not
show how small the noise is: readings that alternate between two counts scatter by half a count even if the noise is very small. The
number of samples at each count does show the size of the noise, because only sufficiently large noise reaches a third count.

In array shapes, K is the number of channels, and S is the number of noise levels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.plan.schedule import Rest

NOISES = np.geomspace(0.02, 1.0, 24)  # standard deviations that are compared, in counts
SPREADS = np.geomspace(0.02, 4.0, 32)  # standard deviations of the noises of a mixture, in counts
MIXED = 1.5  # scatter of a channel, in counts, above which no mixture is considered
PLACES = np.linspace(-1.0, 1.0, 801)  # positions of a true mean relative to a count, in counts
DITHERED = 0.5  # noise, in counts, below which the noise after rounding depends on the reading
DOUBT = float(np.log(2.0))  # standard deviation of the logarithm of the declared noise
STRAY = 1e-4  # fraction of samples that the noise does not explain
HARMONICS = np.arange(1, 101)  # orders of the harmonics of the saw-tooth
_ROUNDS, _STEPS = 3, 20  # rounds and steps of expectation maximisation; every round computes the true means again
_MOST = 60  # largest number of different counts in a usable segment at rest


def is_coarse(white: Array | float, count: Array | float) -> NDArray[np.bool_]:
    """Returns True if the counts of a channel are so coarse that the noise does not dither the rounding. Rounding errors then do
    not average out. `white`: standard deviation of a rounded sample. The square of `white` includes the variance count²/12 of the
    rounding. `count`: size of one count, in the same unit. The arrays are evaluated element by element."""
    return np.asarray(np.square(white) < np.square(count) * (1 / 12 + DITHERED**2))


def dithering(sigma: Array | float) -> Array:
    """Returns the variance of the rounding error in the mean of many samples, divided by the variance without noise. `sigma`:
    standard deviation of the noise, in counts. The error is a saw-tooth function of the mean's position within a count. Noise
    multiplies the harmonic k of this function by the characteristic function of the noise at 2πk (Widrow and Kollár, Quantization
    Noise, 2008, section 19.3). Without noise, the variance is 1/12 count².
    """
    return _left_over(_characteristic(sigma))


def _left_over(characteristic: Array) -> Array:
    """Computes the variance of the rounding error, divided by the variance without noise, from the characteristic function of the
    noise at 2πk. `characteristic`: array of shape (…, H) with one value for each of the H harmonics k in `HARMONICS`."""
    return np.asarray(characteristic**2 @ (6 / (np.pi * HARMONICS) ** 2))


def _characteristic(sigma: Array | float) -> Array:
    """Returns the characteristic function of Gaussian noise at 2πk, for the H values of k in `HARMONICS`, shape (…, H). `sigma`:
    array of shape (…), standard deviations of the noise, in counts."""
    return np.asarray(np.exp(-2 * (np.pi * np.multiply.outer(sigma, HARMONICS)) ** 2))


def undithered(observed: Observed, white: Array, coarse: NDArray[np.bool_]) -> Array:
    """Returns the variance of the rounding error in the mean of many samples, SI², shape (K,). `white`: array of shape (K,) in SI
    units, standard deviation of a rounded sample. `coarse`: array of shape (K,), True if the noise of a channel is too small to
    dither the rounding. For coarse channels, the variance is averaged over all noise levels. A noise level has a large weight if it
    agrees both with the declared noise and with the data. The data are the numbers of samples at each count in segments at rest. If
    these numbers show a mixture of smaller and larger noise, the variance is that of the mixture: noise with many small values
    dithers less than Gaussian noise of the same standard deviation. If samples were averaged over bins, these numbers are unknown
    and are not used."""
    found = np.zeros(len(observed.channels))
    for index, channel in enumerate(observed.channels):
        count = channel.resolution
        if count <= 0:
            continue
        mixed = _of_mixture(observed, index) if white[index] < MIXED * count else None
        if mixed is not None:
            factor = mixed
        elif coarse[index] and (observed.bins is None or channel.white > 0):
            log = _of_declared(channel.white * np.sqrt(observed.sample_rate) / count) + _of_counts(observed, index)
            likely = np.exp(log - log.max())
            factor = float(likely @ dithering(NOISES) / likely.sum())
        else:
            before = np.sqrt(max(white[index] ** 2 - count**2 / 12, 0.0)) / count
            factor = float(dithering(before))
        found[index] = count**2 / 12 * factor
    return found


def _of_declared(sigma: float) -> Array:
    """Returns the log prior of the noise levels `NOISES`, which are in counts, shape (S,). The prior is concentrated near the
    declared level; it is uniform if no level is declared. `sigma`: declared standard deviation of the noise, in counts; 0 if none
    is declared."""
    return np.zeros(len(NOISES)) if sigma <= 0 else -0.5 * (np.log(NOISES / sigma) / DOUBT) ** 2


@dataclass(frozen=True)
class _Counted:
    """Contains the readings of a segment at rest, in counts relative to one reading near the mean. `mean`: mean reading. `levels`:
    array of shape (n,), the readings that occur. `times`: array of shape (n,), number of samples with each of these readings."""

    mean: float
    levels: Array
    times: NDArray[np.int64]


def _counted(observed: Observed, index: int) -> list[_Counted]:
    """Counts the readings of a channel in segments at rest. The result is empty if samples were averaged over bins."""
    found: list[_Counted] = []
    if observed.bins is not None:
        return found
    count = observed.channels[index].resolution
    for motion, part in zip(observed.motions, observed.segments(), strict=True):
        levels = np.round((observed.values[part, index] - observed.values[part.start, index]) / count)
        reached, times = np.unique(levels, return_counts=True)
        if isinstance(motion, Rest) and len(reached) <= _MOST:
            nearest = np.round(levels.mean())
            found.append(_Counted(float(levels.mean() - nearest), reached - nearest, times))
    return found


def _of_counts(observed: Observed, index: int) -> Array:
    """Returns the log likelihood of the noise levels `NOISES`, shape (S,). The likelihood is computed from the numbers of samples
    at each count in segments at rest. For each noise level, the true mean of a segment is chosen so that it gives the mean reading
    of the segment."""
    segments = _counted(observed, index)
    return np.array([_log_likelihood(segments, float(sigma), _reading(sigma)) for sigma in NOISES])


def _of_mixture(observed: Observed, index: int) -> float | None:
    """Returns the variance of the rounding error for a mixture of two Gaussian noises, divided by the variance without noise. The
    result is the mean over all pairs of noises, weighted by the likelihood of the numbers of samples at each count in segments at
    rest. The result is None if, by Schwarz's criterion, one Gaussian noise describes these numbers as well as a mixture, which has
    two more parameters."""
    segments = _counted(observed, index)
    if not segments:
        return None
    readings = np.array([_reading(sigma) for sigma in SPREADS])
    times = np.concatenate([one.times for one in segments])
    low, high = np.triu_indices(len(SPREADS), 1)
    alone = [_log_likelihood(segments, float(sigma), own) for sigma, own in zip(SPREADS, readings, strict=True)]
    reading = readings[int(np.argmax(alone))]
    for _ in range(_ROUNDS):
        away = np.concatenate([one.levels - np.interp(one.mean, reading, PLACES) for one in segments])
        chances = STRAY + (1 - STRAY) * _chances(away, SPREADS[:, None])
        share = np.full(len(low), 0.5)
        for _ in range(_STEPS):
            both = share[:, None] * chances[low] + (1 - share[:, None]) * chances[high]
            share = share * ((chances[low] / both) @ times) / times.sum()
        log = np.log(share[:, None] * chances[low] + (1 - share[:, None]) * chances[high]) @ times
        best = int(np.argmax(log))
        reading = share[best] * readings[low[best]] + (1 - share[best]) * readings[high[best]]
    if log[best] - max(alone) <= np.log(times.sum()):
        return None
    factors = _characteristic(SPREADS)
    mixed = share[:, None] * factors[low] + (1 - share[:, None]) * factors[high]
    likely = np.exp(log - log[best])
    return float(likely @ _left_over(mixed) / likely.sum())


def _log_likelihood(segments: list[_Counted], sigma: float, reading: Array) -> float:
    """Returns the log likelihood of the readings for Gaussian noise of `sigma` counts. `reading`: array of shape (P,), mean reading
    for each of the true means `PLACES`."""
    found = 0.0
    for one in segments:
        true = np.interp(one.mean, reading, PLACES)
        found += float(np.log(STRAY + (1 - STRAY) * _chances(one.levels - true, sigma)) @ one.times)
    return found


def _reading(sigma: float) -> Array:
    """Returns the mean reading for each of the true means `PLACES`, shape (P,). `sigma`: standard deviation of the noise. All
    values are in counts."""
    most = int(np.ceil(4 + 4 * sigma))
    levels = np.arange(-most, most + 1) - PLACES[:, None]
    return np.asarray(PLACES + (_chances(levels, sigma) * levels).sum(axis=1))


def _chances(away: Array, sigma: Array | float) -> Array:
    """Returns the probability that a sample is rounded to a certain count. `away`: distance of this count from the true mean, in
    counts. `sigma`: standard deviation of the noise, in counts. The arrays are evaluated element by element."""
    from scipy.special import ndtr

    return np.asarray(ndtr((away + 0.5) / sigma) - ndtr((away - 0.5) / sigma))
