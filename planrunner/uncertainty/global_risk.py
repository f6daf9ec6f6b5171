"""Computes the global risks of a decision rule (JCGM 106:2012, 9.5): the fraction of wrong decisions among all items that a
laboratory tests.

Global risks require prior knowledge of how the quantity is distributed over the items. This distribution is assumed to be normal.
The measured value is assumed to scatter about the true value of an item as Student's t (normal for infinitely many degrees of
freedom), with the standard uncertainty of the present measurement.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

_POINTS = 2000  # nodes of the Gauss–Legendre integration over the prior
_REACH = 9.0  # range of integration, in standard deviations of the prior; the rest has the probability 2·10⁻¹⁹


@dataclass(frozen=True, slots=True)
class Prior:
    """Describes what is known about the quantity before the measurement. The distribution of the quantity over the items is normal,
    with this mean and this standard deviation."""

    mean: float
    standard_deviation: float


@dataclass(frozen=True, slots=True)
class GlobalRisk:
    """The global risks of a decision rule. `consumer`: probability that an item does not conform and is accepted. `producer`:
    probability that an item conforms and is rejected."""

    consumer: float
    producer: float


def global_risk(
    prior: Prior,
    standard_uncertainty: float,
    degrees_of_freedom: float,
    tolerance: tuple[float, float],
    acceptance: tuple[float, float],
) -> GlobalRisk:
    """Returns the risks R_C of the consumer and R_P of the producer (JCGM 106:2012, equations 17 to 20). `tolerance`: lower and
    upper limit, infinite if a limit is missing.

    `acceptance`: interval of the measured values that are accepted; empty if its lower end is above its upper end. Raises
    ValueError if the standard deviation of the prior is not positive.
    """
    if not (math.isfinite(prior.mean) and prior.standard_deviation > 0):
        raise ValueError("a prior needs a mean and a positive standard uncertainty")
    consumer = producer = 0.0
    ends = [prior.mean - _REACH * prior.standard_deviation, prior.mean + _REACH * prior.standard_deviation]
    # Panels end at the tolerance limits, and are narrow near the acceptance limits, where the probability of acceptance changes fast.
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
    """Returns the probability, for each true value (n,), that the measured value lies within the acceptance interval."""
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
