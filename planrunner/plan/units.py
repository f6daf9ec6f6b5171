"""Defines the units. The library pint interprets the texts of units, using the project's own definitions.

The project has its own definitions for three reasons: in this field `g` is standard gravity, not gram; an angle is a dimension, so
that a frequency in Hz differs from a rate in deg/s; and outputs are in pulses. Common units are listed in `_DAILY`, so that the
check of a plan does not need to import pint; a test compares the list with pint.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import lru_cache
from typing import Any

from planrunner.base.dataclass import dataclass
from planrunner.base.findings import nearest

STANDARD_GRAVITY = 9.80665  # m/s^2, CGPM 1901
ZERO_CELSIUS = 273.15  # K

# Base units are SI-coherent: m, kg, s, K, A, rad, pulse, count. An angle is a dimension here.
DEFINITIONS = f"""
pico- = 1e-12 = p-
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
hecto- = 1e2 = h-
kilo- = 1e3 = k-
mega- = 1e6 = M-
meter = [length] = m = metre
second = [time] = s = sec
kilogram = [mass] = kg
kelvin = [temperature]; offset: 0 = K
ampere = [current] = A
radian = [angle] = rad
pulse = [pulse]
count = [count] = LSB
local_g = [local_gravity]
percent = 0.01 = _ = %
ppm = 1e-6
minute = 60 * second = min
hour = 60 * minute = h = hr
day = 24 * hour = d
degree = {math.pi!r} / 180 * radian = deg = °
arcmin = degree / 60 = arcminute
arcsec = arcmin / 60 = arcsecond
turn = 360 * degree = rev = revolution
mil = 0.001 * radian
nautical_mile = 1852 * meter = nmi
hertz = 1 / second = Hz
g = {STANDARD_GRAVITY!r} * meter / second ** 2 = standard_gravity
gal = 0.01 * meter / second ** 2 = Gal
newton = kilogram * meter / second ** 2 = N
pascal = newton / meter ** 2 = Pa
volt = kilogram * meter ** 2 / ampere / second ** 3 = V
tesla = kilogram / ampere / second ** 2 = T
degC = kelvin; offset: 273.15 = °C = celsius
dps = degree / second
degF = 5 / 9 * kelvin; offset: 233.15 + 200 / 9 = °F = fahrenheit
"""

Dimension = tuple[tuple[str, float], ...]

DIMENSIONS: dict[str, Dimension] = {
    "ratio": (),
    "angle": (("angle", 1.0),),
    "angular rate": (("angle", 1.0), ("time", -1.0)),
    "angular acceleration": (("angle", 1.0), ("time", -2.0)),
    "time": (("time", 1.0),),
    "frequency": (("time", -1.0),),
    "temperature": (("temperature", 1.0),),
    "temperature rate": (("temperature", 1.0), ("time", -1.0)),
    "acceleration": (("length", 1.0), ("time", -2.0)),
    "length": (("length", 1.0),),
    "speed": (("length", 1.0), ("time", -1.0)),
    "pressure": (("length", -1.0), ("mass", 1.0), ("time", -2.0)),
    "voltage": (("current", -1.0), ("length", 2.0), ("mass", 1.0), ("time", -3.0)),
}
METERED = (DIMENSIONS["voltage"], DIMENSIONS["pressure"])
"""Dimensions of quantities of the surroundings that meters measure. The reading of a meter may keep one value, and it follows the
surroundings, not the motion. The plan states its uncertainty separately."""

EXAMPLES = {
    "ratio": "0.5 %",
    "angle": "5 arcmin",
    "angular rate": "300 deg/s",
    "angular acceleration": "50 deg/s^2",
    "time": "2 min",
    "frequency": "0.2 Hz",
    "temperature": "25 degC",
    "temperature rate": "3 K/min",
    "acceleration": "1 g",
    "length": "12 mm",
    "speed": "10 m/s",
    "pressure": "101.3 kPa",
    "voltage": "5 V",
}


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit that was found in the definitions: SI value = written value × factor + offset."""

    text: str
    factor: float
    dimension: Dimension
    offset: float = 0.0

    def to_si(self, value: float) -> float:
        return value * self.factor + self.offset

    def from_si(self, value: float) -> float:
        return (value - self.offset) / self.factor


