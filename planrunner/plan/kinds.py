"""Defines kinds of values. One declaration reads a node of the file, and also describes the permitted values as JSON Schema.

A record is a frozen dataclass derived from `Record` whose fields are made with `key(...)`. The reader (with findings at
file:line:column), the JSON Schema for editors, and the reference in `docs/` are all derived from this declaration. Plug-ins declare
their parameters in the same way. The value of each key has a kind: a scalar, a quantity, a collection, a record, or a kind that
depends on the form of the node.

    class Chamber(Record):
        lowest: Quantity = key(QuantityOf("temperature"), "Lowest temperature the chamber reaches.", "-55 degC")

The `read` method of a kind returns None if it has added a finding. If and only if the schema rejects a node, the reader adds a
finding whose code begins with `form-`. Findings about faults that a schema cannot detect (units, directions, references) have other
codes.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import field
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, Literal, Protocol, dataclass_transform

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, InputError, Mark, closest, nearest
from planrunner.plan import source
from planrunner.plan.quantity import Quantity, anchored, read_quantity
from planrunner.plan.quantity import schema as quantity_schema

Schema = JsonObject


class Kind(Protocol):
    """Reads the value of a key, and describes the values that the key permits."""

    def read(self, node: source.Node, log: Findings) -> Any:
        """Reads the value in a node; returns None after adding a finding to `log`."""

    def schema(self) -> Schema:
        """Describes the permitted values as a JSON Schema (draft 2020-12)."""


# -- scalars ---------------------------------------------------------------------------------------------------------

# Spellings of numbers in YAML, including the longest; a text whose pattern accepts all of them may be a plain number.
_NUMBERS = (
    "0",
    "-1",
    "1.5",
    ".5",
    "+1.",
    "1e-3",
    "1E+5",
    "0o17",
    "0x1F",
    ".inf",
    "-.INF",
    ".NaN",
    f"-{'9' * 30}.{'9' * 30}e+999999999",
)


@lru_cache(maxsize=256)
def _takes_numbers(pattern: str) -> bool:
    return not pattern or all(re.fullmatch(pattern, number) for number in _NUMBERS)


@dataclass(frozen=True, slots=True)
class Text:
    """A text.

    `pattern`: a regular expression that the whole text must match. `what`: a description of the required form, for messages.
    `hint`: advice on how to write the text.

    A text that is a plain number in the file is accepted as written, if the pattern does not reject it.
    """

    pattern: str = ""
    what: str = "a text"
    hint: str = ""

    def read(self, node: source.Node, log: Findings) -> str | None:
        if not isinstance(node, source.Scalar) or node.value is None or isinstance(node.value, bool):
            found = f", not {node.text[:60]!r}" if isinstance(node, source.Scalar) and node.text else ""
            hint = "put it in quotes" if found else self.hint or "write it after the ':', in quotes if in doubt"
            log.error("form-type", node.mark, f"{self.what} is expected here{found}", hint)
            return None
        number = not isinstance(node.value, str) and not _takes_numbers(self.pattern)
        if number or (self.pattern and not re.fullmatch(self.pattern, node.text)):
            text = node.text[:60] if node.text.strip() else "an empty text"
            log.error("form-text", node.mark, f"'{text}' is not {self.what}", self.hint or _in_words(self.pattern))
            return None
        return node.text

    def schema(self) -> Schema:
        schema: Schema = {"type": ["string", "number"] if _takes_numbers(self.pattern) else "string"}
        if self.pattern:
            # JSON Schema's dialect knows no named groups.
            schema["pattern"] = anchored(re.sub(r"\(\?P<\w+>", "(?:", self.pattern))
        return schema


CHANNEL = Text("", "a channel's name")  # a channel of the sensor; such names are checked against the bench's sensor


_WORDS_FOR = {
    r"[A-Za-z][A-Za-z0-9_-]{0,39}": "begin with a letter, then use letters, digits, _ and -; at most 40 characters",
    r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}": "letters, digits, '.', _ and -, no folders",
}


def _in_words(pattern: str) -> str:
    """Returns advice on how to write a name, for the finding about a name that does not match `pattern`. For most patterns, the
    advice is in `_WORDS_FOR`. For a pattern that limits only the length, this function makes the advice."""
    if pattern.startswith(r"[^\x00-\x1f]"):
        limit = pattern.rpartition(",")[2].rstrip("}")
        return f"write it on one line, 1 to {limit} characters without control characters"
    return _WORDS_FOR.get(pattern, "see the example in docs/plan-keys.md")


@dataclass(frozen=True, slots=True)
class Choice:
    """One word of a fixed set."""

    names: tuple[str, ...]

    def read(self, node: source.Node, log: Findings) -> str | None:
        if isinstance(node, source.Scalar) and node.value in self.names:
            return node.text
        text = node.text[:60] if isinstance(node, source.Scalar) else ""
        shown = f"'{text}' is not known here" if text else "one word is expected here"
        log.error(
            "form-choice", node.mark, shown, closest(text, self.names) if text else f"one of {', '.join(self.names)}"
        )
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
        if self.integer and isinstance(value, float) and value.is_integer():
            value = int(value)
        if isinstance(value, bool) or not isinstance(value, int if self.integer else int | float):
            text = f", not '{node.text[:40]}'" if isinstance(node, source.Scalar) and node.text else ""
            log.error(
                "form-type",
                node.mark,
                f"{what} is expected here{text}",
                f"write {what} {self._bounds()}, without a unit".replace(" ,", ","),
            )
            return None
        if value < self.minimum or value > self.maximum:
            shown = node.text[:40] if isinstance(node, source.Scalar) else value
            log.error("form-range", node.mark, f"{shown} is out of range", f"write {what} {self._bounds()}")
            return None
        if not math.isfinite(value):
            log.error(
                "meaning-not-finite",
                node.mark,
                f"{value} is not a finite number",
                f"write {what} {self._bounds()}".rstrip(),
            )
            return None
        return value

    def _bounds(self) -> str:
        if math.isfinite(self.minimum) and math.isfinite(self.maximum):
            return (
                f"from {self.minimum:g} to {self.maximum if self.integer else format(self.maximum, '.12g')}"
                if self.minimum < self.maximum
                else f"equal to {self.minimum:g}"
            )
        low = f"of at least {self.minimum:g}" if math.isfinite(self.minimum) else ""
        return low or (f"of at most {self.maximum:.12g}" if math.isfinite(self.maximum) else "")

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


Sign = Literal["any", "positive", "not negative"]


def has_sign(quantity: Quantity, sign: Sign, mark: Mark, log: Findings, name: str = "") -> bool:
    """Returns True if a quantity has the required sign; otherwise adds a finding. `name`: the key that the finding names."""
    if sign == "any" or quantity.value > 0 or (sign == "not negative" and quantity.value == 0):
        return True
    hint = "write zero or more" if sign == "not negative" else "write a value above zero"
    shown = f"{name} of {quantity}" if name else f"{quantity}"
    needed = "must not be negative" if sign == "not negative" else "must be positive"
    log.error("meaning-range", mark, f"{shown} is out of range: it {needed}", hint)
    return False


@dataclass(frozen=True, slots=True)
class QuantityOf:
    """Reads a number with a unit of the named dimension, or with any unit if the dimension is None.

    `uncertain`: True if an uncertainty may be stated, because results include it. `elsewhere`: if no uncertainty may be stated
    here, a text that says where to state it.
    """

    dimension: str | None
    sign: Sign = "any"
    uncertain: bool = False
    elsewhere: str = ""

    def read(self, node: source.Node, log: Findings) -> Quantity | None:
        quantity = read_quantity(node, self.dimension, log, self.uncertain, self.elsewhere)
        if quantity is None:
            return None
        if not has_sign(quantity, self.sign, node.mark, log):
            return None
        if self.dimension == "temperature" and quantity.value < 0:
            log.error("meaning-range", node.mark, f"{quantity} is below absolute zero", "change the number")
            return None
        return quantity

    def schema(self) -> Schema:
        return quantity_schema(self.dimension, self.uncertain)


# -- collections -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list. `single`: True if a single item may be written without a list. `maximum`: largest number of items; 0 means any
    number."""

    item: Kind
    single: bool = False
    minimum: int = 0
    maximum: int = 0

    def read(self, node: source.Node, log: Findings) -> tuple[Any, ...] | None:
        if not isinstance(node, source.Sequence):
            if self.single:
                value = self.item.read(node, log)
                return None if value is None else (value,)
            log.error(
                "form-type", node.mark, "a list is expected here", "write [a, b], or one item per line after '- '"
            )
            return None
        if len(node.items) < self.minimum:
            entries = "entry is" if self.minimum == 1 else "entries are"
            log.error(
                "form-size",
                node.mark,
                f"at least {self.minimum} {entries} needed here",
                "add to the list, or leave the key out",
            )
            return None
        if self.maximum and len(node.items) > self.maximum:
            log.error("form-size", node.mark, f"at most {self.maximum} entries are allowed here", "shorten the list")
            return None
        values = [self.item.read(item, log) for item in node.items]
        return tuple(value for value in values if value is not None)

    def schema(self) -> Schema:
        array: Schema = {"type": "array", "items": self.item.schema()}
        if self.minimum:
            array["minItems"] = self.minimum
        if self.maximum:
            array["maxItems"] = self.maximum
        return {"anyOf": [self.item.schema(), array]} if self.single else array


