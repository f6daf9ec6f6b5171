"""Fits effects that change an output within segments. The fit uses the samples. First, the shapes are fitted by variable
projection; then all amplitudes are fitted together with the means in one linear fit.

The samples of a segment are split into their mean and the differences from this mean. For given shapes, such as a time constant,
the amplitudes are fitted linearly, so that the χ² of this fit is a function of the shapes alone (G. Golub and V. Pereyra, SIAM J.
Numer. Anal. 10, 1973). The fit searches for the smallest χ² within the bounds of the catalogue. At this minimum, the model y is
linearised in amplitudes and shapes: J = ∂y/∂(amplitudes, shapes). A contrast is a weighted sum of the differences of the samples
from the means of their segments. If the noise is white, a few contrasts, one for each column of J, contain all information that the
samples within the segments contribute to the fit. After the means have been subtracted from the columns of J, let JᵀJ = V·S·Vᵀ be
the eigendecomposition of JᵀJ, and z the samples. The contrasts S^(−1/2)·Vᵀ·Jᵀ·z then have the design matrix √S·Vᵀ, and their noise
is uncorrelated and has the standard deviation σ of the samples. The contrasts are added to the means of the segments as further
observations of the generalised least-squares fit (`outputs_fit`). Drift, errors of the table and scatter between segments therefore
act on the means as in every other fit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.effects.interface import HasShape, shown_by
from planrunner.error_model.observed import Observed
from planrunner.error_model.sample_columns import ErrorsAtSamples, SampleColumns, of_stimulus, shaped
from planrunner.error_model.segment_columns import Amplitude, EffectPart, OutputErrors
from planrunner.estimators.interface import UnfitDataError
from planrunner.observation.flicker import weighted_covariance
from planrunner.observation.observations import SIGNIFICANCE, variances_differ
from planrunner.plan.units import Unit

_SLOPE = 1e-3  # of the distance to the next value of the catalogue: the step for a derivative with respect to a shape
_EDGE = 0.02  # of that distance: a shape nearer to the end of the catalogue's values counts as at its bound
_ROUNDS = 15  # of the Gauss-Newton method, for the amplitudes of a nonlinear model
_DONE = 1e-8  # relative change of χ²
_RESOLVED = 1e-12  # of the largest eigenvalue of JᵀJ, for columns of size one: smaller ones are rounding
_REWEIGHTED = 2.0  # change of a weight from which the search for the shapes is repeated
_KEPT = 12  # evaluations of the columns that are kept
_MOVED_ROUNDS = 3
_ROUNDING = 1e-9  # of the largest value of an input once per turn: a mean that is smaller is a rounding error
_BATCHES = 16  # of a segment, for the test whether its noise is white
_FEWEST_SEGMENTS = 3  # fewest segments whose contributions to a contrast can be compared
_IN_ONE = 0.8  # Σ e² from which a single segment dominates a contrast


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Describes the shape of an effect. `values`: the values that the catalogue gives for the shape, in ascending order.
    `discrete`: True if the effect allows only these values."""

    part: EffectPart
    values: Array
    discrete: bool

    @property
    def id(self) -> str:
        return self.part.effect.id

    def at(self, place: float) -> float:
        """Returns the value of the shape at the index `place` in the list of catalogue values. Indices count from 0; a fractional index
        interpolates between two values."""
        from scipy.interpolate import PchipInterpolator

        if self.discrete or len(self.values) < 3:
            return float(self.values[round(place)])
        return float(
            PchipInterpolator(np.arange(len(self.values)), self.values)(np.clip(place, 0, len(self.values) - 1))
        )

    def step(self, value: float) -> float:
        """Returns the step width for a numerical derivative with respect to the shape, at the shape `value`."""
        near = int(np.clip(np.searchsorted(self.values, value), 1, len(self.values) - 1))
        return _SLOPE * float(self.values[near] - self.values[near - 1])

    def at_bound(self, value: float) -> bool:
        first, last = self.values[[0, -1]]
        low, high = self.values[1] - first, last - self.values[-2]
        return not self.discrete and bool(value < first + _EDGE * low or value > last - _EDGE * high)


