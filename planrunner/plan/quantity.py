"""Defines quantities. A quantity is one number and one unit, never an expression.

300 deg/s          a value
54.7356 deg ± 20 arcsec   with its standard uncertainty
±0.5 deg/h         both signs: a sweep over +/-, or a limit around zero
{value: 54.7356 deg, half_width: 30 arcsec, distribution: rectangular}   with a half-width and a distribution
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from functools import cache, lru_cache

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import Findings, Mark, closest
from planrunner.plan.source import Mapping, Node, Scalar
from planrunner.plan.units import DIMENSIONS, EXAMPLES, Unit, UnknownUnitError, dimension_name, suggestion, unit

# One grammar for the reader and for the JSON Schema. Text copied from documents contains no-break and thin spaces.
_SPACE = "[ \\t\\r\\n\\u00a0\\u2009\\u202f]*"
_NUMBER = r"[-+−]?(?:[0-9]{1,30}(?:\.[0-9]{0,30})?|\.[0-9]{1,30})(?:[eE][-+−]?[0-9]{1,9})?"
# A digit or an exponent at the end of a number is not the beginning of a unit.
_UNIT = r"(?:(?<![0-9.])1(?![0-9.,])|(?![eE][-+−]?[0-9])[A-Za-zµμ°′″%√(])[A-Za-z0-9_µμ°′″%√²³^*/·⋅() \u00a0\u2009\u202f-]{0,80}"
_SIGN = r"(?:±|\+/-|\+-)"
_VALUE = rf"{_NUMBER}{_SPACE}(?:{_UNIT}{_SPACE})?"
PLAIN = rf"{_SPACE}{_NUMBER}{_SPACE}{_UNIT}{_SPACE}"
_BOTH = rf"{_NUMBER}{_SPACE}{_UNIT}{_SPACE}{_SIGN}{_SPACE}{_VALUE}"
_SHARED = rf"{_NUMBER}{_SPACE}{_SIGN}{_SPACE}{_NUMBER}{_SPACE}{_UNIT}{_SPACE}"
_UNCERTAIN = rf"{_SPACE}(?:{_BOTH}|{_SHARED})"
_BARE = rf"{_SPACE}{_NUMBER}{_SPACE}(?:{_SIGN}{_SPACE}{_NUMBER}{_SPACE})?"
_PIECE = rf"(?:{_SIGN}{_SPACE})?{_VALUE}"
_PLAIN_BARE = rf"{_SPACE}{_NUMBER}{_SPACE}"
WITH_UNIT = rf"(?:{PLAIN}|{_UNCERTAIN})"
BARE_OR_WITH_UNIT = rf"(?:{_BARE}|{PLAIN}|{_UNCERTAIN})"
SIGNED = rf"{_SPACE}{_SIGN}{PLAIN}"
SYMMETRIC = rf"{_SPACE}{_SIGN}{_SPACE}{_VALUE}"

_SPACE_NEEDED = _SPACE.replace("*", "+")
_MAX_TEXT, _MAX_SWEEP = 200, 4000

_PARTS = (
    rf"{_SPACE}({_NUMBER}){_SPACE}(?:({_UNIT}){_SPACE})?(?:{_SIGN}{_SPACE}({_NUMBER}){_SPACE}(?:({_UNIT}){_SPACE})?)?"
)
_SIGNED = re.compile(rf"{_SPACE}({_SIGN})(.*)", re.DOTALL)
# No measured value lies outside this range; calculations with larger values would overflow.
_SMALLEST, _LARGEST = 1e-30, 1e30

# Divisors of a half-width that give a standard uncertainty (JCGM 100:2008, 4.3.7 to 4.3.9; U-shaped: F.2.3.3).
DISTRIBUTIONS = {"rectangular": math.sqrt(3), "triangular": math.sqrt(6), "u-shaped": math.sqrt(2), "normal": 2.0}


@dataclass(frozen=True, slots=True)
class Quantity:
    """Contains `value` and `standard_uncertainty` in SI-coherent units (rad, s, K, m/s^2 …); `unit` is the unit as written.
    `distribution`: distribution of the value's uncertainty, one of `DISTRIBUTIONS`."""

    value: float
    unit: Unit
    standard_uncertainty: float = 0.0
    degrees_of_freedom: float = math.inf
    distribution: str = "normal"

    def __str__(self) -> str:
        unit_text = "" if self.unit.text == "1" else f" {self.unit.text}"
        text = f"{self.unit.from_si(self.value):.9g}{unit_text}"
        if self.standard_uncertainty:
            text += f" ± {self.standard_uncertainty / self.unit.factor:.3g}{unit_text}"
        return text

    @property
    def shape(self) -> str:
        """Returns the name of the distribution in an uncertainty budget. If the degrees of freedom are finite, this is Student's t
        instead of normal."""
        return "t" if math.isfinite(self.degrees_of_freedom) and self.distribution == "normal" else self.distribution

    def to(self, unit_text: str) -> float:
        """Returns the value expressed in another unit of the same dimension."""
        return unit(unit_text).from_si(self.value)


