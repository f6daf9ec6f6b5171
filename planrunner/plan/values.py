"""Kinds of value: scalars and collections. Each kind reads a node and describes itself as JSON Schema.

A kind's `read` returns None when it has added a finding. The reader adds a finding with a code beginning with `form-` if and only
if the schema rejects the node. Faults that a schema cannot detect (units, directions, references) have other codes.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from typing import Any, Protocol

from planrunner.base.dataclass import dataclass
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Findings, closest
from planrunner.plan import source
from planrunner.plan.quantity import Quantity, anchored, read_quantity
from planrunner.plan.quantity import schema as quantity_schema

Schema = JsonObject


class Kind(Protocol):
    """The permitted values of a key."""

    def read(self, node: source.Node, log: Findings) -> Any:
        """The value, or None after adding a finding to `log`."""

    def schema(self) -> Schema:
        """The kind as JSON Schema (draft 2020-12)."""


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
    """A text. pattern: must match the whole text; what: the required form in words; hint: how to write it.

    A plain number is accepted as written, unless the pattern rejects some numbers.
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
    """The required form of a name in words. Patterns that only limit the length need no words."""
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


@dataclass(frozen=True, slots=True)
class QuantityOf:
    """A number with a unit of the named dimension (None: any). `sign` may be 'any', 'positive' or 'not negative'.

    uncertain: whether an uncertainty may be stated because results use it. elsewhere: if it may not, a text that says where to
    state the uncertainty.
    """

    dimension: str | None
    sign: str = "any"
    uncertain: bool = False
    elsewhere: str = ""

    def read(self, node: source.Node, log: Findings) -> Quantity | None:
        quantity = read_quantity(node, self.dimension, log, self.uncertain, self.elsewhere)
        if quantity is None:
            return None
        if (self.sign == "positive" and quantity.value <= 0) or (self.sign == "not negative" and quantity.value < 0):
            log.error(
                "meaning-range",
                node.mark,
                f"{quantity} is out of range: it must be {self.sign}",
                "write zero or more" if self.sign == "not negative" else "write a value above zero",
            )
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
    """A list. single: one item may be written without a list. maximum: 0 means any number."""

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
    """A mapping from names to values of one kind; `names` restricts the names. of_channels: the names are channels of the sensor."""

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
    """Separate kinds for a scalar, a mapping and a list. A form without a kind is refused.

    A mapping with the key `value` counts as a quantity if a scalar would be one.
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
    """One of a few words, or a value of another kind."""

    words: tuple[str, ...]
    other: Kind

    def read(self, node: source.Node, log: Findings) -> Any:
        if isinstance(node, source.Scalar) and node.value in self.words:
            return node.value
        return self.other.read(node, log)

    def schema(self) -> Schema:
        return {"anyOf": [{"enum": list(self.words)}, self.other.schema()]}
