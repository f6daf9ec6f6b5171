"""Describes errors that correlate the means of different segments: declared flicker, and errors of the table.

A correlated error describes how every observation depends on r independent inputs. All r inputs have the same stated uncertainty.
The contribution of the error to the covariance of the observations is computed from this description. This covariance determines
the weights of the observations. The module also computes the sensitivities of the results to the inputs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.uncertainty.influences import Influence, InputQuantity

_RESOLVED = 1e-12  # of the largest variance: differences of observations are known to a millionth at best


@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedError:
    """An error that changes several observations together.

    `changes`: maps the index of each affected output to an array of shape (n, r), the changes of the n observations per unit of
    each of the r inputs. `parts`: names of the r inputs, as in `Influence`. `within`: maps the index of an output to an array of
    shape (n,), the contribution of the error to the variance within the segments, per squared unit of the input. `channel`: if the
    error is the noise of a channel, the name of this channel; otherwise empty.
    """

    quantity: InputQuantity
    changes: Mapping[int, Array]
    parts: tuple[str, ...] = ()
    within: Mapping[int, Array] = field(default_factory=dict)
    channel: str = ""

    def covariance(self, one: int, other: int) -> Array | float:
        """Returns the contribution of the error to the covariance between the observations of two outputs, shape (n, n). The result
        is 0.0 if the error does not act on both outputs. `one`, `other`: indices of the outputs."""
        if one not in self.changes or other not in self.changes:
            return 0.0
        return np.asarray(self.quantity.standard_uncertainty**2 * (self.changes[one] @ self.changes[other].T))

    def through(self, functionals: Array, in_scatter: bool = False) -> Influence:
        """Computes how the error influences q quantities, which depend linearly on the observations. `functionals`: array of shape
        (q, m, n), the derivative of each quantity with respect to each of the n observations of each of the m outputs.
        `in_scatter`: True if the scatter of the data already contains the effect of the error."""
        moved = sum(functionals[:, output] @ change for output, change in self.changes.items())
        return Influence(self.quantity, np.asarray(moved), in_scatter, self.parts)


def functionals_of(gains: Array) -> Array:
    """Converts the gains (m, p, n) of m outputs with p coefficients each to linear functions (m·p, m, n) of the observations of all
    outputs. The functions are grouped by output."""
    m, p, n = gains.shape
    stacked: Array = np.einsum("apn,ab->apbn", gains, np.eye(m)).reshape(m * p, m, n)
    return stacked


def explained(effects: Sequence[CorrelatedError], output: int) -> Array | float:
    """Returns the contribution of correlated errors to the variance of an output within the segments, shape (n,). `output`: index
    of the output."""
    shares = (one.quantity.standard_uncertainty**2 * one.within[output] for one in effects if output in one.within)
    return sum(shares, 0.0)


def stacked_roots(effects: Sequence[CorrelatedError], outputs: int, n: int) -> Array:
    """Computes how the n observations of each output change if an input changes by one standard uncertainty, for each of r inputs.
    Returns an array of shape (outputs, n, r); 0 for an error that does not act on an output. If L₁ and L₂ are the changes of two
    outputs, L₁·L₂ᵀ is the contribution of the errors to the covariance between their observations."""
    roots = []
    for effect in effects:
        columns = next(iter(effect.changes.values())).shape[1]
        root = np.zeros((outputs, n, columns))
        for output, change in effect.changes.items():
            root[output] = effect.quantity.standard_uncertainty * change
        roots.append(root)
    return np.concatenate(roots, axis=2) if roots else np.zeros((outputs, n, 0))


def mixed(spread: Array, roots: Array) -> Array:
    """Returns the covariance of the n observations of each output, shape (…, n, n): the sum of the covariances of noise and of
    correlated errors. `spread`: array of shape (…, n), standard uncertainty of the noise. `roots`: array of shape (…, n, r) from
    `stacked_roots`."""
    covariance = np.asarray(roots @ roots.swapaxes(-1, -2))
    i = np.arange(spread.shape[-1])
    variances = covariance[..., i, i] + spread**2
    covariance[..., i, i] = variances + _RESOLVED * variances.max(axis=-1, keepdims=True)
    return covariance
