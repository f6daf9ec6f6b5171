"""Computes the meaning of a plan or a bench: everything that affects what is done or measured, and nothing else.

The meaning is the expanded content of the file. It has one entry for each segment, with inherited and default keys filled in, and
with quantities in SI-coherent units. Comments, formatting, the order of keys, the way in which a sweep is written, units, and texts
for readers (title, description) are not part of the meaning. Two files with the same meaning have the same canonical JSON (RFC
8785) and the same SHA-256 digest.

Numbers are rounded to 12 significant digits, so that the conversion of units does not change them. Labels are part of the meaning,
because recordings and estimates refer to segments by labels.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from enum import Enum
from functools import lru_cache

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import Json, JsonObject
from planrunner.base.findings import Findings, InputError, Mark
from planrunner.bench.model import Bench, InstrumentEntry, runs_on_virtual_clock, safe_order
from planrunner.instruments.formats.choice import Format
from planrunner.plan.expand import StatedSegment, expand
from planrunner.plan.kinds import Record, keys_of
from planrunner.plan.meaning import check_meaning
from planrunner.plan.model import USUAL, DiagnosisSpec, EstimateSpec, Limit, Plan, RunItem, SymmetricKind
from planrunner.plan.motion import motion_of
from planrunner.plan.orientation import Orientation
from planrunner.plan.quantity import Quantity, parse_quantity, parse_symmetric
from planrunner.plan.schedule import Cycle, RecordedMotion, Rest, Rock, Spin
from planrunner.plan.segments import MotionSpec, StabilitySpec, State, Turns
from planrunner.plan.selection import Detection, Labels
from planrunner.plan.units import Dimension

VERSION = 1
"""Version of the format in which the meaning of a plan is written. A digest is valid for one version only."""

DIGITS = 12
"""Number of significant digits of a number. Unit conversions are exact to about 15 digits."""


@dataclass(frozen=True, slots=True)
class StatedValue:
    """One value in the meaning of a plan or bench.

    `content`: the canonical form of the value, for digests. `shown`: the value as the file writes it, for readers. `quantity`: if
    the value is a quantity, the quantity with its unit as written; otherwise None.
    """

    content: Json
    shown: str
    quantity: Quantity | None = None


Branch = StatedValue | dict[str, "Branch"] | list["Branch"]
"""A part of a meaning: a value, parts by name, or a list of parts."""


@dataclass(frozen=True, slots=True)
class Meaning:
    """The meaning of a plan or bench: everything in its file that affects what is done or measured.

    `kind`: `plan` or `bench`. `content`: maps each key to a part of the meaning. `texts`: texts for readers, which are not part of
    the meaning.
    """

    kind: str
    content: dict[str, Branch]
    texts: Mapping[str, str]

    def document(self) -> JsonObject:
        """Returns the meaning as a JSON document."""
        return {"planrunner_meaning": VERSION, self.kind: plain(self.content)}

    def canonical(self) -> bytes:
        """Returns the document as canonical JSON (RFC 8785)."""
        return canonical_json(self.document())

    def digest(self) -> str:
        """Returns the SHA-256 of the canonical JSON, as 64 hexadecimal digits."""
        return hashlib.sha256(self.canonical()).hexdigest()

    def lines(self) -> Iterator[str]:
        """Yields the meaning as lines of text, for programs that compare texts line by line. Each line contains the path of a
        value, and the value."""
        yield f"{self.kind} {VERSION}"
        yield from _lines("", self.content)


def canonical_json(value: Json) -> bytes:
    """Returns the canonical form of a JSON value according to RFC 8785: sorted keys, no spaces, shortest numbers."""
    import rfc8785  # not needed by `check`

    return rfc8785.dumps(value)


def digest_of_bench(bench: Bench) -> str:
    """Returns the SHA-256 of the meaning of a bench, as 64 hexadecimal digits."""
    return meaning_of_bench(bench).digest()


def meaning_of_plan(plan: Plan, bench: Bench | None = None) -> Meaning:
    """Returns the meaning of a plan. Raises `InputError` with the findings if the plan has errors.

    `bench`: the bench on which the plan runs. If a bench is given, the meaning contains the meaning of the bench; otherwise, it
    contains only the name of the bench in the plan.
    """
    log = Findings()
    for name in sorted(plan.origin.broken):
        log.error("review-unread", plan.at(name), f"'{name}' could not be read completely", "correct it first")
    stated = expand(plan, log)
    check_meaning(plan, stated, plan.report, log)  # whether reports exist is no question of meaning
    segments = [_segment(item, log) for item in stated]
    if log.errors or not stated:
        raise InputError(log)
    labels = Labels([item.label for item in stated])
    names = [item.label for item in stated]
    estimates = {name: _estimate(spec, labels, names) for name, spec in plan.estimates.items()}
    content: dict[str, Branch] = {
        "sensor": _record(plan.sensor),
        "bench": _bench_of(plan, bench),
        "record": {name: _of(item) for name, item in plan.record.items()},
        "mounting": {name: _record(axis) for name, axis in plan.mounting.items()},
        "segments": [*segments],
        "estimates": {**estimates},
        "limits": _in_order([_limit(limit) for limit in plan.limits]),
        "diagnosis": _selecting(plan.diagnosis or DiagnosisSpec(), labels, names),
        "report": _in_order([_of(name) for name in dict.fromkeys(plan.report)]),
    }
    texts = {"title": plan.title, "description": plan.description, "author": ", ".join(plan.author)}
    return Meaning("plan", content, texts)


def meaning_of_bench(bench: Bench) -> Meaning:
    """Returns the meaning of a bench. Calibrations and asset numbers are part of the meaning, because results are traceable through
    them."""
    content = _record(bench)
    for name in ("planrunner_bench", "description"):
        content.pop(name)
    content["clock"] = _of("virtual" if runs_on_virtual_clock(bench) else "wall")
    content["safe_order"] = [_of(name) for name in safe_order(bench)]
    return Meaning("bench", content, {"description": bench.description})


def procedure_of(plan: Plan) -> Meaning:
    """Returns the meaning of a plan without its bench. An approval covers this meaning, together with the benches named in the
    approval. Raises `InputError` for a plan with errors."""
    meaning = meaning_of_plan(plan)
    return replace(meaning, content={name: part for name, part in meaning.content.items() if name != "bench"})


def equipment_of(bench: Bench) -> Meaning:
    """Returns the meaning of a bench without the approvals that it requires. An approval therefore remains valid if only these
    requirements change."""
    meaning = meaning_of_bench(bench)
    return replace(meaning, content={name: part for name, part in meaning.content.items() if name != "approvals"})


def plain(branch: Branch) -> Json:
    """Returns the canonical content of a part of a meaning, as JSON data."""
    if isinstance(branch, StatedValue):
        return branch.content
    if isinstance(branch, dict):
        parts = ((name, plain(part)) for name, part in branch.items())
        return {name: content for name, content in parts if content is not None}
    return [plain(part) for part in branch]


def _bench_of(plan: Plan, bench: Bench | None) -> Branch:
    if bench is None:
        return StatedValue({"name": plan.bench}, plan.bench)
    digest = digest_of_bench(bench)
    return StatedValue({"sha256": digest}, f"{bench.name} ({digest[:12]})")


# -- segments --------------------------------------------------------------------------------------------------------


def _segment(item: StatedSegment, log: Findings) -> dict[str, Branch]:
    state = item.state
    return {
        "label": _of(item.label),
        "orientation": _of(state.orientation),
        "motion": _motion(state, item.marks, log),
        "temperature": _of(state.temperature),
        "supply_voltage": _of(state.supply_voltage),
        "ambient_pressure": _of(state.ambient_pressure),
        "soak": _wait(state.soak),
        "settle": _wait(state.settle),
        "dwell": _dwell(state.dwell),
        "sample_rate": _of(state.sample_rate),
        "mode": _of(state.mode),
        "watch": _of(state.watch),
        "on_break": _of(state.on_break or "retake"),
        "prompts": [_of(text) for text, _ in item.prompts],
        "conditioning": _of(item.conditioning),
    }


_NO_WAIT = parse_quantity("0 s")


def _wait(stated: Quantity | StabilitySpec | None) -> Branch:
    return _of(_NO_WAIT if stated is None else stated)


def _dwell(stated: Quantity | Turns | str | None) -> Branch:
    if isinstance(stated, Turns):
        return {name: part for name, part in _record(stated).items() if part != _NOTHING}
    return _of(stated)


_REST = StatedValue("rest", "rest")


def _motion(state: State, marks: Mapping[str, Mark], log: Findings) -> Branch:
    """Returns the motion as the table executes it. A rate becomes a spin about the vertical, and clockwise angles become negative."""
    dwell = state.dwell.value if isinstance(state.dwell, Quantity) else None
    motion = motion_of(state, marks, dwell, log)
    if motion is None or isinstance(motion, Rest):
        return _REST
    spec = state.motion if isinstance(state.motion, MotionSpec) else MotionSpec(rate=state.rate)
    sign = -1.0 if spec.sense == "clockwise" else 1.0
    if isinstance(motion, Spin) and spec.rate is not None:
        rate = replace(spec.rate, value=motion.rate)
        return {"rate": _of(rate), "about": StatedValue([_number(part) for part in motion.about], spec.about)}
    if isinstance(motion, Rock) and spec.rock is not None:
        left = math.inf if dwell is None else dwell - motion.steady
        whole = math.isclose(motion.duration, left, rel_tol=1e-9) or spec.for_ is None
        phases = spec.rock.phases or (parse_quantity("0 deg"),)
        return {
            "amplitude": _of(spec.rock.amplitude),
            "frequency": _of(spec.rock.frequency),
            "phases": [_of(phase) for phase in phases],
            "for": StatedValue(None, "the rest of the dwell") if whole else _of(spec.for_),
            "after": _of(spec.after),
        }
    if isinstance(motion, RecordedMotion) and spec.recorded is not None:
        shown: dict[str, Branch] = {
            name: [StatedValue(channel, channel) for channel in channels]
            for name, channels in (
                ("attitude", motion.attitude),
                ("rates", motion.rates),
                ("forces", motion.forces),
            )
            if channels
        }
        if motion.angle:
            shown["angle"] = StatedValue(motion.angle, motion.angle)
            shown["about"] = StatedValue([_number(part) for part in motion.about], spec.about)
        return {"recorded": shown | {"averaging": _of(spec.recorded.averaging)}}
    assert isinstance(motion, Cycle) and spec.cycle is not None
    positions = {name: _of(replace(angle, value=sign * angle.value)) for name, angle in spec.cycle.items()}
    moves = [
        StatedValue(
            [move.start, _number(move.turn), move.end], f"{move.start} {math.degrees(move.turn):+.9g} {move.end}"
        )
        for move in motion.moves
    ]
    return {
        "cycle": {**positions},
        "moves": [*moves],
        "turn_rate": _of(spec.turn_rate),
        "stop": _of(spec.stop),
    }


# -- results ---------------------------------------------------------------------------------------------------------


def _estimate(spec: EstimateSpec, labels: Labels, names: Sequence[str]) -> dict[str, Branch]:
    parts = _selecting(spec, labels, names)
    parts["uses"] = _in_order([_of(name) for name in spec.uses])
    if spec.validate is not None and isinstance(spec.validate, str):
        parts["validate"] = _record(USUAL)
    return parts


def _selecting(spec: EstimateSpec | DiagnosisSpec, labels: Labels, names: Sequence[str]) -> dict[str, Branch]:
    """Returns the meaning of a record that selects segments. The patterns in the record are replaced by the labels that they
    select."""
    parts = _record(spec)
    if isinstance(spec.segments, Detection):
        found = _record(spec.segments)
        found["within"] = _selected(spec.segments.within, labels, names)
        parts["segments"] = found
    else:
        parts["segments"] = _selected(spec.segments, labels, names)
    return parts


def _selected(patterns: Sequence[str], labels: Labels, names: Sequence[str]) -> Branch:
    chosen: set[int] = set()
    for pattern in patterns:
        chosen |= labels.meant_by(pattern)
    return [_of(names[index]) for index in sorted(chosen)]


def _limit(limit: Limit) -> dict[str, Branch]:
    """Returns the meaning of a limit with its two bounds. ±x means at least −x and at most x."""
    parts = _record(limit)
    bound = None if limit.within is None else parse_symmetric(limit.within)
    parts.pop("within")
    if bound is not None:
        parts["at_least"], parts["at_most"] = _of(replace(bound, value=-bound.value)), _of(bound)
    return parts


def _in_order(parts: Sequence[Branch]) -> list[Branch]:
    """Sorts a list whose order has no meaning, by the canonical forms of its parts."""
    return sorted(parts, key=lambda part: canonical_json(plain(part)))


# -- values ----------------------------------------------------------------------------------------------------------

_NOTHING = StatedValue(None, "none")


def _of(value: object) -> Branch:
    """Returns the meaning of a value that was read from a plan or bench. Raises `InputError` for a value of a plug-in that has no
    JSON form."""
    match value:
        case None:
            return _NOTHING
        case bool():
            return StatedValue(value, "yes" if value else "no")
        case Enum():
            return _of(value.value)
        case str():
            return StatedValue(value, value)
        case int() | float():
            return StatedValue(_number(value), f"{value:.{DIGITS}g}" if isinstance(value, float) else str(value))
        case Quantity():
            return _stated_quantity(value)
        case Orientation():
            return StatedValue(_matrix(value), value.text)
        case RunItem():
            return StatedValue(value.required, "required" if value.required else "optional")
        case Record():
            return _record(value)
        case Mapping():
            return {str(name): _of(item) for name, item in value.items()}
        case list() | tuple():
            return [_of(item) for item in value]
        case _ if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = dataclasses.fields(value)
            return {item.name: _of(getattr(value, item.name)) for item in fields if item.compare}
    message = (
        f"a value of the type '{type(value).__name__}' has no JSON form, so this file cannot be compared or approved"
    )
    hint = "the plug-in must read the value into a number, a text, a quantity or a record"
    raise InputError.at(Mark("<plug-in>"), "review-value", message, hint)


def _record(record: Record) -> dict[str, Branch]:
    """Returns the meaning of a record: every key with its value. The keys of a plug-in are at the same level as the common keys, as
    in the file."""
    parts: dict[str, Branch] = {}
    for name, item in keys_of(type(record)).items():
        value = getattr(record, item.name)
        kind = item.metadata["kind"]
        if isinstance(kind, SymmetricKind) and isinstance(value, str):
            bound = parse_symmetric(value)
            parts[name] = StatedValue(value if bound is None else _quantity(bound), value)
        else:
            parts[name] = _of(value)
    if isinstance(record, EstimateSpec | InstrumentEntry | Format):
        parts.update(_record(record.parameters))
    return parts


@lru_cache(maxsize=4096)
def _stated_quantity(quantity: Quantity) -> StatedValue:
    """Returns the meaning of a quantity. Results are cached, because plans repeat their quantities."""
    return StatedValue(_quantity(quantity), str(quantity), quantity)


def _quantity(quantity: Quantity) -> JsonObject:
    content: JsonObject = {"value": _number(quantity.value), "unit": si_unit(quantity.unit.dimension)}
    if quantity.standard_uncertainty:
        content["standard_uncertainty"] = _number(quantity.standard_uncertainty)
        content["distribution"] = quantity.distribution
        if math.isfinite(quantity.degrees_of_freedom):
            content["degrees_of_freedom"] = _number(quantity.degrees_of_freedom)
    return content


@lru_cache(maxsize=1024)
def _matrix(orientation: Orientation) -> Json:
    """Returns the meaning of an orientation: its matrix, rounded to 12 decimals because components of unit vectors are all on the
    same scale. Rows are the sensor's axes in East-North-Up."""
    if orientation.matrix is None:
        return "unknown"
    return [[round(part, DIGITS) + 0.0 for part in row] for row in orientation.matrix]


