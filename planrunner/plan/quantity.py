"""Quantities: one number and one unit, never an expression.

    300 deg/s          a value
    54.7356 deg ± 20 arcsec   with its standard uncertainty
    ±0.5 deg/h         both signs: a sweep over +/-, or a limit around zero
    {value: 54.7356 deg, half_width: 30 arcsec, distribution: rectangular}   anything richer
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from planrunner.plan.findings import Findings
from planrunner.plan.source import Mapping, Node, Scalar
from planrunner.plan.units import DIMENSIONS, EXAMPLES, Unit, UnknownUnitError, dimension_name, unit

_NUMBER = r"[-+−]?(?:[0-9]{1,40}(?:\.[0-9]{0,40})?|\.[0-9]{1,40})(?:[eE][-+]?[0-9]{1,3})?"
_VALUE = re.compile(rf"({_NUMBER})\s*(.*)", re.DOTALL)
_SIGNS = re.compile(r"(±|\+/-|\+-)\s*(.*)", re.DOTALL)
_SPLIT = re.compile(r"±|\+/-")
PATTERN = rf"^\s*(±|\+/-)?\s*{_NUMBER}\s*\S.*$"

# Divisors of a half-width that give a standard uncertainty (JCGM 100:2008, 4.3.7 to 4.3.9; U-shaped: F.2.3.3).
DISTRIBUTIONS = {"rectangular": math.sqrt(3), "triangular": math.sqrt(6), "u-shaped": math.sqrt(2), "normal": 2.0}


@dataclass(frozen=True, slots=True)
class Quantity:
    """`value` and `standard_uncertainty` in SI-coherent units (rad, s, K, m/s^2 …); `unit` is the unit as written."""

    value: float
    unit: Unit
    standard_uncertainty: float = 0.0
    degrees_of_freedom: float = math.inf

    def __str__(self) -> str:
        text = f"{self.unit.from_si(self.value):.9g} {self.unit.text}"
        if self.standard_uncertainty:
            text += f" ± {self.standard_uncertainty / self.unit.factor:.3g} {self.unit.text}"
        return text

    def to(self, unit_text: str) -> float:
        """The value expressed in another unit of the same dimension."""
        return unit(unit_text).from_si(self.value)


class QuantityError(ValueError):
    """Why a text is no quantity: `code`, message and hint."""

    def __init__(self, code: str, message: str, hint: str = ""):
        super().__init__(message)
        self.code = code
        self.hint = hint


def parse_quantity(text: str, dimension: str | None = None) -> Quantity:
    """The quantity in `text`, of the named dimension (see `units.DIMENSIONS`) if one is given. Raises `QuantityError`."""
    parts = _SPLIT.split(text)
    if len(parts) > 2 or not parts[0].strip():
        raise _no_quantity(text, dimension)
    value, resolved = _value(parts[0], dimension, text)
    if len(parts) == 1:
        return Quantity(value, resolved)
    wanted = "temperature" if resolved.offset else dimension
    width, own = _value(parts[1], wanted, text, fallback=resolved)
    if own.dimension != resolved.dimension:
        raise QuantityError("meaning-dimension", f"{own.text} after ± is not of the dimension of {resolved.text}")
    uncertainty = (width - own.offset) if own.offset else width
    if uncertainty < 0:
        raise QuantityError("meaning-range", "a standard uncertainty cannot be negative", "write ± and a positive number")
    return Quantity(value, resolved, uncertainty)


def parse_sweep(text: str, dimension: str | None) -> list[Quantity]:
    """`±300, ±150 deg/s` or `10, 20, 30 deg` as quantities, ± giving + then −. Raises `QuantityError`."""
    pieces = [piece.strip() for piece in text.split(",")]
    last = _VALUE.fullmatch(_SIGNS.sub(r"\2", pieces[-1]))
    shared = last[2].strip() if last else ""
    values: list[Quantity] = []
    for piece in pieces:
        signed = _SIGNS.fullmatch(piece)
        body = signed[2] if signed else piece
        match = _VALUE.fullmatch(body)
        if match and not match[2].strip():
            body = f"{body} {shared}"
        quantity = parse_quantity(body, dimension)
        values.append(quantity)
        if signed:
            values.append(Quantity(-quantity.value, quantity.unit, quantity.standard_uncertainty))
    return values


def parse_symmetric(text: str, dimension: str | None = None) -> Quantity | None:
    """The positive bound of `±0.5 deg/h`, or None when the text has no leading ±. Raises `QuantityError`."""
    signed = _SIGNS.fullmatch(text.strip())
    return parse_quantity(signed[2], dimension) if signed else None


def _value(text: str, dimension: str | None, whole: str, fallback: Unit | None = None) -> tuple[float, Unit]:
    match = _VALUE.fullmatch(text.strip())
    if not match:
        raise _no_quantity(whole, dimension)
    number, unit_text = float(match[1].replace("−", "-")), match[2].strip()
    example = EXAMPLES.get(dimension or "", "300 deg/s")
    if not unit_text:
        if fallback is None:
            if dimension == "ratio":
                unit_text = "1"
            else:
                raise QuantityError("meaning-unit-missing", f"'{whole.strip()[:40]}' has no unit", f"write for example '{example}'")
        else:
            unit_text = fallback.text
    if re.match(r"[\^*/+\-−0-9.(]", unit_text):
        if unit_text[:1] != "(" or re.search(r"[0-9]\*\*|[-+]", unit_text):
            raise _no_quantity(whole, dimension)
    try:
        resolved = unit(unit_text)
    except UnknownUnitError as error:
        raise QuantityError("meaning-unit", f"{error}", f"write for example '{example}'") from None
    if dimension is not None and resolved.dimension != DIMENSIONS[dimension]:
        raise QuantityError(
            "meaning-dimension",
            f"'{unit_text[:40]}' is a unit of {dimension_name(resolved.dimension)}; a unit of {dimension} is needed",
            f"write for example '{example}'",
        )
    value = resolved.to_si(number)
    if not math.isfinite(value):
        raise QuantityError("meaning-not-finite", f"'{whole.strip()[:40]}' is not a finite number", f"write for example '{example}'")
    return value, resolved


def _no_quantity(text: str, dimension: str | None) -> QuantityError:
    example = EXAMPLES.get(dimension or "", "300 deg/s")
    if re.match(r"\s*[-+.]*(nan|inf)", text, re.IGNORECASE):
        return QuantityError("meaning-not-finite", f"'{text.strip()[:40]}' is not a finite number", f"write for example '{example}'")
    return QuantityError(
        "meaning-quantity",
        f"'{text.strip()[:40]}' is not one number and one unit",
        f"write for example '{example}'; expressions are not computed",
    )


def read_quantity(node: Node, dimension: str | None, log: Findings) -> Quantity | None:
    """The quantity a node holds, text or mapping; findings go to `log`, and then the result is None."""
    if isinstance(node, Mapping):
        return _read_rich(node, dimension, log)
    if not isinstance(node, Scalar):
        log.error("form-type", node.mark, "one quantity is expected here, not a list", _example(dimension))
        return None
    if node.value is None or isinstance(node.value, bool):
        log.error("form-type", node.mark, f"a quantity is expected here, not '{node.text[:40]}'", _example(dimension))
        return None
    try:
        return parse_quantity(node.text, dimension)
    except QuantityError as error:
        log.error(error.code, node.mark, str(error), error.hint)
        return None


def _example(dimension: str | None) -> str:
    return f"write for example '{EXAMPLES.get(dimension or '', '300 deg/s')}'"


_RICH_KEYS = ("value", "standard_uncertainty", "half_width", "distribution", "degrees_of_freedom")


def _read_rich(node: Mapping, dimension: str | None, log: Findings) -> Quantity | None:
    for key, _ in node.entries:
        if key.text not in _RICH_KEYS:
            log.error("form-unknown-key", key.mark, f"unknown key '{key.text[:60]}'", f"known here: {', '.join(_RICH_KEYS)}")
            return None
    value_node = node.get("value")
    if not isinstance(value_node, Scalar):
        log.error("form-missing-key", node.mark, "a quantity needs 'value'", _example(dimension))
        return None
    value = read_quantity(value_node, dimension, log)
    if value is None:
        return None
    spread, divisor = node.get("standard_uncertainty"), 1.0
    half_width = node.get("half_width")
    if half_width is not None:
        if spread is not None:
            log.error("meaning-uncertainty", half_width.mark, "both standard_uncertainty and half_width", "give one of them")
            return None
        shape = node.get("distribution")
        name = shape.text if isinstance(shape, Scalar) else "rectangular"
        if name not in DISTRIBUTIONS:
            at = shape.mark if shape else node.mark
            log.error("form-choice", at, f"unknown distribution '{name[:40]}'", f"known here: {', '.join(DISTRIBUTIONS)}")
            return None
        spread, divisor = half_width, DISTRIBUTIONS[name]
    uncertainty = 0.0
    if spread is not None:
        width = read_quantity(spread, _width_dimension(value.unit), log)
        if width is None:
            return None
        uncertainty = (width.value - width.unit.offset) / divisor
        if uncertainty < 0 or width.unit.dimension != value.unit.dimension:
            log.error("meaning-uncertainty", spread.mark, "an uncertainty must be positive and of the value's dimension", "")
            return None
    freedom = node.get("degrees_of_freedom")
    degrees = math.inf
    if freedom is not None:
        if not isinstance(freedom, Scalar) or not isinstance(freedom.value, int | float) or not freedom.value > 0:
            log.error("form-type", freedom.mark, "degrees of freedom must be a positive number", "write for example 9")
            return None
        degrees = float(freedom.value)
    return Quantity(value.value, value.unit, uncertainty, degrees)


def _width_dimension(value_unit: Unit) -> str | None:
    return next((name for name, known in DIMENSIONS.items() if known == value_unit.dimension), None)


def schema(dimension: str | None) -> dict[str, object]:
    """JSON Schema of a quantity; the unit itself is checked by `planrunner check`, which knows units."""
    text = {"type": ["string", "number"]} if dimension == "ratio" else {"type": "string", "pattern": r"[0-9]"}
    spread = {"type": ["string", "number"]}
    rich = {
        "type": "object",
        "additionalProperties": False,
        "required": ["value"],
        "properties": {
            "value": text,
            "standard_uncertainty": spread,
            "half_width": spread,
            "distribution": {"enum": list(DISTRIBUTIONS)},
            "degrees_of_freedom": {"type": "number", "exclusiveMinimum": 0},
        },
    }
    return {"anyOf": [text, rich]}