class QuantityError(ValueError):
    """Reports that a text is not a quantity. The exception has a `code`, a message and a hint."""

    def __init__(self, code: str, message: str, hint: str = ""):
        super().__init__(message)
        self.code = code
        self.hint = hint

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.code, str(self), self.hint)


def takes_bare_number(dimension: str | None) -> bool:
    """Returns True if a number without a unit can be a quantity of this dimension. The result is True for a ratio, and for None,
    which means any dimension."""
    return dimension in (None, "ratio")


@lru_cache(maxsize=4096)
def parse_quantity(text: str, dimension: str | None = None) -> Quantity:
    """Parses the quantity in `text`, of the named dimension (see `units.DIMENSIONS`) if one is given. Raises `QuantityError` if the
    text is not such a quantity.

    In all of `54.7 deg ± 0.1 deg`, `54.7 deg ± 6 arcmin`, `54.7 deg ± 0.1` and `54.7 ± 0.1 deg`, the number after ± is a standard
    uncertainty.
    """
    match = _parts(text)
    if match is None or not (_has_unit(match) or takes_bare_number(dimension)):
        raise _no_quantity(text, dimension)
    number, unit_text, width, width_unit = match.groups()
    unit_text = unit_text or width_unit or "1"
    resolved = _unit(unit_text, dimension)
    value = _in_range(resolved.to_si(_float(number)), text, dimension)
    if width is None:
        return Quantity(value, resolved)
    own = _unit(width_unit, None) if width_unit else resolved
    if own.dimension != resolved.dimension:
        kinds = dimension_name(own.dimension), dimension_name(resolved.dimension)
        message = f"'{own.text}' after ± is a unit of {kinds[0]}, but the value is in a unit of {kinds[1]}"
        raise QuantityError("meaning-dimension", message, f"give the uncertainty in {resolved.text}")
    # An uncertainty is a difference, so the offset of degC or degF is not applied.
    uncertainty = _in_range(_float(width) * own.factor, text, dimension)
    if uncertainty < 0:
        raise QuantityError(
            "meaning-range", "a standard uncertainty cannot be negative", "write ± and a positive number"
        )
    return Quantity(value, resolved, uncertainty)


