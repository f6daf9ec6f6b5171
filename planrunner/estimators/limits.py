"""Applies limits to coefficients: converts units, applies the decision rule and gives the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import Coefficient, Estimate, EstimationError
from planrunner.plan.model import Limit
from planrunner.plan.quantity import Quantity, parse_symmetric
from planrunner.plan.units import UnknownUnitError, unit
from planrunner.uncertainty.decision import CONFIDENCE, coverage_factor, decide
from planrunner.uncertainty.global_risk import GlobalRisk, Prior, global_risk


@dataclass(frozen=True, slots=True)
class LimitVerdict:
    """A limit and its verdict. The fields value, standard_uncertainty, expanded_uncertainty, lower and upper are in `unit`.

    `quantity`: name of the form `estimate.coefficient`. `requirement`: the limit in words, such as `within ±5 deg/h`.
    `probability`: probability that the true value conforms. `guard_band`: distance that the value must have from the limits.
    `guard_factor`: guard band divided by the expanded uncertainty U. `coverage`: coverage probability of U. `false_decision`:
    specific risk, which is the probability that this verdict is wrong. `consumer_risk`, `producer_risk`: the global risks of the
    decision rule, if the limit states a prior.
    """

    quantity: str
    requirement: str
    rule: str
    verdict: Literal["pass", "fail"]
    value: float
    unit: str
    standard_uncertainty: float
    expanded_uncertainty: float
    coverage_factor: float
    reason: str = ""
    probability: float = math.nan
    lower: float = -math.inf
    upper: float = math.inf
    guard_band: float = math.nan
    guard_factor: float = math.nan
    coverage: float = CONFIDENCE
    false_decision: float = math.nan
    consumer_risk: float = math.nan
    producer_risk: float = math.nan


VerdictKind = Literal["pass", "warned", "fail", "none"]
"""Verdict on all limits of a plan. `warned` means passed with warnings; `none` means that the plan sets no limits."""


def verdict_kind(limits: Sequence[LimitVerdict], failures: Mapping[str, str], warnings: int) -> VerdictKind:
    """Returns the verdict on all limits together. `failures`: messages about estimates and limits without a result. `warnings`:
    number of warnings that may invalidate the verdict."""
    if failures:
        return "fail"
    if not limits:
        return "none"
    if any(limit.verdict != "pass" for limit in limits):
        return "fail"
    return "warned" if warnings else "pass"


def hold(limit: Limit, estimates: Mapping[str, Estimate]) -> LimitVerdict:
    """Returns the verdict on one limit (`plan.model.Limit`). A circular coefficient is first shifted by whole turns until it is as
    near as possible to the middle between the two bounds of the limit. Raises `EstimationError` if the quantity of the limit is
    missing or has a dimension other than that of the limit."""
    coefficient = _coefficient(limit.quantity, estimates)
    lower, upper = bounds(limit, coefficient)
    u, freedom = coefficient.standard_uncertainty, coefficient.degrees_of_freedom
    both = math.isfinite(lower) and math.isfinite(upper)
    value = coefficient.near((lower + upper) / 2) if both else coefficient.value
    decision = decide(value, u, freedom, lower, upper, limit.rule, limit.guard_band, limit.coverage, coefficient.role)
    band = decision.guard_band
    risk = _global(limit, coefficient, (lower, upper), (lower + band, upper - band))
    return LimitVerdict(
        limit.quantity,
        _in_words(limit),
        limit.rule,
        decision.verdict,
        value,
        coefficient.unit,
        u,
        decision.expanded_uncertainty,
        coverage_factor(freedom, limit.coverage),
        decision.reason,
        decision.probability,
        lower,
        upper,
        band,
        limit.guard_band if limit.rule == "guarded" else 0.0,
        limit.coverage,
        decision.false,
        risk.consumer,
        risk.producer,
    )


def _global(
    limit: Limit, coefficient: Coefficient, tolerance: tuple[float, float], acceptance: tuple[float, float]
) -> GlobalRisk:
    """Returns the global risks of the decision rule; NaN if the limit states no prior, or if the uncertainty is not known.
    `tolerance`: lower and upper limit. `acceptance`: lowest and highest value that is accepted."""
    if limit.prior is None or not math.isfinite(coefficient.standard_uncertainty):
        return GlobalRisk(math.nan, math.nan)
    if not limit.prior.standard_uncertainty:
        raise EstimationError("the prior has no uncertainty: write for example prior: 0.1 deg/h ± 0.2 deg/h")
    spread = limit.prior.standard_uncertainty / unit(coefficient.unit).factor
    prior = Prior(_in_unit(limit.prior, coefficient), spread)
    return global_risk(prior, coefficient.standard_uncertainty, coefficient.degrees_of_freedom, tolerance, acceptance)


def _coefficient(quantity: str, estimates: Mapping[str, Estimate]) -> Coefficient:
    name, _, wanted = quantity.partition(".")
    if name not in estimates:
        raise EstimationError(f"'{name}' gave no result to compare with the limit")
    try:
        return estimates[name][wanted]
    except KeyError:
        known = [item.name for item in estimates[name].coefficients]
        raise EstimationError(f"'{name}' has no coefficient '{wanted}': {closest(wanted, known)}") from None


def bounds(limit: Limit, coefficient: Coefficient) -> tuple[float, float]:
    """Returns the lower and the upper bound of a `plan.model.Limit`, in the coefficient's unit; infinite for a bound that is not
    given.

    Raises `EstimationError` for a limit of another dimension, for a limit without bounds, and for a limit that no value can meet.
    """
    if limit.within is not None:
        bound = parse_symmetric(limit.within)
        if bound is None:
            raise EstimationError(
                f"'{limit.within}' is not a limit about zero; write for example ±0.5 {coefficient.unit}"
            )
        width = _in_unit(bound, coefficient)
        return -width, width
    lower = -math.inf if limit.at_least is None else _in_unit(limit.at_least, coefficient)
    upper = math.inf if limit.at_most is None else _in_unit(limit.at_most, coefficient)
    if math.isinf(lower) and math.isinf(upper):
        raise EstimationError("the limit gives no bound: write within, at_least or at_most")
    if lower > upper:
        raise EstimationError("at_least is larger than at_most, so no value can pass")
    return lower, upper


def _in_unit(bound: Quantity, coefficient: Coefficient) -> float:
    try:
        own = unit(coefficient.unit)
    except UnknownUnitError:
        raise EstimationError(f"its unit '{coefficient.unit}' is not known, so no limit can be applied") from None
    if own.dimension != bound.unit.dimension:
        raise EstimationError(
            f"the limit is in {bound.unit.text}, the coefficient in {coefficient.unit}: write it in {coefficient.unit}"
        )
    # A limit in the coefficient's own unit is compared without a conversion to SI and back.
    return bound.unit.from_si(bound.value) if bound.unit.text == own.text else own.from_si(bound.value)


def _in_words(limit: Limit) -> str:
    if limit.within is not None:
        return f"within {limit.within}"
    parts = [
        f"{word} {bound}"
        for word, bound in (("at least", limit.at_least), ("at most", limit.at_most))
        if bound is not None
    ]
    return ", ".join(parts)
