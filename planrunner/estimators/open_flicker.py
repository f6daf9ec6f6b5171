"""Warns if the intervals of an estimate may be too narrow because neither the bench file nor the data limit the size of the flicker
noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.interface import CoefficientRole, Estimate
from planrunner.estimators.unstated_flicker import CREDIBLE
from planrunner.uncertainty.decision import coverage_factor

SUFFICIENT = 0.90
"""Lowest acceptable coverage of a 95 % interval. An estimate gets a warning if flicker of the largest possible size would reduce
the coverage below this value."""


@dataclass(frozen=True, slots=True)
class OpenFlicker:
    """Describes the flicker of a channel if it may be larger than an estimate assumes.

    `bound`: the largest bias instability B that the data do not exclude, in `unit`. If B has this value, the intervals of the
    coefficients are too narrow. `coefficient`: name of the coefficient whose interval is affected most. `widening`: the factor by
    which this interval would have to be widened.
    """

    channel: str
    unit: str
    bound: float
    coefficient: str
    widening: float


def open_flicker(estimate: Estimate) -> tuple[OpenFlicker, ...]:
    """Finds flicker that may make an interval of an estimate too narrow. Returns at most one entry for each unstated flicker.
    `estimate`: an estimate whose standard uncertainties and degrees of freedom include the whole budget. Coefficients that measure
    scatter, or that are the largest of several values, are not examined, because they already contain the flicker."""
    found = []
    spreads = np.array([item.standard_uncertainty for item in estimate.coefficients])
    located = np.array([item.role is CoefficientRole.LOCATION for item in estimate.coefficients], dtype=bool)
    judged = located & np.isfinite(spreads) & (spreads > 0)
    factors = np.array([coverage_factor(item.degrees_of_freedom) for item in estimate.coefficients])
    for one in estimate.unstated:
        slow = np.where(judged, np.sum(one.influence.sensitivities**2, axis=1), 0.0)
        if one.evidence is None or not slow.any():
            continue
        bound = one.evidence.bound()
        wider = np.sqrt(1 + bound**2 * slow / np.where(judged, spreads, 1.0) ** 2)
        narrow = np.where(judged, wider / factors, 0.0)
        worst = int(np.argmax(narrow))
        if narrow[worst] * coverage_factor(math.inf, SUFFICIENT) > 1:
            widening = float(narrow[worst] * coverage_factor(math.inf))
            name = estimate.coefficients[worst].name
            found.append(OpenFlicker(one.channel, one.influence.quantity.unit, bound, name, widening))
    return tuple(found)


def with_flicker_words(estimate: Estimate) -> Estimate:
    """Adds a warning to an estimate about flicker that may make its intervals too narrow. Also adds a note about the other channels
    for which the bench file states no flicker."""
    if not estimate.unstated:
        return estimate
    found = open_flicker(estimate)
    named = {one.channel for one in found}
    silent = tuple(dict.fromkeys(one.channel for one in estimate.unstated if one.channel not in named))
    notes = (no_flicker_declared(silent),) if silent else ()
    warnings = (_warning(found),) if found else ()
    return replace(estimate, notes=(*estimate.notes, *notes), warnings=(*estimate.warnings, *warnings))


def _warning(found: Sequence[OpenFlicker]) -> Said:
    bounds = tuple(
        said("{bound:.2g} {unit} ({output})", bound=one.bound, unit=one.unit, output=one.channel) for one in found
    )
    worst = max(found, key=lambda one: one.widening)
    return said(
        "The bench file gives no bias instability for {outputs}. The data only show that the coefficient B of "
        "flicker noise is at most {bounds}, each with a probability of {share:.0f} %. The uncertainties do not "
        "include this flicker. With flicker of this size, the 95 % interval of {coefficient} would have to be "
        "{widening:.2g} times as wide. Write `bias_instability` in the bench file, from the data sheet or an Allan "
        "deviation; write 0 if the noise is known to be white.",
        outputs=tuple(one.channel for one in found),
        bounds=bounds,
        share=100 * CREDIBLE,
        coefficient=worst.coefficient,
        widening=worst.widening,
    )


def no_flicker_declared(channels: Sequence[str]) -> Said:
    """Returns a note about channels without a declared bias instability."""
    return said(
        "No bias instability is declared for {outputs}: the intervals are valid only if the noise of different "
        "segments is independent (no flicker).",
        outputs=tuple(channels),
    )
