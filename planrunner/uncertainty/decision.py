"""Applies decision rules: decides whether a measured value conforms to a limit, taking its uncertainty into account (JCGM
106:2012)."""

from __future__ import annotations

import math
from enum import StrEnum
from functools import lru_cache
from typing import Literal

from planrunner.base.dataclass import dataclass

CONFIDENCE = 0.95

Rule = Literal["simple", "guarded"]
_LEAST_FREEDOM = 0.5  # of χ²; with fewer degrees of freedom, a measure of scatter is known too poorly for χ²


class CoefficientRole(StrEnum):
    """States which kind of quantity a coefficient is. The kind determines how the value scatters about the true value.

    `LOCATION`: a quantity such as a constant, a slope or an angle, whose value scatters about the true value as Student's t.
    `SCALE`: a measure of scatter s, such as a standard deviation. ν·s²/σ² follows χ² with ν degrees of freedom, where σ is the true
    value. `MAXIMUM`: the largest of several absolute values, such as a nonlinearity or a hysteresis; it is never negative.
    """

    LOCATION = "location"
    SCALE = "scale"
    MAXIMUM = "maximum"


@lru_cache(maxsize=4096)
def coverage_factor(degrees_of_freedom: float, confidence: float = CONFIDENCE) -> float:
    """Returns the factor k of the expanded uncertainty (JCGM 100:2008, G.3). This factor is the quantile of Student's t for a
    two-sided interval, or of the normal distribution for infinite degrees of freedom. If there are no degrees of freedom, the
    factor is infinite."""
    from scipy.special import ndtri, stdtrit

    upper = 0.5 + confidence / 2
    if not degrees_of_freedom > 0:
        return math.inf
    if degrees_of_freedom > 1e6:
        return float(ndtri(upper))
    return float(stdtrit(degrees_of_freedom, upper))


def expanded_uncertainty(
    standard_uncertainty: float, degrees_of_freedom: float, confidence: float = CONFIDENCE
) -> float:
    """Returns the expanded uncertainty U = k·u; zero if u = 0."""
    return coverage_factor(degrees_of_freedom, confidence) * standard_uncertainty if standard_uncertainty else 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """Contains a verdict and the numbers on which it is based.

    `probability`: probability that the true value conforms, computed only from the value and its uncertainty (JCGM 106, 7).
    `guard_band`: distance that the value must keep from the limits, in their unit (0 for the simple rule). `coverage_factor`: the
    factor k of the expanded uncertainty.
    """

    verdict: Literal["pass", "fail"]
    reason: str
    probability: float
    guard_band: float
    expanded_uncertainty: float
    coverage_factor: float = math.nan

    @property
    def false(self) -> float:
        """Returns the specific risk (JCGM 106, 9.3). For a pass, it is the probability of false acceptance; for a fail, it is the
        probability of false rejection."""
        return 1.0 - self.probability if self.verdict == "pass" else self.probability


def decide(
    value: float,
    standard_uncertainty: float,
    degrees_of_freedom: float,
    lower: float = -math.inf,
    upper: float = math.inf,
    rule: Rule = "guarded",
    factor: float = 1.0,
    confidence: float = CONFIDENCE,
    role: CoefficientRole = CoefficientRole.LOCATION,
) -> Decision:
    """Decides whether the true value lies between the limits `lower` and `upper`. All values have the same unit. `role`: kind of
    quantity, which determines the distribution.

    `rule`: with `simple`, the value passes if it lies within the limits (simple acceptance, JCGM 106, 8.2). With `guarded`, it
    passes if it lies within the limits by at least the guard band w = r·U (guarded acceptance, JCGM 106, 8.3.2). Here r is
    `factor`, and U = k·u is the expanded uncertainty for the coverage probability `confidence`. For the role SCALE, U is instead
    the distance between value and limit at which the χ² interval of the value touches the limit. A value that is not finite, or
    whose uncertainty is not finite, never passes. Raises ValueError if both limits are missing or if the lower limit is above the
    upper.
    """
    if lower > upper or (math.isinf(lower) and math.isinf(upper)):
        raise ValueError("a limit needs a lower or an upper bound, the lower not above the upper")
    if not (math.isfinite(value) and math.isfinite(standard_uncertainty)):
        return Decision("fail", "the value or its uncertainty is not known", 0.0, 0.0, 0.0)
    k = coverage_factor(degrees_of_freedom, confidence)
    expanded = expanded_uncertainty(standard_uncertainty, degrees_of_freedom, confidence)
    probability = conformance_probability(value, standard_uncertainty, degrees_of_freedom, lower, upper, role)
    near = upper if upper - value <= value - lower else lower
    freedom = scale_freedom(value, standard_uncertainty) if role is CoefficientRole.SCALE else 0.0
    band = guard_band(_to_bound(near, near == upper, freedom, confidence) if freedom else expanded, rule, factor)
    if not lower <= value <= upper:
        return Decision("fail", "the value is outside the limit", probability, band, expanded, k)
    if not (lower + band <= value <= upper - band):
        width = "its expanded uncertainty" if factor == 1 else f"{factor:g} times its expanded uncertainty"
        reason = f"the value is within the limit, but not by as much as {width} (inside the guard band)"
        return Decision("fail", reason, probability, band, expanded, k)
    reason = "the value is within the limit"
    if rule == "guarded":
        reason = "the value and its guard band are within the limit"
        if factor == 1:
            reason = "the value and its expanded uncertainty are within the limit"
    return Decision("pass", reason, probability, band, expanded, k)


