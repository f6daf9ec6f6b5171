"""Drift of the zero between the readings before and after the rates, as far as the included effects do not explain it.

The type A uncertainty includes the noise of the zeros. With declared flicker it also includes the flicker, of which the drift of a
series is one sample. A drift is added separately only if both together do not explain it. Otherwise every interval would include the
same noise twice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array
from planrunner.estimators.tilted.evaluation import Group
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.observations import SIGNIFICANCE


def half_drift(groups: Sequence[Group], axis: int, sigma: Array, shared: bool) -> float:
    """Half of the drift of an axis's zero, in root mean square over temperatures and repeats, without the contribution of its noise.

    sigma: (N,), standard uncertainty of each segment's mean. shared: only the part common to all repeats, including noise.
    """
    drifts = [group.drift[:, axis] for group in groups]
    if shared:
        return math.sqrt(np.mean([one.mean() ** 2 for one in drifts])) / 2
    own = [group.between**2 @ sigma**2 for group in groups]
    squares = [np.mean(drift**2 - noise) for drift, noise in zip(drifts, own, strict=True)]
    return math.sqrt(max(0.0, float(np.mean(squares)))) / 2


def moved_further(groups: Sequence[Group], sigma: Array, flicker: Sequence[CorrelatedError]) -> set[int]:
    """Axes whose zeros drifted more than noise and declared flicker explain, by the χ² test of all drifts at 1 %.

    sigma: (N, m), standard uncertainty of each segment's mean from noise; without noise and flicker, any drift is too large.
    """
    from scipy.special import chdtrc

    weights = np.vstack([group.between for group in groups])
    found = set()
    for axis in range(sigma.shape[1]):
        drift = np.concatenate([group.drift[:, axis] for group in groups])
        slow = [effect.covariance(axis, axis) for effect in flicker if axis in effect.changes]
        covariance = np.diag(sigma[:, axis] ** 2) + sum(slow)
        squares = float(drift @ np.linalg.pinv(weights @ covariance @ weights.T, hermitian=True) @ drift)
        if drift.any() and (not covariance.any() or chdtrc(len(drift), squares) < SIGNIFICANCE):
            found.add(axis)
    return found


def moved_alike(groups: Sequence[Group]) -> set[int]:
    """Axes whose zeros drifted in the same way in all repeats, by more than the scatter between repeats explains. An F test at 1 %
    compares the mean drifts at the temperatures with that scatter. Every group has at least two repeats."""
    from scipy.special import fdtrc

    freedom = sum(len(group.drift) - 1 for group in groups)
    scatter = sum(((group.drift - group.drift.mean(axis=0)) ** 2).sum(axis=0) for group in groups) / freedom
    means = sum(len(group.drift) * group.drift.mean(axis=0) ** 2 for group in groups) / len(groups)
    ratio = np.divide(means, scatter, out=np.where(means > 0, np.inf, 0.0), where=scatter > 0)
    return {int(axis) for axis in np.flatnonzero(fdtrc(len(groups), freedom, ratio) < SIGNIFICANCE)}
