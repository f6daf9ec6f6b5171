"""Checks what concerns the whole plan: labels, references between parts, limits, reports.

Channels named in estimates are checked against the channels of the bench's sensor. Parameters of the kind `CHANNEL` are found by
their declaration, so estimators of plug-ins are checked as well.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence

from planrunner.base.findings import Findings, Mark, closest, elsewhere
from planrunner.plan.expand import StatedSegment
from planrunner.plan.kinds import CHANNEL, Kind, ListOf, MapOf, Record, keys_of
from planrunner.plan.model import DiagnosisSpec, EstimateSpec, Limit, Plan
from planrunner.plan.selection import Detection, Labels


def check_meaning(plan: Plan, segments: Sequence[StatedSegment], templates: Iterable[str], log: Findings) -> None:
    """Adds findings on estimates, limits and reports. `templates`: the names of reports that can be written.

    A reference to a part that could not be read is not reported as unknown, so that one mistake causes only one finding.
    """
    names = [key.removeprefix("estimates.") for key in plan.origin.keys if key.startswith("estimates.")] or list(
        plan.estimates
    )
    complete = bool(segments) and all(spec.sound for spec in plan.segments)
    labels = Labels([segment.label for segment in segments])
    for name, spec in plan.estimates.items():
        _check_uses(name, spec, names, log)
    _check_names(plan, names, log)
    if complete:
        selections: list[EstimateSpec | DiagnosisSpec] = list(plan.estimates.values())
        if plan.diagnosis is not None:
            selections.append(plan.diagnosis)
        # An estimate may refer to a label that is missing or repeated.
        with log.resting_on(*plan.origin.parts("segments")):
            used = _check_selections(selections, labels, log)
        if plan.estimates:
            with log.resting_on(
                *(part for key in ("segments", "estimates", "diagnosis") for part in plan.origin.parts(key))
            ):
                _check_unused(segments, used, log)
    for limit in plan.limits:
        with log.resting_on(limit.origin.mark):
            _check_limit(limit, log)
    known = sorted(templates)
    for index, report in enumerate(plan.report):
        if report not in known:
            log.error(
                "meaning-unknown-report",
                plan.at(f"report[{index}]"),
                f"there is no report '{report}'",
                closest(report, known),
            )


def _check_uses(name: str, spec: EstimateSpec, names: list[str], log: Findings) -> None:
    for index, other in enumerate(spec.uses):
        at = spec.at(f"uses[{index}]")
        if other not in names:
            continue  # `_check_names` reports it
        if other in spec.uses[:index]:
            log.error("meaning-estimate-twice", at, f"'{name}' uses '{other}' twice", "name each estimate once")
        elif other == name:
            log.error("meaning-estimate-order", at, f"'{name}' uses itself", "name an estimate that precedes it")
        elif name in names and names.index(other) > names.index(name):
            message = f"'{name}' uses '{other}', which is not an earlier estimate"
            log.error("meaning-estimate-order", at, message, f"put '{other}' above '{name}'")


def _check_names(plan: Plan, names: list[str], log: Findings) -> None:
    """Adds a finding for each name that is not the name of an estimate. A name that is used several times causes only one
    finding."""
    unknown: dict[str, list[Mark]] = {}
    for spec in plan.estimates.values():
        for index, other in enumerate(spec.uses):
            if other not in names:
                unknown.setdefault(other, []).append(spec.at(f"uses[{index}]"))
    for limit in plan.limits:
        estimate = limit.quantity.split(".", 1)[0]
        if estimate not in names:
            unknown.setdefault(estimate, []).append(limit.at("quantity"))
    with log.resting_on(*plan.origin.meant.get("estimates", ())):
        for name, marks in unknown.items():
            message = f"'{name}' is not an estimate of this plan{elsewhere(marks, marks[0])}"
            log.error("meaning-unknown-estimate", marks[0], message, closest(name, names))


def _check_selections(specs: Sequence[EstimateSpec | DiagnosisSpec], labels: Labels, log: Findings) -> set[int]:
    """Checks the selected segments. A pattern that matches no segment causes only one finding, even if it is used several times."""
    chosen: set[int] = set()
    undefined: dict[str, list[Mark]] = {}
    for spec in specs:
        # The record with the patterns, and their key.
        holder, key = (spec.segments, "within") if isinstance(spec.segments, Detection) else (spec, "segments")
        patterns = spec.segments.within if isinstance(spec.segments, Detection) else spec.segments
        for index, pattern in enumerate(patterns):
            found = labels.meant_by(pattern)
            if not found:
                undefined.setdefault(pattern, []).append(holder.at(f"{key}[{index}]"))
            chosen.update(found)
        if not patterns:
            hint = "leave the key out to choose all segments, or name some"
            log.error("meaning-undefined-label", holder.at(key), "no segment is chosen", hint)
    for pattern, marks in undefined.items():
        message = f"no segment is labelled '{pattern}'{elsewhere(marks, marks[0])}"
        log.error("meaning-undefined-label", marks[0], message, labels.closest(pattern))
    return chosen


def _check_unused(segments: Sequence[StatedSegment], used: set[int], log: Findings) -> None:
    """Adds one warning for each place in the plan file where unused segments are defined, even if several unused segments are
    defined at one place. `used`: indices of the used segments."""
    unused: dict[Mark, list[str]] = {}
    for index, segment in enumerate(segments):
        if index not in used and not segment.conditioning:
            unused.setdefault(segment.mark, []).append(segment.label)
    for mark, labels in unused.items():
        shown = ", ".join(f"'{label}'" for label in labels[:3]) + (
            f" and {len(labels) - 3} more" if len(labels) > 3 else ""
        )
        what = f"the segment {shown} is" if len(labels) == 1 else f"the segments {shown} are"
        log.warning(
            "meaning-unused-label",
            mark,
            f"{what} recorded but no estimate uses {'it' if len(labels) == 1 else 'them'}",
            _UNUSED_HINT if len(labels) == 1 else _UNUSED_HINT.replace("it is", "they are").replace(" it ", " them "),
        )


_UNUSED_HINT = "name it in the 'segments' of an estimate, write `conditioning: true` if it is a warm-up, or leave it out of the plan"


def _check_limit(limit: Limit, log: Findings) -> None:
    given = [name for name in ("within", "at_least", "at_most") if name in limit.origin.keys]
    if not given:
        log.error(
            "meaning-limit",
            limit.origin.mark,
            "a limit needs within, at_least or at_most",
            "add for example within: ±0.5 deg/h",
        )
    if "within" in given and len(given) > 1:
        hint = "use at_least and at_most for a limit that is not symmetric"
        log.error("meaning-limit", limit.at("within"), f"'within' cannot be used together with '{given[1]}'", hint)
    if limit.rule == "simple" and "guard_band" in limit.origin.keys:
        hint = "remove it, or write rule: guarded"
        log.error("meaning-limit", limit.at("guard_band"), "'guard_band' has no meaning for the rule 'simple'", hint)
    if limit.prior is not None and not limit.prior.standard_uncertainty:
        hint = "write for example prior: 0.1 deg/h ± 0.2 deg/h"
        log.error(
            "meaning-uncertainty",
            limit.at("prior"),
            "a prior needs the standard deviation of the quantity among the tested items",
            hint,
        )
    if limit.at_least is not None and limit.at_most is not None:
        if limit.at_least.unit.dimension != limit.at_most.unit.dimension:
            low, high = (
                "a pure number" if bound.unit.text == "1" else f"in {bound.unit.text}"
                for bound in (limit.at_least, limit.at_most)
            )
            message = f"at_least is {low}, at_most is {high}: these have different dimensions"
            log.error("meaning-dimension", limit.at("at_most"), message, "give both in the unit of the coefficient")
        elif limit.at_least.value >= limit.at_most.value:
            message = f"at_least ({limit.at_least}) is not below at_most ({limit.at_most}): no value could pass"
            log.error("meaning-limit", limit.at("at_least"), message, "exchange them")


def check_channels(parameters: Record, outputs: Collection[str] | None, log: Findings) -> None:
    """Adds a finding for each channel that the sensor does not have, and for each channel that is named twice.

    `outputs`: names of the sensor's outputs; None if it is not known what will be recorded. Default channels of an estimator, which
    the plan does not name, may be absent from the outputs. The estimator itself decides whether it needs these channels.
    """
    seen: set[str] = set()
    for key, place, channel in _named(parameters):
        given = key in parameters.origin.keys
        mark = parameters.at(place)
        if channel in seen:
            hint = "give each axis and each purpose a different channel"
            log.error("meaning-channel-twice", mark, f"'{channel[:60]}' is named twice", hint)
        elif given and outputs is not None and channel not in outputs:
            message = f"{key}: the sensor of this bench has no output '{channel[:60]}'"
            log.error("meaning-sensor-output", mark, message, closest(channel, outputs))
        seen.add(channel)


def channels_of(parameters: Record) -> tuple[str, ...]:
    """Returns the channels named in parameters, including defaults."""
    return tuple(dict.fromkeys(channel for _, _, channel in _named(parameters)))


def _named(parameters: Record) -> Iterator[tuple[str, str, str]]:
    """Yields each channel that the parameters name, as a tuple of the key, the path of the value in the parameters (such as
    `channels[1]`) and the channel."""
    for key, name, kind in _naming(type(parameters)):
        value = getattr(parameters, name)
        if isinstance(kind, ListOf):
            for k, channel in enumerate(value):
                yield key, f"{key}[{k}]", channel
        elif isinstance(kind, MapOf):
            for channel in value:
                yield key, f"{key}.{channel}", channel
        elif value is not None:
            yield key, key, value


def _naming(parameters: type[Record]) -> tuple[tuple[str, str, Kind], ...]:
    """Returns a tuple for each key whose value names channels: the key, the name of its field in the record, and the kind of its
    value."""
    if parameters not in _NAMING:
        kinds = [(key, item.name, item.metadata["kind"]) for key, item in keys_of(parameters).items()]
        _NAMING[parameters] = tuple(
            (key, name, kind)
            for key, name, kind in kinds
            if kind == CHANNEL
            or (isinstance(kind, ListOf) and kind.item == CHANNEL)
            or (isinstance(kind, MapOf) and kind.of_channels)
        )
    return _NAMING[parameters]


_NAMING: dict[type[Record], tuple[tuple[str, str, Kind], ...]] = {}