@dataclass(frozen=True, slots=True)
class MapOf:
    """Reads a mapping from names to values of one kind. `names`: the permitted names; if there are none, every name that matches
    `pattern` is permitted. `of_channels`: True if the names are channels of the sensor."""

    item: Kind
    names: tuple[str, ...] = ()
    pattern: str = r"[^\x00-\x1f]{1,80}"
    of_channels: bool = False

    def read(self, node: source.Node, log: Findings) -> JsonObject | None:
        if not isinstance(node, source.Mapping):
            log.error("form-type", node.mark, "a mapping of names is expected here", "write {name: value, …}")
            return None
        result: JsonObject = {}
        for name, item in node.entries:
            if self.names and name.text not in self.names:
                log.error(
                    "form-unknown-key", name.mark, f"unknown name '{name.text[:60]}'", closest(name.text, self.names)
                )
            elif not self.names and not re.fullmatch(self.pattern, name.text):
                log.error("form-name", name.mark, f"'{name.text[:60]}' is not a usable name", _in_words(self.pattern))
            elif (value := self.item.read(item, log)) is not None:
                result[name.text] = value
        return result

    def schema(self) -> Schema:
        schema: Schema = {"type": "object", "additionalProperties": self.item.schema()}
        schema["propertyNames"] = {"enum": list(self.names)} if self.names else {"pattern": anchored(self.pattern)}
        return schema


