"""Checks of meaning that concern the whole plan: labels, references between parts, limits, reports."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from planrunner.plan.expand import StatedSegment
from planrunner.plan.findings import Findings, closest
from planrunner.plan.model import EstimateSpec, Limit, Plan
from planrunner.plan.quantity import QuantityError, parse_symmetric
from planrunner.plan.selection import Detection, select


def check_meaning(plan: Plan, segments: Sequence[StatedSegment], templates: Iterable[str], log: Findings) -> None:
    """Adds findings on estimates, limits and reports. `templates`: the names of reports that can be written."""
    labels = [segment.label for segment in segments]
    used: set[int] = set()
    complete = all(spec.sound for spec in plan.segments)
    for name, spec in plan.estimates.items():
        used.update(_check_estimate(plan, name, spec, labels, complete, log))
    if plan.estimates and complete:
        for index, segment in enumerate(segments):
            if index not in used:
                message = f"the segment '{segment.label}' is recorded but no estimate uses it"
                log.warning("meaning-unused-label", segment.mark, message, "use it in an estimate, or leave it out")
    for limit in plan.limits:
        _check_limit(plan, limit, log)
    known = sorted(templates)
    for report in plan.report:
        if report not in known:
            message = f"there is no report '{report}'"
            log.error("meaning-unknown-report", plan.at("report"), message, closest(report, known))


def _check_estimate(
    plan: Plan, name: str, spec: EstimateSpec, labels: list[str], complete: bool, log: Findings
) -> list[int]:
    earlier = list(plan.estimates)[: list(plan.estimates).index(name)]
    for other in spec.uses:
        if other not in plan.estimates:
            log.error("meaning-unknown-estimate", spec.at("uses"), f"'{other}' is no estimate of this plan", closest(other, plan.estimates))
        elif other not in earlier:
            message = f"'{name}' uses '{other}', which is not estimated before it"
            log.error("meaning-estimate-order", spec.at("uses"), message, f"put '{other}' first")
    patterns = spec.segments.within if isinstance(spec.segments, Detection) else spec.segments
    chosen: list[int] = []
    for pattern in patterns:
        found = select(labels, [pattern])
        if not found and complete:
            at = spec.at("segments")
            log.error("meaning-undefined-label", at, f"no segment is labelled '{pattern}'", closest(pattern, labels[:50]))
        chosen.extend(found)
    return chosen


def _check_limit(plan: Plan, limit: Limit, log: Findings) -> None:
    estimate = limit.quantity.split(".", 1)[0]
    if estimate not in plan.estimates:
        at = limit.at("quantity")
        log.error("meaning-unknown-estimate", at, f"'{estimate}' is no estimate of this plan", closest(estimate, plan.estimates))
    if limit.within is None and limit.at_least is None and limit.at_most is None:
        log.error("meaning-limit", limit.origin.mark, "a limit needs within, at_least or at_most", "add for example within: ±0.5 deg/h")
    if limit.within is not None:
        if limit.at_least is not None or limit.at_most is not None:
            log.error("meaning-limit", limit.at("within"), "within stands alone", "use at_least and at_most for a lopsided limit")
        try:
            bound = parse_symmetric(limit.within)
        except QuantityError as error:
            log.error(error.code, limit.at("within"), str(error), error.hint)
        else:
            if bound is None:
                message = f"'{limit.within[:40]}' is not symmetric about zero"
                log.error("meaning-limit", limit.at("within"), message, "write ±0.5 deg/h, or use at_least and at_most")
            elif bound.value <= 0:
                log.error("meaning-range", limit.at("within"), f"±{bound} must be positive", "change the number")
    if limit.at_least is not None and limit.at_most is not None:
        if limit.at_least.unit.dimension != limit.at_most.unit.dimension:
            log.error("meaning-dimension", limit.at("at_most"), "at_least and at_most are of different dimensions", "use one unit")
        elif limit.at_least.value > limit.at_most.value:
            log.error("meaning-limit", limit.at("at_least"), "at_least is above at_most: nothing could pass", "exchange them")