def parse_sweep(text: str, dimension: str | None) -> list[Quantity]:
    """Parses the values of a sweep, such as `±300, ±150 deg/s` or `10, 20, 30 deg`; ± gives two values, first the positive value
    and then the negative value. Raises `QuantityError` if the text is not such a list.

    A unit after the last value applies to values without a unit. A space must follow every comma between two values. A comma
    without a following space is refused, because it may be a decimal comma.
    """
    if re.search(r",[^ \t\r\n\u00a0\u2009\u202f]", text):
        hint = "write a decimal point (1.5 deg/s), or a space after the comma between two values (1, 5 deg/s)"
        raise QuantityError(
            "form-quantity",
            f"'{text.strip()[:40]}' has a comma without a following space, which may be a decimal comma",
            hint,
        )
    if len(text) > _MAX_SWEEP:
        raise QuantityError(
            "form-quantity", f"a sweep longer than {_MAX_SWEEP} characters", "write the values as a list"
        )
    pieces = text.split(",")
    signed = _SIGNED.fullmatch(pieces[-1])
    last = _parts(signed[2] if signed else pieces[-1])
    shared = (last[2] or last[4] or "") if last else ""
    ending = parse_signed(pieces[-1], dimension)
    values: list[Quantity] = []
    for piece in pieces[:-1]:
        signed = _SIGNED.fullmatch(piece)
        found = _parts(signed[2] if signed else piece)
        values.extend(parse_signed(f"{piece} {shared}" if found and not _has_unit(found) else piece, dimension))
    return values + ending


def parse_signed(text: str, dimension: str | None) -> list[Quantity]:
    """Parses `±300 deg/s` as +300 and −300 deg/s, and a text without a leading ± as one quantity. Raises `QuantityError` if the
    text is not such a quantity."""
    signed = _SIGNED.fullmatch(text)
    quantity = parse_quantity(signed[2] if signed else text, dimension)
    if not signed or quantity.value == 0:
        return [quantity]
    if quantity.unit.offset:
        hint = "list both temperatures"
        raise QuantityError("meaning-range", f"± of a temperature in {quantity.unit.text} is unclear", hint)
    return [quantity, Quantity(-quantity.value, quantity.unit, quantity.standard_uncertainty)]


def is_symmetric(text: str) -> bool:
    """Returns True if a text has the form `SYMMETRIC`. The unit is not checked."""
    signed = _SIGNED.fullmatch(text)
    parts = _parts(signed[2]) if signed else None
    return parts is not None and parts[3] is None


def is_signed(text: str) -> bool:
    """Returns True if a text begins with ±."""
    return _SIGNED.fullmatch(text) is not None


def parse_symmetric(text: str) -> Quantity | None:
    """Returns the positive bound of `±0.5 deg/h`, or None if the text has no leading ±. Raises `QuantityError` if the text after
    the ± is not a quantity."""
    signed = _SIGNED.fullmatch(text)
    return parse_quantity(signed[2]) if signed else None


def _parts(text: str) -> re.Match[str] | None:
    """Splits a text into the number, its unit, the uncertainty and the unit of the uncertainty. A part is None if the text does not
    contain it. The result is None if the text is not a quantity."""
    return _grammar(max(text, default="") <= "\xff").fullmatch(text) if len(text) <= _MAX_TEXT else None


@cache
def _grammar(latin: bool) -> re.Pattern[str]:
    """Returns the regular expression that `_parts` uses. `latin`: True for a text of Latin-1 characters only, which is the usual
    case. A smaller expression is then enough; compiling the full expression takes milliseconds."""
    return re.compile(re.sub(r"\\u(?!00)[0-9a-f]{4}|[^\x00-\xff]", "", _PARTS) if latin else _PARTS)


def _has_unit(parts: re.Match[str]) -> bool:
    """Returns True if the value or its uncertainty has a unit, which then applies to both."""
    return parts[2] is not None or parts[4] is not None


def _float(number: str) -> float:
    return float(number.replace("−", "-"))


def _unit(text: str, dimension: str | None) -> Unit:
    try:
        resolved = unit(text)
    except UnknownUnitError as error:
        meant = suggestion(text, DIMENSIONS[dimension] if dimension is not None else None)
        raise QuantityError("meaning-unit", str(error), meant or _example(dimension)) from None
    if dimension is not None and resolved.dimension != DIMENSIONS[dimension]:
        message = (
            f"'{text.strip()[:40]}' is a unit of {dimension_name(resolved.dimension)}; a unit of {dimension} is needed"
        )
        raise QuantityError("meaning-dimension", message, _example(dimension))
    return resolved