@dataclass(frozen=True, slots=True)
class ByShape:
    """Reads a value whose kind depends on the form of the node. There can be separate kinds for a scalar, a mapping and a list. A
    node is refused if there is no kind for its form.

    If scalars are read as quantities, a mapping with the key `value` is read as a quantity too.
    """

    scalar: Kind | None = None
    mapping: Kind | None = None
    sequence: Kind | None = None
    what: str = "another form"

    def read(self, node: source.Node, log: Findings) -> Any:
        by_type = {source.Scalar: self.scalar, source.Mapping: self.mapping, source.Sequence: self.sequence}
        kind = by_type[type(node)]
        if isinstance(self.scalar, QuantityOf) and isinstance(node, source.Mapping) and node.get("value") is not None:
            kind = self.scalar
        if kind is None:
            log.error("form-type", node.mark, f"{self.what} is expected here", "see the example in docs/plan-keys.md")
            return None
        return kind.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [kind.schema() for kind in (self.scalar, self.mapping, self.sequence) if kind is not None]}


@dataclass(frozen=True, slots=True)
class WordOr:
    """Reads one of a few words, or a value of another kind."""

    words: tuple[str, ...]
    other: Kind

    def read(self, node: source.Node, log: Findings) -> Any:
        if isinstance(node, source.Scalar) and node.value in self.words:
            return node.value
        return self.other.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [{"enum": list(self.words)}, self.other.schema()]}


