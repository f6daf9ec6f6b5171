"""Measures the noise that a recording shows within segments: its spectrum, and its level in every segment.

The spectrum and the level are measured in the remainder of the samples, outside the coefficients, where no effect of the catalogue
acts. Therefore noise cannot absorb an effect, and an effect cannot appear as noise. At the lowest frequencies, nearly all of the
data belong to the coefficients, so little can be measured. If the noise is coloured, its spectrum at these frequencies is therefore
also derived from the cosine coefficients, by the median of their squares. An effect in fewer than half of the segments hardly
changes this median. There are several reasons for coloured noise: outputs are rounded, filtered or differenced, or they contain
lines of interference. Vibration can make the noise differ between segments. By default, the noise counts as white, and as equal in
all segments. A description with more parameters is used only if Schwarz's criterion (BIC; Annals of Statistics 6, 1978) prefers it.
A spectrum that is measured only at rest, or only in motion, is used for all segments if it describes the other segments better than
white noise.

In array shapes, S is the number of segments, N is the number of samples, K is the number of channels, M is the number of
coefficients of a channel, and B is the number of frequency bands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.covariance import Blocks
from planrunner.gap.evidence.spectrum import UPPER, SpectralBasis, Spectrum
from planrunner.plan.schedule import Rest

CARRIED = 4.0  # weight of the next higher band in the level of a band of a common spectrum, as a number of coefficients
OWN = 16.0  # the same for the spectrum of one segment
_ROUNDS = 2  # number of times that the levels and the spectra are computed in turn
_LEAKAGE_ROUNDS = 10  # number of steps that remove the leakage of the cosine transform from a spectrum
_KEPT = 0.3  # smallest fraction of a density that these steps keep, because non-stationary noise has another leakage
_WINDOWS = 16  # number of windows of a segment; the level is the median of their energies, which a burst does not raise
_EFFICIENCY = 2 / np.pi  # efficiency of a median, relative to a mean
_MEDIAN = 0.4549  # median of χ² with one degree of freedom
_OF_MEDIAN = 0.368  # efficiency of the median of squares of normal values as an estimate of their variance
_COUNTED = 2.0  # smallest number of coefficients of a band from which its variance in a segment is measured
_SEGMENTS = 4  # smallest number of such segments with which the scatter between segments is measured
_VARIOUS = 4.0  # smallest degrees of freedom of the scatter between segments
_SAME = 1e3  # degrees of freedom at and above which the variances of the segments count as equal
_NARROW = 4.0  # smallest degrees of freedom with which the noise near the frequency of a harmonic is measured
_STANDING = 0.1
"""The level of a segment is at least this fraction of the median level of all segments or, if the level at rest is lower, of the
level at rest. This limit is necessary because a limited or stuck output has little noise or none, but is not more precise than
other outputs."""
_LEAST_SEEN = 1e-6
"""Fraction of the energy of a vector of the basis that the remaining samples must show, so that they determine its coefficient."""
_IN_LOBE = 32  # number of frequencies at which the noise of a segment mean is evaluated
_SMALLEST = 1e-6  # smallest level relative to the white noise, for example of an output that stays at one count


@dataclass(frozen=True)
class NoiseWithin:
    """Contains the variance of the noise of each channel, relative to its white level.

    `frequency`: array of shape (B,) in Hz, centres of the bands. `weight`: array of shape (B,), number of coefficients in each
    band. `spectrum`: array of shape (2, B, K), spectra of the segments at rest and of the segments in motion, as the cosine
    transform of a segment shows them. `density`: array of shape (2, B, K), the spectra at rest and in motion without the leakage of
    the transform, that is, without noise that the transform shows at wrong frequencies. `level`: array of shape (S, K), level of
    each segment. `own`: array of shape (S, B, K), variance in each band of a segment, divided by the product of `spectrum` and
    `level`. `moving`: array of shape (S,), index of the spectrum that applies to each segment: 0 at rest, 1 in motion. `coloured`:
    array of shape (2, K), True if a spectrum is not white. `differing`: array of shape (K,), True if the level differs between
    segments. `peaks`: array of shape (M, K), lower limit of the variance of each harmonic of the motion, relative to the level of
    its segment; zero for other coefficients.
    """

    frequency: Array
    weight: Array
    spectrum: Array
    density: Array
    level: Array
    own: Array
    moving: NDArray[np.int64]
    coloured: NDArray[np.bool_]
    differing: NDArray[np.bool_]
    peaks: Array

    @property
    def lowest(self) -> float:
        """Returns the lowest frequency [Hz] at which the spectrum was measured."""
        return float(self.frequency[0])

    def of_coefficients(self, observed: Observed, spectrum: Spectrum) -> list[Blocks]:
        """Returns, for each channel, the covariances between the coefficients of the same segment.

        The covariance of two coefficients with the vectors u and v of the basis is ∫ S(f)·U*(f)·V(f) df for stationary noise, where
        S is the spectral density, and U and V are the Fourier transforms of u and v. If the noise is strong at high frequencies,
        this covariance is not zero. The reason is that, at the ends of a segment, the vectors of even order are similar to each
        other. The same is true for the vectors of odd order. The variance of a coefficient of the cosine transform, or of a
        harmonic, is at least the spectrum of the cosine transform at its frequency. A harmonic that begins or ends within a period
        contains more noise of high frequencies than a vector of the cosine transform. Means count as independent of the other
        coefficients, because slow noise determines them.
        """
        size = [len(basis.frequency) for basis in spectrum.bases]
        found = [Blocks.diagonal(size, self.level[:, channel]) for channel in range(self.level.shape[1])]
        coloured = np.flatnonzero(self.coloured.any(0) | self.differing | self.peaks.any(0))
        known: dict[tuple[int, int], Array] = {}
        common = (self.own == 1.0).all(axis=(1, 2))
        for index, basis in enumerate(spectrum.bases if len(coloured) else ()):
            key = id(basis), int(self.moving[index])
            covariance = known.get(key) if common[index] else None
            if covariance is None:
                half = observed.sample_rate / int(observed.bin_size[index]) / 2
                covariance = self._covariance(index, basis, half, self.peaks[spectrum.segment == index])
            if common[index]:
                known[key] = covariance
            for channel in coloured.tolist():
                found[channel].of_segment(index)[:] = self.level[index, channel] * covariance[channel]
        return found

    def without_held(self, observed: Observed, held: NDArray[np.bool_]) -> NoiseWithin:
        """Returns a copy with another level for segments in which samples are replaced by the fit. Replaced samples have no noise,
        so the measured level of such a segment is too low. If the median level of all segments is higher, the median is used
        instead. `held`: array of shape (N, K), True for replaced samples."""
        affected = np.logical_or.reduceat(held, observed.bounds[:-1], axis=0)
        return replace(
            self, level=np.where(affected, np.maximum(self.level, np.median(self.level, axis=0)), self.level)
        )

    def of_held(self, observed: Observed, spectrum: Spectrum, held: NDArray[np.bool_]) -> list[Blocks]:
        """Returns, for each channel, the increase of the covariances of the coefficients due to samples that are replaced by the
        fit. `held`: array of shape (N, K), True for replaced samples.

        Let G be the rows of the basis V that belong to the other samples of a segment. Only these samples determine the
        coefficients. If a sample has the variance σ², the covariance of the coefficients is then σ²·(GᵀG)⁻¹ instead of σ²·I.
        """
        size = [len(basis.frequency) for basis in spectrum.bases]
        found = [Blocks.diagonal(size, np.zeros(len(size))) for _ in observed.channels]
        for index, (basis, part) in enumerate(zip(spectrum.bases, observed.segments(), strict=True)):
            for channel in np.flatnonzero(held[part].any(axis=0)).tolist():
                left = basis.removed[~held[part][:, channel]]
                values, vectors = np.linalg.eigh(left.T @ left)
                more = (vectors * (1 / np.maximum(values, _LEAST_SEEN) - 1)) @ vectors.T
                found[channel].of_segment(index)[:] = self.level[index, channel] * more[: size[index], : size[index]]
        return found

    def _covariance(self, segment: int, basis: SpectralBasis, half: float, peaks: Array) -> Array:
        """Returns the covariance of the coefficients of a segment, relative to the level of the segment, shape (K, m, m). `half`:
        half of the sampling rate, Hz. `peaks`: array of shape (m, K), the rows of the attribute `peaks` for this segment.

        The harmonics of the motion absorb all coefficients near their frequencies. Therefore, a line of the noise at these
        frequencies is not visible in a segment in motion. It is visible in the spectrum at rest. If the spectrum at rest is larger,
        the difference is added to the variance of the harmonic.
        """
        from scipy.fft import rfft

        count = len(basis.vectors)
        waves = rfft(basis.vectors, 2 * count, axis=0) / np.sqrt(count)
        waves[[0, -1]] /= np.sqrt(2)
        frequency = np.linspace(0.0, half, len(waves))
        kind = int(self.moving[segment])
        density = self._of_kind(self.density, kind, segment, frequency)
        found = np.array([((waves.conj().T * own) @ waves).real for own in density.T])
        found[:, 0] = found[:, :, 0] = 0.0
        periodic = np.flatnonzero(basis.harmonic >= 0)
        seen = self._of_kind(self.spectrum, kind, segment, basis.frequency[periodic])
        found[:, periodic, periodic] = np.maximum(found[:, periodic, periodic], seen.T)
        at_rest = self.coloured[0] & (self.moving == 0).any()
        found[:, 0, 0] = np.maximum(found[:, 0, 0], self._of_mean(kind, segment, count / (2 * half)))
        harmonics = np.flatnonzero(basis.harmonic > 0)
        if kind and at_rest.any() and len(harmonics):
            more = np.maximum(self._of_kind(self.density, 0, segment, frequency) - density, 0.0) * at_rest
            found[:, harmonics, harmonics] += (np.abs(waves[:, harmonics]) ** 2).T.dot(more).T
        found[:, harmonics, harmonics] = np.maximum(found[:, harmonics, harmonics], peaks[harmonics].T)
        return found

    def _of_mean(self, kind: int, segment: int, lasting: float) -> Array:
        """Returns the variance (K,) of the mean of a segment that lasts `lasting` seconds, relative to the level of the segment, from
        the noise at frequencies up to 1/`lasting`. The mean of a short segment contains noise of several bands. The lowest band
        alone is measured less precisely, because only the longest segments contribute to it. `kind`, `segment`: the same as in
        `_of_kind`."""
        turns = (np.arange(_IN_LOBE) + 0.5) / _IN_LOBE
        weight = np.sinc(turns) ** 2
        return np.asarray(weight @ self._of_kind(self.spectrum, kind, segment, turns / lasting) / weight.sum())

    def of_segment(self, segment: int, frequency: Array) -> Array:
        """Returns the variance of the noise of a segment at the frequencies (n,) [Hz], relative to the white level, shape (n,
        K)."""
        return np.asarray(self.level[segment] * self._relative(segment, frequency))

    def of_kind(self, kind: int, frequency: Array | float) -> Array:
        """Returns the spectrum at rest (kind 0) or in motion (kind 1) at one frequency, shape (K,), or at several frequencies (n,),
        shape (n, K), in Hz. The result does not contain the levels of segments."""
        return self._between(self.spectrum[kind], frequency)

    def whitened(self, segment: int, samples: Array, half: float) -> Array:
        """Returns the samples (n, K) of a segment with less noise at low frequencies. Where the noise exceeds the noise at all
        higher frequencies, it is reduced to their level. The coefficients of the cosine transform are divided by the square root of the
        spectrum that `_falling` returns. Low frequencies with less noise are not amplified, because the ends of a segment and slow changes
        of the noise would then look like bursts. The bands of the segment itself are not used, because a burst raises them. `half`: half of
        the sampling rate of the samples, Hz."""
        from scipy.fft import dct, idct

        kind = int(self.moving[segment])
        channels = np.flatnonzero(self.coloured[kind])
        found = samples.copy()
        if len(channels):
            frequency = np.arange(len(samples)) * half / len(samples)
            root = np.sqrt(_falling(self.of_kind(kind, frequency)[:, channels]))
            found[:, channels] = idct(dct(samples[:, channels], norm="ortho", axis=0) / root, norm="ortho", axis=0)
        return found

    @property
    def inefficiency(self) -> Array:
        """Returns, for each channel, the number of whitened samples (`whitened`) divided by the degrees of freedom of a sum of their
        squares, shape (K,). This factor exceeds 1 if the whitened noise is still coloured."""
        left = self.spectrum / np.array([_falling(one) for one in self.spectrum])
        return np.asarray((self.weight @ left**2 * self.weight.sum() / (self.weight @ left) ** 2).max(0))

    def _relative(self, segment: int, frequency: Array) -> Array:
        """Returns the spectrum of a segment, without its level, at frequencies (n,) [Hz], shape (n, K). The spectrum is constant
        beyond the outermost bands."""
        return self._of_kind(self.spectrum, int(self.moving[segment]), segment, frequency)

    def _of_kind(self, spectra: Array, kind: int, segment: int, frequency: Array) -> Array:
        """Returns the values (n, K) of `spectrum` or `density` at frequencies (n,), as measured at rest (kind 0) or in motion (kind
        1). `spectra`: `spectrum` or `density`. `segment`: index of the segment whose attribute `own` applies."""
        return self._between(spectra[kind] * self.own[segment], frequency)

    def _between(self, bands: Array, frequency: Array | float) -> Array:
        """Interpolates the values `bands` (B, K) linearly in logarithms at one frequency, shape (K,), or at several frequencies (n,),
        shape (n, K). The values are constant beyond the outermost bands."""
        place = np.log(np.maximum(frequency, self.lowest))
        logs = [np.interp(place, np.log(self.frequency), one) for one in np.log(bands).T]
        return np.asarray(np.exp(np.stack(logs, axis=-1)))


def noise_within(observed: Observed, spectrum: Spectrum, white: Array, left: Array) -> NoiseWithin:
    """Measures the noise within the segments, outside the coefficients. `white`: array of shape (K,) in SI units, standard
    deviation of the white noise of a sample. `left`: array of shape (M, K) in SI·√samples, coefficients after the fitted nominal
    parameters have been subtracted."""
    count = np.maximum(spectrum.count, 0.0)
    low = np.flatnonzero((spectrum.harmonic == 0) & (spectrum.frequency > 0))
    band_of = np.minimum(np.searchsorted(spectrum.edges, spectrum.frequency[low], side="right"), count.shape[1]) - 1
    used = count.sum(0) + np.bincount(band_of, minlength=count.shape[1]) > 0
    band_of = (np.cumsum(used) - 1)[band_of]
    squares = left[low] ** 2 / np.maximum(white, 1e-300) ** 2
    count = count[:, used]
    energy = spectrum.energy[:, used] / np.maximum(white, 1e-300) ** 2
    centre = np.sqrt(np.maximum(spectrum.edges[:-1], spectrum.edges[1:] / 4) * spectrum.edges[1:])[used]
    moving = np.array([int(not isinstance(motion, Rest)) for motion in observed.motions])
    shape = (2, len(centre), len(white))
    spectra, coloured = np.ones(shape), np.zeros((2, len(white)), dtype=bool)
    level, differing = np.ones((len(observed), len(white))), np.zeros(len(white), dtype=bool)
    standing = np.zeros(level.shape, dtype=bool)
    of_segment, typical = np.maximum(count.sum(1), 1e-9), _typical(observed, spectrum) / np.maximum(white, 1e-300) ** 2
    upper = spectrum.edges[:-1][used] > UPPER * observed.sample_rate
    for channel, _ in product(range(len(white)), range(_ROUNDS)):
        for kind in np.unique(moving):
            here = moving == kind
            own = count[here].sum(0)
            seen = (energy[here, :, channel] / level[here, channel][:, None]).sum(0)
            shape_ = _relative_to_upper(seen, own, upper)
            coloured[kind, channel] = _better(shape_, own)
            if coloured[kind, channel]:
                also = here[spectrum.segment[low]]
                each = squares[also, channel] / level[spectrum.segment[low[also]], channel]
                more, size = _of_median(each, band_of[also], len(own))
                shape_ = _relative_to_upper(seen + more, own + size, upper)
            other = spectra[1 - kind, :, channel]
            if not coloured[kind, channel] and coloured[1 - kind, channel] and _fits(seen, own, other):
                coloured[kind, channel], shape_ = True, other
            spectra[kind, :, channel] = shape_ if coloured[kind, channel] else 1.0
        expected = (count * spectra[moving, :, channel]).sum(1) / of_segment
        each = np.maximum(typical[:, channel] / np.maximum(expected, _SMALLEST), _SMALLEST)
        least = _STANDING * min(float(np.median(each)), 1.0)
        standing[:, channel] = each < least
        each = np.maximum(each, least)
        differing[channel] = _better(each, _EFFICIENCY * of_segment)
        level[:, channel] = each if differing[channel] else 1.0
    predicted = level[:, None] * spectra[moving]
    own = np.ones_like(predicted)
    for channel in np.flatnonzero(differing).tolist():
        for index in np.flatnonzero(~standing[:, channel]).tolist():
            seen = energy[index, :, channel] / predicted[index, :, channel]
            own[index, :, channel] = _carried(seen, count[index], 1.0, OWN)
    for kind, channel in np.argwhere(coloured & ~differing).tolist():
        here = np.flatnonzero(moving == kind)
        for band in range(len(centre)):
            own[here, band, channel] = moderated(
                energy[here, band, channel] / predicted[here, band, channel], count[here, band]
            )
    turns = np.pi * np.array([spectrum.edges[:-1][used], spectrum.edges[1:][used], centre]) / (observed.sample_rate / 2)
    density = spectra.copy()
    for state in np.unique(moving).tolist():
        here = moving == state
        samples = np.diff(observed.bounds)[here]
        sampled = np.minimum(turns * float(np.median(observed.bin_size[here])), np.pi)
        leakage = _leakage(sampled, float(here.sum() / np.sum(1 / samples)))
        for channel in np.flatnonzero(coloured[state]).tolist():
            density[state, :, channel] = _without_leakage(spectra[state, :, channel], leakage)
    nothing = np.zeros((len(spectrum.segment), len(white)))
    found = NoiseWithin(centre, count.sum(0), spectra, density, level, own, moving, coloured, differing, nothing)
    return replace(found, peaks=_peaks(found, observed, spectrum, white))


def _peaks(noise: NoiseWithin, observed: Observed, spectrum: Spectrum, white: Array) -> Array:
    """Returns a lower limit for the variance of the harmonics of the motion, relative to the level of the segment, shape (M, K);
    zero for other coefficients. The limit follows from the spectra of all segments, at rest and in motion. A single segment is not
    used, because the few neighbours of a harmonic in its own segment may be small by chance.

    In addition, a resonance or a line of the noise can be much narrower than a band. The coefficients of the remainder's cosine
    transform show such a peak with the resolution of a segment's length. Let a harmonic of the frequency f₀ be observed for the
    time T. At rest, its variance is the mean of the squares of these coefficients with the weight sinc²(T·(f − f₀)). In motion, the
    remainder does not contain the harmonic itself, so its neighbours up to the distance 2/T are used instead. If Schwarz's
    criterion prefers a peak to the spectrum of the bands, the limit is the height of the peak. If the noise is known to be
    coloured, the number of data in the criterion is the number of these coefficients, otherwise the number of all coefficients.
    `white`: array of shape (K,) in SI units, standard deviation of the white noise of a sample.
    """
    from scipy.fft import dct

    found = np.zeros((len(spectrum.segment), len(white)))
    harmonics: dict[tuple[float, float], list[int]] = {}
    for row in np.flatnonzero(spectrum.harmonic > 0).tolist():
        lasting = float(observed.counts[spectrum.segment[row]] / observed.sample_rate)
        harmonics.setdefault((float(spectrum.frequency[row]), lasting), []).append(row)
    if not harmonics:
        return found
    frequencies, energies, counts = [], [], []
    for index, (part, basis) in enumerate(zip(observed.segments(), spectrum.bases, strict=True)):
        half, size = observed.sample_rate / int(observed.bin_size[index]) / 2, part.stop - part.start
        frequencies.append(np.arange(size) * half / size)
        squares = dct(spectrum.remainder[part], type=2, norm="ortho", axis=0) ** 2 / np.maximum(white, 1e-300) ** 2
        energies.append(squares / noise.of_segment(index, frequencies[-1]))
        counts.append(np.ones(size))
        np.subtract.at(counts[-1], np.minimum(np.round(basis.frequency / half * size).astype(np.int64), size - 1), 1.0)
    still = np.flatnonzero(noise.moving == 0).tolist()
    for (about, lasting), rows in harmonics.items():
        for kind, segments, reach in ((0, still, 1.0), (1, np.unique(spectrum.segment[rows]).tolist(), 2.0)):
            energy, size, squared = np.zeros(len(white)), 0.0, 0.0
            for index in segments:
                near = slice(*np.searchsorted(frequencies[index], about + np.array([-reach, reach]) / lasting))
                distance = (frequencies[index][near] - about) * lasting
                weight = np.ones(len(distance)) if kind else np.sinc(distance) ** 2
                energy += weight @ energies[index][near]
                size += float(weight @ counts[index][near])
                squared += float(weight**2 @ counts[index][near])
            usual = noise.of_kind(kind, about)
            least = noise.coloured[kind] * usual
            if size > 0 and squared > 0 and size**2 / squared >= _NARROW:
                degrees, ratio = size**2 / squared, np.maximum(energy / size, _SMALLEST)
                among = np.where(noise.coloured.any(0), degrees, noise.weight.sum())
                peak = (ratio > 1) & (degrees * (ratio - 1 - np.log(ratio)) > np.log(among))
                least = np.where(peak, ratio * usual, least)
            found[rows] = np.maximum(found[rows], least)
    return found


def _leakage(turns: Array, count: float) -> Array:
    """Returns a matrix (B, B). The cosine transform of `count` samples shows a part of the density of a band in other bands. The
    matrix contains this part for each band (second index) and each other band (first index). `turns`: array of shape (3, B), edges
    and centres of the bands, rad per sample.

    A basis vector of the transform with the frequency θ also responds to other frequencies ω. With n = `count`, the squared
    response is sin²(ω/2)·cos²(θ/2)/(n·(sin²(ω/2) − sin²(θ/2))²), averaged over the phase difference n·ω between the ends of the
    segment.
    """
    low, high, centre = turns
    power = np.sin(centre / 2) ** 2
    away = power[None, :] - power[:, None]
    shown = (high - low) / np.pi * power * np.cos(centre / 2)[:, None] ** 2
    found = np.divide(shown, count * away**2, out=np.zeros_like(shown), where=away != 0)  # 0 for the band itself
    return np.asarray(np.minimum(found, 1.0))


def _without_leakage(seen: Array, leakage: Array) -> Array:
    """Computes the densities (B,) for which the cosine transform has the variances `seen` (B,), by iterations of expectation
    maximisation (Richardson, J. Opt. Soc. Am. 62, 1972). `leakage`: array of shape (B, B); its product with the densities is the
    variance that leaks into each band from the others."""
    found = seen.copy()
    for _ in range(_LEAKAGE_ROUNDS):
        found = np.maximum(found * seen / (found + leakage @ found), _KEPT * seen)
    return found


def _falling(spectrum: Array) -> Array:
    """Returns the smallest spectrum (n, K) that does not increase with the frequency and is nowhere smaller than `spectrum` (n, K)."""
    return np.asarray(np.maximum.accumulate(spectrum[::-1], axis=0)[::-1])


def _relative_to_upper(energy: Array, count: Array, upper: NDArray[np.bool_]) -> Array:
    """Returns the levels (B,) of the bands, scaled so that the mean over the `upper` bands is 1. `energy`: array of shape (B,),
    energy in each band. `count`: array of shape (B,), number of coefficients in each band."""
    found = _carried(energy, count, float(energy.sum() / max(count.sum(), 1e-9)), CARRIED)
    if count[upper].sum() > 0:
        found /= float((found * count)[upper].sum() / count[upper].sum())
    return found


def _of_median(squares: Array, band: NDArray[np.int64], bands: int) -> tuple[Array, Array]:
    """Estimates the energies (B,) and the degrees of freedom (B,) of the bands from the medians of squares (n,) of normal values.
    `band`: array of shape (n,), band of each square."""
    size: Array = np.bincount(band, minlength=bands).astype(np.float64) * _OF_MEDIAN
    level = np.array([np.median(squares[band == b]) if size[b] > 0 else 0.0 for b in range(bands)]) / _MEDIAN
    return level * size, size


def _typical(observed: Observed, spectrum: Spectrum) -> Array:
    """Returns the variance of the remainder of each segment, shape (S, K). It is the median over windows, corrected for the degrees
    of freedom of the coefficients and for the bias of the median of χ² (Wilson and Hilferty, Proc. Nat. Acad. Sci. 17, 1931)."""
    found = np.zeros((len(observed), spectrum.remainder.shape[1]))
    for index, (part, basis) in enumerate(zip(observed.segments(), spectrum.bases, strict=True)):
        squares = spectrum.remainder[part] ** 2
        windows = max(min(_WINDOWS, len(squares) // 8), 1)
        size = len(squares) // windows
        each = squares[: windows * size].reshape(windows, size, -1).mean(1)
        bias = (1 - 2 / (9 * size)) ** 3 if windows > 2 else 1.0
        found[index] = np.median(each, axis=0) / bias * len(squares) / max(len(squares) - basis.removed.shape[1], 1)
    return found


def _carried(energy: Array, count: Array, above: float, carried: float) -> Array:
    """Returns the levels (B,) of the bands, computed from the highest band to the lowest. Each level is a weighted average of the
    band's own energy and the level of the next higher band, which has the weight of `carried` coefficients. The highest band has no
    higher band; the level `above` is used instead."""
    out = np.ones(len(energy))
    for band in range(len(energy) - 1, -1, -1):
        above = max((energy[band] + carried * above) / (count[band] + carried), _SMALLEST)
        out[band] = above
    return out


def moderated(energy: Array, count: Array) -> Array:
    """Returns the variances (S,) of one band in S segments. Each variance is a weighted mean of the energy of its segment and the
    energies of the other segments.

    The variances of the segments are assumed to scatter like the inverse of a χ² variable. The degrees of freedom of this variable
    follow from the scatter of the energies (Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004). If a common variance of all segments
    explains the scatter of the energies, every result is 1. Otherwise, each result is the variance that one more coefficient of the
    segment would have in its predictive distribution (Student's t). `energy`: array of shape (S,), energy of the band in each
    segment, relative to the common variance. `count`: array of shape (S,), number of coefficients of the band in each segment.
    """
    from scipy.optimize import brentq
    from scipy.special import digamma, polygamma

    seen = (count >= _COUNTED) & (energy > 0)
    if seen.sum() < _SEGMENTS:
        return np.ones(len(energy))
    half = count[seen] / 2
    logs = np.log(energy[seen] / count[seen]) - digamma(half) + np.log(half)
    excess = float(logs.var(ddof=1) - polygamma(1, half).mean())
    if excess <= polygamma(1, _SAME / 2):
        return np.ones(len(energy))
    prior = _VARIOUS
    if excess < polygamma(1, _VARIOUS / 2):
        prior = float(brentq(lambda freedom: polygamma(1, freedom / 2) - excess, _VARIOUS, _SAME))
    common = float(np.exp(logs.mean() + digamma(prior / 2) - np.log(prior / 2)))
    return np.asarray((prior * common + np.where(seen, energy, 0.0)) / (prior + np.where(seen, count, 0.0) - 2))


def _better(ratio: Array, count: Array) -> bool:
    """Returns True if, by Schwarz's criterion, separate levels describe the variances `ratio` (n,) better than the common level 1
    of the white noise. The variances are relative to the white noise and have the degrees of freedom `count` (n,)."""
    seen = count > 0
    ratio, count = np.maximum(ratio[seen], _SMALLEST), count[seen]
    gain = float((count * (ratio - 1 - np.log(ratio))).sum())
    return bool(gain > len(ratio) * np.log(max(float(count.sum()), 2.0)))


def _fits(energy: Array, count: Array, variance: Array) -> bool:
    """Returns True if variances (B,) from other data describe energies (B,), with degrees of freedom `count` (B,), better than
    white noise. The likelihoods of the two descriptions are compared directly, because no parameter is fitted."""
    return bool((energy * (1 - 1 / variance) - count * np.log(variance)).sum() > 0)
