"""Estimates parameters: the amplitudes and shapes of the effects that a diagnosis names, and the terms that the nominal simulation
fits. These terms can be compared with the specification of the sensor.

In array shapes, K is the number of channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import HasShape, OutsideCoefficients, Shaped, triad_of
from planrunner.error_model.effects.nominal import PARTS
from planrunner.gap.hypotheses.candidates import Candidate, Weighed, Weighing

_ALONE = (
    0.9  # share of the probability of one evaluated value from which its neighbours give the uncertainty by a parabola
)


@dataclass(frozen=True, slots=True)
class ParameterEstimate:
    effect: str
    name: str
    value: float
    unit: str
    standard_uncertainty: float


def amplitudes(
    weighing: Weighing,
    effect: str,
    weighed: Weighed,
    columns: slice = slice(None),
    walking: bool = False,
    ratios: Array | None = None,
) -> list[ParameterEstimate]:
    """Returns the posterior means and standard deviations of the amplitudes of an effect. The prior of the amplitudes has its most
    probable scale.

    `columns`: the columns that belong to this effect, if it is one of a set of effects. `walking`: True if a random walk of the
    gyros acts in addition. `ratios`: array of shape (K,), variance of the residuals of each channel, divided by the variance of the
    noise at its most probable setting (levels of flicker and random walk); None if the residuals are only noise. Amplitudes that
    are fixed at 1 are omitted, because they are not parameters.
    """
    mean, covariance = weighing.amplitudes(weighed, walking)
    if ratios is not None:
        at = weighing.likeliest_with(weighed.log_bayes, walking)
        whitened = [columns for _, columns in weighing.whitened_at(weighed, at)]
        excess = sum((r - 1) * own.T @ own for r, own in zip(ratios, whitened, strict=True))
        covariance = covariance + covariance @ excess @ covariance  # White, Econometrica 48, 1980
    spread = np.sqrt(np.diag(covariance))
    free = [k for k in range(len(mean))[columns] if k not in weighed.variant.fixed]
    listed = [(weighed.variant.columns[k], mean[k], spread[k]) for k in free]
    return [
        ParameterEstimate(
            effect,
            column.name,
            float(value * column.magnitude / column.factor),
            column.unit,
            float(sigma * column.magnitude / column.factor),
        )
        for column, value, sigma in listed
    ]


def wider(listed: Sequence[ParameterEstimate], weighed: Weighed, ratios: Array | None) -> list[ParameterEstimate]:
    """Increases the uncertainties of shape estimates if the residuals are larger than the noise. `ratios`: the same as in
    `amplitudes`. The variances of the shape are multiplied by a weighted average of `ratios`. The weight of a channel is the energy
    of the effect in this channel."""
    if ratios is None:
        return list(listed)
    energy = np.array([float((own**2).sum()) for own in weighed.by_channel])
    factor = float(np.sqrt(ratios @ energy / energy.sum()))
    return [replace(one, standard_uncertainty=one.standard_uncertainty * factor) for one in listed]


def shape(candidate: Candidate) -> list[ParameterEstimate]:
    """Returns the shape of an effect and its uncertainty. The shape and its uncertainty are computed from the evidence for all
    evaluated values of the shape. If the evidence of the first or the last value is nearly the largest, the shape may be outside
    the evaluated range. The uncertainty is then at least the largest distance between neighbouring values (relative to the shape)."""
    effect = candidate.effect
    if isinstance(effect, HasShape) and not isinstance(effect, Shaped) and candidate.best.variant.shape is not None:
        # The shape is one of a few numbers. The amplitudes are those of the best number.
        return [
            ParameterEstimate(candidate.id, effect.shape_name, candidate.best.variant.shape, effect.shape_unit, 0.0)
        ]
    values = np.array([item.variant.shape for item in candidate.variants if item.variant.shape is not None])
    if not len(values) or not isinstance(effect, Shaped):
        return []
    evidence = np.array([float(item.log_bayes[candidate.at]) for item in candidate.variants])
    order = np.argsort(values)
    values, evidence = values[order], evidence[order]
    width = np.gradient(np.log(values)) if len(values) > 1 else np.ones(1)
    weight = np.exp(evidence - evidence.max()) * width
    weight /= weight.sum()
    mean = float(weight @ values)
    spread = float(np.sqrt(weight @ (values - mean) ** 2))
    top = int(np.argmax(weight))
    if weight[top] > _ALONE and 0 < top < len(values) - 1:  # the values are further apart than the uncertainty
        near = slice(top - 1, top + 2)
        bend, slope, _ = np.polyfit(values[near] / values[top] - 1, evidence[near] - evidence[top], 2)
        mean = float(values[top] * (1 - slope / (2 * bend)))
        spread = float(values[top] / np.sqrt(-2 * bend))
    if len(values) > 1 and max(evidence[0], evidence[-1]) > evidence.max() - _NEAR:  # the shape may be beyond the grid
        spread = max(spread, mean * float(np.expm1(np.diff(np.log(values)).max())))
    return [ParameterEstimate(candidate.id, effect.shape_name, mean, effect.shape_unit, spread)]


def exact_shape(effect: Shaped, forms: Sequence[tuple[Weighed, float]]) -> list[ParameterEstimate]:
    """Returns the shape of an effect that has no amplitude. The shape is the mean of the shapes of `forms`, weighted by their
    probabilities. `forms`: the effect at several values of its shape, each with its probability."""
    values, share = np.array([form.variant.shape for form, _ in forms]), np.array([p for _, p in forms])
    mean = float(share @ values)
    spread = float(np.sqrt(share @ (values - mean) ** 2))
    return [ParameterEstimate(effect.id, effect.shape_name, mean, effect.shape_unit, spread)]


def opposite(effect: Shaped, best: Weighed) -> list[ParameterEstimate]:
    """For an effect without amplitude: if the data require the effect with the opposite sign, returns a negative shape. The
    magnitude of the shape is the fitted amplitude times the shape of the best form. A negative delay means that the table's angle
    is delayed instead of the outputs."""
    (share,), ((variance,),) = best.amplitudes
    size = float(best.variant.shape or 0.0)
    return [
        ParameterEstimate(
            effect.id, effect.shape_name, float(share) * size, effect.shape_unit, float(np.sqrt(variance)) * size
        )
    ]


def of_noise(weighing: Weighing, effect: OutsideCoefficients, beside: Weighed | None = None) -> list[ParameterEstimate]:
    """Returns the parameters of an effect on the noise: white noise density or resolution of each channel of the triad, or the
    density of the random walk. `beside`: the other effects that act. Without `beside`, the random walk would also have to explain
    the changes that these effects cause."""
    observed, name, noise = weighing.observed, effect.id, effect.outside
    gyros = observed.of_kind("gyro")
    triad = observed.of_kind(triad_of(effect))
    found = []
    if noise == "white":
        for c in triad:
            channel = observed.channels[c]
            density = float(weighing.white[c] / np.sqrt(observed.sample_rate) / channel.factor)
            uncertainty = density / float(np.sqrt(2 * weighing.white_degrees[c]))
            found.append(
                ParameterEstimate(name, f"white_{'xyz'[channel.axis]}", density, f"{channel.unit}*sqrt(s)", uncertainty)
            )
    if noise == "resolution":
        for c in triad:
            channel = observed.channels[c]
            found.append(
                ParameterEstimate(
                    name, f"count_{'xyz'[channel.axis]}", float(weighing.steps[c] / channel.factor), channel.unit, 0.0
                )
            )
    if noise == "random walk" and gyros:
        mean, spread = _density(weighing, beside)
        factor, text = observed.channels[gyros[0]].factor, observed.channels[gyros[0]].unit
        found.append(ParameterEstimate(name, "density", mean / factor, f"{text}/sqrt(s)", spread / factor))
    return found


def _density(weighing: Weighing, beside: Weighed | None) -> tuple[float, float]:
    """Returns posterior mean and standard deviation of the density of the random walk, SI/√s. The evaluated levels are often further
    apart than the uncertainty of the density. Therefore, the log evidence is interpolated between the levels by a spline of the
    logarithm of the density, and integrated over a fine grid. The standard deviation includes the spacing of the fine grid and the
    difference between the means for a cubic and a quintic spline. If the density may lie outside the evaluated levels, the standard
    deviation is at least the mean. `beside`: the same as in `of_noise`."""
    from scipy.interpolate import make_interp_spline

    settings = weighing.settings["gyro"]
    evidence = weighing.base if beside is None else weighing.base + beside.log_bayes
    log = np.where(np.isfinite(evidence), evidence + weighing.log_prior[1], -np.inf).reshape(weighing.shape).max(1)
    families: dict[tuple[float, bool], list[int]] = {}
    for index, setting in enumerate(settings):
        if setting.walk > 0 and np.isfinite(log[index]):
            families.setdefault((setting.flicker, setting.alike), []).append(index)
    walks = np.array([setting.walk for setting in settings])
    lowest, highest = np.log([walks[walks > 0].min(), walks.max()])
    fine = np.linspace(lowest, highest, _FINE)
    found = []
    for degree in (3, 5):
        total = np.full(len(fine), -np.inf)
        for own in families.values():
            at = np.log(walks[own])
            if len(own) > degree:
                inside = (fine >= at[0]) & (fine <= at[-1])
                total[inside] = np.logaddexp(total[inside], make_interp_spline(at, log[own], k=degree)(fine[inside]))
            else:
                nearest = np.abs(fine[:, None] - at).argmin(0)
                total[nearest] = np.logaddexp(total[nearest], log[own])
        weight = np.exp(total - total.max())
        weight /= weight.sum()
        mean = float(weight @ np.exp(fine))
        variance = float(weight @ (np.exp(fine) - mean) ** 2) + (mean * (fine[1] - fine[0])) ** 2 / 12
        found.append((mean, variance, bool(total[[0, -1]].max() > total.max() - _AT_THE_EDGE)))
    (cubic, _, _), (mean, variance, limit) = found
    spread = float(np.sqrt(variance + (mean - cubic) ** 2))
    return mean, max(spread, mean) if limit else spread


_FINE = 4001  # number of values of the density, over the range of the evaluated levels
_AT_THE_EDGE = 2.0
"""If the log evidence of the smallest or the largest level of the random walk is less than this value (in nats) below the largest log
evidence, the density may be outside the evaluated levels."""
_NEAR = 0.5
"""If the log evidence of the first or last value of a shape is less than this value (in nats, one standard deviation of a parabola)
below the largest log evidence, the shape may be outside the evaluated range."""
_UNDETERMINED = 1e-6
"""The plan does not determine some combinations (directions) of the parameters. If at most this fraction of a parameter lies in
such directions, the parameter counts as determined."""


def nominal_values(weighing: Weighing, nominal: tuple[str, ...]) -> list[ParameterEstimate]:
    """Estimates bias, scale factor and misalignment of every channel by weighted least squares. Terms that the data of the plan do
    not determine are omitted. The field `effect` of each estimate contains the name of the term, such as `accel_bias`. Effects that
    are missing from the simulation influence these estimates."""
    terms = [
        f"{kind}_{part}"
        for kind in ("gyro", "accel")
        for part, make in PARTS.items()
        if f"{kind}_{part}" in nominal
        for _ in make(weighing.observed, kind)
    ]
    found = []
    for index, design in enumerate(weighing.whole):
        own = [place for place, column in enumerate(weighing.nominal_columns) if index in column.parts]
        if not own:
            continue
        weight = weighing.weights[index][0]
        columns = weight.whiten(np.hstack([design, weighing.angles[index]]))
        size = np.linalg.norm(columns, axis=0) + 1e-300
        left, values, right = np.linalg.svd(columns / size, full_matrices=False)
        told = values > 1e-8 * values.max(initial=0.0)
        inverse = right[told].T / values[told]
        fit = inverse @ (left[:, told].T @ weight.whiten(weighing.spectrum.values[:, [index]])[:, 0])
        spread, known = np.sqrt((inverse**2).sum(1)), (right[told] ** 2).sum(0)
        for k, place in enumerate(own):
            column = weighing.nominal_columns[place]
            if known[k] > 1 - _UNDETERMINED:
                scale = column.magnitude / column.factor / size[k]
                found.append(
                    ParameterEstimate(
                        terms[place], column.name, float(fit[k] * scale), column.unit, float(spread[k] * scale)
                    )
                )
    return found