class UnknownUnitError(ValueError):
    """Reports that a text is not a unit. The message explains the fault to the user."""


_DEG = math.pi / 180
_ANGLE, _RATE, _TIME = DIMENSIONS["angle"], DIMENSIONS["angular rate"], DIMENSIONS["time"]
_ACCEL = DIMENSIONS["acceleration"]
_DAILY = {
    unit.text: unit
    for unit in (
        Unit("1", 1.0, ()),
        Unit("%", 0.01, ()),
        Unit("ppm", 1e-6, ()),
        Unit("deg", _DEG, _ANGLE),
        Unit("rad", 1.0, _ANGLE),
        Unit("mrad", 1e-3, _ANGLE),
        Unit("arcmin", _DEG / 60, _ANGLE),
        Unit("arcsec", _DEG / 3600, _ANGLE),
        Unit("deg/s", _DEG, _RATE),
        Unit("deg/h", _DEG / 3600, _RATE),
        Unit("rad/s", 1.0, _RATE),
        Unit("deg/s^2", _DEG, DIMENSIONS["angular acceleration"]),
        Unit("s", 1.0, _TIME),
        Unit("ms", 1e-3, _TIME),
        Unit("min", 60.0, _TIME),
        Unit("h", 3600.0, _TIME),
        Unit("Hz", 1.0, DIMENSIONS["frequency"]),
        Unit("degC", 1.0, DIMENSIONS["temperature"], ZERO_CELSIUS),
        Unit("K", 1.0, DIMENSIONS["temperature"]),
        Unit("K/min", 1 / 60, DIMENSIONS["temperature rate"]),
        Unit("m", 1.0, DIMENSIONS["length"]),
        Unit("mm", 1e-3, DIMENSIONS["length"]),
        Unit("km", 1000.0, DIMENSIONS["length"]),
        Unit("nmi", 1852.0, DIMENSIONS["length"]),
        Unit("m/s", 1.0, (("length", 1.0), ("time", -1.0))),
        Unit("nmi/h", 1852 / 3600, (("length", 1.0), ("time", -1.0))),
        Unit("m/s^2", 1.0, _ACCEL),
        Unit("g", STANDARD_GRAVITY, _ACCEL),
        Unit("mg", STANDARD_GRAVITY / 1000, _ACCEL),
        Unit("ug", STANDARD_GRAVITY / 1e6, _ACCEL),
        Unit("pulse/s", 1.0, (("pulse", 1.0), ("time", -1.0))),
        Unit("pulse", 1.0, (("pulse", 1.0),)),
        Unit("(deg/h)/(pulse/s)", _DEG / 3600, (("angle", 1.0), ("pulse", -1.0))),
        Unit("deg/h/g", _DEG / 3600 / STANDARD_GRAVITY, (("angle", 1.0), ("length", -1.0), ("time", 1.0))),
        Unit("pulse/sqrt(s)", 1.0, (("pulse", 1.0), ("time", -0.5))),
        Unit("pulse/s/sqrt(s)", 1.0, (("pulse", 1.0), ("time", -1.5))),
        Unit("(pulse/s)/(deg/s)", 1 / _DEG, (("angle", -1.0), ("pulse", 1.0))),
        Unit("(pulse/s)/(m/s^2)", 1.0, (("length", -1.0), ("pulse", 1.0), ("time", 1.0))),
        Unit("deg/sqrt(h)", _DEG / 60, (("angle", 1.0), ("time", -0.5))),
        Unit("arcsec/sqrt(h)", _DEG / 3600 / 60, (("angle", 1.0), ("time", -0.5))),
        Unit("m/s/sqrt(h)", 1 / 60, (("length", 1.0), ("time", -1.5))),
        Unit("deg/h/sqrt(h)", _DEG / 3600 / 60, (("angle", 1.0), ("time", -1.5))),
        Unit("ug*sqrt(s)", STANDARD_GRAVITY / 1e6, (("length", 1.0), ("time", -1.5))),
        Unit("ug/sqrt(h)", STANDARD_GRAVITY / 1e6 / 60, (("length", 1.0), ("time", -2.5))),
        Unit("deg/s/sqrt(Hz)", _DEG, (("angle", 1.0), ("time", -0.5))),
        Unit("ug/sqrt(Hz)", STANDARD_GRAVITY / 1e6, (("length", 1.0), ("time", -1.5))),
        Unit("ppm/K", 1e-6, (("temperature", -1.0),)),
        Unit("ppm/K^2", 1e-6, (("temperature", -2.0),)),
        Unit("deg/h/K", _DEG / 3600, (("angle", 1.0), ("temperature", -1.0), ("time", -1.0))),
        Unit("deg/h/K^2", _DEG / 3600, (("angle", 1.0), ("temperature", -2.0), ("time", -1.0))),
        Unit("ug/K", STANDARD_GRAVITY / 1e6, (("length", 1.0), ("temperature", -1.0), ("time", -2.0))),
        Unit("ug/K^2", STANDARD_GRAVITY / 1e6, (("length", 1.0), ("temperature", -2.0), ("time", -2.0))),
        Unit("V", 1.0, DIMENSIONS["voltage"]),
        Unit("mV", 1e-3, DIMENSIONS["voltage"]),
        Unit("Pa", 1.0, DIMENSIONS["pressure"]),
        Unit("hPa", 100.0, DIMENSIONS["pressure"]),
        Unit("kPa", 1000.0, DIMENSIONS["pressure"]),
        Unit("ug/g^2", 1e-6 / STANDARD_GRAVITY, (("length", -1.0), ("time", 2.0))),
        Unit("ug/g^3", 1e-6 / STANDARD_GRAVITY**2, (("length", -2.0), ("time", 4.0))),
        Unit("ppm/(deg/s)", 1e-6 / _DEG, (("angle", -1.0), ("time", 1.0))),
        Unit("ppm/dps^2", 1e-6 / _DEG**2, (("angle", -2.0), ("time", 2.0))),
    )
}

