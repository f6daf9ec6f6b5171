"""Decision rules: whether a measured value conforms to a limit, given its uncertainty (JCGM 106:2012)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Literal

from planrunner.dataclass import dataclass

CONFIDENCE = 0.95

Rule = Literal["simple", "guarded"]


@lru_cache(maxsize=4096)
def coverage_factor(degrees_of_freedom: float, confidence: float = CONFIDENCE) -> float:
    """k of the expanded uncertainty: Student's t for a two-sided interval (JCGM 100:2008, G.3); the normal quantile for infinitely
    many degrees of freedom. Infinite without any degrees of freedom."""
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
    """U = k·u; zero for u = 0."""
    return coverage_factor(degrees_of_freedom, confidence) * standard_uncertainty if standard_uncertainty else 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """A verdict with its grounds. probability: that the true value conforms, from the value and its uncertainty alone (JCGM 106, 7).
    guard_band: how far inside the limits the value had to be, in their unit (0 for the simple rule). coverage_factor: of the expanded
    uncertainty."""

    verdict: Literal["pass", "fail"]
    reason: str
    probability: float
    guard_band: float
    expanded_uncertainty: float
    coverage_factor: float = math.nan

    @property
    def false(self) -> float:
        """Specific risk (JCGM 106, 9.3): of false acceptance where it passes, of false rejection where it fails."""
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
) -> Decision:
    """The verdict on lower ≤ true value ≤ upper, all in one unit.

    simple: the value is within the limits (simple acceptance, JCGM 106, 8.2). guarded: it lies within them by at least the guard band
    w = r·U (guarded acceptance, JCGM 106, 8.3.2), with r = `factor` and U = k·u for a coverage probability of `confidence`. A value or
    uncertainty that is not finite never passes. Raises ValueError when both limits are missing or the lower one is the larger.
    """
    if lower > upper or (math.isinf(lower) and math.isinf(upper)):
        raise ValueError("a limit needs a lower or an upper bound, the lower not above the upper")
    if not (math.isfinite(value) and math.isfinite(standard_uncertainty)):
        return Decision("fail", "the value or its uncertainty is not known", 0.0, 0.0, 0.0)
    k = coverage_factor(degrees_of_freedom, confidence)
    expanded = expanded_uncertainty(standard_uncertainty, degrees_of_freedom, confidence)
    probability = conformance_probability(value, standard_uncertainty, degrees_of_freedom, lower, upper)
    band = guard_band(expanded, rule, factor)
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
    """w = r·U of guarded acceptance; none of simple acceptance."""
    return factor * expanded if rule == "guarded" and factor else 0.0


def conformance_probability(
    value: float,
    standard_uncertainty: float,
    degrees_of_freedom: float,
    lower: float = -math.inf,
    upper: float = math.inf,
) -> float:
    """The probability that the true value lies in [lower, upper], for Student's t about the value scaled by the uncertainty."""
    from scipy.special import ndtr, stdtr

    if standard_uncertainty == 0:
        return 1.0 if lower <= value <= upper else 0.0
    if not degrees_of_freedom > 0:
        return 0.0

    def below(bound: float) -> float:
        if math.isinf(bound):
            return 1.0 if bound > 0 else 0.0
        z = (bound - value) / standard_uncertainty
        return float(ndtr(z) if degrees_of_freedom > 1e6 else stdtr(degrees_of_freedom, z))

    return min(1.0, max(0.0, below(upper) - below(lower)))