@dataclass(frozen=True, slots=True, eq=False)
class Contrasts:
    """Contains r contrasts (weighted sums of samples within segments) that contribute to a fit, in the output's unit.

    `matrix`: array of shape (r, p), design matrix of the contrasts. `values`: array of shape (r,), the contrasts. `sigma`: array of
    shape (r,), standard deviations of the contrasts. `flicker`: array of shape (r, r), a matrix F with F·Fᵀ equal to the covariance
    of the contrasts due to flicker with the bias instability B = 1. `phase`: array of shape (r, k), change of the contrasts by each
    of the k errors that an unknown angle of the table causes. `moved`: array of shape (r,), the contrasts of the model's output in
    the segments whose motion comes from the recording.
    """

    matrix: Array
    values: Array
    sigma: Array
    flicker: Array
    phase: Array
    moved: Array


@dataclass(frozen=True, slots=True, eq=False)
class WithinFit:
    """Contains the result of a fit of an output to its samples in n segments.

    `amplitudes`: the p amplitudes of the fit: first the amplitudes of the model, then the shapes that are not discrete. `matrix`:
    array of shape (n, p), design matrix of the means, SI value per SI amplitude. `mean`: array of shape (n,), the observed means.
    `offset`: array of shape (n,), the part of the means that is not fitted. `mean` and `offset` have the unit of the output. `own`:
    array of shape (n,) in SI units, the mean output of an ideal sensor. `available`: maps each effect to the names of all
    amplitudes that it has for this output. `shapes`: maps each effect to the fitted value of its shape. `at_bound`: names of
    effects whose shape is at a bound of the catalogue's values. `coloured`: ratio of the variance of batch means to the variance
    that white noise explains; 1 if the noise is white. `uneven`: the largest of the ratios that `uneven_ratios` computes for the
    contrasts; 1 if the contributions of the segments to each contrast agree. `dilution`: ratio of the variance of the residuals to
    the variance of the model's output within the segments whose motion comes from the recording; 0 without such segments.
    `moved_error`: array of shape (n,), standard error of the mean of each segment whose motion comes from the recording, computed
    from the residuals of the fit; NaN for other segments. `phase`: array of shape (n, k), change of the means, in the output's
    unit, by each of the k errors that an unknown angle of the table causes.
    """

    amplitudes: tuple[Amplitude, ...]
    matrix: Array
    mean: Array
    offset: Array
    contrasts: Contrasts
    own: Array
    available: Mapping[str, tuple[str, ...]]
    shapes: Mapping[str, float]
    moved_error: Array
    phase: Array
    at_bound: tuple[str, ...] = ()
    coloured: float = 1.0
    uneven: float = 1.0
    dilution: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SampledOutput:
    """The N samples of one output in n segments. `observed`: the stimulus at the samples, in the order of the segments. `values`:
    array of shape (N,), in the output's unit; None for a schedule. `variance`: array of shape (n,), variance of one sample in each
    segment. `error`: array of shape (n,), standard error of the mean of each segment. `gain`: True if the scale factor is among the
    amplitudes. `nominal`: nominal response, in the output's unit per SI unit of the measured quantity. `flicker`: declared bias
    instability, in the output's unit. `expected`: for each effect, the values of its parameters that the plan expects.
    """

    observed: Observed
    errors: OutputErrors
    unit: Unit
    values: Array | None
    variance: Array
    error: Array
    gain: bool
    nominal: float
    flicker: float = 0.0
    expected: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def shapes_of(model: ErrorsAtSamples) -> tuple[Shape, ...]:
    """Returns the shapes in a model, without the shapes of effects that cannot act in this plan."""
    found = []
    for part in model.errors.chosen:
        if shaped(part):
            values = model.grid(part)
            if len(values):
                found.append(Shape(part, values, len(values) < 3))
    return tuple(found)


def fit_within(output: SampledOutput) -> WithinFit:
    """Fits an output to its samples. Raises `UnfitDataError` if the samples do not determine a shape."""
    model = ErrorsAtSamples.of(output.observed, output.errors)
    return _Problem(output, model, shapes_of(model)).solved()