# Names, products, quotients, sqrt(), parentheses, and small powers of a single name: towers such as m^6^6^6^6 would take long to compute.
_POWER = r"(?:\^|\*\*)-?[1-6](?![0-9^]|\*\*)"
_SHAPE = re.compile(rf"(?:(?:[A-Za-zµμ_]{{1,24}}|%)(?:{_POWER})?|1(?![0-9.])|\*(?!\*)|[/() ])+")
_UNCLEAR = re.compile(r"[A-Za-zµμ%)] +[A-Za-zµμ%(]|// *|\) *\(|[A-Za-zµμ%]\((?<!sqrt\()|\)[A-Za-zµμ%]")
_MAX_TEXT = 60
_SIGNS = {
    "°C": "degC",
    "°F": "degF",
    "°": "deg",
    "′": "arcmin",
    "″": "arcsec",
    "·": "*",
    "⋅": "*",
    "²": "^2",
    "³": "^3",
    "√": "sqrt",
}
_AS_SIGN = re.compile("|".join(_SIGNS))
_SQRT = re.compile(r"sqrt *\(([A-Za-zµμ%*/ ]*)\)")


@lru_cache(maxsize=4096)
def unit(text: str) -> Unit:
    """Returns the unit that `text` names, for example `deg/s`. Raises `UnknownUnitError` if the text is not a unit."""
    text = text.strip()
    if text in _DAILY:
        return _DAILY[text]
    written = _AS_SIGN.sub(lambda match: _SIGNS[match[0]], text)
    if written in _DAILY:
        return replace(_DAILY[written], text=text)
    if not written or len(text) > _MAX_TEXT or not _SHAPE.fullmatch(written) or _UNCLEAR.search(written):
        raise UnknownUnitError(f"'{text[:40]}' is not a unit")
    try:
        registry = _registry()
        parsed = registry.parse_units(_SQRT.sub(r"(\1)**0.5", written))
        factor, root = registry.get_base_units(parsed)
        dimension = {name.strip("[]"): float(power) for name, power in root.dimensionality.items()}
    except Exception:
        raise UnknownUnitError(f"'{text[:40]}' is not a unit") from None
    offset = 0.0
    if str(parsed) in ("degC", "degF"):
        offset = registry.Quantity(0.0, parsed).to("kelvin").magnitude
        factor, _ = registry.get_base_units(f"delta_{parsed}")
    if not (1e-30 < float(factor) < 1e30):
        raise UnknownUnitError(f"'{text[:40]}' is not a unit of measurement")
    return Unit(text, float(factor), tuple(sorted(dimension.items())), float(offset))


