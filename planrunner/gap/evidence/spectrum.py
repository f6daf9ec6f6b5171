"""Reduces a recording to the data that a diagnosis uses: a few exact coefficients for each segment and channel, and the energy of
the remainder in each frequency band.

The coefficients of a segment refer to an orthonormal basis. The basis consists of the lowest orders of the cosine transform
(DCT-II; order 0 is the mean) and of harmonics of the table's motion (1 to 3 per turn, 1 to 5 per period of rocking). Effects can
appear at these harmonics. If an encoder shows the motion, the angular rates take the place of the harmonics. In this case, an
unknown delay between the encoder and the sensor causes a part of the samples that is proportional to the angular accelerations.
This part is removed and not used as evidence. If it were kept, it would count as noise at the frequencies of the rates.
Deterministic effects lie in the span of this basis. The remainder of the samples is noise or a tone; the energies of its DCT-II in
frequency bands describe it. Outliers far outside the noise are replaced by the fit of the basis and counted, because a single
outlier would affect all coefficients.

In array shapes, N is the number of all samples, n is the number of samples of a segment, M is the number of all coefficients of a
channel, m is the number of coefficients of a segment, S is the number of segments, K is the number of channels, B is the number of
frequency bands, and P is the number of columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby, pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.observed import Observed
from planrunner.observation.bins import SPIKE
from planrunner.plan.schedule import RecordedMotion, Rest, Rock, Spin

LOW_ORDERS = 5
OCTAVES = 12  # number of octaves below half the sampling rate in which the remainder is divided into bands
FINE = 5  # number of the highest octaves, each of which has four bands
UPPER = 0.999 / 8  # fraction of the sampling rate above which the bands define the white level
RESPONSE = -1
"""Marks the coefficients of the response to a recorded motion. This value is used instead of the order of a harmonic."""
NODES = 49  # number of samples that represent a turn of the table
_SMOOTH = 1e-5  # fraction of the largest value of a signal by which a trigonometric polynomial may miss the signal
_DEPENDENT = 0.05  # smallest fraction of its norm that a harmonic must keep after the lower orders are removed


@dataclass(frozen=True)
class SpectralBasis:
    """Contains the basis of one segment. `vectors`: array of shape (n, m) with orthonormal columns; the first column is constant.
    `frequency`: array of shape (m,), the frequency of each vector in Hz; it is 0 for the constant vector. `harmonic`: array of
    shape (m,), the kind of each vector: 0 for a vector of the cosine transform, `RESPONSE` for the response to a recorded motion,
    and the order of the harmonic for a harmonic of the motion. `latency`: array of shape (n, q), further orthonormal columns,
    orthogonal to `vectors`: the response to a delay between the sensor and the encoder. These columns are removed from the samples,
    but their coefficients are not used.
    """

    vectors: Array
    frequency: Array
    harmonic: NDArray[np.int64]
    latency: Array

    @cached_property
    def removed(self) -> Array:
        """Returns all columns that are removed from the samples, shape (n, m + q): `vectors`, followed by `latency`."""
        return np.hstack([self.vectors, self.latency]) if self.latency.size else self.vectors


@dataclass(frozen=True)
class Spectrum:
    """Contains the M coefficients of all segments, and the remainder of the samples.

    `segment`: array of shape (M,), index of the segment to which a coefficient belongs. `frequency`, `harmonic`: arrays of shape
    (M,), as in `SpectralBasis`. `means`: array of shape (S,), indices of the coefficients of order 0. `values`: array of shape (M,
    K), the coefficients in SI·√samples. `energy`: array of shape (S, B, K) in SI², energy of the DCT-II of the remainder in the
    bands between `edges` (B + 1,), Hz. `count`: array of shape (S, B), number of coefficients of the DCT-II in each band.
    `remainder`: array of shape (N, K), samples minus their components in the basis. `spikes`: array of shape (K,), number of
    samples that were replaced by the fit. `replaced`: array of shape (N, K), for replaced samples the difference between the sample
    and the fit; otherwise zero. `readings`: array of shape (S, K) in SI units, mean outputs of the segments. If the samples are
    means over bins of k samples, all values except `readings` are multiplied by √k. Their white noise is then equal to the white
    noise of a single sample.
    """

    bases: tuple[SpectralBasis, ...]
    segment: NDArray[np.int64]
    frequency: Array
    harmonic: NDArray[np.int64]
    means: NDArray[np.int64]
    values: Array
    edges: Array
    energy: Array
    count: Array
    remainder: Array
    spikes: NDArray[np.int64]
    replaced: Array
    readings: Array

    def project(self, observed: Observed, columns: Array, acting: NDArray[np.bool_] | None = None) -> Array:
        """Computes the coefficients of columns of samples. Columns of shape (N, P) give coefficients of shape (M, P). `acting`:
        array of shape (S,), True for the segments to compute; by default all."""
        roots = _roots(observed)
        if acting is None or acting.all():
            made = [
                (vectors @ columns[part].reshape(-1, vectors.shape[-1], columns.shape[1])).reshape(-1, columns.shape[1])
                for vectors, part in self.runs
            ]
            coefficients = np.concatenate(made)
        else:
            coefficients, parts = np.zeros((len(self.segment), columns.shape[1])), observed.segments()
            for index in np.flatnonzero(acting).tolist():
                np.matmul(self.bases[index].vectors.T, columns[parts[index]], out=coefficients[self.rows[index]])
        return coefficients if roots is None else coefficients * roots[self.segment, None]

    def of_constant(self, constant: NDArray[np.bool_]) -> Spectrum:
        """Returns a copy that projects columns with a single sample for each constant segment. This sample represents all samples
        of the segment. `constant`: array of shape (S,), True for segments in which all columns are constant. The copy is only for
        `project`: its `remainder` and `replaced` still contain all samples."""
        alone: dict[int, SpectralBasis] = {}
        for basis, one in zip(self.bases, constant, strict=True):
            if one and id(basis) not in alone:
                alone[id(basis)] = replace(basis, vectors=basis.vectors.sum(axis=0, keepdims=True))
        bases = [alone[id(own)] if one else own for own, one in zip(self.bases, constant, strict=True)]
        return replace(self, bases=tuple(bases))

    def of_turns(self, observed: Observed, signals: Sequence[Array]) -> tuple[Spectrum, NDArray[np.bool_]]:
        """Returns a copy that projects columns with few samples of each segment in which the table turns at a constant rate, and a
        mask (N,) of the remaining samples. All columns of such a segment must be functions of the table's angle alone. The
        trigonometric polynomial through `NODES` samples, which are spread over a turn, is projected. This is exact for smooth
        functions, and an approximation for functions with an edge. A segment keeps all its samples if the table makes
        less than a turn, or if one of the `signals`, arrays of shape (N,), is not such a polynomial. Like `of_constant`, the copy
        is only for `project`."""
        bases, kept = list(self.bases), np.ones(len(observed.time), dtype=bool)
        largest = np.array([np.abs(signal).max() for signal in signals])
        for index, (motion, part) in enumerate(zip(observed.motions, observed.segments(), strict=True)):
            angle = observed.angle[part]
            if not isinstance(motion, Spin) or len(angle) <= 2 * NODES or np.ptp(angle) < 2 * np.pi * (1 - 1 / NODES):
                continue
            at = _spread_over_a_turn(angle)
            waves = _waves(angle, (len(at) - 1) // 2)
            through = np.linalg.pinv(waves[at])
            own = np.column_stack([signal[part] for signal in signals])
            missed = np.abs(own - waves @ (through @ own[at])).max(axis=0)
            if (missed > _SMOOTH * largest).any():
                continue
            bases[index] = replace(bases[index], vectors=((bases[index].vectors.T @ waves) @ through).T)
            kept[part] = False
            kept[part.start + at] = True
        return replace(self, bases=tuple(bases)), kept

    def outside(self, observed: Observed, columns: Array) -> Array:
        """Removes the components in the basis of each segment from columns (N, P), in the same way as from the samples."""
        out = columns.copy()
        for basis, part in zip(self.bases, observed.segments(), strict=True):
            out[part] -= basis.removed @ (basis.removed.T @ out[part])
        return out

    @cached_property
    def rows(self) -> list[slice]:
        """Returns, for each segment, the slice of its coefficients."""
        ends = np.cumsum([0, *(basis.vectors.shape[1] for basis in self.bases)]).tolist()
        return [slice(*one) for one in pairwise(ends)]

    @cached_property
    def runs(self) -> list[tuple[Array, slice]]:
        """Groups consecutive segments whose bases have the same shape, so that a group can be evaluated at once. For each group of
        k segments, returns the transposed bases (k, m, n) and the slice of their samples. If all segments of a group share one
        basis, returns this transposed basis (m, n) only once for the group."""
        found, first = [], 0
        for _, run in groupby(self.bases, key=lambda basis: basis.vectors.shape):
            bases = list(run)
            last = first + len(bases) * len(bases[0].vectors)
            same = all(basis is bases[0] for basis in bases)
            vectors = bases[0].vectors.T if same else np.array([basis.vectors.T for basis in bases])
            found.append((vectors, slice(first, last)))
            first = last
        return found


def _spread_over_a_turn(angle: Array) -> NDArray[np.int64]:
    """Returns the indices of at most `NODES` angles, in ascending order, that are spread over a turn. `angle`: array of shape (n,), in
    rad."""
    turn = np.mod(angle, 2 * np.pi)
    order = np.argsort(turn)
    wanted = 2 * np.pi * np.arange(NODES) / NODES
    above = np.searchsorted(turn[order], wanted) % len(angle)
    near = np.stack([order[above - 1], order[above]])
    away = np.abs(np.mod(turn[near] - wanted + np.pi, 2 * np.pi) - np.pi)
    return np.unique(near[np.argmin(away, axis=0), np.arange(NODES)])


def _waves(angle: Array, harmonics: int) -> Array:
    """Returns a constant, and the cosines and sines of the multiples 1 to h of an angle (n,), as an array of shape (n, 2h + 1)."""
    waves = np.cumprod(np.repeat(np.exp(1j * angle)[:, None], harmonics, axis=1), axis=1)
    return np.hstack([np.ones((len(angle), 1)), waves.real, waves.imag])


def basis_of(observed: Observed, index: int) -> SpectralBasis:
    """Makes the basis of one segment."""
    part = observed.segments()[index]
    n = part.stop - part.start
    rate = observed.sample_rate / int(observed.bin_size[index])
    order = np.arange(min(LOW_ORDERS, n))
    columns = [np.cos(np.pi * k * (np.arange(n) + 0.5) / n) for k in order]
    frequency, harmonic = list(order * rate / (2 * n)), [0] * len(order)
    motion = observed.motions[index]
    encoder = isinstance(motion, RecordedMotion) and bool(motion.angle)
    for column in _by_axis(observed.omega[part]) if encoder else []:
        columns.append(column)
        frequency.append(float(np.linalg.norm(np.gradient(column)) / np.linalg.norm(column)) * rate / (2 * np.pi))
        harmonic.append(RESPONSE)
    for h, phase, hertz in _harmonics(observed, part, motion):
        if hertz < rate / 2:
            columns += [np.cos(phase), np.sin(phase)]
            frequency += [hertz] * 2
            harmonic += [h] * 2
    size = len(columns)
    columns += _by_axis(observed.swing[part]) if encoder else []
    stacked = np.column_stack(columns)
    stacked /= np.linalg.norm(stacked, axis=0) + 1e-300
    q, r = np.linalg.qr(stacked)
    keep = np.abs(np.diag(r)) > _DEPENDENT
    q = q * np.sign(np.diag(r))
    own = np.flatnonzero(keep[:size])
    return SpectralBasis(
        q[:, own], np.array(frequency)[own], np.array(harmonic)[own], q[:, size + np.flatnonzero(keep[size:])]
    )


def _shared(known: dict[tuple[int, int, object], SpectralBasis], observed: Observed, index: int) -> SpectralBasis:
    """Returns the basis of a segment. Segments at rest with the same length share one basis."""
    motion = observed.motions[index]
    if not isinstance(motion, Rest):
        return basis_of(observed, index)
    key = int(observed.counts[index]), int(observed.bin_size[index]), motion
    if key not in known:
        known[key] = basis_of(observed, index)
    return known[key]


def _harmonics(observed: Observed, part: slice, motion: object) -> list[tuple[int, Array, float]]:
    if isinstance(motion, Spin):
        hertz = abs(motion.rate) / (2 * np.pi)
        return [(h, h * observed.angle[part], h * hertz) for h in (1, 2, 3)]
    if isinstance(motion, Rock):
        since = observed.time[part] - observed.time[part.start]
        phase = 2 * np.pi * motion.frequency * since
        return [(h, h * phase, h * motion.frequency) for h in range(1, 6)]
    return []


def _by_axis(motion: Array) -> list[Array]:
    """Returns the components (n,) of a recorded motion (n, 3), for each axis about which there is motion. The mean of each
    component is subtracted. The effects of scale factors and misalignments are proportional to the angular rates. The effects of a
    delay and of the first-order lag of a filter are nearly proportional to the angular accelerations. Only motion that an encoder
    shows is used. The reference of a free motion is not used, because it has its own delays and filters, which act at the same
    frequencies."""
    motion = motion - motion.mean(axis=0)
    size = np.linalg.norm(motion, axis=0)
    return [motion[:, axis] for axis in np.flatnonzero(size > _DEPENDENT * size.max())]


def spectrum(observed: Observed, reference: Array, held: NDArray[np.bool_] | None = None) -> Spectrum:
    """Computes the spectrum of the samples after the nominal simulation `reference` (N, K) has been subtracted. `held`: array of
    shape (N, K), True for samples that are replaced by the fit."""
    known: dict[tuple[int, int, object], SpectralBasis] = {}
    bases = tuple(_shared(known, observed, index) for index in range(len(observed)))
    sizes = [len(basis.frequency) for basis in bases]
    edges = band_edges(observed.sample_rate / 2)
    values, energy = [], np.zeros((len(bases), len(edges) - 1, len(observed.channels)))
    count = np.zeros((len(bases), len(edges) - 1))
    remainder = np.empty_like(observed.values)
    replaced = np.zeros(observed.values.shape)  # takes no memory before it is written
    spikes = np.zeros(len(observed.channels), dtype=np.int64)
    roots = _roots(observed)
    if observed.bins is not None:
        spikes += observed.bins.spikes
    smallest = np.array([max(c.resolution / 2, c.white * np.sqrt(observed.sample_rate) / 4) for c in observed.channels])
    for index, (basis, part) in enumerate(zip(bases, observed.segments(), strict=True)):
        left = observed.values[part] - reference[part]
        if roots is not None:
            left *= roots[index]
        coefficients, rest, spiked = _robust(basis.removed, left, smallest, None if held is None else held[part])
        spikes += spiked.sum(axis=0)
        values.append(coefficients[: len(basis.frequency)])
        replaced[part][spiked] = rest[spiked]
        rest[spiked if held is None else spiked | held[part]] = 0.0
        remainder[part] = rest
        half = observed.sample_rate / int(observed.bin_size[index]) / 2
        orders = np.minimum(np.round(edges / half * len(rest)).astype(np.int64), len(rest))
        energy[index] = _of_bands(rest, orders)
        count[index] = np.diff(orders) - _of_bands(basis.latency, orders).sum(axis=1)
        taken = np.round(basis.frequency / half * len(rest)).astype(np.int64)
        band = np.minimum(np.searchsorted(orders, taken, side="right"), len(orders) - 1) - 1
        np.subtract.at(count[index], band, 1)
    first = np.concatenate(([0], np.cumsum(sizes)[:-1])).astype(np.int64)
    return Spectrum(
        bases,
        np.repeat(np.arange(len(bases)), sizes),
        np.concatenate([basis.frequency for basis in bases]),
        np.concatenate([basis.harmonic for basis in bases]),
        first,
        np.concatenate(values),
        edges,
        energy,
        count,
        remainder,
        spikes,
        replaced,
        np.add.reduceat(observed.values, observed.bounds[:-1], axis=0) / np.diff(observed.bounds)[:, None],
    )


def _of_bands(samples: Array, orders: NDArray[np.int64]) -> Array:
    """Returns the energy of the DCT-II of samples (n, K) in B bands, shape (B, K). `orders`: array of shape (B + 1,), the orders
    that bound the bands."""
    from scipy.fft import dct

    squares = dct(samples, type=2, norm="ortho", axis=0) ** 2
    return np.diff(np.vstack([np.zeros(squares.shape[1]), np.cumsum(squares, axis=0)])[orders], axis=0)


def _roots(observed: Observed) -> Array | None:
    """Returns, for each segment, the square root of the bin size, shape (S,). A mean over a bin, multiplied by this weight, has the
    same white noise as a single sample. The result is None if the recording contains single samples instead of means over bins."""
    return None if observed.bins is None else np.sqrt(observed.bins.size)


def band_edges(half: float) -> Array:
    """Returns the edges of the frequency bands, Hz, shape (B + 1,). Each of the `FINE` highest octaves is divided into four
    bands of equal width. Each octave below them is one band. The lowest band contains all frequencies below the lowest octave.
    `half`: half of the sampling rate, which is the upper edge of the highest band."""
    octaves = 2.0 ** -np.arange(OCTAVES, -1, -1)
    fine = [np.linspace(low, 2 * low, 5)[1:] for low in octaves[-FINE - 1 : -1]]
    return half * np.concatenate([[0.0], octaves[: OCTAVES - FINE + 1], *fine])


def _robust(
    vectors: Array, samples: Array, smallest: Array, held: NDArray[np.bool_] | None
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Fits the basis robustly. Returns the coefficients (m, K), the samples (n, K) minus the fit, and a mask (n, K) of the samples
    that are spikes. `held`: mask (n, K) of further samples. Spikes and the samples in `held` are not used for the fit. `vectors`:
    array of shape (n, m), the basis. `smallest`: array of shape (K,), smallest standard deviation that the residuals of the fit are
    assumed to have."""
    coefficients = vectors.T @ samples
    spiked = np.zeros(samples.shape, dtype=bool)
    for _ in range(4):
        rest = samples - vectors @ coefficients
        sigma = np.maximum(1.4826 * np.median(np.abs(rest), axis=0), smallest)
        now = np.abs(rest) > SPIKE * sigma
        if held is not None:
            now |= held
        if bool((now == spiked).all()):
            break
        spiked = now
        for channel in np.flatnonzero(spiked.any(axis=0)):
            good = ~spiked[:, channel]
            coefficients[:, channel] = np.linalg.lstsq(vectors[good], samples[good, channel], rcond=None)[0]
    spikes = spiked if held is None else spiked & ~held
    return coefficients, samples - vectors @ coefficients, spikes


def white_level(observed: Observed, spectrum_: Spectrum) -> tuple[Array, Array]:
    """Returns the standard deviation of the white noise of a sample, and the degrees of freedom of this estimate, each of shape
    (K,). The estimate uses the upper bands of segments at rest.

    If no segment is at rest, all segments are used. The upper bands begin at one eighth of the sampling rate, above all slow
    processes.
    """
    still = np.array([not isinstance(motion, Spin | Rock) for motion in observed.motions])
    chosen = still if still.any() else np.ones(len(observed), dtype=bool)
    if observed.bins is not None:
        total = float(observed.bins.count[chosen].sum())
        whole = observed.bins.energy[chosen].sum(axis=0)
        return np.sqrt(np.diag(whole) / total), np.full(len(observed.channels), total)
    upper = spectrum_.edges[:-1] > UPPER * observed.sample_rate
    energy = spectrum_.energy[chosen][:, upper].sum(axis=(0, 1))
    count = float(spectrum_.count[chosen][:, upper].sum())
    return np.sqrt(energy / count), np.full(len(observed.channels), count)
