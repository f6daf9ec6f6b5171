"""From nested segments to a flat list of states: inheritance, sweeps, repeats and readable labels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from planrunner.plan.findings import Findings, Mark, closest
from planrunner.plan.model import STATE_KEYS, Plan, SegmentSpec, State
from planrunner.plan.sweep import SweepValue

MAX_SEGMENTS = 200_000

_PLACEHOLDER = re.compile(r"\{([a-z_]*)\}")


@dataclass(frozen=True, slots=True)
class StatedSegment:
    """One segment with all that it inherited: key → value as read, and where each value stands."""

    label: str
    state: Mapping[str, Any]
    marks: Mapping[str, Mark]
    mark: Mark


def expand(plan: Plan, log: Findings) -> list[StatedSegment]:
    """Every segment in order. Findings: too many, repeated or empty labels, keys that make no sense together."""
    state: dict[str, Any] = {}
    marks: dict[str, Mark] = {}
    if plan.defaults is not None:
        _inherit(plan.defaults, state, marks)
    segments: list[StatedSegment] = []
    for spec in plan.segments:
        for segment in _expand(spec, (), state, marks, log):
            segments.append(segment)
            if len(segments) > MAX_SEGMENTS:
                log.error("limit-segments", spec.origin.mark, f"more than {MAX_SEGMENTS} segments", "sweep over fewer values")
                return []
    return _unique(segments, log)


def _inherit(own: State, state: dict[str, Any], marks: dict[str, Mark]) -> None:
    for name in STATE_KEYS:
        value = getattr(own, name)
        if value is not None:
            _set(name, value, own.at(name), state, marks)


def _set(name: str, value: Any, mark: Mark, state: dict[str, Any], marks: dict[str, Mark]) -> None:
    """A rate replaces an inherited motion and the other way round: both say what the table does."""
    for other in {"rate": ("motion",), "motion": ("rate",)}.get(name, ()):
        state.pop(other, None)
    state[name] = value
    marks[name] = mark


def _expand(
    spec: SegmentSpec, path: tuple[str, ...], state: dict[str, Any], marks: dict[str, Mark], log: Findings
) -> Iterator[StatedSegment]:
    if not spec.sound:
        return
    if spec.rate is not None and spec.motion is not None:
        log.error("meaning-motion", spec.at("motion"), "both rate and motion", "keep one: rate is short for motion: {rate: …}")
        return
    if spec.for_each is not None and spec.for_each.size * spec.repeat > MAX_SEGMENTS:
        log.error("limit-segments", spec.for_each.mark, f"more than {MAX_SEGMENTS} segments", "sweep over fewer values")
        return
    state, marks = dict(state), dict(marks)
    _inherit(spec, state, marks)
    for turn in range(1, spec.repeat + 1):
        rows = spec.for_each.combinations(spec.order, spec.shuffle_seed) if spec.for_each else iter([()])
        keys = [axis.key for axis in spec.for_each.axes] if spec.for_each else []
        for row in rows:
            own_state, own_marks = dict(state), dict(marks)
            for name, value in zip(keys, row, strict=True):
                _set(name, value.value, value.mark, own_state, own_marks)
            own = path + _label_parts(spec, keys, row, turn, log)
            if spec.steps:
                for step in spec.steps:
                    yield from _expand(step, own, own_state, own_marks, log)
            elif own:
                yield StatedSegment("/".join(own), own_state, own_marks, spec.origin.mark)
            else:
                log.error("meaning-label", spec.origin.mark, "this segment has no label", "add for example `label: zero`")
                return


def _label_parts(
    spec: SegmentSpec, keys: list[str], row: tuple[SweepValue, ...], turn: int, log: Findings
) -> tuple[str, ...]:
    values = dict(zip(keys, row, strict=True))
    parts: list[str] = []
    used: set[str] = set()

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        if name == "repeat":
            used.add(name)
            return str(turn)
        if name in values:
            used.add(name)
            return values[name].short
        known = [*values, "repeat"]
        log.error("meaning-label", spec.at("label"), f"{{{name[:40]}}} in the label is not swept here", closest(name, known))
        return name

    if spec.label is not None:
        parts.append(_PLACEHOLDER.sub(fill, spec.label))
    if spec.repeat > 1 and "repeat" not in used:
        parts.append(f"r{turn}")
    parts.extend(value.name for name, value in values.items() if name not in used)
    return tuple(parts)


def _unique(segments: list[StatedSegment], log: Findings) -> list[StatedSegment]:
    first: dict[str, Mark] = {}
    for segment in segments:
        if segment.label in first:
            message = f"the label '{segment.label}' is used twice (first on line {first[segment.label].line})"
            log.error("meaning-label-repeated", segment.mark, message, "give each segment or sweep a label of its own")
        else:
            first[segment.label] = segment.mark
    return segments
