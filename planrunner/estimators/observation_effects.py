"""What acts on the segments' means beside the noise within them and is not the same for all: declared flicker, the table's positions.

An effect says how every observation follows r independent inputs of one stated uncertainty. So it gives both what it adds to the
covariance of the observations, by which they are weighted, and how whatever is computed from them follows it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.stated_influences import mean_stimulus
from planrunner.estimators.turned_segments import DIRECTIONS, turned
from planrunner.physics.earth import Site
from planrunner.physics.terms import ErrorModel
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.influences import Influence, InputQuantity, Inputs

Array = NDArray[np.float64]

_STEP = 1e-5  # rad, of central differences
_RESOLVED = (
    1e-12  # of the largest variance: differences of observations are taken to be known no better than a millionth
)


@dataclass(frozen=True, slots=True, eq=False)
class Effect:
    """changes: for each output that it acts on, by its place, (n, r): change of each observation per unit of each input. parts: names of
    the r inputs, as for `Influence`. within: for each output, (n,), what of the variance that is seen within the segments it makes, per
    unit² of the input."""

    quantity: InputQuantity
    changes: Mapping[int, Array]
    parts: tuple[str, ...] = ()
    within: Mapping[int, Array] = field(default_factory=dict)

    def covariance(self, one: int, other: int) -> Array | float:
        """What it adds to the covariance between the observations of two outputs, (n, n); 0.0 where it acts on one of them alone."""
        if one not in self.changes or other not in self.changes:
            return 0.0
        return np.asarray(self.quantity.standard_uncertainty**2 * (self.changes[one] @ self.changes[other].T))

    def through(self, functionals: Array, in_scatter: bool = False) -> Influence:
        """On q quantities that follow the observations by functionals, (q, m, n)."""
        moved = sum(functionals[:, output] @ change for output, change in self.changes.items())
        return Influence(self.quantity, np.asarray(moved), in_scatter, self.parts)


def functionals_of(gains: Array) -> Array:
    """Coefficients, output after output, as functionals of all observations, (m·p, m, n), from gains (m, p, n)."""
    m, p, n = gains.shape
    return np.einsum("apn,ab->apbn", gains, np.eye(m)).reshape(m * p, m, n)


def explained(effects: Sequence[Effect], output: int) -> Array | float:
    """What of the variance that is seen within the segments the effects make, (n,)."""
    shares = (one.quantity.standard_uncertainty**2 * one.within[output] for one in effects if output in one.within)
    return sum(shares, 0.0)


def mixed(spread: Array, effects: Sequence[Effect], output: int) -> Array:
    """Covariance (n, n) of an output's observations: noise of standard uncertainty `spread` (n,) and the effects."""
    covariance = np.diag(spread**2) + sum(effect.covariance(output, output) for effect in effects)
    return np.asarray(covariance + _RESOLVED * covariance.diagonal().max() * np.eye(len(spread)))


def position_effects(
    model: ErrorModel, segments: Sequence[Segment], site: Site, inputs: Inputs, coefficients: Array
) -> tuple[Effect, ...]:
    """The table's stated position uncertainty about each direction at each orientation, the same whenever that orientation is taken.

    coefficients: (m, p) of m outputs, SI columns and the outputs' units. It acts across a vector and not along it: an accelerometer that
    points up feels nothing of it, one that lies level all. Nothing where nothing is stated.
    """
    position = inputs.get("table position")
    if position is None:
        return ()
    m, n = len(coefficients), len(segments)
    names = list(dict.fromkeys(segment.orientation for segment in segments))
    place = [names.index(segment.orientation) for segment in segments]
    changes = np.zeros((m, n, len(DIRECTIONS), len(names)))
    for k, about in enumerate(DIRECTIONS.values()):
        low, high = (
            model.columns(mean_stimulus(turned(segments, about, step, axis_too=False), site))
            for step in (-_STEP, _STEP)
        )
        changes[:, np.arange(n), k, place] = ((high - low) / (2 * _STEP) @ coefficients.T).T
    parts = tuple(f"{name} about {word}" for word in DIRECTIONS for name in names)
    return (Effect(position, dict(enumerate(changes.reshape(m, n, -1))), parts),)
