"""Generates the reference of all keys, `docs/plan-keys.md`, from the record classes with which plans are read.

The command `python -m planrunner.plan.reference docs` writes the file. A test checks that the file is up to date.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol, runtime_checkable

from planrunner.base import plugins
from planrunner.plan import model, selection
from planrunner.plan.kinds import (
    Boolean,
    ByShape,
    Choice,
    Kind,
    ListOf,
    MapOf,
    Number,
    Plugged,
    QuantityOf,
    Record,
    RecordOf,
    Text,
    WordOr,
    inline,
    is_required,
    keys_of,
)
from planrunner.plan.orientation import OrientationKind
from planrunner.plan.quantity import RICH_KEYS
from planrunner.plan.segments import (
    SWEPT_KEYS,
    ForEachKind,
    MotionSpec,
    Ramp,
    RecordedSpec,
    RockSpec,
    SegmentKind,
    SegmentSpec,
    StabilitySpec,
    State,
    Turns,
    WatchSpec,
)

_HEAD = """\
# Every key of a plan

Generated from the source code with `python -m planrunner.plan.reference docs`; do not edit.
[plan-language.md](plan-language.md) explains the keys with complete examples. A key in **bold** is required.
Write an angle, a time or another physical quantity as a number with its unit.
"""

_SECTIONS: tuple[tuple[str, str, type[Record]], ...] = (
    ("A plan", "The top of the file.", model.Plan),
    ("`sensor`", "", model.Sensor),
    ("`mounting`: each axis", "", model.MountedAxis),
    ("A state", "Keys of `defaults` and of every segment.", State),
    ("A segment", "In addition to the keys of a state.", SegmentSpec),
    ("`motion`", "", MotionSpec),
    ("`motion`: `rock`", "", RockSpec),
    ("`motion`: `recorded`", "", RecordedSpec),
    ("`temperature`: a ramp", "", Ramp),
    ("`dwell`: whole turns or cycles", "", Turns),
    ("`settle`, `soak`: until readings have settled", "", StabilitySpec),
    ("`watch`", "", WatchSpec),
    ("An estimate", "", model.EstimateSpec),
    ("`segments` found in the data", "", selection.Detection),
    ("A limit", "", model.Limit),
    ("`diagnosis`", "", model.DiagnosisSpec),
)


def keys_reference() -> str:
    """Writes the whole page of the reference, with the keys of every installed estimator."""
    state = set(keys_of(State))
    parts = [_HEAD]
    for title, about, record in _SECTIONS:
        fields = keys_of(record)
        if record is SegmentSpec:
            fields = {name: item for name, item in fields.items() if name not in state}
        parts.append(section(title, about or first_line(record), fields))
    parts.append(_quantity_section())
    for name in plugins.names(plugins.ESTIMATORS):
        plugin = plugins.load(plugins.ESTIMATORS, name)
        fields = keys_of(plugin.Parameters)
        about = str(plugin.summary).rstrip(".") + "."
        parts.append(section(f"Estimator `{name}`", about if fields else f"{about} It has no further keys.", fields))
    return "\n".join(parts)


def section(title: str, about: str, fields: Mapping[str, dataclasses.Field[object]]) -> str:
    """Writes the section of the page about one record: its title, a text, and a table of its keys."""
    if not fields:
        return f"## {title}\n\n{about}\n"
    lines = [f"## {title}", "", about, "", "| key | value | meaning | example |", "|---|---|---|---|"]
    for name, item in fields.items():
        shown = f"**`{name}`**" if is_required(item) else f"`{name}`"
        meta = item.metadata
        lines.append(
            f"| {shown} | {_cell(type_words(meta['kind']))} | {_cell(meta['description'])} | "
            f"`{_cell(inline(meta['example']))}` |"
        )
    return "\n".join(lines) + "\n"


def _quantity_section() -> str:
    lines = [
        "## A quantity as a mapping",
        "",
        "This mapping can replace any quantity that is written as text.",
        "",
        "| key | meaning | example |",
        "|---|---|---|",
    ]
    lines += [f"| `{name}` | {description} | `{example}` |" for name, (description, example) in RICH_KEYS.items()]
    return "\n".join(lines) + "\n"


@runtime_checkable
class Described(Protocol):
    """A kind that describes the values that it accepts."""

    what: str


def type_words(kind: Kind) -> str:
    """Describes in words the values that a kind accepts."""
    match kind:
        case Text():
            return kind.what
        case Choice():
            return "one of " + ", ".join(f"`{name}`" for name in kind.names)
        case Number():
            what = "a whole number" if kind.integer else "a number"
            return f"{kind.minimum:g}" if kind.minimum == kind.maximum else f"{what}{_bounds(kind)}"
        case Boolean():
            return "`true` or `false`"
        case QuantityOf():
            sign = {"positive": ", above zero", "not negative": ", zero or more"}.get(kind.sign, "")
            return f"{_quantity_words(kind.dimension)}{sign}"
        case ListOf():
            item = type_words(kind.item)
            return f"{item}, or a list of such values" if kind.single else f"a list; each item is {item}"
        case MapOf():
            names = f"one of {', '.join(kind.names)}" if kind.names else "a name"
            values = type_words(kind.item)
            if isinstance(kind.item, ListOf) and not kind.item.single:
                values = f"a list (each item is {type_words(kind.item.item)})"
            if isinstance(kind.item, MapOf):
                values = f"itself a mapping (each key is a name, each value is {type_words(kind.item.item)})"
            return f"a mapping; each key is {names}, each value is {values}"
        case WordOr():
            return " or ".join([*(f"`{word}`" for word in kind.words), type_words(kind.other)])
        case ByShape():
            return ", or ".join(
                type_words(part) for part in (kind.scalar, kind.mapping, kind.sequence) if part is not None
            )
        case ForEachKind():
            return f"a mapping with any of these keys, each with its values: {', '.join(SWEPT_KEYS)}"
        case RecordOf() | Plugged():
            return _RECORDS.get(kind.record, "a mapping of keys")
    for own, words in _OWN.items():
        if isinstance(kind, own):
            return words
    return kind.what if isinstance(kind, Described) else "see the description"


def _quantity_words(dimension: str | None) -> str:
    if dimension is None:
        return "a quantity with any unit"
    return f"{'an' if dimension[0] in 'aeiou' else 'a'} {dimension}"


_OWN: dict[type, str] = {
    OrientationKind: "an orientation",
    selection.SelectionKind: "one label or pattern, a list of labels or patterns, or intervals found in the data",
    SegmentKind: "a segment",
    model.RunItemKind: "`required` or `optional`",
    model.SymmetricKind: "± and a number with its unit",
}
_RECORDS: dict[type[Record], str] = {
    model.Sensor: "a sensor",
    model.MountedAxis: "the direction of that axis",
    State: "a state",
    MotionSpec: "a motion",
    RockSpec: "rocking",
    RecordedSpec: "channels that show a motion",
    Ramp: "a ramp",
    Turns: "whole turns or cycles",
    StabilitySpec: "readings that must settle",
    WatchSpec: "limits",
    model.EstimateSpec: "an estimate",
    model.Limit: "a limit",
}


def _bounds(kind: Number) -> str:
    if math.isfinite(kind.minimum) and math.isfinite(kind.maximum):
        return f" from {kind.minimum:.12g} to {kind.maximum:.12g}"
    if math.isfinite(kind.minimum):
        return f", {kind.minimum:.12g} or more"
    return f", {kind.maximum:.12g} or less" if math.isfinite(kind.maximum) else ""


def first_line(record: type) -> str:
    return (record.__doc__ or "").split("\n")[0]


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


if __name__ == "__main__":
    (Path(sys.argv[1]) / "plan-keys.md").write_text(keys_reference(), encoding="utf-8")
