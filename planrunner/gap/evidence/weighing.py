"""Whitens coefficients with the noise, projects the nominal parameters out of them, and evaluates designs on the result. Whitened
coefficients have independent noise of unit variance. A design is a set of columns, such as the signatures of an effect, whose
amplitudes are unknown.

A setting of the noise consists of a level of flicker and a level of random walk for each triad. At every setting, the coefficients
of each channel are whitened in two steps. In the first step, the coefficients above order 0, which describe the changes within a
segment, are whitened segment by segment. In the second step, the coefficients of order 0, which are the segment means, are whitened
jointly. Before the second step, the part of the means that the other coefficients predict is subtracted. This part is zero unless
there is a random walk. Then the nominal parameters, which have a flat prior, are projected out. These are the parameters that the
nominal simulation fits, such as bias and scale factors. The likelihood of the residuals is the residual likelihood (REML: Patterson
and Thompson, Biometrika 58, 1971).

Some recordings cannot separate all nominal parameters. Examples are recordings with a single orientation, recordings of poses with
unknown orientation, and recordings in which gravity is never along an axis. The columns of these parameters are linearly dependent
or zero. Therefore, an independent basis of all nominal columns is computed first, so that the parameters absorb only the space that
their columns span.

The evidence of a design needs only the eigenvalues of its Gram matrix and the squared scores along the eigenvectors. Both are
computed from the few rows in which the design is not zero. Let Y be the whitened rows of the design, and B an orthonormal basis of
the nominal columns. Then the Gram matrix is YᵀY − (BᵀY)ᵀ(BᵀY). The score is Yᵀr, because the residual r has no component along B.

In array shapes, S is the number of segments, M is the number of coefficients of a channel, K is the number of channels, G is the
number of settings of the noise, q is the number of nominal parameters of a channel, and P is the number of columns.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import RANGE, STRONGEST, WEAKEST
from planrunner.gap.evidence.covariance import (
    Blocks,
    Correlation,
    MeansCovariance,
    SlowNoise,
    WalkAcross,
    flicker_spectrum,
)
from planrunner.gap.evidence.noise_within import NoiseWithin
from planrunner.gap.evidence.spectrum import Spectrum

FLICKER_FACTORS = (1.0, 0.5, 2.0)
FLICKER_PRIOR = (0.5, 0.25, 0.25)  # log-normal prior about the declared level, with a width of a factor of two
WALKS = np.geomspace(WEAKEST, 10 * STRONGEST, 13)
"""Levels of an undeclared random walk. Each level is stated as the expected energy of the random walk in the segment means of the
triad, in units of the noise of these means."""


DEPENDENT = 1e-8
"""Columns of unit length count as linearly dependent in a direction whose singular value, relative to the largest one, is below
this limit."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Describes one setting of the noise of a triad.

    `flicker`: factor by which the declared flicker level is multiplied. `walk`: level of the random walk in SI/√s. If `alike` is
    True, `walk` is the density of the random walk in every axis; otherwise it is the scale of the prior from which the density of
    each axis is drawn. `prior`: prior probability of this setting. The prior probabilities of all settings without a random walk
    add up to 1. The prior probabilities of all settings with a random walk whose expected energy (`WALKS`) is at most `STRONGEST`
    also add up to 1; the same density continues above `STRONGEST`.
    """

    flicker: float
    walk: float
    prior: float
    alike: bool = True


def settings_of(observed: Observed, slow: SlowNoise, means: Array, kind: str) -> tuple[Setting, ...]:
    """Lists the settings of the noise of a triad. Random walks are included only for gyros. If flicker is declared, the settings
    multiply its declared level by several factors. `means`: array of shape (S, K) in SI², variances of the segment means without
    slow noise."""
    members = observed.of_kind(kind)
    if not members:
        return (Setting(0.0, 0.0, 1.0),)
    factors: tuple[float, ...] = (0.0,)
    priors: tuple[float, ...] = (1.0,)
    if any(observed.channels[c].flicker > 0 for c in members):
        factors, priors = FLICKER_FACTORS, FLICKER_PRIOR
    walks = [0.0]
    if kind == "gyro" and len(observed) > 2:
        walks += list(np.sqrt(WALKS / sum(_walk_energy(observed, slow, c, means[:, c]) for c in members)))
    step = float(np.log(WALKS[1] / WALKS[0])) / RANGE
    return tuple(
        Setting(factor, float(walk), prior * (1.0 if walk == 0 else step / 2), alike)
        for alike in (False, True)
        for walk in walks
        for factor, prior in zip(factors, priors, strict=True)
        if walk > 0 or not alike
    )


def _walk_energy(observed: Observed, slow: SlowNoise, channel: int, means: Array) -> float:
    """Returns the expected energy of a random walk with unit density in the segment means of one channel, after a constant has been
    removed. The energy is in units of the noise of the means. This noise is the sum of the declared flicker and of independent
    noise with the variances `means` (S,)."""
    noise = np.diag(means) + observed.channels[channel].flicker ** 2 * slow.flicker
    inverse = np.linalg.inv(np.linalg.cholesky(noise))
    walk = inverse @ slow.random_walk @ inverse.T
    constant = inverse.sum(1)
    return float(np.trace(walk) - constant @ walk @ constant / (constant @ constant))


def _sharing(readings: Array, count: float) -> Array:
    """Returns, for each segment (S,), the number of segments, including the segment itself, whose mean readings have the same
    rounding error. The mean over such segments has the same rounding error as each of them."""
    return np.asarray(np.exp(-0.5 * ((readings[:, None] - readings) / (count / 4)) ** 2).sum(0))


def walking_alike(weights: Sequence[ChannelWeights], settings: Sequence[Setting]) -> tuple[list[ChannelWeights], Array]:
    """Returns the weights and the log likelihood (G,) of a channel at each setting of the noise. In settings that are not `alike`,
    the densities of the random walks of a triad have a common scale, but each axis has its own density.

    For a scale q, the density of an axis has the prior |N(0, q²)|. The likelihood is averaged over the density levels with this
    prior. The returned weights are the weights of the most probable level. The data from which this level is estimated may also
    contain an effect. If a strong effect is present, random walks with the same density in all axes are closer to the truth.
    Therefore, settings with such random walks (`alike`) are also included.
    """
    log = np.array([weight.log_likelihood for weight in weights])
    walks = np.array([setting.walk for setting in settings])
    chosen, marginal = list(weights), log.copy()
    for g, setting in enumerate(settings):
        if setting.walk > 0 and not setting.alike:
            mates = np.flatnonzero((walks > 0) & np.array([_mates(setting, other) for other in settings]))
            ratio = walks[mates] / setting.walk
            prior = ratio * np.exp(-(ratio**2) / 2)
            terms = log[mates] + np.log(prior / prior.sum() + 1e-300)
            marginal[g] = np.logaddexp.reduce(terms)
            chosen[g] = weights[int(mates[np.argmax(terms)])]
    return chosen, marginal


def _mates(one: Setting, other: Setting) -> bool:
    return other.flicker == one.flicker and other.alike == one.alike


class ChannelWeights:
    """Contains the weights of one channel for one level of flicker (relative to the declared level) and one level of the random
    walk. `whiten` scales coefficients (M, …) to unit noise; `project` whitens them and projects the nominal parameters out.

    `relative`: array of shape (M,), variance of the noise of each coefficient, divided by the variance of the white noise.
    `walk_within`: array of shape (M,) in SI²·samples, variance of the coefficients above order 0 (all except the segment means) due
    to a random walk. `undithered`: variance of the rounding error of a segment mean, which does not average out over the samples.
    `segment`: array of shape (M,), as in `Spectrum`. `log_likelihood`: residual log likelihood (REML) of the data without any
    effect. `log_det`: −2·log_likelihood minus the sum of the squared residuals. `basis`: array of shape (M, q), orthonormal basis
    of the whitened nominal columns. `scale`: array of shape (M,), factors that whiten coefficients one by one. If there is no slow
    noise, they apply to all coefficients, otherwise only to the coefficients above order 0.
    """

    def __init__(
        self,
        observed: Observed,
        slow: SlowNoise,
        spectrum: Spectrum,
        channel: int,
        white: float,
        flicker: float,
        walk: float,
        nominal: Array,
        noise: NoiseWithin,
        relative: Blocks,
        undithered: float,
    ):
        declared = observed.channels[channel]
        counts = observed.counts.astype(float)
        within = relative.times(white**2)
        independent = within.variances[spectrum.means] / counts
        if undithered > 0:
            independent += undithered * _sharing(spectrum.readings[:, channel], declared.resolution)
        level = flicker * declared.flicker
        tail = undithered * counts[spectrum.segment] / 4
        measured = noise.coloured[noise.moving[spectrum.segment], channel]
        if level > 0:
            tail += level**2 * observed.sample_rate / 2 * _beyond_measured(spectrum, noise.lowest, measured)
        across: WalkAcross | None = None
        self.walk_within: Array = np.zeros(len(spectrum.segment))
        if walk > 0:
            walking = slow.walk_within.times(walk**2)
            within = _besides(walking, within, measured).joined(walking)
            across = slow.walk_across.times(walk**2)
            self.walk_within = np.where(spectrum.frequency > 0, walking.variances, 0.0)
        within = within.plus(tail)
        self.walk = walk
        self._covariance = MeansCovariance(slow, independent, level**2, walk**2)
        self.segment = spectrum.segment
        self._means = spectrum.means
        self._order_0 = spectrum.frequency == 0
        self._root = np.sqrt(counts)
        self.scale = 1 / np.sqrt(within.variances)
        self._across = across
        self._predicted: WalkAcross | None = None
        self._inverse: Array | None = None
        if level == 0 and walk == 0:
            self.scale[self._means] = 1 / (np.sqrt(independent) * self._root)
        self._within = within if within.correlated else None
        self._correlation = None if self._within is None else Correlation(self._within)
        self._fit(nominal, spectrum.values[:, channel], jointly=level > 0 or walk > 0)

    def _fit(self, nominal: Array, values: Array, jointly: bool) -> None:
        """Projects the nominal columns (M, q) out of `values` (M,), the coefficients of the data. `jointly`: True if the segment
        means are whitened jointly, because slow noise correlates them."""
        if jointly:
            self.scale[self._means] = 1.0
            covariance = self._covariance.whole()
            if self._across is not None:
                self._predicted = self._across.of(self._within_segments(self._across.columns))
                covariance = covariance - self._predicted.squared()
            factor = np.linalg.cholesky(covariance)
            self._inverse = np.asarray(np.linalg.inv(factor))
            self.log_det = 2 * float(np.log(np.diag(factor)).sum())
        else:
            self.log_det = -2 * float(np.log(self._root).sum())
        if self._correlation is not None:
            self.log_det += self._correlation.log_det
        whitened = self.whiten(nominal)
        self.basis: Array
        self.basis, upper = np.linalg.qr(whitened) if nominal.shape[1] else (whitened, np.zeros((0, 0)))
        self.log_det -= 2 * float(np.log(self.scale).sum())
        self.log_det += 2 * float(np.log(np.abs(np.diag(upper)) + 1e-300).sum())
        self.residual: Array = self.project(values[:, None])[:, 0]
        self.log_likelihood = -0.5 * (self.log_det + float(self.residual @ self.residual))

    def towards(self, other: ChannelWeights, share: float, nominal: Array, values: Array) -> ChannelWeights:
        """Returns the weights for the covariance C + share·(C′ − C). C is the covariance of these weights; C′ is the covariance of
        `other`, which must contain flicker. Neither of the two weights may contain a random walk. The covariance is linear in the
        square of the flicker level, so this method gives the weights for any level of flicker. `share` may be negative or above 1,
        as long as the result is a covariance. `nominal`: array of shape (M, q), nominal columns. `values`: array of shape (M,) in
        SI units, coefficients of the channel."""
        made = copy(self)
        made._covariance = self._covariance.towards(other._covariance, share)
        variance = 1 / self.scale**2
        change = share * (1 / other.scale**2 - variance)
        made.scale = 1 / np.sqrt(variance + change)
        if self._within is not None:
            made._within = self._within.plus(change)
            made._correlation = Correlation(made._within)
        made._fit(nominal, values, jointly=True)
        return made

    def beside(self, columns: Array) -> ChannelWeights:
        """Returns a copy in which further columns (M, p), in SI units, have been added to the nominal columns. The `log_likelihood`
        of the copy takes account of the smaller residual, but not of the determinant of the additional columns."""
        made = copy(self)
        whitened = self.whiten(columns[:, columns.any(axis=0)])
        whitened /= np.linalg.norm(whitened, axis=0)
        left, size, _ = np.linalg.svd(whitened - self.basis @ (self.basis.T @ whitened), full_matrices=False)
        left = left[:, size > _NOTHING]
        made.basis = np.hstack([self.basis, left])
        made.residual = self.residual - left @ (left.T @ self.residual)
        made.log_likelihood = self.log_likelihood + 0.5 * float(self.residual @ self.residual)
        made.log_likelihood -= 0.5 * float(made.residual @ made.residual)
        return made

    def without(self, caused: Array) -> ChannelWeights:
        """Returns a copy for the data without a known part. `caused`: array of shape (M,) in SI units, coefficients of this part."""
        made = copy(self)
        made.residual = self.residual - self.project(caused[:, None])[:, 0]
        squares = float(self.residual @ self.residual) - float(made.residual @ made.residual)
        made.log_likelihood = self.log_likelihood + 0.5 * squares
        return made

    def refitted(self, nominal: Array, values: Array) -> ChannelWeights:
        """Returns a copy with other nominal columns (M, q) and other coefficients of the data (`values`, shape (M,)), both in SI
        units."""
        made = copy(self)
        made._fit(nominal, values, jointly=self._inverse is not None)
        return made

    def inflated(self, ratio: float) -> ChannelWeights:
        """Returns a copy in which the variance of the noise has been multiplied by `ratio`."""
        made, root = copy(self), float(np.sqrt(ratio))
        made._covariance = self._covariance.times(ratio)
        made.scale = self.scale / root
        made._inverse = None if self._inverse is None else self._inverse / root
        made._across = None if self._across is None else self._across.times(ratio)
        made._predicted = None if self._predicted is None else self._predicted.times(root)
        made.residual = self.residual / root
        squares = float(self.residual @ self.residual)
        made.log_likelihood = self.log_likelihood + 0.5 * (1 - 1 / ratio) * squares
        return made

    def covariance(self, rows: NDArray[np.bool_]) -> Array:
        """Returns the covariance of the coefficients in the rows that a mask (M,) selects, in SI²·samples."""
        chosen = np.flatnonzero(rows)
        out = np.diag(1 / self.scale[chosen] ** 2)
        if self._correlation is not None:
            out = self._correlation.between(chosen) / np.outer(self.scale[chosen], self.scale[chosen])
        at = np.flatnonzero(np.isin(chosen, self._means))
        owners = self.segment[chosen[at]]
        out[np.ix_(at, at)] = self._covariance.whole()[np.ix_(owners, owners)] * np.outer(
            self._root[owners], self._root[owners]
        )
        if self._across is not None:
            across = self._across.between(owners, chosen) * self._root[owners, None]
            out[at] += across
            out[:, at] += across.T
        return out

    @property
    def variances(self) -> Array:
        """Returns the variance of each coefficient, shape (M,), in SI²·samples."""
        out = np.asarray(1 / self.scale**2)
        out[self._means] = self._covariance.variances * self._root**2
        return out

    def whitening(self, rows: NDArray[np.bool_]) -> Callable[[Array], Array]:
        """Returns a function that whitens coefficients (n,) or (n, P) of the rows that a mask (M,) selects, in the same way as
        `whiten` does."""
        chosen = np.flatnonzero(rows)
        at = np.flatnonzero(np.isin(chosen, self._means))
        owners = self.segment[chosen[at]]
        root = self._root[owners]
        scale = self.scale[chosen]
        among = None if self._correlation is None else self._correlation.among(rows)

        def within_segments(columns: Array) -> Array:
            out = (columns.T * scale).T
            return out if among is None else among.apart(everywhere(out))[chosen]

        def everywhere(columns: Array) -> Array:
            full = np.zeros((len(rows), *columns.shape[1:]))
            full[chosen] = columns
            return full

        covariance, predicted = self._covariance.whole()[np.ix_(owners, owners)], None
        if self._across is not None:
            predicted = self._across.of(everywhere(within_segments(self._across.columns[chosen])))
            covariance = covariance - predicted.squared()[np.ix_(owners, owners)]
        inverse = np.linalg.inv(np.linalg.cholesky(covariance))

        def whiten(columns: Array) -> Array:
            out = within_segments(columns)
            means = (columns[at].T / root).T
            if predicted is not None:
                means = means - predicted.product(everywhere(out))[owners]
            out[at] = inverse @ means
            return out

        return whiten

    def _within_segments(self, columns: Array) -> Array:
        """Whitens the coefficients above order 0 of columns (M, P), segment by segment. These are all coefficients except the
        segment means."""
        out = columns * self.scale[:, None]
        return out if self._correlation is None else self._correlation.apart(out)

    def whiten(self, columns: Array) -> Array:
        """Returns columns (M, P), given in SI units, after whitening, in the same shape."""
        out = self._within_segments(columns)
        if self._inverse is not None:
            means = columns[self._means] / self._root[:, None]
            if self._predicted is not None:
                means -= self._predicted.product(out)
            out[self._means] = self._inverse @ means
        return out

    def transposed(self, columns: Array) -> Array:
        """Multiplies columns (M, P) by the transpose of the matrix by which `whiten` multiplies them. The product of whitened
        coefficients W·c with a column y is then cᵀ·(Wᵀ·y), without whitening c."""
        own, means = columns, None
        if self._inverse is not None:
            means = self._inverse.T @ columns[self._means]
            own = columns.copy()
            own[self._means] = 0.0
            if self._predicted is not None:
                own -= self._predicted.transposed_product(means)
        out = (own if self._correlation is None else self._correlation.apart_transposed(own)) * self.scale[:, None]
        if means is not None:
            out[self._means] += means / self._root[:, None]
        return out

    def unwhiten(self, whitened: Array) -> Array:
        """Inverts `whiten`. `whitened`: array of shape (M, n)."""
        joined = whitened if self._correlation is None else self._correlation.joined(whitened)
        out = joined / self.scale[:, None]
        if self._inverse is not None:
            means = np.linalg.solve(self._inverse, whitened[self._means])
            if self._predicted is not None:
                means += self._predicted.product(whitened)
            out[self._means] = means * self._root[:, None]
        return out

    def gap_and_noise(self) -> tuple[float, float]:
        """Returns the sum of squares of the residual before whitening, and its expectation for noise alone, SI²·samples."""
        basis = self.unwhiten(self.basis)
        whole = float(self.variances.sum())
        gap = self.unwhiten(self.residual[:, None])
        return float((gap**2).sum()), whole - float((basis**2).sum())

    def whitened_rows(self, columns: Array, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
        """Whitens columns that are zero except in a few rows. `columns`: array of shape (n, P), values of these columns in the rows
        `rows` (n,). Returns the rows in which the whitened columns are not zero, and the whitened values in these rows. The segment
        means are whitened jointly, so each mean affects the whitened values of all later means."""
        if self._correlation is not None:
            whole = np.zeros((len(self.scale), columns.shape[1]))
            whole[rows] = columns
            whitened = self.whiten(whole)
            acting = np.flatnonzero(whitened.any(axis=1))
            return acting, whitened[acting]
        own = self._order_0[rows]
        if self._inverse is None or not own.any():
            return rows, columns * self.scale[rows, None]
        owners = self.segment[rows[own]]
        means = self._inverse[:, owners] @ (columns[own] / self._root[owners, None])
        others = rows[~own]
        return np.concatenate([self._means, others]), np.concatenate([means, columns[~own] * self.scale[others, None]])

    def project(self, columns: Array) -> Array:
        """Returns columns (M, P), given in SI units, after whitening and without the part that the nominal parameters absorb, in the
        same shape."""
        whitened = self.whiten(columns)
        return whitened - self.basis @ (self.basis.T @ whitened)


def _beyond_measured(spectrum: Spectrum, lowest: float, measured: NDArray[np.bool_]) -> Array:
    """Returns the spectral density of flicker with the coefficient B = 1 that must be added at the frequency of each coefficient,
    shape (M,); 0 for segment means. A measured coloured spectrum already contains the flicker; in this case, only the increase
    below the lowest measured frequency [Hz] is added. `measured`: array of shape (M,), True for the coefficients whose spectrum is
    measured."""
    out = np.zeros(len(spectrum.frequency))
    within = spectrum.frequency > 0
    out[within] = flicker_spectrum(spectrum.frequency[within])
    return np.where(measured, np.maximum(out - flicker_spectrum(np.array([lowest])), 0.0), out)


def _besides(walking: Blocks, within: Blocks, measured: NDArray[np.bool_]) -> Blocks:
    """Returns the covariances `within` of the coefficients without the part that a random walk with the covariances `walking`
    causes. A measured coloured spectrum already contains the random walk, so its variance is subtracted as far as possible.
    `measured`: array of shape (M,), True for the coefficients whose spectrum is measured."""
    share = np.where(measured, walking.variances / within.variances, 0.0)
    return within.scaled(np.sqrt(np.maximum(1 - share, 0.0)))


def coefficients_of(observed: Observed, spectrum: Spectrum, columns: Sequence[Column]) -> list[Array]:
    """Returns, for each channel, the coefficients that each column causes if its amplitude equals the `magnitude` of the column,
    shape (M, P); zero where a column does not act."""
    reduced = reduced_columns(observed, spectrum, columns)
    return [table_of(reduced, channel, spectrum.segment) for channel in range(len(observed.channels))]


def reduced_columns(observed: Observed, spectrum: Spectrum, columns: Sequence[Column]) -> list[Column]:
    """Returns the columns with coefficients (M,) instead of samples (N,) in their `parts`. Columns with the same samples in a channel
    share one array of coefficients, even if they act in different segments: `Column.segments` is not applied to the coefficients.
    In segments in which none of these columns acts, the coefficients are zero."""
    found: dict[tuple[int, tuple[int, ...]], _Shared] = {}
    for index, column in enumerate(columns):
        for channel, part in column.parts.items():
            table, place = _table(part)
            shared = found.setdefault((table.__array_interface__["data"][0], table.strides), _Shared(table))
            shared.places.append((index, channel, place))
            shared.acting = shared.acting | (True if column.segments is None else column.segments)
    parts: list[dict[int, Array]] = [{} for _ in columns]
    for shared in found.values():
        projected = spectrum.project(observed, shared.table, np.broadcast_to(shared.acting, len(observed)))
        of_place = list(projected.T)
        for index, channel, place in shared.places:
            parts[index][channel] = of_place[place]
    return [replace(column, parts=own) for column, own in zip(columns, parts, strict=True)]


def table_of(columns: Sequence[Column], channel: int, segment: NDArray[np.int64]) -> Array:
    """Returns the coefficients that columns cause in one channel if their amplitudes equal their magnitudes, shape (M, P). `columns`:
    P columns that contain coefficients, as `reduced_columns` returns them. `segment`: array of shape (M,), as in `Spectrum`."""
    out = np.zeros((len(segment), len(columns)))
    for index, column in enumerate(columns):
        if channel in column.parts:
            here = 1.0 if column.segments is None else column.segments[segment]
            out[:, index] = column.parts[channel] * (column.magnitude * here)
    return out


def inner_products(columns: Sequence[Column], others: Mapping[int, Array], means: NDArray[np.int64]) -> Array:
    """Returns the inner products of P columns of coefficients with other columns, summed over the channels, shape (p, P).

    Columns that differ only in the segments in which they act, such as the same step at different moments, are evaluated together,
    from the sums over each segment. `columns`: P columns that contain coefficients, for amplitudes equal to their magnitudes.
    `others`: for each channel in which they are not zero, the other columns, shape (M, p). `means`: array of shape (S,), as in
    `Spectrum`."""
    alike: dict[tuple[tuple[int, int], ...], list[int]] = {}
    for index, column in enumerate(columns):
        alike.setdefault(tuple((channel, id(part)) for channel, part in column.parts.items()), []).append(index)
    out = np.zeros((next(iter(others.values())).shape[1], len(columns)))
    for same in alike.values():
        parts = columns[same[0]].parts
        products = [others[channel] * part[:, None] for channel, part in parts.items() if channel in others]
        if products:
            of_segments = np.add.reduceat(np.sum(products, axis=0), means, axis=0)
            acting = np.array([_acting(columns[index], len(means)) for index in same])
            out[:, same] = (acting @ of_segments).T
    return out


def _acting(column: Column, segments: int) -> Array:
    """Returns the magnitude of a column in segments in which it acts, and 0 in other segments, shape (S,)."""
    acting = np.full(segments, column.magnitude)
    return acting if column.segments is None else acting * column.segments


@dataclass
class _Shared:
    """A table of samples (N, P). Several columns of effects may have the same samples; the table contains these samples once.

    `places`: for each column of an effect, its index, its channel, and the index of the table's column that contains its samples.
    `acting`: True for segments in which any of these effect columns acts."""

    table: Array
    places: list[tuple[int, int, int]] = field(default_factory=list)
    acting: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(1, dtype=bool))


def _table(part: Array) -> tuple[Array, int]:
    """Finds the table of samples (N, P) that contains the array `part` (N,) as one of its columns. Returns the table and the index
    of the column. The signatures of a triad are columns of one table, so they can be projected together."""
    whole = part.base
    if isinstance(whole, np.ndarray) and whole.ndim == 2 and whole.flags.c_contiguous and len(whole) == len(part):
        offset = part.__array_interface__["data"][0] - whole.__array_interface__["data"][0]
        if part.strides[0] == whole.strides[0] and 0 <= offset < whole.strides[0]:
            return whole, offset // whole.itemsize
    return part[:, None], 0


def independent(columns: Array) -> Array:
    """Returns the columns (M, q) unchanged if they are linearly independent; otherwise returns r < q combinations (M, r) that span
    the same space."""
    size = np.linalg.norm(columns, axis=0)
    used = columns[:, size > 0] / size[size > 0]
    left, values, _ = np.linalg.svd(used, full_matrices=False)
    keep = values > DEPENDENT * values.max(initial=0.0)
    return columns if int(keep.sum()) == columns.shape[1] else left[:, keep] * float(size.max(initial=0.0))


Rows = NDArray[np.bool_]
Eigen = tuple[Array, Array]  # eigenvalues (n,) and squared scores (n,)
_NOTHING = 1e-6  # largest norm of a nominal direction that is only a rounding error


class Left:
    """Contains the coefficients of a channel, weighted at one setting of the noise. Some of their rows may have been removed.

    `rows`: array of shape (M,), True for the remaining rows. `basis`: array of shape (M, q), orthonormal basis of the whitened
    nominal columns on these rows. `residual`: array of shape (M,), whitened residual. `basis` and `residual` are zero in the
    removed rows.
    """

    def __init__(self, weight: ChannelWeights, rows: Rows, basis: Array, residual: Array):
        self.weight, self.rows, self.basis, self.residual = weight, rows, basis, residual

    @classmethod
    def whole(cls, weight: ChannelWeights) -> Left:
        return cls(weight, np.ones(len(weight.residual), dtype=bool), weight.basis, weight.residual)

    def without(self, taken: Rows) -> Left:
        """Returns the channel after further rows have been removed. Only the remaining rows then determine the nominal parameters.
        Rows of order 0 (the segment means) are whitened jointly, so they must be removed together."""
        rows = self.rows & ~taken
        basis, size, _ = np.linalg.svd(self.basis * rows[:, None], full_matrices=False)
        basis = basis[:, size > _NOTHING]
        residual = self.residual * rows
        return Left(self.weight, rows, basis, residual - basis @ (basis.T @ residual))

    def whitened(self, columns: Array, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
        """Whitens columns as `ChannelWeights.whitened_rows` does, but leaves out the removed rows. `columns`: array of shape (n,
        P), values of the columns in the rows `rows` (n,); the columns are zero in all other rows. Returns the remaining rows in
        which the whitened columns are not zero, and the whitened values in these rows."""
        at, whitened = self.weight.whitened_rows(columns, rows)
        here = self.rows[at]
        return (at, whitened) if here.all() else (at[here], whitened[here])


@dataclass(frozen=True)
class AtRows:
    """A design that is zero except in a few rows, such as the segment means. `rows`: array of shape (n,), indices of these rows.
    `columns`: array of shape (n, P), the columns in these rows."""

    rows: NDArray[np.int64]
    columns: Array


DesignColumns = Array | Rows | AtRows


def eigen(left: Left, design: DesignColumns) -> Eigen:
    """Returns the eigenvalues and the squared scores of a design. `design`: columns (M, P), columns that are zero except in a few
    rows, or a mask (M,) of rows. A mask represents a design with one column for each selected row; this column is zero in all other
    rows. Both results are empty if the design is zero in all remaining rows."""
    if isinstance(design, AtRows):
        rows, columns = design.rows, design.columns
    elif design.ndim == 1:
        return _of_rows(left, np.flatnonzero(np.logical_and(design, left.rows)))
    else:
        rows, columns = np.arange(len(design)), np.asarray(design, dtype=float)
    columns = columns[:, columns.any(axis=0)]
    acting = columns.any(axis=1)
    at, whitened = left.whitened(columns[acting], rows[acting])
    if not whitened.size:
        return np.zeros(0), np.zeros(0)
    along = left.basis[at].T @ whitened
    values, vectors = np.linalg.eigh(whitened.T @ whitened - along.T @ along)
    return _seen(values, (vectors.T @ (whitened.T @ left.residual[at])) ** 2, float((whitened**2).sum(0).max()))


def _of_rows(left: Left, at: NDArray[np.int64]) -> Eigen:
    """Returns the eigenvalues and the squared scores of a design that has one column for each of the given rows. The Gram matrix of
    such columns is diagonal except for the part that the nominal parameters absorb. Among rows of equal weight, the absorbed part
    has at most as many directions as there are parameters. All directions that are orthogonal to the absorbed part are eigenvectors
    with the same eigenvalue."""
    if not len(at):
        return np.zeros(0), np.zeros(0)
    scale = left.weight.scale[at]
    levels, which = np.unique(scale, return_inverse=True)
    basis, score = left.basis[at] * scale[:, None], left.residual[at] * scale
    free: list[Eigen] = []
    diagonal, taken, scores = [], [], []
    for number, level in enumerate(levels):
        own, told = basis[which == number], score[which == number]
        if len(own) > own.shape[1]:
            directions, own = np.linalg.qr(own)
            rest = told - directions @ (told := directions.T @ told)
            count = len(rest) - len(told)
            free.append((np.full(count, level**2), np.full(count, float(rest @ rest) / count)))
        diagonal.append(np.full(len(own), level**2))
        taken.append(own)
        scores.append(told)
    held = np.concatenate(taken)
    values, vectors = np.linalg.eigh(np.diag(np.concatenate(diagonal)) - held @ held.T)
    mixed = _seen(values, (vectors.T @ np.concatenate(scores)) ** 2, float(levels[-1] ** 2))
    values, along = (np.concatenate(parts) for parts in zip(mixed, *free, strict=True))
    return values, along


def _seen(values: Array, along: Array, largest: float) -> Eigen:
    """Removes the eigenvalues and squared scores of the directions that the nominal parameters absorb completely. `values`: array
    of shape (p,), eigenvalues of the Gram matrix. `along`: array of shape (p,), squared scores. `largest`: largest energy of a
    column before the projection."""
    seen = visible(values, largest)
    return values[seen], along[seen]


def visible(energy: Array, largest: float) -> NDArray[np.bool_]:
    """Returns a mask of the columns of which the nominal parameters leave more than rounding errors. `energy`: energies of the
    columns after the projection. `largest`: largest energy of a column before the projection."""
    return np.asarray(energy > _NOTHING**2 * largest)
