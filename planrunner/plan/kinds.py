"""Kinds of value: one declaration that both reads a node and describes itself as JSON Schema.

A record is a frozen dataclass derived from `Record` whose fields are made with `key(...)`. From that one declaration come the
reader (with findings at file:line:column), the JSON Schema that editors use, and the reference in `docs/`. Plug-ins declare their
parameters in the same way. A kind's `read` returns None when it has added a finding.

    class Chamber(Record):
        lowest: Quantity = key(QuantityOf("temperature"), "Lowest temperature the chamber reaches.", "-55 degC")
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, dataclass_transform

from planrunner.plan import source
from planrunner.plan.findings import Findings, InputError, Mark, closest
from planrunner.plan.quantity import Quantity, read_quantity
from planrunner.plan.quantity import schema as quantity_schema

Schema = dict[str, Any]


class Kind(Protocol):
    """What a value may be."""

    def read(self, node: source.Node, log: Findings) -> Any:
        """The value, or None after adding a finding to `log`."""

    def schema(self) -> Schema:
        """The same as JSON Schema (draft 2020-12)."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a record stands in its file, key by key. Empty for records made in code."""

    mark: Mark = field(default_factory=lambda: Mark("<code>"))
    keys: Mapping[str, Mark] = field(default_factory=dict)

    def at(self, key: str) -> Mark:
        return self.keys.get(key, self.mark)


_REQUIRED: Any = dataclasses.MISSING


def key(
    kind: Kind,
    description: str,
    example: Any,
    default: Any = _REQUIRED,
    *,
    default_factory: Any = _REQUIRED,
    name: str | None = None,
) -> Any:
    """A dataclass field that is also a key of the language. Every key has a description and an example; `name` is its
    spelling in YAML where that is not a Python name."""
    metadata = {"kind": kind, "description": description, "example": example, "name": name}
    if default_factory is not _REQUIRED:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(key, field))
class Record:
    """Base of every record of the language: subclasses become frozen, keyword-only dataclasses."""

    origin: Origin = field(default_factory=Origin, compare=False, repr=False)

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    def at(self, name: str) -> Mark:
        return self.origin.at(name)


dataclass(frozen=True, kw_only=True)(Record)


def keys_of(record: type[Record]) -> dict[str, dataclasses.Field[Any]]:
    """YAML key → field, in order of declaration."""
    fields = [item for item in dataclasses.fields(record) if "kind" in item.metadata]
    return {item.metadata["name"] or item.name: item for item in fields}


def is_required(item: dataclasses.Field[Any]) -> bool:
    return item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING


# -- scalars ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Text:
    """A text. `pattern` is matched against all of it; `what` says in words what it must be."""

    pattern: str = ""
    what: str = "a text"

    def read(self, node: source.Node, log: Findings) -> str | None:
        if not isinstance(node, source.Scalar) or node.value is None or isinstance(node.value, bool):
            log.error("form-type", node.mark, f"{self.what} is expected here", "write it on one line, in quotes if in doubt")
            return None
        if self.pattern and not re.fullmatch(self.pattern, node.text):
            log.error("form-text", node.mark, f"'{node.text[:60]}' is not {self.what}", f"it must match {self.pattern}")
            return None
        return node.text

    def schema(self) -> Schema:
        if self.pattern:
            return {"type": ["string", "number"], "pattern": f"^(?:{self.pattern})$"}
        return {"type": ["string", "number"]}


@dataclass(frozen=True, slots=True)
class Choice:
    """One word of a fixed set."""

    names: tuple[str, ...]

    def read(self, node: source.Node, log: Findings) -> str | None:
        if isinstance(node, source.Scalar) and node.value in self.names:
            return node.text
        shown = f"'{node.text[:60]}' is not known here" if isinstance(node, source.Scalar) else "one word is expected here"
        log.error("form-choice", node.mark, shown, closest(getattr(node, "text", ""), self.names))
        return None

    def schema(self) -> Schema:
        return {"enum": list(self.names)}


@dataclass(frozen=True, slots=True)
class Number:
    """A plain number without a unit."""

    minimum: float = -math.inf
    maximum: float = math.inf
    integer: bool = False

    def read(self, node: source.Node, log: Findings) -> float | int | None:
        what = "a whole number" if self.integer else "a number"
        value = node.value if isinstance(node, source.Scalar) else None
        if isinstance(value, bool) or not isinstance(value, int if self.integer else int | float):
            log.error("form-type", node.mark, f"{what} is expected here", "write it without a unit")
            return None
        if not math.isfinite(value):
            log.error("meaning-not-finite", node.mark, f"{value} is not a finite number", "write a finite number")
            return None
        if not self.minimum <= value <= self.maximum:
            bounds = f"from {self.minimum:g}" + (f" to {self.maximum:g}" if math.isfinite(self.maximum) else "")
            log.error("meaning-range", node.mark, f"{value} is out of range", f"{what} {bounds}")
            return None
        return value

    def schema(self) -> Schema:
        schema: Schema = {"type": "integer" if self.integer else "number"}
        if math.isfinite(self.minimum):
            schema["minimum"] = self.minimum
        if math.isfinite(self.maximum):
            schema["maximum"] = self.maximum
        return schema


