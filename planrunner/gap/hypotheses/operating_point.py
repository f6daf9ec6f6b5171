"""Computes how an effect on the output of the sensor changes with the nominal parameters, such as bias and scale factors.

A dead zone or a limit acts on the output. Its size therefore depends on the bias and the scale factors of the sensor. To first
order in the nominal parameters θ, the effect is e(θ) = e(θ₀) + E·(θ − θ₀). Here, θ₀ is the operating point: the nominal parameters
at which the form of the effect was computed. Each column of E is the change of the effect per change of one parameter, a central
difference. The step of these differences is one standard uncertainty of each parameter, because the exact derivative of a dead zone
is infinite at its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import ChangesWithinSegments, Column, Effect, Shaped
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.weighing import coefficients_of
from planrunner.gap.hypotheses.candidates import Weighing

_WIDTHS = (30.0, 10.0, 3.0, 1.0)
"""Steps of the differences that replace derivatives in the first iterations, in standard uncertainties of the output."""
_ROUNDS = 9  # iterations of Gauss–Newton
_ROUNDING = 1e-6
"""If the output changes by less than this fraction of a change of the nominal output, it counts as constant. Smaller changes are
rounding errors, which must not count as information about the parameters."""
_STILL = 0.1  # standard deviations of the noise by which the effect may still change


@dataclass(frozen=True)
class OperatingPoint:
    """Contains the nominal parameters at which an effect on the output is linearised, and its change with these parameters. Each
    attribute has one array per channel. `values`: shape (q,), the nominal parameters θ₀ in units of their magnitudes. `nominal`:
    shape (M, q), the columns of the nominal parameters. `change`: shape (M, q), the change of the effect per magnitude of each
    parameter (E in the description of the module, multiplied by the amplitude of the effect); zero if the effect does not act on
    the channel."""

    values: tuple[Array, ...]
    nominal: tuple[Array, ...] = field(repr=False)
    change: tuple[Array, ...] = field(repr=False)


def on_output(effect: Effect) -> Shaped | None:
    """Returns the effect if it acts on the output and is fully determined by its shape; otherwise None."""
    acts = isinstance(effect, ChangesWithinSegments) and effect.acts_on == "output"
    return effect if acts and isinstance(effect, Shaped) else None


def operating_point(
    weighing: Weighing,
    effect: Shaped,
    shape: float,
    taken: Sequence[Array] | None = None,
    amplitude: float = 1.0,
) -> OperatingPoint:
    """Computes how an effect on the output changes with the nominal parameters.

    `shape`, `amplitude`: shape and amplitude of the effect. `taken`: for each channel, the coefficients (M,) that the effect
    causes, or None. If `taken` is given, the nominal parameters are fitted together with the effect; otherwise, they are fitted
    without the effect.
    """
    values = weighing.nominal_values(taken)
    if taken is not None:
        values = settled(weighing, effect, shape, values, amplitude)
    change = _changes(weighing, effect, shape, weighing.seen(values), amplitude, _steps(weighing))
    return OperatingPoint(tuple(values), tuple(weighing.whole), tuple(change))


def moving(
    weighing: Weighing, effect: Shaped, shape: float, values: Sequence[Array], columns: Sequence[Column]
) -> Weighing:
    """Returns a copy of `weighing` that takes account, to the first order, of how an effect on the output changes with the nominal
    parameters. The shape of the effect is then searched together with the parameters and with the amplitudes of other effects.
    `values`: values of the parameters of each channel. `columns`: columns of the other effects, with samples."""
    seen = weighing.seen(values)
    change = _changes(weighing, effect, shape, seen, 1.0, _steps(weighing))
    return weighing.moving(change, values, passed_on(weighing, effect, shape, seen, columns) if columns else None)


def settled(
    weighing: Weighing, effect: Shaped, shape: float, values: Sequence[Array], amplitude: float = 1.0
) -> list[Array]:
    """Fits the nominal parameters together with an effect on the output. Returns the values of the parameters of each channel.

    `values`: values of the nominal parameters at which the fit starts. Repeated fits to the data minus the effect would converge
    slowly: in segments with a limited output, these data follow the scale factor of the preceding fit. Therefore, the fit includes
    the change of the effect with the parameters (Gauss–Newton). The first derivatives are differences over wide steps: within a
    dead zone, the output is zero, and the exact derivative would not show how to leave the dead zone.
    """
    found, steps, change = list(values), _steps(weighing), list[Array]()
    for number in range(_ROUNDS):
        seen = weighing.seen(found)
        if number < len(_WIDTHS):
            change = _changes(weighing, effect, shape, seen, amplitude, _WIDTHS[number] * steps)
        caused = coefficients_of(weighing.observed, weighing.spectrum, effect.at(seen, shape).columns)
        fixed = [raw.sum(axis=1) * amplitude - own @ at for raw, own, at in zip(caused, change, found, strict=True)]
        before, found = found, weighing.nominal_values(fixed, change)
        moved = [
            own[0].whiten(whole @ (new - old)[:, None])
            for own, whole, new, old in zip(weighing.weights, weighing.whole, found, before, strict=True)
        ]
        if number >= len(_WIDTHS) - 1 and max(float((part**2).sum()) for part in moved) < _STILL**2:
            break
    return found


def _changes(
    weighing: Weighing, effect: Shaped, shape: float, seen: Observed, amplitude: float, step: Array
) -> list[Array]:
    """Returns, for each channel, the change (M, q) of the effect per magnitude of each nominal parameter. An effect on the output
    is a function of the nominal output alone, so its derivative follows from the chain rule: it is the derivative of the effect
    with respect to the nominal output, multiplied by the derivative of the nominal output with respect to the parameter. The other
    arguments are those of `_slopes`."""
    change = [np.zeros_like(whole) for whole in weighing.whole]
    for channel, slope in _slopes(effect, shape, seen, step).items():
        samples = slope[:, None] * weighing.samples_of(channel)
        change[channel] = weighing.spectrum.project(weighing.observed, samples) * amplitude
    return change


def _slopes(effect: Shaped, shape: float, seen: Observed, step: Array) -> dict[int, Array]:
    """Returns the derivative (N,) of the effect with respect to the nominal output, for each channel in which it is not zero. `seen`:
    the recording with the nominal output. `step`: array of shape (N, K), step of the nominal output over which the effect is
    differentiated."""
    output, found = seen.nominal_output, dict[int, Array]()
    (more,), (less,) = (effect.at(replace(seen, fitted=output + sign * step), shape).columns for sign in (1.0, -1.0))
    for channel in sorted(more.parts.keys() & less.parts.keys()):
        rise, run = more.parts[channel] - less.parts[channel], 2 * step[:, channel]
        slope = np.divide(rise, run, out=np.zeros(len(run)), where=run > 0)
        slope[np.abs(1 + slope) < _ROUNDING] = -1.0
        if slope.any():
            found[channel] = slope
    return found


def passed_on(
    weighing: Weighing, effect: Shaped, shape: float, seen: Observed, columns: Sequence[Column]
) -> list[Array]:
    """Computes how other effects appear after an effect on the output. For example, they do not appear while the output is at a
    limit. Returns, for each channel, the coefficients (M, P) of `columns`, multiplied by the derivative of the output with respect
    to its nominal value. `seen`: the recording with the nominal output, which contains the other effects."""
    slopes = _slopes(effect, shape, seen, _steps(weighing))
    passed = [
        replace(
            column,
            parts={c: part * (1 + slopes[c]) if c in slopes else part for c, part in column.parts.items()},
        )
        for column in columns
    ]
    return coefficients_of(weighing.observed, weighing.spectrum, passed)


def _steps(weighing: Weighing) -> Array:
    """Returns the standard uncertainty (N, K) of each nominal output. It follows from the standard uncertainties of the nominal
    parameters."""
    channels = range(len(weighing.whole))
    return np.column_stack(
        [np.sqrt(weighing.samples_of(channel) ** 2 @ _uncertainty(weighing, channel) ** 2) for channel in channels]
    )


def _uncertainty(weighing: Weighing, channel: int) -> Array:
    """Returns the standard uncertainties (q,) of the nominal parameters of a channel, in units of their magnitudes. The uncertainty
    of each parameter is computed with the other parameters fixed; it is 0 for a parameter that the recording does not determine."""
    energy = (weighing.weights[channel][0].whiten(weighing.whole[channel]) ** 2).sum(axis=0)
    return np.where(energy > 0, 1 / np.sqrt(np.maximum(energy, 1e-300)), 0.0)
