"""Rounds numbers for readers. An uncertainty is rounded to two significant digits, and its value to the same decimal place (JCGM
100:2008, 7.2.6).

-1.2346 ± 0.0021        (1.5000 ± 0.0012)e-07        12400 ± 1300
"""

from __future__ import annotations

import math
from decimal import ROUND_HALF_EVEN, Decimal

from planrunner.base.dataclass import dataclass

_PLAIN_FROM, _PLAIN_TO = -5, 6  # decimal exponents of the leading digit that are written without a power of ten


@dataclass(frozen=True, slots=True)
class Rounded:
    """A rounded value.

    `value`, `uncertainty`: texts with the same number of decimals. `exponent`: exponent of the power of ten by which both numbers
    must be multiplied; 0 if there is none."""

    value: str
    uncertainty: str
    exponent: int = 0

    def __str__(self) -> str:
        text = f"{self.value} ± {self.uncertainty}" if self.uncertainty else self.value
        if not self.exponent:
            return text
        return f"({text})e{self.exponent:+03d}" if self.uncertainty else f"{text}e{self.exponent:+03d}"


def rounded(value: float, standard_uncertainty: float) -> Rounded:
    """Rounds the uncertainty to two significant digits, and the value to the same decimal place. Ties are rounded to even.

    If the uncertainty is zero, the value has seven significant digits. A value that is not finite is written as `∞`, `-∞` or "not known".
    """
    if not math.isfinite(value):
        return Rounded(_word(value), "" if standard_uncertainty == 0 else _alone(standard_uncertainty))
    if not math.isfinite(standard_uncertainty) or standard_uncertainty <= 0:
        exponent, text = _split(value, 7)
        return Rounded(text, "" if standard_uncertainty == 0 else _word(standard_uncertainty), exponent)
    spread = _significant(_decimal(standard_uncertainty), 2)
    last = spread.adjusted() - 1
    number = _quantized(_decimal(value), last)
    leading = max(spread.adjusted(), number.adjusted() if number else spread.adjusted())
    exponent = 0 if _PLAIN_FROM <= leading < _PLAIN_TO else leading
    return Rounded(_fixed(number, exponent, last), _fixed(spread, exponent, last), exponent)


def format_pair(value: float, uncertainty: float) -> tuple[str, str]:
    """Returns value and uncertainty as texts with the same last decimal and the same power of ten. The uncertainty has two
    significant digits."""
    pair = rounded(value, uncertainty)
    power = f"e{pair.exponent}" if pair.exponent else ""
    return pair.value + power, pair.uncertainty + power if pair.uncertainty else ""


def in_parentheses(value: float, standard_uncertainty: float) -> str:
    """Returns a value with its standard uncertainty in parentheses, such as `-1.2346(21)`. The number in parentheses is in units of
    the value's last digit (JCGM 100:2008, 7.2.2). In this way, the sign ± is used only for expanded uncertainties.

    An uncertainty of one or more is written with its decimals: `12.4(1.3)`.
    """
    pair = rounded(value, standard_uncertainty)
    if not pair.uncertainty:
        return str(pair)
    digits = pair.uncertainty
    if digits.startswith("0."):
        digits = digits[2:].lstrip("0")
    return f"{pair.value}({digits})" + (f"e{pair.exponent}" if pair.exponent else "")


def _decimal(number: float) -> Decimal:
    """Returns the shortest decimal number that represents a float: 0.1 becomes 0.1, not the nearest binary fraction."""
    return Decimal(repr(float(number)))


def _significant(number: Decimal, digits: int) -> Decimal:
    """Returns a number rounded to `digits` significant digits; 0.0996 to two digits becomes 0.10."""
    result = _quantized(number, number.adjusted() - digits + 1)
    return _quantized(result, result.adjusted() - digits + 1)


def _quantized(number: Decimal, last: int) -> Decimal:
    return number.scaleb(-last).to_integral_value(ROUND_HALF_EVEN).scaleb(last)


def _fixed(number: Decimal, exponent: int, last: int) -> str:
    """Returns a number as text with decimals up to the last significant digit; zero has no sign."""
    return f"{number.scaleb(-exponent) or Decimal(0):.{max(0, exponent - last)}f}"


def _split(value: float, digits: int) -> tuple[int, str]:
    if value == 0:
        return 0, "0"
    number = _significant(_decimal(value), digits).normalize()
    leading = number.adjusted()
    if _PLAIN_FROM <= leading < _PLAIN_TO + 3:
        return 0, f"{number:f}"
    return leading, f"{number.scaleb(-leading):f}"


def _word(number: float) -> str:
    return "not known" if math.isnan(number) or math.isfinite(number) else ("-∞" if number < 0 else "∞")


def _alone(number: float) -> str:
    return f"{number:.2g}" if math.isfinite(number) else _word(number)
