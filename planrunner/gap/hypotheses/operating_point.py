"""Computes how an effect on the output of the sensor changes with the nominal parameters.

A dead zone or a limit acts on the output. Its size therefore depends on the bias and the scale factors of the sensor. To first
order in the nominal parameters θ, the effect is e(θ) = e(θ₀) + E·(θ − θ₀). The nominal parameters θ₀ are those at which the form of
the effect was computed. The columns of E are central differences. The step of these differences is one standard uncertainty of each
parameter, because the exact derivative of a dead zone is infinite at its edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import ChangesWithinSegments, Effect, Shaped
from planrunner.error_model.observed import Observed
from planrunner.gap.evidence.weighing import coefficients_of
from planrunner.gap.hypotheses.candidates import Weighing

_STEPS = 6  # of Gauss–Newton
_STILL = 0.1  # standard deviations of the noise by which the effect may still change


@dataclass(frozen=True)
class OperatingPoint:
    """Contains the nominal parameters about which an effect on the output is linear. Each attribute has one array per channel.
    `values`: shape (q,), the nominal parameters θ₀ in units of their magnitudes. `nominal`: shape (M, q), the columns of the
    nominal parameters. `change`: shape (M, q), the columns of E, multiplied by the amplitude of the effect; zero if the effect does
    not act on the channel."""

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

    `shape`, `amplitude`: shape and amplitude of the effect. `taken`: for each channel, the part (M,) of the coefficients that the
    effect explains if it is fitted together with the nominal parameters; None if these are fitted without the effect.
    """
    values, seen = weighing.nominal_values(taken), weighing.seen(taken)
    steps = [_uncertainty(weighing, channel) for channel in range(len(values))]
    change = [np.zeros_like(columns) for columns in weighing.whole]
    for j in range(max(map(len, values))):
        more, less = (
            coefficients_of(
                seen, weighing.spectrum, effect.at(replace(seen, fitted=weighing.output_at(moved)), shape).columns
            )
            for moved in (_moved(values, steps, j, sign) for sign in (1.0, -1.0))
        )
        for channel, step in enumerate(steps):
            if j < len(step) and step[j] > 0:
                difference = (more[channel] - less[channel]).sum(axis=1)
                change[channel][:, j] = difference * (amplitude / (2 * step[j]))
    return OperatingPoint(tuple(values), tuple(weighing.whole), tuple(change))


def settled(weighing: Weighing, effect: Shaped, shape: float, taken: Sequence[Array]) -> Observed:
    """Fits the nominal parameters together with an effect on the output, and returns the recording with the fitted output
    (`Weighing.seen`).

    `taken`: for each channel, the coefficients (M,) that the effect causes at the nominal parameters of the preceding fit. A fit to
    the data minus `taken` would converge slowly: in segments with a limited output, it would keep the scale factor of the preceding
    fit. Therefore, the fit includes the change of the effect with the parameters (Gauss–Newton).
    """
    for _ in range(_STEPS):
        point = operating_point(weighing, effect, shape, taken)
        seen = weighing.seen(taken)
        caused = [raw.sum(axis=1) for raw in coefficients_of(seen, weighing.spectrum, effect.at(seen, shape).columns)]
        fixed = [own - change @ at for own, change, at in zip(caused, point.change, point.values, strict=True)]
        fitted = weighing.nominal_values(fixed, point.change)
        before = taken
        taken = [own + change @ values for own, change, values in zip(fixed, point.change, fitted, strict=True)]
        away = [
            (new - old) / weighing.white[channel] for channel, (new, old) in enumerate(zip(taken, before, strict=True))
        ]
        if max(float(part @ part) for part in away) < _STILL**2:
            break
    return weighing.seen(taken)


def _moved(values: Sequence[Array], steps: Sequence[Array], j: int, sign: float) -> list[Array]:
    """Returns the nominal parameters of all channels after parameter number j of each channel has been changed by its step."""
    return [own + sign * np.where(np.arange(len(own)) == j, step, 0.0) for own, step in zip(values, steps, strict=True)]


def _uncertainty(weighing: Weighing, channel: int) -> Array:
    """Returns the standard uncertainties (q,) of the nominal parameters of a channel, in units of their magnitudes. The uncertainty
    of each parameter is computed with the other parameters fixed; it is 0 for a parameter that the recording does not determine."""
    energy = (weighing.weights[channel][0].whiten(weighing.whole[channel]) ** 2).sum(axis=0)
    return np.where(energy > 0, 1 / np.sqrt(np.maximum(energy, 1e-300)), 0.0)