class Origin:
    """Contains the positions of the keys of a record in the file. The mapping is empty for a record that was made in code.

    `broken`: the keys whose values could not be read completely. `meant`: maps an absent key to the positions of the unknown keys
    that may be misspellings of the key.
    """

    def __init__(
        self,
        node: source.Mapping | None = None,
        broken: frozenset[str] = frozenset(),
        meant: Mapping[str, tuple[Mark, ...]] = MappingProxyType({}),
    ):
        self._node = node
        self.broken = broken
        self.meant = meant

    def __getstate__(self) -> dict[str, object]:
        """Returns the state for pickling. The state does not contain the nodes, because nodes contain marks of the parser, which
        cannot be pickled."""
        return {"_node": None, "broken": self.broken, "meant": dict(self.meant), "mark": self.mark, "keys": self.keys}

    @cached_property
    def mark(self) -> Mark:
        return Mark("<code>") if self._node is None else self._node.mark

    @cached_property
    def keys(self) -> Mapping[str, Mark]:
        """Maps the path of each key to a position in the file. For example, the path `report` refers to the value of this key,
        `report[1]` refers to the second entry of its list, and `limits.x` refers to the value of `x` in the mapping `limits`."""
        marks: dict[str, Mark] = {}
        for name, item in self._node.entries if self._node else ():
            marks[name.text] = _used(name, item)
            if isinstance(item, source.Sequence):
                marks.update({f"{name.text}[{index}]": entry.mark for index, entry in enumerate(item.items)})
            elif isinstance(item, source.Mapping):
                marks.update({f"{name.text}.{entry.text}": _used(entry, value) for entry, value in item.entries})
                marks.update(
                    {
                        f"{name.text}.{entry.text}[{index}]": one.mark
                        for entry, value in item.entries
                        if isinstance(value, source.Sequence)
                        for index, one in enumerate(value.items)
                    }
                )
        return marks

    def parts(self, key: str) -> tuple[Mark, ...]:
        """Returns the positions that determine the value of a key. The result is the position of the value or, if the key is
        absent, the positions of the unknown keys that may be misspellings of the key."""
        return (self.keys[key],) if key in self.keys else self.meant.get(key, ())

    def at(self, key: str) -> Mark:
        """Returns the mark of a key, or of an entry in the list or mapping that is the key's value. If an entry has no mark,
        returns the mark of its key; if a key has no mark, returns the mark of the record."""
        if key in self.keys:
            return self.keys[key]
        return self.keys.get(key.partition("[")[0].partition(".")[0], self.mark)


_REQUIRED: Any = dataclasses.MISSING


def key(
    kind: Kind,
    description: str,
    example: object,
    *,
    default: Any = _REQUIRED,
    default_factory: Any = _REQUIRED,
    name: str | None = None,
    fallback: Any = None,
    traits: object = None,
) -> Any:
    """Makes a dataclass field that is also a key of the language. Every key has a description and an example.

    `name`: spelling of the key in YAML, if it is not a valid Python name and therefore differs from the name of the field.
    `fallback`: value that replaces a required value that is missing or wrong, so that the rest of the record can still be checked.
    `traits`: properties that the module of the record needs, such as whether the key may be swept.
    """
    metadata = {
        "kind": kind,
        "description": description,
        "example": example,
        "name": name,
        "fallback": fallback,
        "traits": traits,
    }
    if default_factory is not _REQUIRED:
        return field(default_factory=default_factory, metadata=metadata)
    return field(default=default, metadata=metadata)


def optional(kind: Kind, description: str, example: object, *, name: str | None = None, traits: object = None) -> Any:
    """Makes a key that may be left out; its value is then None."""
    return key(kind, description, example, default=None, name=name, traits=traits)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(key, field))
class Record:
    """Base class of every record of the language: subclasses become frozen, keyword-only dataclasses."""

    origin: Origin = field(default_factory=Origin, compare=False, repr=False)

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, kw_only=True)(cls)

    def at(self, name: str) -> Mark:
        return self.origin.at(name)


dataclass(frozen=True, kw_only=True)(Record)


Fields = Mapping[str, dataclasses.Field[Any]]
"""Fields, by their YAML keys."""
_KEYS: dict[type[Record], Fields] = {}


def keys_of(record: type[Record]) -> Fields:
    """Returns the keys of a record in the order of their declaration."""
    if record not in _KEYS:
        made: Any = record
        fields = [item for item in dataclasses.fields(made) if "kind" in item.metadata]
        _KEYS[record] = MappingProxyType({item.metadata["name"] or item.name: item for item in fields})
    return _KEYS[record]


def is_required(item: dataclasses.Field[Any]) -> bool:
    return item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING


# -- records ---------------------------------------------------------------------------------------------------------


