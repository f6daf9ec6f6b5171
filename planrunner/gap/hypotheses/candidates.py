"""Evaluates the candidates, that is, the effects that may explain a gap. For each form of every effect (the effect at one value of
its shape), computes the evidence, and the fraction of the effect's energy that the nominal parameters do not absorb.

In array shapes, N is the number of samples, K is the number of channels, M is the number of coefficients of a channel, G is the
number of settings of the noise, p is the number of columns of an effect, and q is the number of nominal parameters of a channel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import Column, Effect, Variant
from planrunner.error_model.effects.nominal import PARTS
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.bayes_factors import (
    WEAKEST,
    best_amplitudes,
    held_log_bayes_factor,
    log_bayes_factors,
)
from planrunner.gap.evidence.covariance import SlowNoise
from planrunner.gap.evidence.noise_levels import counts
from planrunner.gap.evidence.noise_within import noise_within
from planrunner.gap.evidence.outliers import outliers
from planrunner.gap.evidence.rounding import is_coarse, undithered
from planrunner.gap.evidence.spectrum import Spectrum, spectrum, white_level
from planrunner.gap.evidence.weighing import (
    ChannelWeights,
    Setting,
    coefficients_of,
    independent,
    reduced_columns,
    settings_of,
    table_of,
    walking_alike,
)
from planrunner.physics.sampled_motion import AngleFrom
from planrunner.plan.model import NOMINAL_TERMS
from planrunner.plan.schedule import Rest

ABSORBED = 1e-4  # fraction of a signature's energy up to which the remainder is due to rounding
FULL = NOMINAL_TERMS
EXCLUDED = -15.0  # log probability below which amplitudes count as physically impossible: 5 σ beyond a limit
_QUANTILES = 256  # number of quantiles of the noise of a sample
_AT_ONCE = 1 << 23  # values of whitened columns at all settings of the noise that are in memory at a time: 64 MB
_ROUNDING = 1e-13  # fraction of a signal; smaller changes are rounding errors
_UNLIKELY = 1e-3  # probability at and below which a setting of the noise is omitted


@dataclass(frozen=True, slots=True)
class Reduced(Variant):
    """A variant of an effect whose columns contain coefficients instead of samples (`reduced_columns`). Columns with the same samples
    share their coefficients, so all forms of all effects together need little memory."""

    @classmethod
    def of(cls, variant: Variant, columns: Sequence[Column]) -> Reduced:
        """Makes a reduced variant from a variant and its columns of coefficients."""
        return cls(tuple(columns), variant.shape, variant.widths, variant.fixed)

    def with_tables(self, raw: Sequence[Array]) -> Reduced:
        """Returns a copy with other coefficients. `raw`: for each channel, the coefficients (M, p) of the p columns, for amplitudes
        equal to their magnitudes. Channels on which a column does not act are ignored."""
        columns = []
        for k, column in enumerate(self.columns):
            parts = {channel: raw[channel][:, k] / column.magnitude for channel in column.parts}
            columns.append(replace(column, parts=parts, segments=None))
        return Reduced.of(self, columns)


@dataclass(frozen=True)
class Weighed:
    """Contains a variant of an effect (the effect at one value of its shape) after whitening and evaluation. `gram`: array of shape
    (G, p, p), inner products between the whitened, projected columns. `score`: array of shape (G, p), inner products of these
    columns with the whitened data. Both arrays are computed at each of the G settings of the noise. A setting of the noise is a
    combination of levels of flicker and random walk. Projection removes the part of a column that the nominal parameters absorb.
    Amplitudes are in magnitudes: the amplitude of each column is divided by its prior scale `Column.magnitude`.

    `trace`: energy of the columns after projection, at the first setting of the noise. `kept`: ratio of this energy to the energy
    before projection. `weights`: the weights of each channel at the first setting.
    """

    variant: Reduced
    gram: Array = field(repr=False)
    score: Array = field(repr=False)
    trace: float
    kept: float
    weights: Sequence[ChannelWeights] = field(repr=False)

    @property
    def raw(self) -> tuple[Array, ...]:
        """Returns, for each channel, the columns (M, p) before whitening and projection, each for an amplitude equal to
        `Column.magnitude`. The columns are computed at each call; there are too many effects to store them."""
        columns = self.variant.columns
        return tuple(table_of(columns, channel, own.segment) for channel, own in enumerate(self.weights))

    @property
    def by_channel(self) -> tuple[Array, ...]:
        """Returns, for each channel, the whitened, projected columns (M, p) at the first setting of the noise. The columns are computed
        at each call, as in `raw`."""
        return tuple(own.project(raw) for own, raw in zip(self.weights, self.raw, strict=True))

    @property
    def held(self) -> bool:
        """Returns True if the variant has a single amplitude, which is 1 for physical reasons. Only the shape is then free."""
        return len(self.variant.columns) == len(self.variant.fixed) == 1

    @cached_property
    def log_bayes(self) -> Array:
        """Returns the log Bayes factor at each setting of the noise, shape (G,). If the amplitudes are free, the factor is an
        average over the strength of the effect, its energy λ in units of the noise. The amplitude of an effect without a free
        amplitude is kept near 1."""
        if self.held:
            return held_log_bayes_factor(self.gram[:, 0, 0], self.score[:, 0])
        fixed = self.variant.fixed
        return self.if_possible(log_bayes_factors(self.gram, self.score, None if fixed else self.trace, fixed))

    def if_possible(self, log_bayes: Array) -> Array:
        """Returns the log Bayes factor under the condition that the amplitudes are physically possible, shape (G,). `log_bayes`:
        array of shape (G,), log Bayes factor without this condition. An effect whose best fit is physically impossible is not
        preferred to no effect, even if it reproduces the data well."""
        found = log_bayes + self.log_possible
        return np.minimum(found, self.log_possible) if self.excluded else found

    @property
    def excluded(self) -> bool:
        """Returns True if the amplitudes that fit best are physically impossible."""
        return self.log_possible <= EXCLUDED

    @cached_property
    def log_possible(self) -> float:
        """Returns the logarithm of the probability that every amplitude is physically possible; it is negative or zero. The log
        Bayes factor for a prior without limits, plus this value, is the log Bayes factor for a prior with the physical limits."""
        return self.log_possible_at(*self.amplitudes) if self.limited else 0.0

    @cached_property
    def limited(self) -> list[int]:
        """Returns the indices of the free amplitudes that have a physical limit."""
        return [
            k
            for k, column in enumerate(self.variant.columns)
            if k not in self.variant.fixed and np.isfinite([column.smallest, column.largest]).any()
        ]

    def log_possible_at(self, mean: Array, covariance: Array) -> float:
        """Does the same as `log_possible`, for given amplitudes: mean (p,) and covariance (p, p) in magnitudes."""
        from scipy.special import log_ndtr

        columns, limited = self.variant.columns, self.limited
        smallest = np.array([columns[k].smallest / columns[k].magnitude for k in limited])
        largest = np.array([columns[k].largest / columns[k].magnitude for k in limited])
        inside = np.minimum(largest - mean[limited], mean[limited] - smallest)
        return float(log_ndtr(inside / np.sqrt(np.diag(covariance)[limited])).sum())

    @property
    def can_be_seen(self) -> bool:
        """Returns False if the projected columns are zero, except for rounding, or if the energy λ of the effect, in units of the
        noise, stays below `WEAKEST` for all physically possible amplitudes."""
        if self.kept <= ABSORBED or self.trace <= 0:
            return False
        columns, gram = self.variant.columns, self.gram[0]
        reach = np.array([max(-column.smallest, column.largest) / column.magnitude for column in columns])
        seen = np.diag(gram) > 0
        if not np.isfinite(reach[seen]).all():
            return True
        return float(reach[seen] @ np.abs(gram[np.ix_(seen, seen)]) @ reach[seen]) >= WEAKEST

    @cached_property
    def amplitudes(self) -> tuple[Array, Array]:
        """Returns mean (p,) and covariance (p, p) of the amplitudes in magnitudes, at the first setting of the noise."""
        return self.amplitudes_at(0)

    def amplitudes_at(self, setting: int) -> tuple[Array, Array]:
        """Returns mean (p,) and covariance (p, p) of the amplitudes in magnitudes, at one setting of the noise."""
        return best_amplitudes(self.gram[setting], self.score[setting], self.variant.widths, self.variant.fixed)


Forms = Sequence[tuple[Weighed, float]]
"""Forms of an effect that is completely determined by its shape, each with its probability."""


@dataclass(frozen=True)
class Candidate:
    """Contains an effect and its evaluated variants. `log_bayes`: array of shape (G,), log Bayes factor averaged over the shape of
    the effect. `at`: index of the setting of the noise at which the forms are compared. `at` is the most probable setting without a
    random walk of the gyros, because a random walk would explain much of the residuals of a wrong form. `settled`: True if the
    nominal parameters were fitted together with the effect before its forms were computed. `whole`: the forms with the amplitude 1
    and their probabilities, if the effect is strong and its shape determines it completely."""

    effect: Effect
    variants: tuple[Weighed, ...]
    log_bayes: Array
    at: int = 0
    settled: bool = False
    whole: Forms = ()

    @property
    def id(self) -> str:
        return self.effect.id

    @property
    def best(self) -> Weighed:
        return max(self.variants, key=lambda weighed: float(weighed.log_bayes[self.at]))

    @property
    def shape_cost(self) -> float:
        """Returns the logarithm of a ratio at the first setting of the noise: the evidence averaged over the shape, divided by the
        evidence of the best shape. The result is never positive."""
        return float(self.log_bayes[0]) - max(float(weighed.log_bayes[0]) for weighed in self.variants)

    @property
    def kept(self) -> float:
        return max((weighed.kept for weighed in self.variants), default=0.0)


class Weighing:
    """Contains a recording with its noise and its nominal model, prepared for the evaluation of effects. The setting of a triad is
    a level of flicker and a level of random walk. A setting of the noise combines a setting of the gyros with a setting of the
    accelerometers. The index of a setting is (gyro setting) × (number of accelerometer settings) + (accelerometer setting).

    `removed`: array of shape (N, K) in SI units, a signal (for example a line) that is subtracted from the samples before the
    evaluation. `held`: array of shape (N, K), True for samples that are replaced by the fit, such as samples that repeat an earlier
    sample. `coarse`: array of shape (K,), True for channels whose noise does not dither the rounding to counts; the scatter of the
    samples of such a channel shows rounding, not noise. `outliers`: array of shape (N, K) in SI units, errors of single samples
    that are left out; None if there are none.

    The following attributes have one item for each channel. `whole`: the columns (M, q) of the nominal parameters. `angles`: the
    columns (M, n) of `angle_columns` that act on the channel. `known`: the columns (M, n) of effects that count as nominal
    parameters.
    """

    def __init__(
        self,
        observed: Observed,
        nominal: Sequence[str] = FULL,
        removed: Array | None = None,
        held: NDArray[np.bool_] | None = None,
    ):
        self.steps, self.held = counts(observed), held
        channels = zip(observed.channels, self.steps, strict=True)
        self.declared = observed
        self.observed = observed = replace(
            observed, channels=tuple(replace(channel, resolution=float(step)) for channel, step in channels)
        )
        self.nominal_columns = nominal_columns(observed, nominal)
        self._reference = simulated(observed, nominal)
        reference = self._reference if removed is None else self._reference + removed
        self._measure(reference, held)
        self.outliers = outliers(observed, self.spectrum, self.noise, self.white, self.coarse)
        if self.outliers is not None:
            self._measure(reference + self.outliers, held)
        phase = of_unknown_phase(observed, self.spectrum) / self.white**2
        relative = [
            blocks.plus(own)
            for blocks, own in zip(self.noise.of_coefficients(observed, self.spectrum), phase.T, strict=True)
        ]
        if held is not None and held.any():
            more = self.noise.of_held(observed, self.spectrum, held)
            relative = [own.joined(further) for own, further in zip(relative, more, strict=True)]
        fast = np.column_stack([own.variances[self.spectrum.means] for own in relative]) * self.white**2
        slow, means = SlowNoise.of(observed, self.spectrum), fast / observed.counts[:, None]
        self.weights: list[list[ChannelWeights]] = []
        self.settings: dict[str, tuple[Setting, ...]] = {
            kind: settings_of(observed, slow, means, kind) for kind in ("gyro", "accel")
        }
        self.observed = observed.with_model(scatter=self._scatter())
        self.observed = self.seen()
        rounding = undithered(observed, self.white, self.coarse)
        self.log_likelihood: list[Array] = []
        for index, channel in enumerate(observed.channels):
            settings, fitted = self.settings[channel.kind], self.nominal[index]
            levels = {
                level: ChannelWeights(
                    observed,
                    slow,
                    self.spectrum,
                    index,
                    float(self.white[index]),
                    *level,
                    fitted,
                    self.noise,
                    relative[index],
                    float(rounding[index]),
                )
                for level in dict.fromkeys((setting.flicker, setting.walk) for setting in settings)
            }
            each = [levels[setting.flicker, setting.walk] for setting in settings]
            chosen, likelihood = walking_alike(each, settings)
            self.weights.append(chosen)
            self.log_likelihood.append(likelihood)

    def _measure(self, reference: Array, held: NDArray[np.bool_] | None) -> None:
        """Computes the coefficients of the samples after `reference` (N, K) has been subtracted, the coefficients of the nominal
        columns, and the noise. `held`: the same as in `Weighing`."""
        observed = self.observed
        self.spectrum: Spectrum = spectrum(observed, reference, held)
        level, self.white_degrees = white_level(observed, self.spectrum)
        self.white: Array = np.maximum(level, self.steps / np.sqrt(12))
        self.coarse: NDArray[np.bool_] = is_coarse(self.white, self.steps)
        coefficients = coefficients_of(observed, self.spectrum, self.nominal_columns)
        self.whole = [
            part[:, [c for c, column in enumerate(self.nominal_columns) if index in column.parts]]
            for index, part in enumerate(coefficients)
        ]
        angles = coefficients_of(observed, self.spectrum, angle_columns(observed))
        self.angles = [part[:, part.any(axis=0)] for part in angles]
        self.nominal = [independent(np.hstack(parts)) for parts in zip(self.whole, self.angles, strict=True)]
        self.known: list[Array] = [part[:, :0] for part in self.whole]
        self.noise = noise_within(observed, self.spectrum, self.white, self._left())
        if held is not None:
            self.noise = self.noise.without_held(observed, held)

    def _left(self) -> Array:
        """Returns the coefficients (M, K) after the nominal parameters, fitted by least squares, have been subtracted."""
        bases = [np.linalg.qr(columns)[0] for columns in self.nominal]
        each = [
            values - basis @ (basis.T @ values) for basis, values in zip(bases, self.spectrum.values.T, strict=True)
        ]
        return np.column_stack(each)

    def _scatter(self) -> Array:
        """Returns quantiles (K, Q) of the noise of a sample at rest, SI. Samples that were replaced are left out. If the recording
        contains means over bins, or if few samples are left, the noise is assumed to be normal."""
        from scipy.special import ndtri

        observed, share = self.observed, (np.arange(_QUANTILES) + 0.5) / _QUANTILES
        still = np.array([isinstance(motion, Rest) for motion in observed.motions])[observed.owner]
        found = np.outer(self.white, ndtri(share))
        for index, own in enumerate(self.spectrum.remainder[still].T if observed.bins is None else ()):
            used = own[own != 0]
            if len(used) >= _QUANTILES:
                found[index] = np.quantile(used, share)
        return np.asarray(found)

    def nominal_values(
        self, taken: Sequence[Array] | None = None, change: Sequence[Array] | None = None
    ) -> list[Array]:
        """Returns, for each channel, the values (q,) of its nominal parameters in magnitudes, in the order of its columns in
        `whole`. The values are fitted by least squares to all coefficients. If the noise has already been measured, the fit is
        weighted according to the most probable setting of the noise. `taken`: for each channel, the coefficients (M,) that an
        effect explains; they are subtracted before the fit. `change`: for each channel, the change (M, q) of the effect per
        magnitude of each nominal parameter, which is added to the columns of the parameters."""
        found = []
        for index, whole in enumerate(self.whole):
            nominal = whole if change is None else whole + change[index]
            left = self.spectrum.values[:, index] - (0.0 if taken is None else taken[index])
            both = np.column_stack([nominal, self.angles[index], left])
            if self.weights:
                both = self.weights_at(self.likeliest[0], index).whiten(both)
            size = np.linalg.norm(both[:, :-1], axis=0) + 1e-300
            values = np.linalg.lstsq(both[:, :-1] / size, both[:, -1], rcond=None)[0] / size
            found.append(values[: nominal.shape[1]])
        return found

    def misfits(self, values: Sequence[Array], taken: Sequence[Array]) -> list[float]:
        """Returns, for each channel, the sum of the squared whitened residuals, at the most probable noise. The amplitudes of `angles`
        are fitted. `values`, `taken`: for each channel, the values (q,) of its nominal parameters in magnitudes, and the
        coefficients (M,) that an effect explains."""
        found = []
        for index, (whole, at) in enumerate(zip(self.whole, values, strict=True)):
            left = self.spectrum.values[:, index] - taken[index] - whole @ at
            both = self.weights_at(self.likeliest[0], index).whiten(np.column_stack([self.angles[index], left]))
            basis, rest = np.linalg.qr(both[:, :-1])[0], both[:, -1]
            found.append(float(rest @ rest - ((basis.T @ rest) ** 2).sum()))
        return found

    def weights_at(self, setting: int, channel: int) -> ChannelWeights:
        """Returns the weights of a channel at one setting of the noise."""
        gyro, accel = divmod(setting, self.shape[1])
        return self.weights[channel][gyro if self.observed.channels[channel].kind == "gyro" else accel]

    def without_walks(self) -> Weighing:
        """Returns a copy with the settings of the noise that contain no random walk. These settings alone determine the evidence of
        a hypothesis without a random walk. There are few such settings, so this evidence is computed faster."""
        kept = {kind: [k for k, one in enumerate(own) if one.walk == 0] for kind, own in self.settings.items()}
        kinds = [channel.kind for channel in self.observed.channels]
        return self._changed(
            settings={kind: tuple(own[k] for k in kept[kind]) for kind, own in self.settings.items()},
            weights=[[own[k] for k in kept[kind]] for own, kind in zip(self.weights, kinds, strict=True)],
            log_likelihood=[own[kept[kind]] for own, kind in zip(self.log_likelihood, kinds, strict=True)],
        )

    def fitted(self, values: Sequence[Array] | None = None) -> Array:
        """Returns the output of the nominal model, shape (N, K). `values`: the same as in `output_at`; by default, the nominal
        parameters are fitted without any effect."""
        return self.output_at(self.nominal_values() if values is None else values)

    def output_at(self, values: Sequence[Array]) -> Array:
        """Returns the output (N, K), SI, of the nominal model. `values`: for each channel, the values of its nominal parameters in
        magnitudes."""
        out = self._reference.copy()
        for index, of_channel in enumerate(values):
            own = [column for column in self.nominal_columns if index in column.parts]
            for column, value in zip(own, of_channel, strict=True):
                out[:, index] += column.parts[index] * (column.magnitude * value)
        return out

    def samples_of(self, channel: int) -> Array:
        """Returns the samples (N, q) of the columns of a channel's nominal parameters, SI per magnitude, in the order of `whole`."""
        own = [column for column in self.nominal_columns if channel in column.parts]
        found = np.empty((len(self.observed.time), len(own)))
        for place, column in enumerate(own):
            np.multiply(column.parts[channel], column.magnitude, out=found[:, place])
        return found

    def seen(self, values: Sequence[Array] | None = None) -> Observed:
        """Returns the recording, extended by the fitted output of the nominal model and the fitted response of each channel to the
        rate. `values`: the same as in `fitted`."""
        observed, fitted = self.observed, self.fitted(values)
        if observed.along is not None:
            return observed.with_model(fitted=fitted)
        axes = np.eye(3)[[channel.axis for channel in observed.channels]]
        felt = np.column_stack([observed.omega, np.ones(len(fitted))])
        more = np.linalg.pinv(felt.T @ felt, hermitian=True) @ (felt.T @ (fitted - self._reference))
        return observed.with_model(fitted=fitted, response=axes + more[:3].T)

    def beside(self, known: Weighed) -> Weighing:
        """Returns a copy in which the columns of effects (`known`) count as nominal parameters, so that their amplitudes are free
        in every channel."""
        acting = [raw[:, raw.any(axis=0)] for raw in known.raw]
        return self._with(
            lambda weight, channel: weight.beside(known.raw[channel]),
            nominal=[independent(np.hstack(parts)) for parts in zip(self.nominal, acting, strict=True)],
            known=[np.hstack(parts) for parts in zip(self.known, acting, strict=True)],
        )

    def with_known(self, columns: Sequence[Column], amplitudes: Array) -> Weighing:
        """Returns a copy in which the nominal output contains effects with known amplitudes. `columns`: P columns with samples.
        `amplitudes`: array of shape (P,), in units of `Column.magnitude`."""
        caused = [raw @ amplitudes for raw in coefficients_of(self.observed, self.spectrum, columns)]
        reference = self._reference.copy()
        for column, amplitude in zip(columns, amplitudes, strict=True):
            acting = True if column.segments is None else column.segments[self.observed.owner]
            for channel, part in column.parts.items():
                reference[:, channel] += np.where(acting, part, 0.0) * (column.magnitude * amplitude)
        made = self._with(
            lambda weight, channel: weight.without(caused[channel]),
            _reference=reference,
            spectrum=replace(self.spectrum, values=self.spectrum.values - np.column_stack(caused)),
        )
        return made._changed(observed=made.seen())

    def condensed(self, columns: Sequence[Column] = ()) -> tuple[Weighing, list[Column]]:
        """Returns a copy for effects on the output, and `columns` for this copy. Such an effect is a function of the nominal output
        alone. In some segments, such as segments at rest, the nominal output and all columns are constant. The copy therefore
        contains only one sample of such a segment, which represents all samples. The coefficients of effects are the same as
        before, except for rounding."""
        constant = np.array([course is None for course in self.observed.courses or (None,) * len(self.observed)])
        for signal in self._signals(columns):
            constant &= _constant(signal, self.observed.bounds)
        if not constant.any():
            return self, list(columns)
        kept = ~constant[self.observed.owner]
        kept[self.observed.bounds[:-1]] = True
        return self._at_samples(kept, self.spectrum.of_constant(constant), columns)

    def of_turns(self, columns: Sequence[Column] = ()) -> tuple[Weighing, list[Column]]:
        """Returns a copy for a first search for effects on the output, and `columns` for this copy. While the table turns at a
        constant rate, the copy contains few samples of the nominal output, as `Spectrum.of_turns` describes. The coefficients of
        effects are approximate in segments in which an output passes a limit or the edge of a dead zone."""
        spectrum_, kept = self.spectrum.of_turns(self.observed, self._signals(columns))
        return (self, list(columns)) if kept.all() else self._at_samples(kept, spectrum_, columns)

    def _signals(self, columns: Sequence[Column]) -> list[Array]:
        """Returns the samples (N,) of the nominal output and of all columns: those of the nominal parameters, and `columns`."""
        of_channels = [part for column in (*self.nominal_columns, *columns) for part in column.parts.values()]
        return [*self._reference.T, *{_place(part): part for part in of_channels}.values()]

    def _at_samples(
        self, kept: NDArray[np.bool_], spectrum_: Spectrum, columns: Sequence[Column]
    ) -> tuple[Weighing, list[Column]]:
        """Returns a copy that contains only the samples in the mask `kept` (N,), and `columns` for this copy. Columns that share their
        samples also share them in the copy. `spectrum_`: projects columns of these samples."""
        taken: dict[tuple[int, tuple[int, ...]], Array] = {}

        def short(column: Column) -> Column:
            for part in column.parts.values():
                if _place(part) not in taken:
                    taken[_place(part)] = part[kept]
            return replace(column, parts={channel: taken[_place(part)] for channel, part in column.parts.items()})

        made = self._changed(
            observed=self.observed.at_samples(kept),
            spectrum=spectrum_,
            nominal_columns=[short(column) for column in self.nominal_columns],
            _reference=self._reference[kept],
        )
        return made, [short(column) for column in columns]

    def moving(
        self, change: Sequence[Array], values: Sequence[Array], beside: Sequence[Array] | None = None
    ) -> Weighing:
        """Returns a copy that includes the change of an effect with the nominal parameters. `change`: for each channel, the change
        (M, q) of the effect per magnitude of each parameter. `values`: for each channel, the values (q,) of the parameters at which
        the effect is evaluated. `beside`: for each channel, further columns (M, P) with free amplitudes, None if there are none."""
        found = self.spectrum.values.copy()
        nominal, changed = list(self.nominal), [bool(own.any()) for own in change]
        for index, (own, at) in enumerate(zip(change, values, strict=True)):
            free = self.known[index][:, :0] if beside is None else beside[index][:, beside[index].any(axis=0)]
            if own.any() or free.size:
                changed[index] = True
                found[:, index] += own @ at
                nominal[index] = independent(
                    np.hstack([self.whole[index] + own, self.angles[index], self.known[index], free])
                )
        return self._with(
            lambda weight, channel: (
                weight.refitted(nominal[channel], found[:, channel]) if changed[channel] else weight
            ),
            nominal=nominal,
            spectrum=replace(self.spectrum, values=found),
        )

    def inflated(self, ratios: Sequence[float]) -> Weighing:
        """Returns a copy in which the variance of each channel's noise has been multiplied by the ratio for this channel."""
        return self._with(lambda weight, channel: weight.inflated(ratios[channel]))

    def _with(self, change: Callable[[ChannelWeights, int], ChannelWeights], **attributes: object) -> Weighing:
        """Returns a copy with changed weights, and with other changed attributes if any are given (`attributes`). Several settings can
        share the same weights. The log likelihood of a setting changes by the same amount as the log likelihood of its weights."""
        made, gains = [], []
        for channel, (weights, likelihood) in enumerate(zip(self.weights, self.log_likelihood, strict=True)):
            changed = {id(weight): change(weight, channel) for weight in weights}
            made.append([changed[id(weight)] for weight in weights])
            gained = [changed[id(weight)].log_likelihood - weight.log_likelihood for weight in weights]
            gains.append(likelihood + np.array(gained))
        return self._changed(weights=made, log_likelihood=gains, **attributes)

    def _changed(self, **attributes: object) -> Weighing:
        """Returns a copy with changed attributes. Values that were computed from other attributes are not copied."""
        made = copy(self)
        for name in ("shape", "base", "log_prior", "likeliest"):
            made.__dict__.pop(name, None)
        made.__dict__.update(attributes)
        return made

    @cached_property
    def shape(self) -> tuple[int, int]:
        return len(self.settings["gyro"]), len(self.settings["accel"])

    @cached_property
    def base(self) -> Array:
        """Returns the log likelihood of the recording without any effect, at each setting of the noise, shape (G,)."""
        parts = {"gyro": np.zeros(self.shape[0]), "accel": np.zeros(self.shape[1])}
        for channel, likelihood in zip(self.observed.channels, self.log_likelihood, strict=True):
            parts[channel.kind] += likelihood
        return np.add.outer(parts["gyro"], parts["accel"]).ravel()

    @cached_property
    def log_prior(self) -> tuple[Array, Array]:
        """Returns two log priors of the settings of the noise, each of shape (G,): for the hypotheses without and with an
        undeclared random walk of the gyros."""
        gyro, accel = self.settings["gyro"], self.settings["accel"]
        prior = np.outer([s.prior for s in gyro], [s.prior for s in accel]).ravel()
        walking = np.repeat([s.walk > 0 for s in gyro], len(accel))
        with np.errstate(divide="ignore"):
            return np.log(np.where(walking, 0.0, prior)), np.log(np.where(walking, prior, 0.0))

    @cached_property
    def likeliest(self) -> tuple[int, ...]:
        """Returns the index of the most probable setting of the noise without a random walk of the gyros. If a random walk is a
        hypothesis, also returns the index of the most probable setting with it."""
        return tuple(int(np.argmax(self.base + prior)) for prior in self.log_prior if np.isfinite(prior).any())

    def likeliest_with(self, log_bayes: Array, walking: bool) -> int:
        """Returns the index of the setting of the noise that is most probable under a hypothesis. Settings with a random walk of
        the gyros are compared if `walking` is True, and settings without one if it is False. `log_bayes`: array of shape (G,), log
        Bayes factor of the hypothesis."""
        terms = self.base + self.log_prior[int(walking)] + np.where(np.isfinite(log_bayes), log_bayes, -1e300)
        return int(np.argmax(terms))

    def whitened_at(self, weighed: Weighed, setting: int) -> list[tuple[ChannelWeights, Array]]:
        """Returns, for each channel, its weights and the whitened, projected columns (M, p) of a variant, at one setting of the
        noise."""
        if setting == 0:
            return [(own[0], columns) for own, columns in zip(self.weights, weighed.by_channel, strict=True)]
        weights = [self.weights_at(setting, channel) for channel in range(len(self.weights))]
        return [(weight, weight.project(raw)) for weight, raw in zip(weights, weighed.raw, strict=True)]

    def evidence(self, log_bayes: Array, walking: bool = False) -> float:
        """Returns the log evidence of a hypothesis, averaged over the settings of the noise. `log_bayes`: array of shape (G,), log
        Bayes factor of the hypothesis at each setting. `walking`: True if a random walk of the gyros acts in addition; the average
        then covers the settings with a random walk."""
        terms = self.base + log_bayes + self.log_prior[int(walking)]
        return float(np.logaddexp.reduce(terms))

    def transposed_at(self, weighed: Weighed, setting: int) -> dict[int, Array]:
        """Returns Wᵀ·y, shape (M, p), for each channel on which a variant acts. Here y are the whitened, projected columns of the
        variant, and W is the matrix that whitens coefficients at one setting of the noise. The inner product of Wᵀ·y with columns of
        coefficients that are not whitened equals the inner product of y with the whitened columns."""
        acting = {channel for column in weighed.variant.columns for channel in column.parts}
        pairs = enumerate(self.whitened_at(weighed, setting))
        return {channel: weight.transposed(columns) for channel, (weight, columns) in pairs if channel in acting}

    def reduced(self, groups: Iterable[Sequence[Variant]]) -> list[Reduced]:
        """Returns the variants of all groups with coefficients instead of samples. The samples of all forms of all effects together
        would need many times the memory of the recording. If `groups` makes the groups one after the other, the samples of only one
        group are in memory at a time."""
        found: list[Reduced] = []
        for group in groups:
            columns = [column for variant in group for column in variant.columns]
            left = iter(reduced_columns(self.observed, self.spectrum, columns))
            found += [Reduced.of(variant, list(islice(left, len(variant.columns)))) for variant in group]
            del group, columns  # releases the memory before the next group is made
        return found

    def amplitudes(self, weighed: Weighed, walking: bool) -> tuple[Array, Array]:
        """Returns posterior mean (p,) and covariance (p, p) of the amplitudes in magnitudes. Mean and covariance are averaged over
        the settings of the noise with a random walk of the gyros if `walking` is True, otherwise over the settings without one."""
        terms = self.base + weighed.log_bayes + self.log_prior[int(walking)]
        share = np.exp(terms - terms.max())
        share /= share.sum()
        likely = np.flatnonzero(share > _UNLIKELY)
        means, covariances = (np.array(part) for part in zip(*map(weighed.amplitudes_at, likely.tolist()), strict=True))
        share = share[likely] / share[likely].sum()
        mean = share @ means
        away = means - mean
        return mean, np.tensordot(share, covariances, 1) + (share[:, None] * away).T @ away

    def weigh_groups(self, groups: Iterable[Sequence[Variant]]) -> list[Weighed]:
        """Does the same as `weigh` for the variants of all groups. The samples of only one group are in memory at a time, as in
        `reduced`."""
        return self.weigh_reduced(self.reduced(groups))

    def weigh(self, variants: Sequence[Variant]) -> list[Weighed]:
        """Whitens variants (effects, each at one value of its shape) and evaluates them at every setting of the noise."""
        return self.weigh_reduced(self.reduced([variants]))

    def weigh_reduced(self, variants: Sequence[Reduced]) -> list[Weighed]:
        """Does the same as `weigh` for variants with coefficients instead of samples. The whitened columns of only one part of the
        variants are in memory at a time."""
        at_once = max(1, _AT_ONCE // (len(self.spectrum.segment) * max(self.shape)))
        ends = np.cumsum([len(variant.columns) for variant in variants])
        found: list[Weighed] = []
        while len(found) < len(variants):
            begin = len(found)
            already = int(ends[begin - 1]) if begin else 0
            end = max(begin + 1, int(np.searchsorted(ends, already + at_once, side="right")))
            found += self._weigh_part(variants[begin:end])
        return found

    def _weigh_part(self, variants: Sequence[Reduced]) -> list[Weighed]:
        """Evaluates variants whose whitened columns fit in memory."""
        columns = [column for variant in variants for column in variant.columns]
        widths = [len(variant.columns) for variant in variants]
        bounds = np.concatenate(([0], np.cumsum(widths))).astype(int)
        sizes = {"gyro": self.shape[0], "accel": self.shape[1]}
        grams = [{kind: np.zeros((n, p, p)) for kind, n in sizes.items()} for p in widths]
        scores = {kind: np.zeros((n, len(columns))) for kind, n in sizes.items()}
        before = np.zeros(len(columns))
        for index, channel in enumerate(self.observed.channels):
            used = np.flatnonzero([index in column.parts for column in columns])
            if not len(used):
                continue
            own = table_of([columns[k] for k in used], index, self.spectrum.segment)
            distinct = {id(weight): weight for weight in self.weights[index]}
            order = {key: number for number, key in enumerate(distinct)}
            which = [order[id(weight)] for weight in self.weights[index]]
            projected = np.array([weight.project(own) for weight in distinct.values()])
            before[used] += (self.weights[index][0].whiten(own) ** 2).sum(0)
            along = [block.T @ weight.residual for block, weight in zip(projected, distinct.values(), strict=True)]
            scores[channel.kind][:, used] += np.array(along)[which]
            for v, (low, high) in enumerate(pairwise(np.searchsorted(used, bounds))):
                if high > low:
                    block, at = projected[:, :, low:high], used[low:high] - bounds[v]
                    grams[v][channel.kind][:, at[:, None], at] += (np.swapaxes(block, 1, 2) @ block)[which]
        first = tuple(own[0] for own in self.weights)
        found = []
        for v, (variant, (low, high)) in enumerate(zip(variants, pairwise(bounds), strict=True)):
            p = high - low
            gram = (grams[v]["gyro"][:, None] + grams[v]["accel"][None]).reshape(-1, p, p)
            score = (scores["gyro"][:, None, low:high] + scores["accel"][None, :, low:high]).reshape(-1, p)
            trace = float(np.trace(gram[0]))
            found.append(
                Weighed(variant, gram, score, trace, trace / max(float(before[low:high].sum()), 1e-300), first)
            )
        return found

    def together(self, forms: Sequence[Weighed]) -> Weighed:
        """Evaluates several effects together: their columns form one linear model. `forms`: one form of each effect."""
        (weighed,) = self.weigh_reduced([joined(forms)])
        return weighed


def _place(part: Array) -> tuple[int, tuple[int, ...]]:
    """Returns the place of an array in memory, which is the same for two views of the same values."""
    return part.__array_interface__["data"][0], part.strides


def _constant(signal: Array, bounds: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Returns a mask (S,) of the segments in which a signal (N,) is constant, except for rounding. `bounds`: array of shape (S + 1,),
    index of the first sample of each segment, followed by N."""
    smallest, largest = (of.reduceat(signal, bounds[:-1]) for of in (np.minimum, np.maximum))
    return np.asarray(largest - smallest <= _ROUNDING * np.maximum(np.abs(smallest), np.abs(largest)))


def joined(forms: Sequence[Weighed]) -> Reduced:
    """Returns the variant that contains the columns of several effects. `forms`: one form of each effect."""
    columns = [form.variant.columns for form in forms]
    widths = tuple(map(len, columns))
    starts = np.cumsum([0, *widths[:-1]]).tolist()
    fixed = tuple(start + k for start, form in zip(starts, forms, strict=True) for k in form.variant.fixed)
    return Reduced(tuple(column for own in columns for column in own), widths=widths, fixed=fixed)


def nominal_columns(observed: Observed, nominal: Sequence[str]) -> list[Column]:
    """Returns the columns of the terms that the nominal simulation fits."""
    columns: list[Column] = []
    for kind in ("gyro", "accel"):
        for part, make in PARTS.items():
            if f"{kind}_{part}" in nominal:
                columns += make(observed, kind)
    return columns


def angle_columns(observed: Observed) -> list[Column]:
    """Returns columns for the angle of the table at the start of a segment: the change of the specific force per radian, for each
    accelerometer. There is one column for each segment whose angle was found from gravity. An angle found from gravity contains the
    errors of the accelerometers. Each channel has its own free correction of this angle, so an error of the angle does not count as
    evidence."""
    shown = [index for index, source in enumerate(observed.angle_from) if source is AngleFrom.GRAVITY]
    if not shown:
        return []
    change = -np.cross(observed.table_axis, observed.force)
    return [
        Column(
            "angle",
            "rad",
            1.0,
            1.0,
            {channel: observed.seen(channel, change) for channel in observed.of_kind("accel")},
            np.arange(len(observed)) == segment,
            axis=None,
        )
        for segment in shown
    ]


def of_unknown_phase(observed: Observed, spectrum_: Spectrum) -> Array:
    """Returns the variance of the coefficients due to the nominal input of unknown phase (`Observed.unknown_phase`), SI²·samples,
    shape (M, K). The cosine and sine components of this input are treated as normal variables. The standard deviation of these
    variables is the amplitude of the input."""
    amplitude = np.abs(observed.unknown_phase)
    if not amplitude.any():
        return np.zeros((len(spectrum_.segment), len(observed.channels)))
    waves = np.column_stack([np.cos(observed.angle), np.sin(observed.angle)])
    seen = spectrum_.project(observed, waves, np.asarray(amplitude.any(axis=1)))
    return np.asarray((seen**2).sum(axis=1, keepdims=True) * amplitude[spectrum_.segment] ** 2)


def simulated(observed: Observed, nominal: Sequence[str]) -> Array:
    """Returns the output of the nominal simulation before any parameter is fitted, SI, shape (N, K)."""
    omega = observed.omega if "earth_rate" in nominal else observed.omega - observed.earth_rate
    return np.column_stack(
        [
            observed.seen(c, omega if channel.kind == "gyro" else observed.force)
            for c, channel in enumerate(observed.channels)
        ]
    )
