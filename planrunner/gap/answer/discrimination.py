"""The log evidence between rival explanations that further measurements are expected to give, computed before they are made.

Every rival is a linear model that consists of the nominal parameters and of effects with normally distributed amplitudes. The
posterior from the recording is the prior for the next measurements. If A is true, the expected log evidence of A against B is
therefore the Kullback-Leibler divergence of the two predictions. This is the criterion of Box and Hill (Technometrics 9, 1967):
T-optimality (Atkinson and Fedorov, Biometrika 62, 1975), averaged over the uncertainty of the amplitudes. New measurements enter
only through their information matrix, so the cost does not depend on the number of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array

_FLAT = 1e-9  # precision of an unknown parameter, relative to its information from the recording
_AT_ONCE = 4_000_000  # numbers in the matrices that are evaluated at a time; limits memory
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(21)


@dataclass(frozen=True)
class Rival:
    """A rival explanation after a recording. `columns`: array of shape (p,), indices of the rival's columns among all columns; mean
    (p,) and precision (p, p): posterior of the amplitudes of these columns."""

    name: str
    probability: float
    columns: NDArray[np.int64] = field(repr=False)
    mean: Array = field(repr=False)
    precision: Array = field(repr=False)

    @classmethod
    def learnt(
        cls, name: str, probability: float, columns: NDArray[np.int64], prior: Array, information: Array, score: Array
    ) -> Rival:
        """The rival with the posterior of its amplitudes after a recording. `prior`: array of shape (p,), precision of the
        amplitudes about zero before the recording, 0 for a nominal parameter. information (P, P) and score (P,): information matrix
        and score vector of the recording for all columns of all rivals, in units of the noise."""
        own = information[np.ix_(columns, columns)]
        precision = own + np.diag(prior + _FLAT * np.maximum(np.diag(own), 1.0))
        mean = np.asarray(np.linalg.solve(precision, score[columns]))
        return cls(name, probability, columns, mean, precision)


def expected_evidence(rivals: Sequence[Rival], information: Array) -> Array:
    """The expected log evidence (…, R, R) for rival i against rival j from measurements with the given information (…, P, P), if i
    is true."""
    size = information.shape[-1]
    covariance = [np.linalg.inv(rival.precision) for rival in rivals]
    found = np.zeros((*information.shape[:-2], len(rivals), len(rivals)))
    gained, left, spent = [], [], []
    for rival in rivals:
        own = rival.columns
        across = information[..., own, :]
        after = rival.precision + across[..., own]
        solved = np.linalg.solve(after, across)
        gained.append(np.linalg.slogdet(after)[1] - np.linalg.slogdet(rival.precision)[1])
        left.append(information - np.swapaxes(across, -1, -2) @ solved)
        spent.append(np.trace(solved[..., own], axis1=-2, axis2=-1))
    for i, a in enumerate(rivals):
        for j, b in enumerate(rivals):
            if i == j:
                continue
            apart = np.zeros(size)
            apart[a.columns] += a.mean
            apart[b.columns] -= b.mean
            rows, columns = np.ix_(a.columns, a.columns)
            unsure = np.sum(left[j][..., rows, columns] * covariance[i], axis=(-2, -1))
            found[..., i, j] = 0.5 * (left[j] @ apart @ apart + unsure - spent[j] + gained[j] - gained[i])
    return np.maximum(found, 0.0)


def expected_loss(rivals: Sequence[Rival], information: Array) -> Array:
    """The expected loss (…) after measurements with the given information (…, P, P): the expectation of −log of the probability of the
    true rival. The best measurements have the smallest loss."""
    many = information.reshape(-1, *information.shape[-2:])
    at_once = max(1, _AT_ONCE // (len(rivals) * many[0].size)) if len(many) else 1
    parts = [
        _averaged(rivals, expected_evidence(rivals, many[first : first + at_once]), np.log1p)
        for first in range(0, len(many), at_once)
    ]
    return np.concatenate([*parts, np.zeros(0)]).reshape(information.shape[:-2])


def expected_probability(rivals: Sequence[Rival], information: Array) -> float:
    """Expected posterior probability of the true rival after measurements with the given information (P, P).

    The log evidence is assumed to be normal with the expectation D of `expected_evidence` and the variance 2D, as for two known signals.
    """
    return float(_averaged(rivals, expected_evidence(rivals, information), lambda odds: 1 / (1 + odds)))


def _averaged(rivals: Sequence[Rival], evidence: Array, measure: Callable[[Array], Array]) -> Array:
    """Averages a measure of the posterior odds against the true rival over the rivals and over the random log evidence. `evidence`:
    array of shape (…, R, R); the result has the shape (…). `measure`: function of the odds."""
    share = np.array([rival.probability for rival in rivals])
    share = share / share.sum()
    total = np.zeros(evidence.shape[:-2])
    for i in range(len(rivals)):
        others = np.arange(len(rivals)) != i
        d = evidence[..., i, others][..., None]
        log = np.clip(d + np.sqrt(2 * d) * _NODES, -700.0, 700.0)
        odds = (share[others, None] / share[i] * np.exp(-log)).sum(-2)
        total += share[i] * (measure(odds) @ _WEIGHTS) / _WEIGHTS.sum()
    return total