def read_keys(
    node: source.Mapping, fields: Mapping[str, dataclasses.Field[Any]], log: Findings, passed: Iterable[str] = ()
) -> tuple[JsonObject, Origin]:
    """Reads the values of the given keys. Returns the values by Python name, and the positions of the keys. Unknown and missing
    keys become findings. Keys in `passed` are permitted, but other code reads them."""
    values: JsonObject = {}
    broken: set[str] = set()
    known, given = dict.fromkeys((*fields, *passed)), {name.text for name, _ in node.entries}
    missing = [name for name, item in fields.items() if name not in given and is_required(item)]
    meant, hints = _meant(node, known, missing)
    for name, item in node.entries:
        if name.text in fields:
            before = log.raised
            value = fields[name.text].metadata["kind"].read(item, log)
            if log.raised > before or value is None:  # faults in aliased nodes are reported where the node is defined
                broken.add(name.text)
            if value is not None:
                values[fields[name.text].name] = value
        elif name.text not in known:
            log.error("form-unknown-key", name.mark, f"unknown key '{name.text[:60]}'", hints[name.text])
    for name_, item_ in fields.items() if missing or broken else ():
        if name_ in missing:
            hint = f"add for example `{name_}: {inline(item_.metadata['example'])}`"
            with log.resting_on(*meant.get(name_, ())):
                log.error("form-missing-key", node.mark, f"the key '{name_}' is missing", hint)
        if is_required(item_) and item_.name not in values and item_.metadata["fallback"] is not None:
            values[item_.name] = item_.metadata["fallback"]
    return values, Origin(node, frozenset(broken), meant)


def _meant(
    node: source.Mapping, known: Collection[str], missing: Sequence[str]
) -> tuple[dict[str, tuple[Mark, ...]], dict[str, str]]:
    """Returns two mappings: from each absent key to the unknown keys that may be misspellings of this key, and from each unknown
    key to a hint.

    An unknown key counts as a misspelling of the absent key that it resembles. An unknown key that resembles no absent key may be a
    misspelling of any optional key. If there are at least as many of these unknown keys as there are missing required keys, each of
    them may also be a misspelling of a required key.
    """
    unknown = {name.text: name.mark for name, _ in node.entries if name.text not in known}
    if not unknown:
        return {}, {}
    absent = [name for name in known if node.get(name) is None]
    meant: dict[str, tuple[Mark, ...]] = {}
    hints: dict[str, str] = {}
    strange: list[str] = []
    for text, mark in unknown.items():
        near = nearest(text, absent)
        if near is None:
            strange.append(text)
            hints[text] = closest(text, known)
        else:
            meant[near] = (*meant.get(near, ()), mark)
            hints[text] = f"did you mean '{near}'?"
    open_ = [name for name in absent if name not in meant]
    lacking = [name for name in missing if name not in meant]
    if len(lacking) > len(strange):
        open_ = [name for name in open_ if name not in lacking]
    elif lacking:
        words = " or ".join(f"'{name}'" for name in lacking)
        hints.update(
            {
                text: f"{words} {'is' if len(lacking) == 1 else 'are'} missing here: did you mean that?"
                for text in strange
            }
        )
    if strange:
        meant.update({name: tuple(unknown[text] for text in strange) for name in open_})
    return meant, hints


def inline(example: Any) -> str:
    """Writes an example value on one line, as a plan would state it."""
    if isinstance(example, Mapping):
        return "{" + ", ".join(f"{name}: {inline(value)}" for name, value in example.items()) + "}"
    if isinstance(example, list | tuple):
        return "[" + ", ".join(map(inline, example)) + "]"
    if isinstance(example, bool):
        return str(example).lower()
    text = str(example)
    return f'"{text}"' if isinstance(example, str) and (", " in text or text[:1] in "*&!%@`#") else text


def _used(key: source.Scalar, value: source.Node) -> Mark:
    """Returns the position at which a value is used. The value of an alias has the position of its anchor, which is before the key.
    In this case, the position of the key is returned."""
    return key.mark if value.precedes(key) else value.mark