def _in_range(value: float, text: str, dimension: str | None) -> float:
    if not math.isfinite(value):
        raise QuantityError(
            "meaning-not-finite", f"'{text.strip()[:40]}' is too large to be represented", _example(dimension)
        )
    if value and not _SMALLEST <= abs(value) <= _LARGEST:
        raise QuantityError(
            "meaning-range", f"'{text.strip()[:40]}' is outside the range of any measurement", _example(dimension)
        )
    return value


def _no_quantity(text: str, dimension: str | None) -> QuantityError:
    shown, example = text.strip()[:40], _example(dimension)
    if re.match(r"\s*[-+.±]*(nan|inf)", text, re.IGNORECASE):
        return QuantityError("form-quantity", f"'{shown}' is not a finite number", example)
    if len(text) > _MAX_TEXT:
        return QuantityError("form-quantity", "this text is too long for one quantity", example)
    if (match := _parts(text)) is not None and not _has_unit(match):
        return QuantityError("form-unit-missing", f"'{shown}' has no unit", example)
    if _SIGNED.fullmatch(text):
        return QuantityError(
            "form-quantity",
            f"'{shown}' has two values; one value is expected here",
            "to use both signs, write the value in for_each",
        )
    if re.match(r"\s*[-+−]?[0-9]+,[0-9]", text):
        return QuantityError("form-quantity", f"'{shown}' has a decimal comma", f"write a decimal point; {example}")
    hint = f"{example}; expressions are not computed"
    return QuantityError("form-quantity", f"'{shown}' is not one number and one unit", hint)


def read_quantity(
    node: Node, dimension: str | None, log: Findings, uncertain: bool, elsewhere: str = ""
) -> Quantity | None:
    """Reads the quantity in a node, which is a text or a mapping. Returns None after a finding was added to `log`.

    `uncertain`: True if results use the uncertainty; otherwise a stated uncertainty causes a finding. `elsewhere`: text that says
    where to state the uncertainty instead; '' if there is no such place.
    """
    if uncertain:
        return _read_rich(node, dimension, log) if isinstance(node, Mapping) else read_scalar(node, dimension, log)
    value = node.get("value") if isinstance(node, Mapping) else None
    text = value.text if isinstance(value, Scalar) else node.text if isinstance(node, Scalar) else ""
    if value is not None or states_uncertainty(text):
        refuse_uncertainty(text, elsewhere, node.mark, log)
        return None
    return read_scalar(node, dimension, log)


def states_uncertainty(text: str) -> bool:
    """Returns True if the text of a quantity contains a ± with a text after it, even if this text is zero."""
    parts = _parts(text)
    return parts is not None and parts[3] is not None


def uncertain_piece(text: str) -> str | None:
    """Finds the first value in the text of a sweep that states an uncertainty. Returns the uncertainty without its leading ±, or
    None if no value states an uncertainty."""
    pieces = [signed[2] if (signed := _SIGNED.fullmatch(piece)) else piece for piece in text.split(",")]
    return next((piece for piece in pieces if states_uncertainty(piece)), None)


def refuse_uncertainty(text: str, elsewhere: str, mark: Mark, log: Findings) -> None:
    """Adds the finding about an uncertainty that is not used."""
    log.error("form-uncertainty-unused", mark, _UNUSED, _plainly(text, elsewhere))


_UNUSED = "no result uses an uncertainty that is stated here"


def _plainly(text: str, elsewhere: str) -> str:
    parts = _parts(text)
    plain = f"write {parts[1]} {parts[2] or parts[4] or ''}".rstrip() if parts else "leave it out"
    return f"{plain}; state it as {elsewhere}" if elsewhere else plain


def without_uncertainty(text: str, dimension: str | None = None) -> Quantity:
    """Returns the quantity in `text`, like `parse_quantity`. Also raises `QuantityError` for an uncertainty that is not used."""
    if states_uncertainty(text):
        raise QuantityError("form-uncertainty-unused", _UNUSED, _plainly(text, ""))
    return parse_quantity(text, dimension)


