"""Determines whether a record has a steady drift that its noise does not explain, and how large this drift is.

The means of the two halves of a run differ by the drift during half the run, and by noise. The variance of this noise is twice the
Allan variance at an averaging time of half the run. This Allan variance is computed from a fit to Hadamard variances, because a
steady drift does not change them. The variance is uncertain, mainly because the random walk is poorly known. The test therefore
uses an upper bound of the variance, which is two standard uncertainties above the estimate.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.estimators.allan.fit import NoiseFit, model_matrix
from planrunner.estimators.allan.phase import Phase

_CHANCE = 1e-3  # probability of differences at least this large by noise alone


@dataclass(frozen=True, slots=True)
class SteadyDrift:
    """The steady drift of a record. `slope`: the drift in the output's unit per second (weighted mean over the runs), with its
    standard uncertainty. The uncertainty is computed for noise that is one standard uncertainty larger than estimated.
    `probability`: probability that noise alone causes differences of this size between the halves of the runs."""

    slope: float
    standard_uncertainty: float
    probability: float

    @property
    def present(self) -> bool:
        return self.probability < _CHANCE


def steady_drift(phase: Phase, fit: NoiseFit) -> SteadyDrift:
    """Estimates the steady drift of a record. `fit`: a fit of the noise model to the Hadamard variances of the same record."""
    from scipy.special import chdtrc

    halves = np.array([(run.size - 1) // 2 for run in phase.runs], dtype=np.int64)
    steps = np.array(
        [(run[2 * m] - 2 * run[m] + run[0]) / m for run, m in zip(phase.runs, halves.tolist(), strict=True)]
    )
    rows = model_matrix(halves)
    found = rows @ np.maximum(fit.squares, 0.0)
    unsure = np.sqrt(np.einsum("ri,ij,rj->r", rows, fit.covariance, rows))
    variances = 2 * (found + unsure)
    ratios = steps**2 / (2 * (found + 2 * unsure))
    spans = halves * phase.interval
    information = float(np.sum(spans**2 / variances))
    return SteadyDrift(
        float(np.sum(spans * steps / variances)) / information,
        1 / math.sqrt(information),
        float(chdtrc(len(steps), np.sum(ratios))),
    )
