"""Reads the key `for_each`, which states sweeps over states. Several swept keys give all combinations of their values, in which the
first key changes slowest.

for_each: {rate: "±300, ±150 deg/s"}                    + then − for each
for_each: {temperature: [-40 degC, 20 degC]}
for_each: {orientation: {P1: {x: up, y: north}, …}}     names become labels

A label depends only on its value, never on the other values, so that adding, removing or splitting values renames no segment.
References to labels, tables of recordings, and plans that a design has written therefore stay valid. Signs therefore follow one
rule:

- a rate always has its sign, because the sign is the sense of rotation (`R+10`, `R-10`);
- any other quantity has a sign only below zero, as engineers usually write it (`20degC`, `-40degC`);
- zero has no sign (`R0`).

An alternative would be signs only in sweeps that contain both signs. It was rejected because of two changes of names: `20degC`
would be renamed when -40 degC is added, and `R+10` would become `R10` when a design splits a sweep into one sweep for each rate.
"""

from __future__ import annotations

import random
import re
from collections.abc import Iterator, Mapping
from dataclasses import replace

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.plan import source
from planrunner.plan.kinds import ByShape, Kind, QuantityOf, Record, Schema, Sign, WordOr, has_sign, keys_of
from planrunner.plan.quantity import (
    Quantity,
    QuantityError,
    anchored,
    is_signed,
    parse_signed,
    parse_sweep,
    refuse_uncertainty,
    signed_schema,
    sweep_schema,
    uncertain_piece,
)


@dataclass(frozen=True, slots=True)
class SweepValue:
    """One value of a sweep. `name`: the part of a label that shows the value. `short`: the text that replaces a {placeholder} in a
    label."""

    name: str
    short: str
    value: object
    mark: Mark


@dataclass(frozen=True, slots=True)
class SweepAxis:
    key: str
    values: tuple[SweepValue, ...]


@dataclass(frozen=True, slots=True)
class Sweep:
    mark: Mark
    axes: tuple[SweepAxis, ...]

    @property
    def size(self) -> int:
        size = 1
        for axis in self.axes:
            size *= len(axis.values)
        return size

    def combinations(self, order: str, seed: int) -> Iterator[tuple[SweepValue, ...]]:
        """Returns every combination of the values, with one value for each swept key, in the given order."""
        rows = list(_product(self.axes, serpentine=order == "serpentine"))
        if order == "reversed":
            rows.reverse()
        elif order == "shuffled":
            random.Random(seed).shuffle(rows)
        return iter(rows)


def _product(axes: tuple[SweepAxis, ...], serpentine: bool) -> Iterator[tuple[SweepValue, ...]]:
    if not axes:
        yield ()
        return
    for index, value in enumerate(axes[0].values):
        rest = _product(axes[1:], serpentine)
        if serpentine and index % 2:
            rest = iter(list(rest)[::-1])
        for row in rest:
            yield (value, *row)


@dataclass(frozen=True, slots=True)
class StateTraits:
    """Properties of a key of a state in addition to its value.

    `swept`: True if the key may be swept with `for_each`. `directed`: True if the sign of the quantity is a direction, so that
    labels show + as well as −. `decisive`: True if the rest of the segment cannot be checked when the value of this key could not
    be read. `replaces`: another key that states the same property in another form. A segment has only one of the two keys: setting
    this key removes an inherited value of the other key. `sweep_example`: an example of a sweep; it is given if the example of one
    value does not show how to write a sweep.
    """

    swept: bool = False
    directed: bool = False
    decisive: bool = False
    replaces: str | None = None
    sweep_example: object = None


def traits_of(state: type[Record]) -> dict[str, StateTraits]:
    """Returns the traits of each key of a state, in the order of declaration."""
    return {name: item.metadata["traits"] or StateTraits() for name, item in keys_of(state).items()}


@dataclass(frozen=True, slots=True)
class SweptKey:
    """Describes one key of a state for which `for_each` can state a list of values. `quantity`: the kind of the values if they are
    quantities; otherwise None."""

    name: str
    kind: Kind
    quantity: QuantityOf | None
    directed: bool
    example: object


