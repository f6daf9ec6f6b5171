"""Errors of the segments' means that are correlated between segments: declared flicker, and errors of the table.

A correlated error states how every observation follows r independent inputs that share one stated uncertainty. This determines two
things: the contribution to the covariance of the observations, by which they are weighted, and the sensitivity of each result to
the inputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.uncertainty.influences import Influence, InputQuantity

_RESOLVED = (
    1e-12  # of the largest variance: differences of observations are taken to be known no better than a millionth
)


@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedError:
    """A correlated error. changes: maps the index of each affected output to (n, r), the change of each observation per unit of
    each input. parts: names of the r inputs, as for `Influence`. within: maps the index of an output to (n,), the contribution of
    the error to the variance within the segments, per unit² of the input. channel: the channel whose noise the error is; empty for
    errors that are not noise."""

    quantity: InputQuantity
    changes: Mapping[int, Array]
    parts: tuple[str, ...] = ()
    within: Mapping[int, Array] = field(default_factory=dict)
    channel: str = ""

    def covariance(self, one: int, other: int) -> Array | float:
        """Contribution to the covariance between the observations of two outputs, (n, n); 0.0 unless the error acts on both."""
        if one not in self.changes or other not in self.changes:
            return 0.0
        return np.asarray(self.quantity.standard_uncertainty**2 * (self.changes[one] @ self.changes[other].T))

    def through(self, functionals: Array, in_scatter: bool = False) -> Influence:
        """Influence on q quantities that are linear functions of the observations, given by functionals (q, m, n)."""
        moved = sum(functionals[:, output] @ change for output, change in self.changes.items())
        return Influence(self.quantity, np.asarray(moved), in_scatter, self.parts)


def functionals_of(gains: Array) -> Array:
    """Coefficients, output after output, as functionals of all observations, (m·p, m, n), from gains (m, p, n)."""
    m, p, n = gains.shape
    stacked: Array = np.einsum("apn,ab->apbn", gains, np.eye(m)).reshape(m * p, m, n)
    return stacked


def explained(effects: Sequence[CorrelatedError], output: int) -> Array | float:
    """Contribution of correlated errors to the variance within the segments, (n,)."""
    shares = (one.quantity.standard_uncertainty**2 * one.within[output] for one in effects if output in one.within)
    return sum(shares, 0.0)


def stacked_roots(effects: Sequence[CorrelatedError], outputs: int, n: int) -> Array:
    """Changes of the n observations of each output per standard uncertainty of every input, (outputs, n, r); 0 for an effect that
    does not act on the output. If L₁ and L₂ belong to two outputs, L₁·L₂ᵀ is the contribution of the effects to the covariance
    between their observations."""
    roots = []
    for effect in effects:
        columns = next(iter(effect.changes.values())).shape[1]
        root = np.zeros((outputs, n, columns))
        for output, change in effect.changes.items():
            root[output] = effect.quantity.standard_uncertainty * change
        roots.append(root)
    return np.concatenate(roots, axis=2) if roots else np.zeros((outputs, n, 0))


def mixed(spread: Array, roots: Array) -> Array:
    """Covariance (…, n, n) of the observations of outputs: noise of standard uncertainty `spread` (…, n), and the contribution of
    the effects, from `roots` (…, n, r)."""
    covariance = np.asarray(roots @ roots.swapaxes(-1, -2))
    i = np.arange(spread.shape[-1])
    variances = covariance[..., i, i] + spread**2
    covariance[..., i, i] = variances + _RESOLVED * variances.max(axis=-1, keepdims=True)
    return covariance
