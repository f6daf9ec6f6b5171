"""Global risks of a decision rule over all items that come to be tested (JCGM 106:2012, 9.5): how many wrong decisions a laboratory makes.

They need what was known before: the distribution of the quantity over the items, here a normal one. A measurement scatters about an
item's true value as Student's t (normal for infinitely many degrees of freedom) with the standard uncertainty of the present one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planrunner.base.dataclass import dataclass

Array = NDArray[np.float64]

_POINTS = 2000  # of Gauss–Legendre on each smooth stretch of the prior
_REACH = 9.0  # standard deviations of the prior that are integrated over; beyond lie 2·10⁻¹⁹


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of the quantity before it is measured: normal, by mean and standard deviation over the items."""

    mean: float
    standard_deviation: float


@dataclass(frozen=True, slots=True)
class GlobalRisk:
    """consumer: probability that an item does not conform and is accepted. producer: that it conforms and is rejected."""

    consumer: float
    producer: float


def global_risk(
    prior: Prior,
    standard_uncertainty: float,
    degrees_of_freedom: float,
    tolerance: tuple[float, float],
    acceptance: tuple[float, float],
) -> GlobalRisk:
    """R_C and R_P (JCGM 106:2012, equations 17 to 20) for limits (lower, upper), infinite where there is none.

    acceptance: the interval that measured values must lie in; empty where its lower end is above its upper one. Raises ValueError for a
    prior without a spread.
    """
    if not (math.isfinite(prior.mean) and prior.standard_deviation > 0):
        raise ValueError("a prior needs a mean and a positive standard uncertainty")
    consumer = producer = 0.0
    ends = [prior.mean - _REACH * prior.standard_deviation, prior.mean + _REACH * prior.standard_deviation]
    # The density of measurements is narrow near the acceptance limits, and the tolerance limits are where a true value changes sides.
    cuts = [*tolerance, *(end + z * standard_uncertainty for end in acceptance for z in (-8, 0, 8))]
    inner = sorted({cut for cut in cuts if ends[0] < cut < ends[1]})
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS // (len(inner) + 1))
    for low, high in zip([ends[0], *inner], [*inner, ends[1]], strict=True):
        true = low + (high - low) * (nodes + 1) / 2
        z = (true - prior.mean) / prior.standard_deviation
        density = np.exp(-(z**2) / 2) / (prior.standard_deviation * math.sqrt(2 * math.pi)) * weights * (high - low) / 2
        accepted = _accepted(true, standard_uncertainty, degrees_of_freedom, acceptance)
        if tolerance[0] <= (low + high) / 2 <= tolerance[1]:
            producer += float(density @ (1 - accepted))
        else:
            consumer += float(density @ accepted)
    return GlobalRisk(consumer, producer)


def _accepted(true: Array, u: float, freedom: float, acceptance: tuple[float, float]) -> Array:
    """Probability that the measured value of each true one (n,) falls within the acceptance interval."""
    from scipy.special import ndtr, stdtr

    low, high = acceptance
    if low > high or (u > 0 and not freedom > 0):
        return np.zeros_like(true)
    if u == 0:
        return ((true >= low) & (true <= high)).astype(float)

    def below(end: float) -> Array:
        if math.isinf(end):
            return np.full_like(true, 1.0 if end > 0 else 0.0)
        z = (end - true) / u
        return np.asarray(ndtr(z) if freedom > 1e6 else stdtr(freedom, z))

    return below(high) - below(low)