_NAME = r"[^/\x00-\x1f]{1,60}"


@dataclass(frozen=True, slots=True)
class ForEachKind:
    """Reads the value of `for_each`, a sweep over those keys of `state` that may be swept."""

    state: type[Record]

    @property
    def keys(self) -> Mapping[str, SweptKey]:
        if self.state not in _SWEPT:
            _SWEPT[self.state] = _swept_keys(self.state)
        return _SWEPT[self.state]

    def read(self, node: source.Node, log: Findings) -> Sweep | None:
        if not isinstance(node, source.Mapping) or not node.entries:
            log.error(
                "form-type",
                node.mark,
                "for_each must be a mapping of keys to the values of their sweep",
                "write {rate: '±300, ±150 deg/s'}",
            )
            return None
        axes = []
        keys = self.keys
        for name, item in node.entries:
            if name.text not in keys:
                log.error(
                    "form-unknown-key", name.mark, f"'{name.text[:60]}' cannot be swept", closest(name.text, keys)
                )
                continue
            values = _values(keys[name.text], item, log)
            if values:
                axes.append(SweepAxis(name.text, values))
        return Sweep(node.mark, tuple(axes)) if len(axes) == len(node.entries) else None

    def schema(self) -> Schema:
        return {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": False,
            "properties": {name: _swept(item) for name, item in self.keys.items()},
        }


_SWEPT: dict[type[Record], Mapping[str, SweptKey]] = {}


def _swept_keys(state: type[Record]) -> Mapping[str, SweptKey]:
    fields, traits = keys_of(state), traits_of(state)
    return {
        name: SweptKey(
            name,
            item.metadata["kind"],
            _quantity_kind(item.metadata["kind"]),
            traits[name].directed,
            traits[name].sweep_example or [item.metadata["example"]],
        )
        for name, item in fields.items()
        if traits[name].swept
    }


def _swept(key: SweptKey) -> Schema:
    value = key.kind.schema()
    one: Schema = value if key.quantity is None else {"anyOf": [value, signed_schema()]}
    forms: list[Schema] = [
        {"type": "array", "minItems": 1, "items": one},
        {
            "type": "object",
            "minProperties": 1,
            "additionalProperties": value,
            "propertyNames": {"pattern": anchored(_NAME)},
        },
    ]
    what = "a list, or a mapping of names to values; the names become labels"
    if key.quantity is not None:
        forms.append(sweep_schema())
        what = "a list, a mapping of names to values, or one text with a shared unit, such as '±300, ±150 deg/s'"
    return {"description": f"Values of {key.name}: {what}.", "examples": [key.example], "anyOf": forms}


def _values(key: SweptKey, node: source.Node, log: Findings) -> tuple[SweepValue, ...] | None:
    if isinstance(node, source.Mapping):
        return _named(key.kind, node, log)
    if isinstance(node, source.Sequence):
        if not node.items:
            log.error("form-size", node.mark, "at least one value is needed here", "list the values")
            return None
        before = log.raised
        read = [value for item in node.items for value in _entry(key, item, log)]
        return _labelled(key, read) if log.raised == before else None
    if key.quantity is None:
        log.error(
            "form-type", node.mark, f"{key.name} is swept over a list or a mapping of names", "write {A: …, B: …}"
        )
        return None
    if not isinstance(node.value, str):
        text = node.text[:40] or "nothing"
        log.error(
            "form-type",
            node.mark,
            f"values with a unit are expected here, not {text}",
            "write for example '±300, ±150 deg/s'",
        )
        return None
    if not _is_exact(key.quantity, node, node.value, log):
        return None
    try:
        quantities = parse_sweep(node.value, key.quantity.dimension)
    except QuantityError as error:
        log.error(error.code, node.mark, str(error), error.hint)
        return None
    return _check_signs(key, quantities, node, log)


