"""Compares estimates of one plan that repeat each other on different segments.

Estimates are repeats if they have the same estimator and the same parameters, if they have no segment in common, and if their
segments have the same orientations, motions and conditions. Their coefficients must then agree within their uncertainties. Estimates that a
`repeatability` estimate compares are left out, because this estimate examines them itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from planrunner.archive.recording import RecordedSegment
from planrunner.base.said import Said, said
from planrunner.estimators.foresight import patterns_of
from planrunner.estimators.interface import Estimate
from planrunner.plan.model import EstimateSpec
from planrunner.plan.schedule import RecordedMotion, Segment
from planrunner.plan.selection import select
from planrunner.uncertainty.homogeneity import SIGNIFICANT, Homogeneity, homogeneity

_NAMED = 3
"""Most coefficients and estimates that a warning names."""
_COMPARES = "repeatability"


def with_scatter_words(
    made: Mapping[str, Estimate], specs: Mapping[str, EstimateSpec], recording: Sequence[RecordedSegment]
) -> dict[str, Estimate]:
    """Returns the estimates. Each estimate whose repeats scatter more than their uncertainties allow has a further warning."""
    found = dict(made)
    for names in repeated(made, specs, recording):
        words = _scatter_words(names, [made[name] for name in names])
        if words is not None:
            for name in names:
                found[name] = replace(made[name], warnings=(*made[name].warnings, words))
    return found


def repeated(
    made: Mapping[str, Estimate], specs: Mapping[str, EstimateSpec], recording: Sequence[RecordedSegment]
) -> list[list[str]]:
    """Returns the groups of estimates that are repeats of each other, by their names."""
    compared = {used for spec in specs.values() if spec.estimator == _COMPARES for used in spec.uses}
    labels = [one.label for one in recording]
    groups: list[list[str]] = []
    chosen: dict[str, set[int]] = {}
    for name, estimate in made.items():
        spec = specs.get(name)
        if spec is None or name in compared or estimate.expected or spec.estimator == _COMPARES:
            continue
        chosen[name] = set(select(labels, patterns_of(spec)))
        for group in groups:
            first = specs[group[0]]
            apart = all(chosen[name].isdisjoint(chosen[other]) for other in group)
            if (
                apart
                and _alike(spec, first)
                and _states(chosen[name], recording) == _states(chosen[group[0]], recording)
            ):
                group.append(name)
                break
        else:
            groups.append([name])
    return [group for group in groups if len(group) > 1]


def _alike(one: EstimateSpec, other: EstimateSpec) -> bool:
    """Returns True if two estimates have the same estimator, parameters and inputs. Parameters that cannot be compared, such as arrays
    of an estimator from elsewhere, count as different."""
    if (one.estimator, one.uses) != (other.estimator, other.uses):
        return False
    try:
        return bool(one.parameters == other.parameters)
    except Exception:  # an estimator may come from anywhere
        return False


def _states(chosen: set[int], recording: Sequence[RecordedSegment]) -> frozenset[object]:
    return frozenset(_state(recording[row].segment) for row in chosen)


def _state(one: Segment) -> object:
    """Returns the orientation, the motion and the conditions of a segment, in a form that can be compared. Recorded motions count
    as equal: they excite the same channels, and estimates of them are compared with their own uncertainties."""
    attitude = None if one.attitude is None else tuple((one.attitude.round(6) + 0.0).ravel().tolist())
    motion = RecordedMotion.__name__ if isinstance(one.motion, RecordedMotion) else repr(one.motion)
    return attitude, motion, one.begins_at, one.ramp_to, one.supply_voltage, one.ambient_pressure, one.mode


def _scatter_words(names: Sequence[str], estimates: Sequence[Estimate]) -> Said | None:
    """Returns a warning about the coefficients that scatter more than their uncertainties allow; None if all agree. With m
    coefficients, each is tested at 1/m of the significance level."""
    each = [{item.name: item for item in one.coefficients} for one in estimates]
    shared = [name for name in each[0] if all(name in own and own[name].unit == each[0][name].unit for own in each)]
    tested: list[tuple[str, Homogeneity]] = []
    for name in shared:
        items = [own[name] for own in each]
        test = homogeneity(
            [one.value for one in items],
            [one.standard_uncertainty for one in items],
            [one.degrees_of_freedom for one in items],
            items[0].period,
        )
        if test is not None:
            tested.append((name, test))
    worse = sorted((pair for pair in tested if pair[1].chance * len(tested) < SIGNIFICANT), key=lambda p: p[1].chance)
    if not worse:
        return None
    return said(
        "The estimates {estimates} repeat each other on different segments, but they scatter more than their standard uncertainties "
        "allow. The scatter divided by the standard uncertainties is {ratios}; by chance, such ratios have a probability of at most "
        "{chance:.2g}. The uncertainties do not include changes from repeat to repeat. Use the scatter of the repeats (estimator "
        "`repeatability`), or find what changed.",
        estimates=_first(names),
        ratios=_first([f"{name} {test.ratio:.2g}" for name, test in worse]),
        chance=max(test.chance for _, test in worse[:_NAMED]) * len(tested),
    )


def _first(texts: Sequence[str]) -> Said | tuple[str, ...]:
    """Returns the first `_NAMED` texts, and the number of the others."""
    more = len(texts) - _NAMED
    return said("{names} and {more} more", names=tuple(texts[:_NAMED]), more=more) if more > 0 else tuple(texts)