@dataclass(frozen=True, slots=True)
class Boolean:
    def read(self, node: source.Node, log: Findings) -> bool | None:
        if isinstance(node, source.Scalar) and isinstance(node.value, bool):
            return node.value
        log.error("form-type", node.mark, "true or false is expected here", "YAML 1.2 knows only true and false")
        return None

    def schema(self) -> Schema:
        return {"type": "boolean"}


@dataclass(frozen=True, slots=True)
class QuantityOf:
    """A number with a unit of the named dimension (None: any). `sign` may be 'any', 'positive' or 'not negative'."""

    dimension: str | None
    sign: str = "any"

    def read(self, node: source.Node, log: Findings) -> Quantity | None:
        quantity = read_quantity(node, self.dimension, log)
        if quantity is None:
            return None
        if (self.sign == "positive" and quantity.value <= 0) or (self.sign == "not negative" and quantity.value < 0):
            log.error("meaning-range", node.mark, f"{quantity} must be {self.sign}", "change the number")
            return None
        return quantity

    def schema(self) -> Schema:
        return quantity_schema(self.dimension)


# -- collections -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list; with `single`, one item may stand alone."""

    item: Kind
    single: bool = False
    minimum: int = 0

    def read(self, node: source.Node, log: Findings) -> tuple[Any, ...] | None:
        if not isinstance(node, source.Sequence):
            if self.single:
                value = self.item.read(node, log)
                return None if value is None else (value,)
            log.error("form-type", node.mark, "a list is expected here", "write [a, b] or one item a line after '- '")
            return None
        if len(node.items) < self.minimum:
            log.error("form-size", node.mark, f"at least {self.minimum} entries are needed here")
            return None
        values = [self.item.read(item, log) for item in node.items]
        return tuple(value for value in values if value is not None)

    def schema(self) -> Schema:
        array: Schema = {"type": "array", "items": self.item.schema()}
        if self.minimum:
            array["minItems"] = self.minimum
        return {"anyOf": [self.item.schema(), array]} if self.single else array


@dataclass(frozen=True, slots=True)
class MapOf:
    """A mapping from names to values of one kind; `names` restricts the names."""

    item: Kind
    names: tuple[str, ...] = ()
    pattern: str = r"[^\x00-\x1f]{1,80}"

    def read(self, node: source.Node, log: Findings) -> dict[str, Any] | None:
        if not isinstance(node, source.Mapping):
            log.error("form-type", node.mark, "a mapping of names is expected here", "write {name: value, …}")
            return None
        result: dict[str, Any] = {}
        for name, item in node.entries:
            if self.names and name.text not in self.names:
                log.error("form-unknown-key", name.mark, f"unknown name '{name.text[:60]}'", closest(name.text, self.names))
            elif not re.fullmatch(self.pattern, name.text):
                log.error("form-name", name.mark, f"'{name.text[:60]}' is not a usable name", "use letters, digits, _ and -")
            elif (value := self.item.read(item, log)) is not None:
                result[name.text] = value
        return result

    def schema(self) -> Schema:
        schema: Schema = {"type": "object", "additionalProperties": self.item.schema()}
        schema["propertyNames"] = {"enum": list(self.names)} if self.names else {"pattern": f"^(?:{self.pattern})$"}
        return schema


@dataclass(frozen=True, slots=True)
class ByShape:
    """One kind for a scalar, another for a mapping, another for a list; whichever is absent is refused."""

    scalar: Kind | None = None
    mapping: Kind | None = None
    sequence: Kind | None = None
    what: str = "another form"

    def read(self, node: source.Node, log: Findings) -> Any:
        by_type = {source.Scalar: self.scalar, source.Mapping: self.mapping, source.Sequence: self.sequence}
        kind = by_type[type(node)]
        if kind is None:
            log.error("form-type", node.mark, f"{self.what} is expected here")
            return None
        return kind.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [kind.schema() for kind in (self.scalar, self.mapping, self.sequence) if kind is not None]}


@dataclass(frozen=True, slots=True)
class WordOr:
    """One of a few words, or else another kind."""

    words: tuple[str, ...]
    other: Kind

    def read(self, node: source.Node, log: Findings) -> Any:
        if isinstance(node, source.Scalar) and node.value in self.words:
            return node.value
        return self.other.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [{"enum": list(self.words)}, self.other.schema()]}


# -- records ---------------------------------------------------------------------------------------------------------