def _entry(key: SweptKey, item: source.Node, log: Findings) -> list[tuple[object, Mark]]:
    """Returns the values that one entry of a list gives. An entry that is a quantity with both signs gives two values; an entry
    with a finding gives none."""
    if (
        key.quantity is not None
        and isinstance(item, source.Scalar)
        and isinstance(item.value, str)
        and is_signed(item.value)
    ):
        if not _is_exact(key.quantity, item, item.value, log):
            return []
        try:
            quantities = parse_signed(item.value, key.quantity.dimension)
        except QuantityError as error:
            log.error(error.code, item.mark, str(error), error.hint)
            return []
        return [(value.value, value.mark) for value in _check_signs(key, quantities, item, log) or ()]
    value = key.kind.read(item, log)
    return [] if value is None else [(value, item.mark)]


def _quantity_kind(kind: Kind) -> QuantityOf | None:
    """Returns the kind of quantity in the kind of a swept key; None if the values are not quantities."""
    scalar = kind.other if isinstance(kind, WordOr) else kind
    inner = scalar.scalar if isinstance(scalar, ByShape) else scalar
    return inner if isinstance(inner, QuantityOf) else None


def _is_exact(quantity: QuantityOf, node: source.Scalar, text: str, log: Findings) -> bool:
    """Returns True if a sweep has no value with an uncertainty. If a value states one, a finding is added, because the uncertainty
    would not be used."""
    piece = uncertain_piece(text)
    if piece is not None:
        refuse_uncertainty(piece, quantity.elsewhere, node.mark, log)
    return piece is None


def _check_signs(
    key: SweptKey, quantities: list[Quantity], node: source.Scalar, log: Findings
) -> tuple[SweepValue, ...] | None:
    """Returns the values with labels. If the swept key does not accept their signs (for example, a dwell cannot be negative), adds
    a finding and returns None."""
    sign: Sign = "any" if key.quantity is None else key.quantity.sign
    if not all(has_sign(quantity, sign, node.mark, log, key.name) for quantity in quantities):
        return None
    return _labelled(key, [(quantity, node.mark) for quantity in quantities])


def _named(kind: Kind, node: source.Mapping, log: Findings) -> tuple[SweepValue, ...] | None:
    values = []
    for name, item in node.entries:
        if not re.fullmatch(r"[^/\x00-\x1f]{1,60}", name.text):
            log.error(
                "form-name",
                name.mark,
                f"'{name.text[:60]}' is not a usable label",
                "leave out '/' and control characters",
            )
            continue
        value = kind.read(item, log)
        if value is not None:
            values.append(SweepValue(name.text, name.text, value, item.mark))
    if not node.entries:
        log.error("form-size", node.mark, "at least one value is needed here", "write {name: value, …}")
    return tuple(values) if node.entries and len(values) == len(node.entries) else None


def _labelled(key: SweptKey, values: list[tuple[object, Mark]]) -> tuple[SweepValue, ...]:
    """Returns the values with labels made from their numbers and units. Labels that occur several times get numbers."""
    rows: list[SweepValue] = []
    for index, (value, mark) in enumerate(values, start=1):
        if isinstance(value, Quantity):
            short = _figure(key, value)
            label = short + re.sub(r"[^A-Za-z0-9%]+", "_", value.unit.text).strip("_")
        else:
            short, label = str(index), f"{key.name}{index}"
        rows.append(SweepValue(label, short, value, mark))
    seen: dict[str, int] = {}
    for position, row in enumerate(rows):
        seen[row.name] = seen.get(row.name, 0) + 1
        if seen[row.name] > 1:
            rows[position] = replace(row, name=f"{row.name}#{seen[row.name]}", short=f"{row.short}#{seen[row.name]}")
    return tuple(rows)


def _figure(key: SweptKey, quantity: Quantity) -> str:
    """Returns the number of a swept quantity for its label, in the unit as written. The module's docstring gives the rule for
    signs."""
    figure = f"{quantity.unit.from_si(quantity.value):.9g}"
    if float(figure) == 0:
        return "0"
    return f"+{figure}" if key.directed and not figure.startswith("-") else figure