@dataclass(frozen=True, slots=True)
class RecordOf:
    """A mapping that is read into a `Record`. `check`: a function of the record and the log; it may add findings that concern
    several keys together."""

    record: type[Record]
    check: Callable[[Any, Findings], None] | None = None

    def read(self, node: source.Node, log: Findings) -> Any:
        if not isinstance(node, source.Mapping):
            names = ", ".join(list(keys_of(self.record))[:6])
            log.error("form-type", node.mark, "a mapping of keys is expected here", f"with keys such as {names}")
            return None
        before = log.raised
        fields = keys_of(self.record)
        values, origin = read_keys(node, fields, log)
        if any(is_required(item) and item.name not in values for item in fields.values()):
            return None
        make: Any = self.record
        record = make(origin=origin, **values)
        if self.check and log.raised == before:
            self.check(record, log)
        return record

    def schema(self) -> Schema:
        return object_schema(keys_of(self.record))


def object_schema(fields: Mapping[str, dataclasses.Field[Any]], closed: bool = True) -> Schema:
    """Returns the JSON Schema of a mapping: every key with its description and an example. `closed`: True if other keys are not
    permitted."""
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
    """Defines what a plug-in class for `Plugged` must have: a record of its parameters."""

    Parameters: type[Record]


@dataclass(frozen=True, slots=True)
class Plugged:
    """Reads a record with additional keys that belong to a plug-in. The value of the key `selector` names the plug-in.

    The keys of the plug-in are in the same mapping as the common keys. The keys of the plug-in are read into the field `parameters`
    of the record.
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
        common = keys_of(self.record)
        plugin = self._chosen(node, log)
        if plugin is None:
            # Common keys of all plug-ins can still be checked; the other keys cannot.
            others = [name.text for name, _ in node.entries if name.text not in common]
            read_keys(
                node,
                {name: item for name, item in common.items() if name != self.selector},
                log,
                (self.selector, *others),
            )
            return None
        own = keys_of(plugin.Parameters)
        fields = {**common, **own}
        before = log.raised
        values, origin = read_keys(node, fields, log)
        # Plug-ins do not check incomplete parameters.
        if log.raised > before or any(is_required(item) and item.name not in values for item in fields.values()):
            return None
        own_names = {item.name for item in own.values()}
        make_parameters: Any = plugin.Parameters
        make: Any = self.record
        parameters = make_parameters(origin=origin, **{k: v for k, v in values.items() if k in own_names})
        rest = {k: v for k, v in values.items() if k not in own_names}
        return make(origin=origin, parameters=parameters, **rest)

    def _chosen(self, node: source.Mapping, log: Findings) -> type[Plugin] | None:
        chosen = node.get(self.selector)
        if chosen is None:
            # The other valid keys depend on the plug-in; a key that resembles the selector counts as a misspelling of it.
            alike = [name for name, _ in node.entries if nearest(name.text, [self.selector]) is not None]
            for name in alike:
                message = f"unknown key '{name.text[:60]}'"
                log.error("form-unknown-key", name.mark, message, f"did you mean '{self.selector}'?")
            with log.resting_on(*(name.mark for name in alike)):
                log.error("form-missing-key", node.mark, f"the key '{self.selector}' is missing", self._known())
        elif not isinstance(chosen, source.Scalar) or not isinstance(chosen.value, str):
            log.error("form-type", chosen.mark, f"the name of one {self.selector} is expected here", self._known())
        else:
            try:
                return self.load(chosen.text)
            except InputError as error:
                if chosen.text not in self.names():
                    message = f"unknown {self.selector} '{chosen.text[:60]}'"
                    log.error(self.code, chosen.mark, message, closest(chosen.text, self.names()))
                    return None
                for finding in error.findings:
                    log.error(finding.code, chosen.mark, finding.message, finding.hint)
        return None

    def _known(self) -> str:
        return f"known here: {', '.join(self.names())}"

    def schema(self) -> Schema:
        common = object_schema(keys_of(self.record), closed=False)
        selector = common["properties"][self.selector]
        common["properties"][self.selector] = {
            "description": selector["description"],
            "examples": selector["examples"],
            "enum": list(self.names()),
        }
        cases = []
        for name in self.names():
            own = object_schema(keys_of(self.load(name).Parameters), closed=False)
            own.pop("type")
            cases.append(
                {"if": {"properties": {self.selector: {"const": name}}, "required": [self.selector]}, "then": own}
            )
        return {**common, "allOf": cases, "unevaluatedProperties": False}
