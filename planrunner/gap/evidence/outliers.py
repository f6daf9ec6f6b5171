"""Finds outliers in coloured noise: single samples whose error is larger than the spectrum of the noise allows.

In white noise, an outlier lies far from all other samples. In coloured noise, an outlier can be smaller than the scatter of the
samples and still change the low frequencies. An example is a gyro whose rounding errors cancel from sample to sample. Each sample
is therefore compared with the value that all other samples of its segment predict.

Let Σ be the covariance of the noise, V the basis of the segment, x the samples, and P = Σ⁻¹ − Σ⁻¹V(VᵀΣ⁻¹V)⁻¹VᵀΣ⁻¹. Then the
estimated error of sample t is (Px)_t/P_tt, and its variance is 1/P_tt (Chang, Tiao and Chen, "Estimation of time series parameters
in the presence of outliers", Technometrics 30, 1988). The discrete cosine transform makes Σ diagonal, except near the ends of the
segment. At an end of the segment, there is no further sample that could cancel the error of the outermost sample. If this error is
large, the outermost sample also counts as an outlier.

A step of the signal also causes a large estimated error of a sample. A sample is therefore an outlier only if two conditions hold:
its segment has few outliers, and no step near the sample explains more of the signal than the outlier does (Tsay, "Outliers, level
shifts, and variance changes in time series", Journal of Forecasting 7, 1988).

In array shapes, n is the number of samples of a segment, N is the number of all samples, and K is the number of channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.noise_within import NoiseWithin
from planrunner.gap.evidence.spectrum import Spectrum
from planrunner.observation.bins import SPIKE

MOST = 3  # largest number of outliers of a channel in a segment; `SHARE` may allow more
SHARE = 1e-3
LARGEST = 30  # upper limit of that number, because the time grows with the square of the number of outliers
LEAST = 64  # smallest number of samples of a segment that is examined
_NEAR = np.array([*range(-4, 6), -32, -24, -16, -12, -8, -6, 7, 9, 13, 17, 25, 33])
"""Possible starts of a step, in samples after an outlier."""
_TRIED = 16  # number of samples with the largest errors, for which P_tt is computed exactly
_ROUGHLY = 0.5  # smallest ratio of the approximate to the exact statistic
_DEVIATION = 0.6745  # median absolute value of a normal variable


@dataclass(frozen=True)
class Pulses:
    """Contains the outliers of a segment, which are errors of single samples. `rows`: array of shape (p,), rows of the samples.
    `sizes`: array of shape (p,), errors of these samples."""

    rows: NDArray[np.int64]
    sizes: Array


def outliers(
    observed: Observed, spectrum: Spectrum, noise: NoiseWithin, white: Array, coarse: NDArray[np.bool_]
) -> Array | None:
    """Returns the errors of the outliers, SI, shape (N, K); None if there are no outliers. `white`: array of shape (K,) in SI
    units, standard deviation of the white noise of a sample. `coarse`: array of shape (K,), True for channels with coarse counts,
    which are not examined. The result also contains the errors of the samples that `spectrum` replaced."""
    from scipy.fft import dct

    found = np.zeros(spectrum.remainder.shape)  # takes no memory before it is written
    transformed: dict[int, Array] = {}
    for index, (basis, part) in enumerate(zip(spectrum.bases, observed.segments(), strict=True)):
        channels = np.flatnonzero(noise.coloured[noise.moving[index]] & ~coarse)
        samples = spectrum.remainder[part]
        if len(samples) < LEAST or not len(channels):
            continue
        if id(basis) not in transformed:
            transformed[id(basis)] = dct(basis.removed, norm="ortho", axis=0)
        size = int(observed.bin_size[index])
        frequency = np.arange(len(samples)) * observed.sample_rate / size / (2 * len(samples))
        variance = noise.of_segment(index, frequency) * white**2
        for channel in channels:
            replaced = np.flatnonzero(spectrum.replaced[part, channel])
            pulses = pulses_in(samples[:, channel], transformed[id(basis)], variance[:, channel], replaced)
            found[part.start + pulses.rows, channel] = (
                pulses.sizes + spectrum.replaced[part.start + pulses.rows, channel]
            ) / np.sqrt(size)
    return found if found.any() else None


def pulses_in(samples: Array, basis: Array, variance: Array, known: NDArray[np.int64]) -> Pulses:
    """Returns the outliers among the samples of a segment, shape (n,).

    `basis`: array of shape (n, m), cosine transforms of m vectors that the samples may contain with unknown amplitudes. `variance`:
    array of shape (n,), variance of the noise in each coefficient of the cosine transform. `known`: rows of samples that are
    already known to be wrong. If too many outliers are found, only the known rows are returned. If there are too many known rows,
    no rows are returned.
    """
    from scipy.fft import dct, idct

    most = max(MOST, min(int(SHARE * len(samples)), LARGEST))
    if len(known) > most:
        return Pulses(known[:0], np.zeros(0))
    root = 1 / np.sqrt(variance)
    transformed = root * dct(samples, norm="ortho")
    precision = _diagonal(root**2)
    rows = known.tolist()
    while len(rows) <= most:
        q, _ = _solved(basis, rows, root)
        error = idct(root * (transformed - q @ (q.T @ transformed)), norm="ortho")  # Px
        error[rows] = 0.0
        rough = np.abs(error) / np.sqrt(precision)
        scale = max(1.0, float(np.median(rough)) / _DEVIATION)
        tried = np.argsort(-rough)[:_TRIED]
        if rough[tried[0]] < _ROUGHLY * SPIKE * scale:
            break
        exact = np.abs(error[tried]) / np.sqrt(_left(_unit(len(samples), tried) * root[:, None], q))
        top = int(np.argmax(exact))
        if exact[top] <= SPIKE * scale or _step(error, int(tried[top]), root, q) >= exact[top]:
            break
        rows.append(int(tried[top]))
    else:
        rows = known.tolist()
    q, turned = _solved(basis, rows, root)
    fitted = turned.T @ (q.T @ transformed)
    return Pulses(np.array(rows, dtype=np.int64), fitted[basis.shape[1] :])


def _solved(basis: Array, rows: list[int], root: Array) -> tuple[Array, Array]:
    """Whitens columns: the vectors `basis` (n, m), and a unit pulse at each of the rows. Returns an orthonormal basis Q of the
    whitened columns, and the matrix T, defined by Q = (whitened columns)·Tᵀ. `root`: array of shape (n,), inverse standard
    deviations."""
    columns = np.column_stack([basis, _unit(len(root), rows)]) * root[:, None]
    size = np.linalg.norm(columns, axis=0)
    turned = np.linalg.inv(np.linalg.cholesky((columns.T @ columns) / np.outer(size, size))) / size
    return columns @ turned.T, turned


def _unit(count: int, rows: Sequence[int] | NDArray[np.int64]) -> Array:
    """Returns the cosine transforms (n, p) of unit pulses, one pulse at each of the rows."""
    order = np.arange(count)[:, None]
    waves = np.cos(np.pi * order * (2 * np.asarray(rows, dtype=float) + 1) / (2 * count)) * np.sqrt(2 / count)
    waves[0] /= np.sqrt(2)
    return np.asarray(waves)


def _diagonal(weight: Array) -> Array:
    """Returns the diagonal of Σ⁻¹, shape (n,). `weight`: array of shape (n,), inverse variance of each coefficient of the cosine
    transform."""
    count = len(weight)
    turned = weight * np.exp(1j * np.pi * np.arange(count) / count)
    turned[0] = 0.0
    return np.asarray((weight.sum() + count * np.fft.ifft(turned).real) / count)


def _left(columns: Array, q: Array) -> Array:
    """Returns the energies (p,) of columns (n, p) after the part in the span of the orthonormal columns `q` (n, m) has been
    removed."""
    return np.asarray(np.maximum((columns**2).sum(0) - ((q.T @ columns) ** 2).sum(0), 1e-300))


def _step(error: Array, row: int, root: Array, q: Array) -> float:
    """Returns the largest test statistic of a step near a row. This statistic has the same scale as the test statistic of an
    outlier, so that the two can be compared.

    `error`: array of shape (n,), the vector Px that the module docstring defines. `root`: array of shape (n,), inverse standard
    deviation of each coefficient of the cosine transform. `q`: array of shape (n, m), orthonormal basis of the whitened columns
    that are fitted (`_solved`).
    """
    from scipy.fft import dct

    count = len(error)
    first = row + _NEAR
    first = first[(first > 0) & (first < count)]
    steps = dct((np.arange(count)[:, None] >= first).astype(float), norm="ortho", axis=0) * root[:, None]
    beyond = np.cumsum(error[::-1])[::-1]
    return float((np.abs(beyond[first]) / np.sqrt(_left(steps, q))).max())