# Alternative spellings.
_OTHERWISE = {
    **{
        "c": "degC",
        "f": "degF",
        "celsius": "degC",
        "degrees": "deg",
        "degree/s": "deg/s",
        "degrees/s": "deg/s",
        "deg/second": "deg/s",
    },
    **{
        "sek": "s",
        "secs": "s",
        "seconds": "s",
        "mins": "min",
        "minutes": "min",
        "hours": "h",
        "hrs": "h",
        "std": "h",
        "days": "d",
    },
    **{"rpm": "rev/min", "rps": "rev/s", "u/min": "rev/min", "gn": "g", "gs": "g", "pulses": "pulse", "pps": "pulse/s"},
}


def measures(text: str, quantity: str) -> bool:
    """Returns True if the text names a unit of a quantity, such as "temperature"; False if the unit is unknown or belongs to
    another quantity."""
    try:
        return unit(text).dimension == DIMENSIONS[quantity]
    except UnknownUnitError:
        return False


def suggestion(text: str, dimension: Dimension | None = None) -> str:
    """Returns the unit that an invalid text probably means: the same letters in another case, or the closest common unit; '' if
    there is none.

    `dimension`: only units of this dimension are suggested.
    """
    if text.strip().lower() in _OTHERWISE:
        return f"did you mean '{_OTHERWISE[text.strip().lower()]}'?"
    for known in (*_DAILY, "kHz", "degF"):
        if known.lower() == text.strip().lower():
            return f"units are case-sensitive: did you mean '{known}'?"
    near = nearest(text.strip(), [name for name, one in _DAILY.items() if dimension in (None, one.dimension)])
    return "" if near is None else f"did you mean '{near}'?"


@lru_cache(maxsize=1)
def _registry() -> Any:
    import pint

    registry: Any = pint.UnitRegistry(None, autoconvert_offset_to_baseunit=True)
    for line in DEFINITIONS.strip().splitlines():
        registry.define(line)
    return registry


def convert(value: float, from_unit: str, to_unit: str) -> float:
    """Converts `value` to another unit of the same dimension. Raises `UnknownUnitError` if a unit is unknown or has another
    dimension."""
    source, target = unit(from_unit), unit(to_unit)
    if source.dimension != target.dimension:
        raise UnknownUnitError(f"{from_unit} cannot be expressed in {to_unit}")
    return target.from_si(source.to_si(value))


def dimension_name(dimension: Dimension) -> str:
    """Returns the usual name of a dimension or, if it has none, its base units with their exponents."""
    for name, known in DIMENSIONS.items():
        if known == dimension:
            return name
    return " ".join(f"{base}^{power:g}" for base, power in dimension) or "ratio"