_LARGEST_INTEGER = 2**53
"""Largest integer that a JSON number represents exactly (RFC 8785, 3.2.2.3). Larger integers, such as seeds, are written as
texts."""


def _number(value: float) -> Json:
    if isinstance(value, int):
        return value if abs(value) < _LARGEST_INTEGER else str(value)
    if not math.isfinite(value):
        return str(value)
    return float(f"{value:.{DIGITS}g}") + 0.0


_SYMBOLS = {
    "length": "m",
    "mass": "kg",
    "time": "s",
    "temperature": "K",
    "current": "A",
    "angle": "rad",
    "local_gravity": "local_g",
}


@lru_cache(maxsize=256)
def si_unit(dimension: Dimension) -> str:
    """Returns the SI-coherent unit of a dimension, such as `rad s^-1`; `1` for a ratio."""
    parts = [_SYMBOLS.get(name, name) + ("" if power == 1 else f"^{power:g}") for name, power in dimension]
    return " ".join(parts) or "1"


def _lines(path: str, branch: Branch) -> Iterator[str]:
    if isinstance(branch, StatedValue):
        yield f"{path}: {canonical_json(branch.content).decode()}"
    elif isinstance(branch, dict):
        for name in sorted(branch):
            yield from _lines(f"{path}.{name}" if path else name, branch[name])
    elif not branch:
        yield f"{path}: []"
    else:
        for index, part in enumerate(branch):
            label = part.get("label") if isinstance(part, dict) else None
            name = str(index + 1) if not isinstance(label, StatedValue) else str(canonical_json(label.content).decode())
            yield from _lines(f"{path}[{name}]", part)
