"""The noise that a recording shows within segments: its spectrum, and its level in every segment.

The spectrum and the level are measured outside the coefficients, where no effect of the catalogue acts. Therefore noise cannot
absorb an effect, and an effect cannot appear as noise. At the lowest frequencies, the coefficients leave little to measure. If the
noise is coloured, its spectrum at these frequencies is also derived from the cosine coefficients, by the median of their squares.
An effect in fewer than half of the segments hardly changes this median. The noise can be coloured because outputs are rounded,
filtered or differenced, or because of lines of interference; vibration makes the noise differ between segments. The noise counts as
white, and as equal in all segments, unless Schwarz's criterion (BIC; Annals of Statistics 6, 1978) prefers the richer description.
A spectrum that is measured only at rest, or only in motion, is used for all segments if it describes the other segments better than
white noise does.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.spectrum import UPPER, Spectrum
from planrunner.plan.schedule import Rest

CARRIED = 4.0  # coefficients' worth of the next higher band that every band of a common spectrum counts in addition
OWN = 16.0  # the same for the spectrum of one segment
_ROUNDS = 2  # alternations of levels and spectra
_WINDOWS = 16  # of a segment, whose median energy is its level, so that a burst in some of them does not raise it
_EFFICIENCY = 2 / np.pi  # of a median, relative to a mean
_MEDIAN = 0.4549  # of χ² with one degree of freedom
_OF_MEDIAN = 0.368  # efficiency of the median of squares of normal values as an estimate of their variance
_SMALLEST = (
    1e-6  # level relative to the white noise below which noise does not lie, such as that of a count that stands
)


@dataclass(frozen=True)
class NoiseWithin:
    """Variance of the noise of each channel, relative to its white level. frequency: (B,), Hz, centres of the bands; weight: (B,),
    number of coefficients in each band. spectrum: (2, B, K), spectra of the segments at rest and of those in motion. level: (S, K),
    level of each segment; own: (S, B, K), variance in each band of a segment, divided by the product of spectrum and level. moving:
    (S,), index of the spectrum that applies to each segment: 0 at rest, 1 in motion. coloured: (2, K), True if a spectrum is not
    white; differing: (K,), True if the level differs between segments."""

    frequency: Array
    weight: Array
    spectrum: Array
    level: Array
    own: Array
    moving: NDArray[np.int64]
    coloured: NDArray[np.bool_]
    differing: NDArray[np.bool_]

    @property
    def lowest(self) -> float:
        """The lowest frequency at which the spectrum was measured, Hz."""
        return float(self.frequency[0])

    @property
    def inefficiency(self) -> Array:
        """Factor (K,) by which coloured noise makes the degrees of freedom of a sum of squares smaller than the number of samples."""
        return np.asarray(
            (self.weight @ self.spectrum**2 * self.weight.sum() / (self.weight @ self.spectrum) ** 2).max(0)
        )

    def of_coefficients(self, observed: Observed, spectrum: Spectrum) -> Array:
        """Variance (M, K) of the coefficients, relative to the white level. For a coefficient of the cosine transform, the variance
        is the value of the spectrum at the frequency of the coefficient. For a harmonic of the motion, it is the mean of the
        spectrum over all frequencies that the harmonic contains, ∫ S(f)·|V(f)|² df for stationary noise. Harmonics are made
        orthogonal to the lower orders. A harmonic close to these orders then consists mostly of the ends of the segment, which
        contain all frequencies."""
        from scipy.fft import rfft

        out = self.level[spectrum.segment]
        first = 0
        for index, basis in enumerate(spectrum.bases):
            rows = slice(first, first := first + len(basis.frequency))
            if not (self.coloured.any() or self.differing.any()):
                continue
            factor = self._relative(index, basis.frequency)
            harmonics = np.flatnonzero(basis.harmonic > 0)
            if len(harmonics):
                shares = np.abs(rfft(basis.vectors[:, harmonics], 2 * len(basis.vectors), axis=0)) ** 2
                half = observed.sample_rate / int(observed.bin_size[index]) / 2
                shares[[0, -1]] /= 2
                shares /= shares.sum(0)
                factor[harmonics] = shares.T @ self._at_harmonics(index, np.linspace(0.0, half, len(shares)))
            out[rows] *= factor
        return out

    def _at_harmonics(self, segment: int, frequency: Array) -> Array:
        """The spectrum as in `_relative`, for use with harmonics of the motion. The harmonics take up all coefficients near their
        frequencies, so the segments in motion do not show a line of the noise there. The spectrum at rest shows such a line; it is
        used where it is larger."""
        found = self._relative(segment, frequency)
        at_rest = self.coloured[0] & (self.moving == 0).any()
        if self.moving[segment] and at_rest.any():
            found[:, at_rest] = np.maximum(found, self._of_kind(0, segment, frequency))[:, at_rest]
        return found

    def of_segment(self, segment: int, frequency: Array) -> Array:
        """Variance (n, K) of the noise of a segment at frequencies (n,), Hz, relative to the white level."""
        return np.asarray(self.level[segment] * self._relative(segment, frequency))

    def _relative(self, segment: int, frequency: Array) -> Array:
        """The spectrum (n, K) of a segment at frequencies (n,), Hz, without the factor for the level of the segment. It is constant
        beyond the outermost bands."""
        return self._of_kind(int(self.moving[segment]), segment, frequency)

    def _of_kind(self, kind: int, segment: int, frequency: Array) -> Array:
        """The spectrum as in `_relative`, but measured at rest (kind 0) or in motion (kind 1)."""
        place = np.log(np.maximum(frequency, self.frequency[0]))
        spectra = np.log(self.spectrum[kind] * self.own[segment])
        return np.asarray(np.exp(np.column_stack([np.interp(place, np.log(self.frequency), one) for one in spectra.T])))


def noise_within(observed: Observed, spectrum: Spectrum, white: Array, left: Array) -> NoiseWithin:
    """Measures the noise within the segments, outside the coefficients. white: (K,), SI, standard deviation of the white noise of a
    sample; left: (M, K), SI·√samples, coefficients after the fitted nominal parameters have been subtracted."""
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
        differing[channel] = _better(each, _EFFICIENCY * of_segment)
        level[:, channel] = each if differing[channel] else 1.0
    predicted = level[:, None] * spectra[moving]
    own = np.ones_like(predicted)
    for channel in np.flatnonzero(differing).tolist():
        for index, (seen, size) in enumerate(zip(energy[:, :, channel] / predicted[:, :, channel], count, strict=True)):
            own[index, :, channel] = _carried(seen, size, 1.0, OWN)
    return NoiseWithin(centre, count.sum(0), spectra, level, own, moving, coloured, differing)


def _relative_to_upper(energy: Array, count: Array, upper: NDArray[np.bool_]) -> Array:
    """Levels (B,) of the bands, scaled so that the mean over the `upper` bands is 1."""
    found = _carried(energy, count, float(energy.sum() / max(count.sum(), 1e-9)), CARRIED)
    if count[upper].sum() > 0:
        found /= float((found * count)[upper].sum() / count[upper].sum())
    return found


def _of_median(squares: Array, band: NDArray[np.int64], bands: int) -> tuple[Array, Array]:
    """Energies (B,) and degrees of freedom (B,) of the bands, estimated from the medians of squares (n,) of normal values. band:
    (n,), band of each square."""
    size: Array = np.bincount(band, minlength=bands).astype(np.float64) * _OF_MEDIAN
    level = np.array([np.median(squares[band == b]) if size[b] > 0 else 0.0 for b in range(bands)]) / _MEDIAN
    return level * size, size


def _typical(observed: Observed, spectrum: Spectrum) -> Array:
    """Variance (S, K) of the remainder of each segment: the median over windows. It is corrected for the degrees of freedom of the
    coefficients and for the bias of the median of χ² (Wilson and Hilferty, Proc. Nat. Acad. Sci. 17, 1931)."""
    found = np.zeros((len(observed), spectrum.remainder.shape[1]))
    for index, (part, basis) in enumerate(zip(observed.segments(), spectrum.bases, strict=True)):
        squares = spectrum.remainder[part] ** 2
        windows = max(min(_WINDOWS, len(squares) // 8), 1)
        size = len(squares) // windows
        each = squares[: windows * size].reshape(windows, size, -1).mean(1)
        bias = (1 - 2 / (9 * size)) ** 3 if windows > 2 else 1.0
        found[index] = np.median(each, axis=0) / bias * len(squares) / max(len(squares) - len(basis.frequency), 1)
    return found


def _carried(energy: Array, count: Array, above: float, carried: float) -> Array:
    """Levels (B,) of the bands, computed from the highest band down. Each band is smoothed towards the next higher band, and the
    highest band towards `above`: the higher level enters as if it came from `carried` additional coefficients."""
    out = np.ones(len(energy))
    for band in range(len(energy) - 1, -1, -1):
        above = max((energy[band] + carried * above) / (count[band] + carried), _SMALLEST)
        out[band] = above
    return out


def _better(ratio: Array, count: Array) -> bool:
    """True if separate levels describe the variances `ratio` (n,) better than the level of the white noise, 1, by Schwarz's
    criterion. The variances are relative to the white noise and have the degrees of freedom `count` (n,)."""
    seen = count > 0
    ratio, count = np.maximum(ratio[seen], _SMALLEST), count[seen]
    gain = float((count * (ratio - 1 - np.log(ratio))).sum())
    return bool(gain > len(ratio) * np.log(max(float(count.sum()), 2.0)))


def _fits(energy: Array, count: Array, variance: Array) -> bool:
    """True if variances (B,) from other data describe energies (B,), with degrees of freedom `count` (B,), better than white noise
    does. The likelihoods of the two descriptions are compared directly, because no parameter is fitted."""
    return bool((energy * (1 - 1 / variance) - count * np.log(variance)).sum() > 0)
