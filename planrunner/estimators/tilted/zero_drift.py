"""How far the zero moved from before the rates to after them, and what of that is not accounted for otherwise.

The zeros have noise, which the data's part of an uncertainty holds. Where flicker is declared, a drift of the zeros is that flicker, seen
once in each series; it counts by itself only where it is larger than noise and flicker make it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.observation_effects import Effect
from planrunner.estimators.observations import SIGNIFICANCE
from planrunner.estimators.tilted.evaluation import Group

Array = NDArray[np.float64]


def half_drift(groups: Sequence[Group], axis: int, sigma: Array, shared: bool) -> float:
    """Half of the drift of an axis's zero, in root mean square over temperatures and repeats, without what its noise makes of it.

    sigma: (N,), standard uncertainty of each segment's mean. shared: only the part that all repeats share, noise and all.
    """
    drifts = [group.drift[:, axis] for group in groups]
    if shared:
        return math.sqrt(np.mean([one.mean() ** 2 for one in drifts])) / 2
    own = [group.between**2 @ sigma**2 for group in groups]
    squares = [np.mean(drift**2 - noise) for drift, noise in zip(drifts, own, strict=True)]
    return math.sqrt(max(0.0, float(np.mean(squares)))) / 2


def moved_further(groups: Sequence[Group], sigma: Array, flicker: Sequence[Effect]) -> set[int]:
    """Axes with declared flicker whose zeros moved further than noise and flicker let them: χ² of all drifts, at 1 %.

    sigma: (N, m), standard uncertainty of each segment's mean from noise.
    """
    if not flicker:
        return set()
    from scipy.special import chdtrc

    weights = np.vstack([group.between for group in groups])
    found = set()
    for axis in {axis for effect in flicker for axis in effect.changes}:
        drift = np.concatenate([group.drift[:, axis] for group in groups])
        covariance = np.diag(sigma[:, axis] ** 2) + sum(effect.covariance(axis, axis) for effect in flicker)
        squares = float(drift @ np.linalg.pinv(weights @ covariance @ weights.T, hermitian=True) @ drift)
        if chdtrc(len(drift), squares) < SIGNIFICANCE:
            found.add(axis)
    return found