def read_scalar(node: Node, dimension: str | None, log: Findings) -> Quantity | None:
    """Does the same as `read_quantity`, but only for a quantity that is written as a text."""
    if not isinstance(node, Scalar) or node.value is None or isinstance(node.value, bool):
        found = f", not '{node.text[:40]}'" if isinstance(node, Scalar) and node.text else ", as a text"
        log.error("form-type", node.mark, f"one quantity is expected here{found}", _example(dimension))
        return None
    if isinstance(node.value, float) and not math.isfinite(node.value) and takes_bare_number(dimension):
        log.error("meaning-not-finite", node.mark, f"'{node.text[:40]}' is not a finite number", _example(dimension))
        return None
    try:
        return parse_quantity(node.text if isinstance(node.value, str) else repr(node.value), dimension)
    except QuantityError as error:
        log.error(error.code, node.mark, str(error), error.hint)
        return None


def _example(dimension: str | None) -> str:
    return f"write for example '{EXAMPLES.get(dimension or '', '300 deg/s')}'"


RICH_KEYS = {
    "value": ("The value with its unit.", "54.7356 deg"),
    "standard_uncertainty": ("Standard uncertainty of the value.", "20 arcsec"),
    "half_width": (
        "Half-width of the interval that certainly contains the value; 'distribution' gives the distribution within "
        "it.",
        "30 arcsec",
    ),
    "distribution": (
        "Shape of the distribution within the half-width; 'normal' means that the half-width is two standard deviations.",
        "rectangular",
    ),
    "degrees_of_freedom": ("Degrees of freedom of the uncertainty; infinite if this key is left out.", 9),
}


def _read_rich(node: Mapping, dimension: str | None, log: Findings) -> Quantity | None:
    before = log.raised
    unknown = [key for key, _ in node.entries if key.text not in RICH_KEYS]
    for key in unknown:
        log.error("form-unknown-key", key.mark, f"unknown key '{key.text[:60]}'", closest(key.text, RICH_KEYS))
    misspelt = [key.mark for key in unknown]  # an apparently missing key may be there with a misspelt name
    value_node = node.get("value")
    value = read_scalar(value_node, dimension, log) if value_node is not None else None
    if value_node is None:
        message = "a quantity written as a mapping needs the key 'value'"
        with log.resting_on(*misspelt):
            log.error("form-missing-key", node.mark, message, _example(dimension))
    if value is not None and value.standard_uncertainty and len(node.entries) > 1 and value_node is not None:
        log.error(
            "meaning-uncertainty",
            value_node.mark,
            "the uncertainty is stated twice",
            "remove the ± and the text after it here",
        )
    width, shape = _width(node, dimension, misspelt, log)
    degrees = _degrees(node, log)
    if value is None or log.raised > before:
        return None
    if width is None:
        return Quantity(value.value, value.unit, value.standard_uncertainty, degrees)
    if width.unit.dimension != value.unit.dimension or width.unit.from_si(width.value) < 0:
        at = node.get("half_width") or node.get("standard_uncertainty") or node
        message = f"the uncertainty must be positive and of the dimension of {value.unit.text}"
        log.error("meaning-uncertainty", at.mark, message, f"give it in {value.unit.text}")
        return None
    divisor = DISTRIBUTIONS[shape] if node.get("half_width") is not None else 1.0
    return Quantity(value.value, value.unit, (width.value - width.unit.offset) / divisor, degrees, shape)