class _Problem:
    """Least squares over the samples of one output. The means of segments and the differences of the samples from these means have
    different weights."""

    def __init__(self, output: SampledOutput, model: ErrorsAtSamples, shapes: tuple[Shape, ...]):
        self.output, self.model, self.shapes = output, model, shapes
        observed = output.observed
        self.owner, self.first = observed.owner, observed.bounds[:-1]
        self.counts = np.diff(observed.bounds).astype(float)
        self.factor = output.unit.factor
        self.sigma = np.sqrt(output.variance)
        self.error = np.array(output.error)
        self._latest: tuple[Amplitude, ...] = ()
        self._kept: dict[tuple[tuple[float, ...], tuple[float, ...]], SampleColumns] = {}

    # -- the model -----------------------------------------------------------------------------------------------------

    def columns(self, values: Sequence[float], amplitudes: Array | None = None) -> SampleColumns:
        """Returns the columns of the model at the stimulus that the given amplitudes produce, or at the nominal stimulus if no
        amplitudes are given. `values`: value of each shape."""
        stimulus = {} if amplitudes is None else self._stimulus(amplitudes)
        key = (tuple(values), tuple(stimulus.values()))
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self.model.columns(self._named(values), stimulus)
        return self._kept[key]

    @cached_property
    def amplitudes(self) -> tuple[Amplitude, ...]:
        return self.columns(self.planned()).amplitudes

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Returns the indices of the amplitudes that change the stimulus."""
        return tuple(n for n, one in enumerate(self.amplitudes) if of_stimulus(one.effect))

    def _stimulus(self, amplitudes: Array) -> dict[tuple[str, str], float]:
        """Returns the amplitudes that change the stimulus, in SI units. `amplitudes`: array of shape (p,), all fitted amplitudes,
        in the output's unit per SI unit."""
        if not self.moving:
            return {}
        response = self._response(amplitudes)
        named = ((self.amplitudes[n].effect.id, self.amplitudes[n].name, n) for n in self.moving)
        return {(effect, name): float(amplitudes[n]) / response for effect, name, n in named}

    def _response(self, amplitudes: Array) -> float:
        """Returns the output per SI unit of the measured quantity, for given amplitudes."""
        along = [n for n, one in enumerate(self.amplitudes) if one.along == self.output.errors.axis]
        direct = self.output.nominal * self.factor == 1.0 or not along
        return 1 / self.factor if direct else float(amplitudes[along[0]])

    def _named(self, values: Sequence[float]) -> dict[str, float]:
        return {shape.id: value for shape, value in zip(self.shapes, values, strict=True)}

    def linear(self, values: Sequence[float], amplitudes: Array) -> Array:
        """Returns the output (N,) in its own unit, before effects on the output (such as a limit) act on it. `values`: value of
        each shape. `amplitudes`: array of shape (p,), in the output's unit per SI unit."""
        columns = self.columns(values, amplitudes)
        ideal = 0.0 if self.output.gain else columns.own / self.factor
        return np.asarray(ideal + amplitudes @ columns.rows)

    def values(self, values: Sequence[float], amplitudes: Array) -> Array:
        """Returns the output (N,) according to the model, in the unit of the output. The arguments are the same as in `linear`."""
        linear = self.linear(values, amplitudes)
        return self.model.output(linear * self.factor, self._named(values)) / self.factor

    def tangents(self, values: Sequence[float], amplitudes: Array) -> Array:
        """Returns the derivatives of the output with respect to the amplitudes, shape (p, N). The arguments are the same as in
        `linear`."""
        rows = self.columns(values, amplitudes).rows
        if self.moving:
            rows = rows.copy()
            for n in self.moving:
                step = np.zeros(len(amplitudes))
                step[n] = self._natural(n)
                sides = [self.linear(values, amplitudes + by * step) for by in (1, -1)]
                rows[n] = (sides[0] - sides[1]) / (2 * step[n])
        if self.model.bent:
            linear = self.linear(values, amplitudes)
            rows = rows * self.model.slope(linear * self.factor, self._named(values))
        return np.asarray(rows)

    def _natural(self, n: int) -> float:
        """Returns the step for a numerical derivative with respect to an amplitude that changes the stimulus."""
        return 10 * self.amplitudes[n].factor * self.output.nominal

    # -- weights -------------------------------------------------------------------------------------------------------

    def means(self, rows: Array) -> Array:
        return np.asarray(np.add.reduceat(rows, self.first, axis=-1) / self.counts)

    def centred(self, rows: Array) -> Array:
        return np.asarray(rows - self.means(rows)[..., self.owner])

    def weighted(self, rows: Array) -> Array:
        """Divides values (…, N) by their noise, so that they have the variance 1. Returns an array of shape (…, N + n): first the
        differences from the means of the n segments, then these means."""
        means = self.means(rows)
        return np.concatenate([(rows - means[..., self.owner]) / self.sigma[self.owner], means / self.error], axis=-1)

    # -- amplitudes and shapes -----------------------------------------------------------------------------------------

    def nominal(self) -> Array:
        """Returns the amplitudes of an ideal sensor, shape (p,), in the output's unit per SI unit. The amplitudes of effects have
        the values that the plan expects."""
        found = np.zeros(len(self.amplitudes))
        for place, one in enumerate(self.amplitudes):
            stated = self.output.expected.get(one.effect.id, {})
            letter = f"_{'xyz'[self.output.errors.axis]}" if one.alone else ""
            own = stated.get(f"{one.name}{letter}", 0.0) * one.factor
            found[place] = (own + (one.along == self.output.errors.axis)) * self.output.nominal
        return found

    def planned(self) -> list[float]:
        """Returns the expected shapes: the value that the plan states or, if it states none, the middle of the catalogue's
        values."""
        return [
            self.output.expected.get(shape.id, {}).get(_shape_name(shape.part), shape.at((len(shape.values) - 1) / 2))
            for shape in self.shapes
        ]

    def projected(self, values: Sequence[float], observed: Array) -> tuple[Array, Array]:
        """Returns the best amplitudes (p,) for given values of the shapes, and the weighted residuals (N + n,). `observed`: array
        of shape (N,), the samples."""
        ideal = np.zeros(len(self.amplitudes))
        if self.moving and self.output.gain:
            ideal = np.where(
                [one.along == self.output.errors.axis for one in self.amplitudes], self.output.nominal, 0.0
            )
        rows = self.tangents(values, ideal) if self.moving and not self.model.bent else self.columns(values).rows
        start = ideal + _solved(self.weighted(rows), self.weighted(observed - self.linear(values, ideal)))
        if not self.model.bent and not self.moving:
            return start, self.weighted(observed - self.linear(values, start))
        best, left = start, self.weighted(observed - self.values(values, start))
        for _ in range(_ROUNDS):
            step = _solved(self.weighted(self.tangents(values, best)), left)
            share, before = 1.0, float(left @ left)
            while share > 1e-4:
                tried = best + share * step
                after = self.weighted(observed - self.values(values, tried))
                if float(after @ after) < before:
                    break
                share /= 4
            else:
                break
            best, left = tried, after
            if before - float(left @ left) <= _DONE * before:
                break
        return best, left

    def search(self, observed: Array, start: list[float] | None) -> list[float]:
        """Searches for the shapes with the smallest χ². Returns one position for each shape, as in `Shape.at`: a position between
        two catalogue values is a fraction. `observed`: array of shape (N,), the samples. `start`: positions at which the search
        starts; if None, the catalogue values are tried first."""
        from scipy.optimize import least_squares, minimize_scalar

        def chi_squared(places: Sequence[float]) -> float:
            left = self.projected(self._at(places), observed)[1]
            return float(left @ left)

        ends = [len(shape.values) - 1 for shape in self.shapes]
        places = [end / 2 for end in ends] if start is None else list(start)
        if start is None:
            for _ in range(min(2, len(self.shapes))):
                for k, end in enumerate(ends):
                    tried = [chi_squared([*places[:k], n, *places[k + 1 :]]) for n in range(end + 1)]
                    places[k] = float(np.argmin(tried))
        free = [k for k, shape in enumerate(self.shapes) if not shape.discrete]
        if len(free) == 1:
            k = free[0]
            bounds = max(places[k] - 1, 0.0), min(places[k] + 1, float(ends[k]))
            found = minimize_scalar(
                lambda at: chi_squared([*places[:k], at, *places[k + 1 :]]),
                bounds=bounds,
                method="bounded",
                options={"xatol": 1e-4},
            )
            places[k] = float(found.x)
        elif free:

            def residuals(tried: Array) -> Array:
                made = list(places)
                for k, at in zip(free, tried, strict=True):
                    made[k] = float(at)
                return self.projected(self._at(made), observed)[1]

            low, high = np.zeros(len(free)), np.array([float(ends[k]) for k in free])
            first = np.clip([places[k] for k in free], low + 1e-3, high - 1e-3)
            made = least_squares(
                residuals, first, bounds=(low, high), diff_step=1e-4, xtol=1e-6, ftol=1e-10, max_nfev=40
            )
            for k, at in zip(free, made.x.tolist(), strict=True):
                places[k] = at
        return places

    def _at(self, places: Sequence[float]) -> list[float]:
        return [shape.at(place) for shape, place in zip(self.shapes, places, strict=True)]

    # -- the result ----------------------------------------------------------------------------------------------------

    def solved(self) -> WithinFit:
        observed = self.output.values
        if observed is None:
            values, amplitudes = self.planned(), self.nominal()
            return self._linearised(values, amplitudes, None, 1.0)
        places = self.search(observed, None)
        changed = self._reweighted(self._at(places), observed)
        if self.shapes:
            places = self.search(observed, None if changed > _REWEIGHTED else places)
            self._reweighted(self._at(places), observed)
        values = self._at(places)
        if self.output.observed.moved.any():  # the first weights came from the motion, not from the noise
            for _ in range(_MOVED_ROUNDS):
                self._reweighted(values, observed)
        amplitudes, _ = self.projected(values, observed)
        coloured = self._colour(self.centred(observed - self.values(values, amplitudes)))
        return self._linearised(values, amplitudes, observed, coloured)

    def _reweighted(self, values: Sequence[float], observed: Array) -> float:
        """Recomputes the noise of the samples and the noise of the means from the residuals of a fit. Returns the factor by which
        the ratio of these two noises changes. `values`: value of each shape. `observed`: array of shape (N,), the samples."""
        before = self.sigma / self.error
        amplitudes, _ = self.projected(values, observed)
        left = observed - self.values(values, amplitudes)
        squares = np.add.reduceat(self.centred(left) ** 2, self.first)
        freedom = np.maximum(self.counts - 1, 1.0)
        each = squares / freedom
        taken = len(amplitudes) + len(self.shapes)
        pooled = float(squares.sum() / max(freedom.sum() - taken, 1.0))
        least = 1e-24 * float(np.max(observed**2, initial=0.0)) + 1e-300
        unequal = (each > least).all() and len(each) > 1 and variances_differ(each, freedom, max(pooled, least))
        self.sigma = np.sqrt(np.maximum(each if unequal else np.full(len(each), pooled), least))
        self._of_moved(left)
        means = self.means(left)
        spare = len(means) - len(amplitudes)
        if spare > 0:
            excess = float(np.sum((means / self.error) ** 2)) / spare
            self.error = self.error * math.sqrt(max(excess, 1.0))
        ratio = self.sigma / self.error / before
        return float(max(ratio.max(), 1 / ratio.min()))

    def _of_moved(self, left: Array) -> None:
        """Computes the errors of the means from the residuals (N,), for segments whose motion comes from the recording. The
        residuals contain the noise of the channels that recorded the motion, but not the motion itself. If there are more segments
        than amplitudes, each error is computed as if the noise were white. All other errors of the means then appear in the scatter
        between segments. Otherwise, the error also includes the scatter of batch means."""
        alone = len(self.counts) <= len(self.amplitudes)
        for s in np.flatnonzero(self.output.observed.moved):
            own = left[self.output.observed.segments()[s]]
            self.error[s] = float(self.sigma[s]) / math.sqrt(len(own))
            if alone:
                length = max(len(own) // _BATCHES, 1)
                batches = own[: len(own) // length * length].reshape(-1, length).mean(axis=1)
                self.error[s] = max(self.error[s], float(batches.std(ddof=1)) / math.sqrt(len(batches)))

    def _linearised(
        self, values: Sequence[float], amplitudes: Array, observed: Array | None, coloured: float
    ) -> WithinFit:
        output = self.output
        rows: list[Array] = [self.tangents(values, amplitudes)]
        self._latest = self.columns(values, amplitudes).amplitudes
        parts, bounds = list(self._latest), []
        for k, (shape, value) in enumerate(zip(self.shapes, values, strict=True)):
            if shape.discrete:
                continue
            step = shape.step(value)
            sides = [[*values[:k], value + by, *values[k + 1 :]] for by in (step, -step)]
            above, below = (self.values(side, self._rescaled(amplitudes, side)) for side in sides)
            slope = (above - below) / (2 * step)
            if not np.abs(slope).max() > 1e-9 * np.abs(self.values(values, amplitudes)).max() / shape.values[-1]:
                raise UnfitDataError(_absent(output, shape))
            effect = shape.part.effect
            size = float(np.abs(slope).max()) * self.factor
            alone = effect.stage in ("sensor", "output")
            name, text = _shape_name(shape.part), _shape_unit(shape.part)
            parts.append(Amplitude(effect, name, True, alone, text, 1.0, None, size, value, True))
            rows.append(slope[None] / self._response(amplitudes))
            if shape.at_bound(value):
                bounds.append(shape.id)
        tangents = np.vstack(rows)
        predicted = self.values(values, amplitudes)
        at = np.concatenate([amplitudes, np.zeros(len(tangents) - len(amplitudes))])
        linear = (predicted if observed is None else observed) - predicted + at @ tangents
        offset = self.means(predicted - at @ tangents)
        columns = self.columns(values, amplitudes)
        left = linear - at @ tangents
        moved = np.where(output.observed.moved[self.owner], self.centred(predicted), 0.0)
        contrasts, uneven = self._contrasts(tangents, linear, left, moved, coloured)
        return WithinFit(
            tuple(parts),
            self.means(tangents).T,
            self.means(predicted if observed is None else observed),
            offset,
            contrasts,
            self.means(columns.own),
            columns.available,
            self._named(values),
            np.where(output.observed.moved, self.error, np.nan),
            self.means(self._once_per_turn()).T,
            tuple(bounds),
            coloured,
            uneven,
            self._dilution(moved, left),
        )

    def _dilution(self, moved: Array, left: Array) -> float:
        """Returns the largest possible relative change of the response to a recorded motion due to the noise of the channels that
        show this motion. `moved`: array of shape (N,), the model's output due to the motion, minus its mean in each segment; zero
        in other segments. `left`: array of shape (N,), residuals.

        If the regressor x has noise of the variance v, a fitted response β is too small by β·v/var(x) (W. A. Fuller, Measurement
        Error Models, 1987, section 1.1). The residuals contain β²·v and the noise of the output. Their variance divided by the
        variance of β·x is therefore an upper limit of v/var(x).
        """
        squares = float(moved @ moved)
        if not squares > 0:
            return 0.0
        rows = self.output.observed.moved[self.owner]
        return min(float(np.sum(self.centred(left)[rows] ** 2)) / squares, 1.0)

    def _rescaled(self, amplitudes: Array, values: Sequence[float]) -> Array:
        """Converts amplitudes for a changed shape, so that their values in the display unit stay the same. The conversion is needed
        because the display unit of an amplitude may depend on the shape."""
        factors = [one.factor for one in self.columns(values).amplitudes]
        return np.asarray(amplitudes * factors / np.array([one.factor for one in self._latest]))

    def _contrasts(
        self, tangents: Array, values: Array, left: Array, moved: Array, coloured: float
    ) -> tuple[Contrasts, float]:
        """Returns the contrasts (see the description of this module), and the largest of the ratios that `uneven_ratios` computes.
        `tangents`: array of shape (p, N), derivatives of the output with respect to the amplitudes. `values`: array of shape (N,),
        the samples. `left`: array of shape (N,), residuals. `moved`: array of shape (N,), as in `_dilution`. `coloured`: ratio of
        the variance of batch means to the variance that white noise explains."""
        weight = 1 / self.sigma[self.owner]
        centred = self.centred(tangents) * weight
        size = np.sqrt(np.sum(centred**2, axis=1))
        whole = np.sqrt(np.sum((tangents * weight) ** 2, axis=1))
        size = np.where(size > 1e-9 * whole, size, np.inf)
        J = centred / size[:, None]
        S, V = np.linalg.eigh(J @ J.T)
        kept = _RESOLVED * max(float(S[-1]), 1e-300) < S if np.isfinite(size).any() else np.inf < S
        S, V = S[kept], V[:, kept]
        functionals = (V / np.sqrt(S)).T @ J
        unit = float(np.sqrt(np.average(self.sigma**2, weights=self.counts)) / math.sqrt(len(self.owner)))
        flicker = np.zeros((len(S), len(S)))
        for part, own in zip(self.output.observed.segments(), self.sigma, strict=True):
            time = self.output.observed.time[part]
            if len(S) and len(time) > 1:
                step = float(np.median(np.diff(time)))
                flicker += weighted_covariance(functionals[:, part] / own, step, step * len(time))
        values_, vectors = np.linalg.eigh(flicker) if len(S) else (np.zeros(0), np.zeros((0, 0)))
        root = vectors * np.sqrt(np.maximum(values_, 0.0))
        finite = np.where(np.isfinite(size), size, 0.0)
        uneven = np.ones(len(S))
        if self.output.observed.moved.any():
            uneven = uneven_ratios(functionals, self.centred(left) * weight, self.first, coloured)
        contrasts = Contrasts(
            (np.sqrt(S)[:, None] * V.T) * finite * unit,
            functionals @ (self.centred(values) * weight) * unit,
            unit * np.sqrt(np.maximum(coloured, uneven)),
            root * unit,
            functionals @ (self.centred(self._once_per_turn()) * weight).T * unit,
            functionals @ (moved * weight) * unit,
        )
        return contrasts, float(uneven.max(initial=1.0))

    def _once_per_turn(self) -> Array:
        """Returns the error of an input that varies once per turn with an unknown phase: its k components in the output's unit,
        shape (k, N)."""
        return errors_of_phase([self._turning[part] for part in self.output.observed.segments()])

    @cached_property
    def _turning(self) -> NDArray[np.complex128]:
        """Returns the part of the input that varies once per turn with an unknown phase, in the output's unit, shape (N,). The
        result has the complex form that `errors_of_phase` expects."""
        observed = self.output.observed
        k = [channel.name for channel in observed.channels].index(self.output.errors.output)
        return np.asarray(observed.unknown_phase[self.owner, k] * self.output.nominal * np.exp(1j * observed.angle))

    def _colour(self, left: Array) -> float:
        """Returns the ratio of the variance of batch means to the variance that white noise explains; 1 if it is not significantly
        larger. An input that varies once per turn with an unknown phase is not noise, so it is first fitted to the batch means and
        removed. `left`: array of shape (N,), residuals minus the mean of the residuals in each segment."""
        from scipy.special import chdtrc

        total, freedom = 0.0, 0
        for part, own in zip(self.output.observed.segments(), self.sigma, strict=True):
            length = (part.stop - part.start) // _BATCHES
            if length < 4 or not own > 0:
                continue
            batches = left[part][: length * _BATCHES].reshape(_BATCHES, length).mean(axis=1)
            known = known_in_batches(self._turning[part], length)
            rest = batches - known @ np.linalg.lstsq(known, batches, rcond=None)[0]
            variance = own**2 / length + self.output.flicker**2 * math.log(_BATCHES) / math.pi
            total += float(np.sum(rest**2)) / variance
            freedom += _BATCHES - known.shape[1]
        return total / freedom if freedom and chdtrc(freedom, total) < SIGNIFICANCE else 1.0


def known_in_batches(turning: NDArray[np.complex128], length: int) -> Array:
    """Returns the columns (_BATCHES, k) that are fitted to the batch means of a segment: a constant, and the batch means of the two
    parts (real and imaginary) of an input that varies once per turn. A part is left out if its batch means are only rounding
    errors, which happens if each batch contains whole turns. `turning`: array of shape (n,), the input in the complex form that
    `errors_of_phase` expects. `length`: number of samples in a batch."""
    within = turning[: length * _BATCHES]
    parts = np.array([within.real, within.imag]).reshape(2, _BATCHES, length).mean(axis=2)
    least = _ROUNDING * np.max(np.abs(within))
    return np.array([np.ones(_BATCHES), *(one for one in parts if np.max(np.abs(one)) > least)]).T


def errors_of_phase(turning: Sequence[NDArray[np.complex128]]) -> Array:
    """Describes the error of an input that varies once per turn with an unknown phase. Returns an array E of shape (k, N) for which
    EᵀE contains the second moments of the error at the N samples of all segments. `turning`: one complex array for each segment;
    zero if the phase is known. The real part is the input at the samples as the fit assumes it; the imaginary part is the input a
    quarter of a turn earlier or later.

    If c is the assumed input, and s the input a quarter of a turn later, the true input is c·cos φ + s·sin φ. The phase φ is
    uniformly distributed, and independent of the phases of other segments. The error c·(cos φ − 1) + s·sin φ therefore has the mean
    −c, and its two parts have the factors cos φ − 1 and sin φ, each with the variance 1/2. The second moments over all segments are
    m·mᵀ + Σ (c·cᵀ + s·sᵀ)/2 with m = Σ c. In these sums over the segments, c and s of a segment are zero at the samples of the
    other segments.
    """
    assumed, found = np.concatenate(turning), []
    first = 0
    for own in turning:
        if own.any():
            both = np.zeros((2, len(assumed)))
            both[:, first : first + len(own)] = np.array([own.real, own.imag]) * math.sqrt(0.5)
            found.append(both)
        first += len(own)
    return np.concatenate([assumed.real[None], *found] if found else [np.zeros((0, len(assumed)))])


def uneven_ratios(functionals: Array, left: Array, first: NDArray[np.int64], coloured: float) -> Array:
    """Computes the ratio of each contrast's variance to the variance that white noise explains, shape (S,) for S contrasts. The
    ratios are estimated from the scatter of the segments' contributions to the contrasts. All ratios are 1 if white noise explains
    this scatter, that is, if the scatter of all contrasts together is not significantly larger.

    `functionals`: array of shape (S, N), orthonormal weights of the samples in each contrast. `left`: array of shape (N,),
    residuals divided by their noise. `first`: array of shape (n,), index of the first sample of each segment. `coloured`: ratio of
    the variance of batch means to the variance that white noise explains.

    Errors of the recorded motion cause such scatter, because they differ from segment to segment and do not become smaller in a
    longer segment. The ratio is R = Σ c²/(1 − Σ e²), where c is the contribution of a segment to a contrast, and e is the part of
    the squared length of the contrast that belongs to the segment. R is unbiased if the contributions have the variance R·e and the
    fit makes Σ c = 0. R is the sandwich estimator for clustered data (K.-Y. Liang, S. L. Zeger, Biometrika 73, 1986).
    """
    from scipy.special import chdtrc

    ratios = np.ones(len(functionals))
    if len(first) < _FEWEST_SEGMENTS or not len(functionals):
        return ratios
    c = np.add.reduceat(functionals * left, first, axis=1)
    e = np.add.reduceat(functionals**2, first, axis=1)
    alone = np.sum(e**2, axis=1)
    several = alone < _IN_ONE
    spare = 1 - alone[several]
    found = np.sum(c[several] ** 2, axis=1) / spare
    degrees = spare / alone[several]
    if several.any() and chdtrc(degrees.sum(), float(found @ degrees) / coloured) < SIGNIFICANCE:
        ratios[several] = np.maximum(found, 1.0)
    return ratios


def _solved(rows: Array, values: Array) -> Array:
    """Returns the least-squares coefficients (p,) of `values` (N,) for the rows (p, N). If some coefficients cannot be separated,
    the solution of smallest norm is returned."""
    size = np.sqrt(np.einsum("pn,pn->p", rows, rows))
    size = np.where(size > 0, size, 1.0)
    scaled = rows / size[:, None]
    normal = scaled @ scaled.T
    if not np.isfinite(normal).all():
        raise UnfitDataError("a value of the model is not a finite number: check the segments for missing data")
    return np.asarray(np.linalg.pinv(normal, rcond=_RESOLVED, hermitian=True) @ (scaled @ values) / size)


def _absent(output: SampledOutput, shape: Shape) -> str:
    effect = shape.part.effect
    return f"{output.errors.output} shows no {effect.id}: leave the effect out, or record segments that show it ({shown_by(effect)})"


def _shape_name(part: EffectPart) -> str:
    assert isinstance(part.effect, HasShape)
    return part.effect.shape_name


def _shape_unit(part: EffectPart) -> str:
    assert isinstance(part.effect, HasShape)
    return part.effect.shape_unit