def guard_band(expanded: float, rule: Rule, factor: float = 1.0) -> float:
    """Returns the guard band w = r·U for guarded acceptance, where r is `factor`, and U is the expanded uncertainty `expanded`;
    zero for simple acceptance."""
    return factor * expanded if rule == "guarded" and factor else 0.0


def conformance_probability(
    value: float,
    standard_uncertainty: float,
    degrees_of_freedom: float,
    lower: float = -math.inf,
    upper: float = math.inf,
    role: CoefficientRole = CoefficientRole.LOCATION,
) -> float:
    """Returns the probability that the true value lies in [lower, upper].

    If `role` is `LOCATION`, the distribution of the true value is Student's t, centred on `value` and scaled by the uncertainty. If
    `role` is `SCALE`, the value is a measure of scatter s with ν degrees of freedom, and ν·s²/σ² follows χ² (JCGM 106, 7.2, with
    the prior 1/σ). If `role` is `MAXIMUM`, the value is the absolute value of a signed quantity with Student's t distribution;
    positive and negative values of this quantity contribute to the probability.
    """
    from scipy.special import chdtr, ndtr, stdtr

    if standard_uncertainty == 0:
        return 1.0 if lower <= value <= upper else 0.0
    if not degrees_of_freedom > 0:
        return 0.0

    freedom = scale_freedom(value, standard_uncertainty) if role is CoefficientRole.SCALE else 0.0

    def below(bound: float) -> float:
        if math.isinf(bound):
            return 1.0 if bound > 0 else 0.0
        if freedom:
            return 1.0 - float(chdtr(freedom, freedom * (value / bound) ** 2)) if bound > 0 else 0.0
        if role is CoefficientRole.MAXIMUM:
            return from_below(bound) - from_below(-bound) if bound > 0 else 0.0
        return from_below(bound)

    def from_below(bound: float) -> float:
        z = (bound - value) / standard_uncertainty
        return float(ndtr(z) if degrees_of_freedom > 1e6 else stdtr(degrees_of_freedom, z))

    return min(1.0, max(0.0, below(upper) - below(lower)))


def scale_freedom(value: float, standard_uncertainty: float) -> float:
    """Computes the degrees of freedom ν of a measure of scatter s from u(s) = s/√(2·ν) (JCGM 100:2008, E.4.3). Returns 0 if ν is
    too small for a χ² distribution, or so large that the distribution is normal."""
    if not (value > 0 and standard_uncertainty > 0):
        return 0.0
    found = (value / standard_uncertainty) ** 2 / 2
    return found if _LEAST_FREEDOM <= found <= 1e6 else 0.0


def _to_bound(bound: float, upper: bool, freedom: float, confidence: float) -> float:
    """Returns the distance that a measure of scatter must keep from the limit `bound`, so that its two-sided χ² interval ends at
    the limit. `upper`: True for an upper limit. `freedom`: degrees of freedom. `confidence`: confidence level of the interval."""
    from scipy.special import chdtri

    beyond = (1 + confidence) / 2 if upper else (1 - confidence) / 2  # chdtri takes the upper tail probability
    return abs(bound) * abs(1 - math.sqrt(float(chdtri(freedom, beyond)) / freedom))