def _width(
    node: Mapping, dimension: str | None, misspelt: Iterable[Mark], log: Findings
) -> tuple[Quantity | None, str]:
    """Returns the stated standard uncertainty or half-width of a quantity (None if neither is stated), and its distribution.
    `misspelt`: positions of unknown keys, one of which may be a misspelling of the missing key `half_width`."""
    standard, half, shape = node.get("standard_uncertainty"), node.get("half_width"), node.get("distribution")
    name = "rectangular"
    if shape is not None:
        name = str(shape.value) if isinstance(shape, Scalar) else ""
        if name not in DISTRIBUTIONS:
            log.error(
                "form-choice",
                shape.mark,
                f"unknown distribution '{name[:40]}'",
                f"known here: {', '.join(DISTRIBUTIONS)}",
            )
        elif half is None:
            hint = "add for example half_width: 30 arcsec"
            with log.resting_on(*misspelt):
                log.error("meaning-uncertainty", shape.mark, "a distribution needs a half_width", hint)
    widths = [(read_scalar(item, dimension, log), item) for item in (standard, half) if item is not None]
    if len(widths) == 2:
        log.error(
            "meaning-uncertainty", widths[1][1].mark, "both standard_uncertainty and half_width", "give one of them"
        )
    if not widths:
        return None, "normal"
    return widths[0][0], name if half is not None else "normal"


def _degrees(node: Mapping, log: Findings) -> float:
    freedom = node.get("degrees_of_freedom")
    if freedom is None:
        return math.inf
    value = freedom.value if isinstance(freedom, Scalar) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or value <= 0:
        log.error("form-type", freedom.mark, "degrees of freedom must be a number above zero", "write for example 9")
        return math.inf
    if math.isnan(value):
        log.error(
            "meaning-not-finite", freedom.mark, "'.nan' is not a number of degrees of freedom", "write for example 9"
        )
    return float(value)


def anchored(pattern: str) -> str:
    """Converts a pattern so that the pattern must match the whole text, both in JSON Schema and in Python. (With '$' alone, a final
    line break would be permitted.)"""
    return rf"^(?:{pattern})$(?!\n)"


def text_schema(dimension: str | None, uncertain: bool) -> dict[str, object]:
    """Returns the JSON Schema of a quantity that is written as a text. The schema does not check the unit; `planrunner check` does.
    `uncertain`: True if an uncertainty may be stated."""
    if takes_bare_number(dimension):
        pattern = BARE_OR_WITH_UNIT if uncertain else rf"(?:{_PLAIN_BARE}|{PLAIN})"
        return {"type": ["string", "number"], "maxLength": _MAX_TEXT, "pattern": anchored(pattern)}
    return {"type": "string", "maxLength": _MAX_TEXT, "pattern": anchored(WITH_UNIT if uncertain else PLAIN)}


def schema(dimension: str | None, uncertain: bool) -> dict[str, object]:
    """Returns the JSON Schema of a quantity. It accepts text and, if an uncertainty may be stated, also a mapping."""
    if not uncertain:
        return text_schema(dimension, uncertain=False)
    text = text_schema(dimension, uncertain=True)
    number = {"type": "number", "exclusiveMinimum": 0}
    kinds: dict[str, dict[str, object]] = {"distribution": {"enum": list(DISTRIBUTIONS)}, "degrees_of_freedom": number}
    properties = {
        name: {
            "description": description,
            "examples": [_rich_example(name, example, dimension)],
            **kinds.get(name, text),
        }
        for name, (description, example) in RICH_KEYS.items()
    }
    return {
        "anyOf": [
            text,
            {"type": "object", "additionalProperties": False, "required": ["value"], "properties": properties},
        ]
    }


def _rich_example(name: str, example: object, dimension: str | None) -> object:
    if name in ("distribution", "degrees_of_freedom"):
        return example
    return EXAMPLES.get(dimension or "", example)


def sweep_schema() -> dict[str, object]:
    """Returns the JSON Schema of a sweep that is written as one text, such as '±300, ±150 deg/s'."""
    pattern = rf"{_SPACE}(?:{_PIECE},{_SPACE_NEEDED})*{_SPACE}(?:{SIGNED}|{PLAIN})"
    description = "Values with a shared unit; ± gives both signs."
    return {"type": "string", "description": description, "maxLength": _MAX_SWEEP, "pattern": anchored(pattern)}


def signed_schema() -> dict[str, object]:
    """Returns the JSON Schema of a single value with a leading ±, which means both signs."""
    return {"type": "string", "maxLength": _MAX_TEXT, "pattern": anchored(SIGNED)}