def read_keys(
    node: source.Mapping, fields: Mapping[str, dataclasses.Field[Any]], log: Findings, passed: Iterable[str] = ()
) -> dict[str, Any]:
    """The given keys' values by Python name; unknown and missing keys are findings. `passed` keys are read elsewhere."""
    values: dict[str, Any] = {}
    known = [*fields, *passed]
    for name, item in node.entries:
        if name.text in fields:
            value = fields[name.text].metadata["kind"].read(item, log)
            if value is not None:
                values[fields[name.text].name] = value
        elif name.text not in known:
            log.error("form-unknown-key", name.mark, f"unknown key '{name.text[:60]}'", closest(name.text, known))
    present = {name.text for name, _ in node.entries}
    for name_, item_ in fields.items():
        if is_required(item_) and name_ not in present:
            hint = f"add for example `{name_}: {_inline(item_.metadata['example'])}`"
            log.error("form-missing-key", node.mark, f"the key '{name_}' is missing", hint)
    return values


def _inline(example: Any) -> str:
    if isinstance(example, Mapping):
        return "{" + ", ".join(f"{name}: {_inline(value)}" for name, value in example.items()) + "}"
    if isinstance(example, list | tuple):
        return "[" + ", ".join(map(_inline, example)) + "]"
    return str(example)


def origin_of(node: source.Mapping) -> Origin:
    """Marks for messages: for each key where its value stands."""
    return Origin(node.mark, {name.text: item.mark for name, item in node.entries})


@dataclass(frozen=True, slots=True)
class RecordOf:
    """A mapping read into a `Record`. `check(record, log)` may add findings that concern several keys."""

    record: type[Record]
    check: Callable[[Any, Findings], None] | None = None

    def read(self, node: source.Node, log: Findings) -> Any:
        if not isinstance(node, source.Mapping):
            names = ", ".join(list(keys_of(self.record))[:6])
            log.error("form-type", node.mark, "a mapping of keys is expected here", f"with keys such as {names}")
            return None
        before = len(log)
        fields = keys_of(self.record)
        values = read_keys(node, fields, log)
        if any(is_required(item) and item.name not in values for item in fields.values()):
            return None
        record = self.record(origin=origin_of(node), **values)
        if self.check and len(log) == before:
            self.check(record, log)
        return record

    def schema(self) -> Schema:
        return object_schema(keys_of(self.record))


def object_schema(fields: Mapping[str, dataclasses.Field[Any]], closed: bool = True) -> Schema:
    """A JSON Schema object: every key with its description and an example."""
    properties = {}
    for name, item in fields.items():
        meta = item.metadata
        properties[name] = {"description": meta["description"], "examples": [meta["example"]], **meta["kind"].schema()}
    schema: Schema = {"type": "object", "properties": properties}
    required = [name for name, item in fields.items() if is_required(item)]
    if required:
        schema["required"] = required
    if closed:
        schema["additionalProperties"] = False
    return schema


class Plugin(Protocol):
    """What `Plugged` needs of a plug-in class: the record of its parameters."""

    Parameters: type[Record]


@dataclass(frozen=True, slots=True)
class Plugged:
    """A record whose further keys belong to the plug-in that `selector` names.

    The plug-in's keys stand beside the common ones; they are read into the record's field `parameters`.
    """

    record: type[Record]
    selector: str
    names: Callable[[], Sequence[str]]
    load: Callable[[str], type[Plugin]]
    code: str

    def read(self, node: source.Node, log: Findings) -> Any:
        if not isinstance(node, source.Mapping):
            log.error("form-type", node.mark, "a mapping of keys is expected here", f"with the key {self.selector}")
            return None
        chosen = node.get(self.selector)
        common = keys_of(self.record)
        if not isinstance(chosen, source.Scalar):
            known = ", ".join(self.names())
            at = node.key_mark(self.selector)
            log.error("form-missing-key", at, f"the key '{self.selector}' is missing", f"known here: {known}")
            return None
        if chosen.text not in self.names():
            message = f"unknown {self.selector} '{chosen.text[:60]}'"
            log.error(self.code, chosen.mark, message, closest(chosen.text, self.names()))
            return None
        try:
            plugin = self.load(chosen.text)
        except InputError as error:
            for finding in error.findings:
                log.error(finding.code, chosen.mark, finding.message, finding.hint)
            return None
        own = keys_of(plugin.Parameters)
        fields = {**common, **own}
        values = read_keys(node, fields, log)
        if any(is_required(item) and item.name not in values for item in fields.values()):
            return None
        own_names = {item.name for item in own.values()}
        origin = origin_of(node)
        parameters = plugin.Parameters(origin=origin, **{k: v for k, v in values.items() if k in own_names})
        rest = {k: v for k, v in values.items() if k not in own_names}
        return self.record(origin=origin, parameters=parameters, **rest)

    def schema(self) -> Schema:
        common = object_schema(keys_of(self.record), closed=False)
        common["properties"][self.selector] = {**common["properties"][self.selector], "enum": list(self.names())}
        common["properties"][self.selector].pop("type", None)
        cases = []
        for name in self.names():
            own = object_schema(keys_of(self.load(name).Parameters), closed=False)
            own.pop("type")
            cases.append({"if": {"properties": {self.selector: {"const": name}}}, "then": own})
        return {**common, "allOf": cases, "unevaluatedProperties": False}
