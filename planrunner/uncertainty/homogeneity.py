"""Tests whether repeated values agree within their stated uncertainties (homogeneity).

The test is that of Welch (Biometrika 38, 1951, 330). k values x_i with standard uncertainties u_i and ν_i degrees of freedom have the
weights w_i = 1/u_i², the sum of weights W and the weighted mean x̄. With

    R² = Σ w_i (x_i − x̄)²/(k − 1),    A = Σ (1 − w_i/W)²/ν_i,
    R²/(1 + 2 (k − 2) A/(k² − 1))

has an F distribution with k − 1 and (k² − 1)/(3 A) degrees of freedom. For ν_i = ∞, this is the χ² test of homogeneity. R is the Birge
ratio (R. T. Birge, Phys. Rev. 40, 1932, 207): about 1 if the values scatter as much as their uncertainties state. Errors that all
repeats have in common are part of u_i but not of the scatter, so R may be much less than 1.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject

SIGNIFICANT = 0.01
"""Probability by chance below which repeats scatter more than their uncertainties allow."""


@dataclass(frozen=True, slots=True)
class Homogeneity:
    """The scatter of k repeats. `ratio`: Birge ratio R. `chance`: probability of at least this ratio if the stated uncertainties are
    right. `farthest`: largest distance of a repeat from the weighted mean, divided by the expanded uncertainty (k = 2) of this
    repeat."""

    repeats: int
    ratio: float
    chance: float
    farthest: float

    def to_json(self) -> JsonObject:
        return {
            "repeats": self.repeats,
            "ratio": self.ratio,
            "chance": self.chance,
            "largest_distance": self.farthest,
        }


def homogeneity(
    values: Sequence[float], uncertainties: Sequence[float], freedoms: Sequence[float], period: float = math.inf
) -> Homogeneity | None:
    """Tests the homogeneity of k values with their standard uncertainties and degrees of freedom. `period`: period of a circular
    quantity. Repeats without a finite value and a positive uncertainty are left out. The result is None if fewer than two remain."""
    x, u, nu = (np.array(one, dtype=float) for one in (values, uncertainties, freedoms))
    used = np.isfinite(x) & np.isfinite(u) & (u > 0) & ~(nu <= 0)
    x, u, nu = x[used], u[used], np.where(np.isnan(nu[used]), math.inf, nu[used])
    k = len(x)
    if k < 2:
        return None
    if math.isfinite(period):
        x = np.array([x[0] + math.remainder(one - x[0], period) for one in x])
    from scipy.special import fdtrc

    w = 1 / u**2
    share = w / w.sum()
    away = x - float(share @ x)
    squares = float(w @ away**2) / (k - 1)
    a = float(np.sum((1 - share) ** 2 / nu))
    statistic = squares / (1 + 2 * (k - 2) * a / (k**2 - 1))
    chance = float(fdtrc(k - 1, min((k**2 - 1) / (3 * a), 1e9) if a > 0 else 1e9, statistic))
    return Homogeneity(k, math.sqrt(squares), chance, float(np.max(np.abs(away) / (2 * u))))
