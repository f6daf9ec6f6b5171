"""Converts nested segments to a flat list of states: resolves inheritance, sweeps and repeats, and makes readable labels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.plan.model import Plan
from planrunner.plan.segments import STATE_KEYS, STATE_TRAITS, SegmentSpec, State, SweepValue

# More than any overnight plan needs; without a limit a file of a few lines could ask for any number.
MAX_SEGMENTS = 10_000

StateValues = dict[str, Any]
"""Values of the keys of a state; `UNREADABLE` replaces a value that cannot be read. The record `State` declares the keys."""

_PLACEHOLDER = re.compile(r"\{([a-z_]*)\}")


@dataclass(frozen=True, slots=True)
class StatedSegment:
    """Contains one segment of a plan: its state, which includes the inherited keys, and the position of each value in the file.

    `prompts`: prompts to the operator that precede the segment, in order, each with its position in the file. `conditioning`: True
    if the plan declares that the segment only brings the sensor to a state. `sound`: False if the state is not known completely,
    because the segment inherits a value from `defaults` that could not be read, or because its label names a key that is not swept.
    """

    label: str
    state: State
    marks: Mapping[str, Mark]
    mark: Mark
    sound: bool = True
    prompts: tuple[tuple[str, Mark], ...] = ()
    conditioning: bool = False


def expand(plan: Plan, log: Findings) -> list[StatedSegment]:
    """Makes all segments of the plan in order, except segments that contain errors themselves. Adds findings about too many
    segments, repeated or empty labels, and contradictory keys."""
    count = sum(_count(spec) for spec in plan.segments)
    if count > MAX_SEGMENTS:
        longest = max(plan.segments, key=_count)
        message = f"the plan has {_shown(count)} segments, more than {MAX_SEGMENTS}"
        log.error(
            "limit-segments",
            longest.origin.mark,
            message,
            "sweep over fewer values, repeat less often, or split the plan",
        )
        return []
    state: StateValues = {}
    marks: dict[str, Mark] = {}
    if plan.defaults is not None:
        _inherit(plan.defaults, state, marks)
        unreadable = plan.defaults.origin.broken.union(plan.defaults.origin.meant).intersection(STATE_KEYS)
        for name in sorted(unreadable) if _one_motion(plan.defaults, log) else ("rate", "motion"):
            _set(name, UNREADABLE, plan.defaults.at(name), state, marks)
    segments = [segment for spec in plan.segments for segment in _expand(spec, (), state, marks, log)]
    _check_unique(segments, log)
    return segments


UNREADABLE = object()


def _stated(state: StateValues) -> tuple[State, bool]:
    """Returns the part of a state that could be read. The second value is True if this part is enough to check a segment."""
    readable = {name: value for name, value in state.items() if value is not UNREADABLE}
    sound = len(readable) == len(state) or not any(state.get(name) is UNREADABLE for name in _DECISIVE)
    return State(**readable), sound


# Without these, the other keys of a segment cannot be judged.
_DECISIVE = tuple(name for name, traits in STATE_TRAITS.items() if traits.decisive)


def _count(spec: SegmentSpec) -> int:
    """Returns the number of segments that one entry of `segments` makes. The number includes segments that will be omitted later,
    because the expansion also processes them."""
    own = spec.repeat * (spec.for_each.size if spec.for_each else 1)
    return own * (sum(_count(step) for step in spec.steps) or 1)


def _shown(count: int) -> str:
    return str(count) if count < 10**9 else "billions of"


def _inherit(own: State, state: StateValues, marks: dict[str, Mark]) -> None:
    for name in STATE_KEYS:
        value = getattr(own, name)
        if value is not None:
            _set(name, value, own.at(name), state, marks)


def _set(name: str, value: object, mark: Mark, state: StateValues, marks: dict[str, Mark]) -> None:
    """Sets the value of a key, and the position of this value in the file. A rate replaces an inherited motion, and a motion
    replaces an inherited rate, because both define the motion of the table."""
    other = STATE_TRAITS[name].replaces
    if other is not None:
        state.pop(other, None)
        marks.pop(other, None)
    state[name] = value
    marks[name] = mark


def _one_motion(own: State, log: Findings) -> bool:
    if own.rate is None or own.motion is None:
        return True
    hint = "keep one of them: rate is short for motion: {rate: …}"
    log.error("meaning-motion", own.at("motion"), "both rate and motion are given", hint)
    return False


def _swept_once(spec: SegmentSpec, log: Findings) -> bool:
    """Returns False, and adds a finding, if a key is both swept and set to a single value, or if rate and motion are both swept."""
    swept = {axis.key: axis for axis in spec.for_each.axes} if spec.for_each else {}
    for name in swept:
        twin = STATE_TRAITS[name].replaces or name
        given = next((key for key in (name, twin) if getattr(spec, key) is not None), None)
        if given is not None:
            log.error(
                "meaning-swept-twice",
                spec.at(given),
                f"'{given}' is given here, but for_each also sweeps '{name}'",
                "keep one of them",
            )
            return False
    if "rate" in swept and "motion" in swept:
        at = swept["motion"].values[0].mark
        log.error("meaning-swept-twice", at, "for_each sweeps both rate and motion", "keep one of them")
        return False
    return True


def _expand(
    spec: SegmentSpec, path: tuple[str, ...], state: StateValues, marks: dict[str, Mark], log: Findings
) -> Iterator[StatedSegment]:
    if not spec.own_sound or not _one_motion(spec, log) or not _swept_once(spec, log):
        return
    state, marks = dict(state), dict(marks)
    _inherit(spec, state, marks)
    rows = list(spec.for_each.combinations(spec.order, spec.shuffle_seed)) if spec.for_each else [()]
    keys = [axis.key for axis in spec.for_each.axes] if spec.for_each else []
    for turn in range(1, spec.repeat + 1):
        for row in rows:
            own_state, own_marks = dict(state), dict(marks)
            for name, value in zip(keys, row, strict=True):
                _set(name, value.value, value.mark, own_state, own_marks)
            before = log.raised
            own = path + _label_parts(spec, keys, row, turn, log)
            swept = log.raised == before  # else a sweep is missing, and with it the keys that it would set
            prompts = _prompts(spec, keys, row, turn, log)
            if spec.steps:
                for step in spec.steps:
                    for segment in _expand(step, own, own_state, own_marks, log):
                        only = spec.conditioning or segment.conditioning
                        sound = segment.sound and swept
                        yield replace(segment, prompts=prompts + segment.prompts, conditioning=only, sound=sound)
                        prompts = ()
            elif own:
                readable, sound = _stated(own_state)
                yield StatedSegment(
                    "/".join(own), readable, own_marks, spec.origin.mark, sound and swept, prompts, spec.conditioning
                )
            else:
                log.error(
                    "meaning-label", spec.origin.mark, "this segment has no label", "add for example `label: zero`"
                )
                return


def _label_parts(
    spec: SegmentSpec, keys: list[str], row: tuple[SweepValue, ...], turn: int, log: Findings
) -> tuple[str, ...]:
    values = dict(zip(keys, row, strict=True))
    parts: list[str] = []
    used: set[str] = set()
    if spec.label is not None:
        parts.append(_filled(spec, "label", spec.label, values, turn, used, log))
    if spec.repeat > 1 and "repeat" not in used:
        parts.append(f"r{turn}")
    parts.extend(value.name for name, value in values.items() if name not in used)
    return tuple(parts)


def _filled(
    spec: SegmentSpec,
    key: str,
    text: str,
    values: Mapping[str, SweepValue],
    turn: int,
    used: set[str],
    log: Findings,
) -> str:
    """Returns the text of `key` after its {placeholders} have been replaced; adds the names of the placeholders to `used`. `turn`:
    number that replaces {repeat}."""

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        if name == "repeat":
            used.add(name)
            return str(turn)
        if name in values:
            used.add(name)
            return values[name].short
        known = [*values, "repeat"]
        message = f"{{{name[:40]}}} in the {key} is not swept here"
        log.error("meaning-label", spec.at(key), message, closest(name, known))
        return name

    return _PLACEHOLDER.sub(fill, text)


def _prompts(
    spec: SegmentSpec, keys: list[str], row: tuple[SweepValue, ...], turn: int, log: Findings
) -> tuple[tuple[str, Mark], ...]:
    if spec.prompt is None:
        return ()
    values = dict(zip(keys, row, strict=True))
    return ((_filled(spec, "prompt", spec.prompt, values, turn, set(), log), spec.at("prompt")),)


def _check_unique(segments: list[StatedSegment], log: Findings) -> None:
    """Adds one finding for each position in the plan that makes repeated labels, however many labels are repeated."""
    first: dict[str, Mark] = {}
    repeated: dict[Mark, list[str]] = {}
    for segment in segments:
        if segment.label in first:
            repeated.setdefault(segment.mark, []).append(segment.label)
        else:
            first[segment.label] = segment.mark
    for mark, labels in repeated.items():
        more = f" (and {len(labels) - 1} more)" if len(labels) > 1 else ""
        message = f"the label '{labels[0]}'{more} is used twice (first on line {first[labels[0]].line})"
        log.error("meaning-label-repeated", mark, message, "give each segment or sweep a unique label")
