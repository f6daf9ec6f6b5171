"""Units by hand-worked factors and by pint; quantities in every form that a plan may write."""

from __future__ import annotations

import math
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from planrunner.base.findings import Findings, Mark
from planrunner.plan import units
from planrunner.plan.quantity import (
    Quantity,
    QuantityError,
    parse_quantity,
    parse_sweep,
    parse_symmetric,
    read_quantity,
)
from planrunner.plan.source import parse
from planrunner.plan.units import DIMENSIONS, EXAMPLES, UnknownUnitError, convert, unit


@pytest.mark.parametrize("text", sorted(units._DAILY))
def test_the_fast_table_says_what_pint_resolves(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fast = unit(text)
    monkeypatch.setattr(units, "_DAILY", {})
    slow = units.unit.__wrapped__(text)
    assert slow.dimension == fast.dimension
    assert slow.factor == pytest.approx(fast.factor, rel=1e-14)
    assert slow.offset == pytest.approx(fast.offset, rel=1e-14)


@pytest.mark.parametrize(
    ("text", "factor", "dimension"),
    [
        # Worked by hand from the definitions (SI Brochure, 9th edition, tables 8 and A; CGPM 1901 for g).
        ("g", 9.80665, "acceleration"),
        ("mg", 9.80665e-3, "acceleration"),
        ("ug", 9.80665e-6, "acceleration"),
        ("µg", 9.80665e-6, "acceleration"),
        ("Gal", 0.01, "acceleration"),
        ("mGal", 1e-5, "acceleration"),
        ("m/s²", 1.0, "acceleration"),
        ("deg/h", math.pi / 648_000, "angular rate"),
        ("°/h", math.pi / 648_000, "angular rate"),
        ("deg/hr", math.pi / 648_000, "angular rate"),
        ("dps", math.pi / 180, "angular rate"),
        ("rev/min", math.pi / 30, "angular rate"),
        ("deg/s/s", math.pi / 180, "angular acceleration"),
        ("arcmin", math.pi / 10_800, "angle"),
        ("′", math.pi / 10_800, "angle"),
        ("arcsec", math.pi / 648_000, "angle"),
        ("″", math.pi / 648_000, "angle"),
        ("turn", 2 * math.pi, "angle"),
        ("mrad", 1e-3, "angle"),
        ("d", 86_400.0, "time"),
        ("ms", 1e-3, "time"),
        ("kHz", 1e3, "frequency"),
        ("1/min", 1 / 60, "frequency"),
        ("hPa", 100.0, "pressure"),
        ("um", 1e-6, "length"),
        ("ppm", 1e-6, "ratio"),
        ("degC/min", 1 / 60, "temperature rate"),
    ],
)
def test_units_by_their_definitions(text: str, factor: float, dimension: str) -> None:
    found = unit(text)
    assert found.dimension == DIMENSIONS[dimension]
    assert found.factor == pytest.approx(factor, rel=1e-14)
    assert found.offset == 0.0


@pytest.mark.parametrize(
    ("text", "kelvin"),
    [
        ("-40 degC", 233.15),
        ("-40 degF", 233.15),
        ("0 degC", 273.15),
        ("32 °F", 273.15),
        ("212 degF", 373.15),
        ("25°C", 298.15),
        ("0 K", 0.0),
    ],
)
def test_temperatures(text: str, kelvin: float) -> None:
    assert parse_quantity(text, "temperature").value == pytest.approx(kelvin, abs=1e-10)


def test_facts_that_this_field_relies_on() -> None:
    assert unit("g").dimension != unit("kg").dimension, "g is standard gravity, not gram"
    assert unit("Hz").dimension != unit("rad/s").dimension, "a frequency is no rate"
    assert unit("deg").dimension != (), "an angle is a dimension"
    assert unit("local_g").dimension != unit("g").dimension, "local gravity is the site's"
    assert convert(1.0, "(deg/h)/(pulse/s)", "rad/pulse") == pytest.approx(math.pi / 648_000)
    assert convert(60.0, "deg/h/sqrt(Hz)", "deg/sqrt(h)") == pytest.approx(1.0)
    with pytest.raises(UnknownUnitError):
        convert(1.0, "Hz", "deg/s")


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            " ",
            "apples",
            "Deg/s",
            "s^",
            "^2",
            "s^10",
            "m^6^6^6^6",
            "m**2**3",
            "(m^6)^6",
            "1^9",
            "2*s",
            "s+s",
            "s-1",
            "__import__",
            "s.s",
        ),
        *(
            "s s",
            "deg s",
            "s(s)",
            "(s)(s)",
            "(s",
            "s)",
            "()",
            "sqrt",
            "sqrt()",
            "sqrt(sqrt(s))",
            "s//s",
            "s*/s",
            "s" * 61,
            "km" * 30,
            "π",
            "s\n+",
        ),
    ],
)
def test_texts_that_are_no_units(text: str) -> None:
    start = time.process_time()
    with pytest.raises(UnknownUnitError):
        unit(text)
    assert time.process_time() - start < 5.0


@given(st.text(alphabet="sgmradehHzC%µ°1234^*/() -sqrt", max_size=60))
def test_no_unit_text_computes_at_length(text: str) -> None:
    start = time.process_time()
    try:
        found = unit(text)
    except UnknownUnitError:
        pass
    else:
        assert math.isfinite(found.factor)
        assert found.factor > 0
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize("dimension", sorted(DIMENSIONS))
def test_an_example_of_every_dimension_is_one(dimension: str) -> None:
    assert parse_quantity(EXAMPLES[dimension], dimension).unit.dimension == DIMENSIONS[dimension]


DEG = math.pi / 180


@pytest.mark.parametrize(
    ("text", "value", "uncertainty"),
    [
        ("300 deg/s", 300 * DEG, 0.0),
        ("300deg/s", 300 * DEG, 0.0),
        ("  300  deg/s ", 300 * DEG, 0.0),
        ("300\u00a0°/s", 300 * DEG, 0.0),
        ("-1.5e2 deg/s", -150 * DEG, 0.0),
        ("−150 deg/s", -150 * DEG, 0.0),
        ("1e−1 rad/s", 0.1, 0.0),
        ("+.5 rad/s", 0.5, 0.0),
        ("5. rad/s", 5.0, 0.0),
        ("54.7356 deg ± 20 arcsec", 54.7356 * DEG, 20 / 3600 * DEG),
        ("54.7356 deg ± 0.5", 54.7356 * DEG, 0.5 * DEG),
        ("54.7356 ± 0.5 deg", 54.7356 * DEG, 0.5 * DEG),
        ("54.7356 +/- 0.5 deg", 54.7356 * DEG, 0.5 * DEG),
        ("20 degC ± 0.5 degC", 293.15, 0.5),
        ("20 degC ± 0.5 K", 293.15, 0.5),
        ("20 ± 0.5 degC", 293.15, 0.5),
        ("68 degF ± 1.8 degF", 293.15, 1.0),
        ("20 degC ± 1.8 degF", 293.15, 1.0),
        ("12 %", 0.12, 0.0),
        ("12 pulse", 12.0, 0.0),
    ],
)
def test_quantities(text: str, value: float, uncertainty: float) -> None:
    found = parse_quantity(text)
    assert found.value == pytest.approx(value, rel=1e-12)
    assert found.standard_uncertainty == pytest.approx(uncertainty, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "dimension", "code"),
    [
        ("9**9**9 deg/s", "angular rate", "form-quantity"),
        ("2*3 deg/s", "angular rate", "form-quantity"),
        ("1+1 deg/s", "angular rate", "form-quantity"),
        ("1,5 deg/s", "angular rate", "form-quantity"),
        ("1 000 deg/s", "angular rate", "form-quantity"),
        ("deg/s", "angular rate", "form-quantity"),
        ("", "time", "form-quantity"),
        ("nan deg/s", "angular rate", "form-quantity"),
        ("-inf deg/s", "angular rate", "form-quantity"),
        ("±5 deg", "angle", "form-quantity"),
        ("5 deg ±", "angle", "form-quantity"),
        ("5 deg ± 1 deg ± 1 deg", "angle", "form-quantity"),
        ("9" * 300 + " s", "time", "form-quantity"),
        ("30", "time", "form-unit-missing"),
        ("0.991", "time", "form-unit-missing"),
        ("5e1", "time", "form-unit-missing"),
        ("30 1", "time", "meaning-dimension"),
        ("30 Hz", "angular rate", "meaning-dimension"),
        ("30 deg", "angular rate", "meaning-dimension"),
        ("30 m", "time", "meaning-dimension"),
        ("20 g", "temperature", "meaning-dimension"),
        ("5 deg ± 1 s", "angle", "meaning-dimension"),
        ("5 apples", "time", "meaning-unit"),
        ("5 e", "time", "meaning-unit"),
        ("5 m^6^6^6^6", "length", "meaning-unit"),
        ("1e999 s", "time", "meaning-not-finite"),
        ("1e999999999 s", "time", "meaning-not-finite"),
        ("1e31 s", "time", "meaning-range"),
        ("1e-31 s", "time", "meaning-range"),
        ("5 deg ± -1 deg", "angle", "meaning-range"),
    ],
)
def test_texts_that_are_no_quantity(text: str, dimension: str, code: str) -> None:
    with pytest.raises(QuantityError) as caught:
        parse_quantity(text, dimension)
    assert caught.value.code == code
    assert str(caught.value)
    assert caught.value.hint


def test_numbers_without_a_unit_are_ratios_where_ratios_may_stand() -> None:
    assert parse_quantity("0.99", "ratio").value == 0.99
    assert parse_quantity("0.99 ± 0.01", None).standard_uncertainty == 0.01
    assert parse_quantity("0.99 1", None).unit.dimension == ()


def test_the_unit_that_was_probably_meant() -> None:
    hints = {}
    for text in ("5 Deg/s", "5 deg/S", "5 hz", "5 degc", "5 arcmn", "5 C", "5 rpm"):
        with pytest.raises(QuantityError) as caught:
            parse_quantity(text)
        hints[text] = caught.value.hint
    for text, meant in {
        "5 Deg/s": "deg/s",
        "5 deg/S": "deg/s",
        "5 hz": "Hz",
        "5 degc": "degC",
        "5 arcmn": "arcmin",
    }.items():
        assert f"'{meant}'" in hints[text]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("±300, ±150 deg/s", [300, -300, 150, -150]),
        ("±300 deg/s, ±150 deg/s", [300, -300, 150, -150]),
        ("10, 20, 30 deg/s", [10, 20, 30]),
        ("1 rad/s, 30 deg/s", [180 / math.pi, 30]),
        ("+/-5, -7, ±0 deg/s", [5, -5, -7, 0]),
        ("5 ± 1, 6 ± 1 deg/s", [5, 6]),
        ("5 deg/s", [5]),
        ("60, ±1 deg/s ± 0.1", [60, 1, -1]),
    ],
)
def test_sweeps(text: str, values: list[float]) -> None:
    found = parse_sweep(text, "angular rate")
    assert [item.to("deg/s") for item in found] == pytest.approx(values)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("1,5 deg/s", "form-quantity"),
        ("±300, ±150", "form-unit-missing"),
        ("1, , 2 deg/s", "form-quantity"),
        (", 2 deg/s", "form-quantity"),
        ("1, 2 Hz", "meaning-dimension"),
        ("1, x deg/s", "form-quantity"),
        ("1, " * 3000 + "1 deg/s", "form-quantity"),
    ],
)
def test_texts_that_are_no_sweep(text: str, code: str) -> None:
    with pytest.raises(QuantityError) as caught:
        parse_sweep(text, "angular rate")
    assert caught.value.code == code
    assert caught.value.hint


def test_both_signs_of_a_temperature_on_a_scale_are_unclear() -> None:
    with pytest.raises(QuantityError):
        parse_sweep("±40 degC", "temperature")


def test_limits_about_zero() -> None:
    bound = parse_symmetric("±0.5 deg/h")
    assert bound is not None
    assert bound.to("deg/h") == pytest.approx(0.5)
    assert parse_symmetric("0.5 deg/h") is None


def read(text: str, dimension: str | None = "angle") -> tuple[object, list[tuple[str, int, int]]]:
    log = Findings()
    node = parse(f"q: {text}", "f").get("q")
    assert node is not None
    found = read_quantity(node, dimension, log, uncertain=True)
    return found, [(item.code, item.mark.line, item.mark.column) for item in log]


@pytest.mark.parametrize(
    ("shape", "divisor"),
    [
        ("", math.sqrt(3)),
        ("rectangular", math.sqrt(3)),
        ("triangular", math.sqrt(6)),
        ("u-shaped", math.sqrt(2)),
        ("normal", 2.0),
    ],
)
def test_half_widths_become_standard_uncertainties(shape: str, divisor: float) -> None:
    """Divisors of JCGM 100:2008, 4.3.7 and 4.3.9."""
    given_shape = f", distribution: {shape}" if shape else ""
    found, errors = read(f"{{value: 10 deg, half_width: 6 arcmin{given_shape}, degrees_of_freedom: 12}}")
    assert errors == []
    assert isinstance(found, Quantity)
    assert found.standard_uncertainty == pytest.approx(0.1 * DEG / divisor)
    assert found.degrees_of_freedom == 12.0


@pytest.mark.parametrize(
    ("text", "errors"),
    [
        ("{half_width: 1 deg}", [("form-missing-key", "{half")]),
        ("{value: 1 deg, width: 1 deg}", [("form-unknown-key", "width")]),
        ("{value: 1 deg, half_width: 1 s}", [("meaning-dimension", "1 s")]),
        ("{value: 1 deg, half_width: -1 deg}", [("meaning-uncertainty", "-1 deg")]),
        ("{value: 1 deg, standard_uncertainty: 1 deg, half_width: 2 deg}", [("meaning-uncertainty", "2 deg")]),
        ("{value: 1 deg, half_width: 1 deg, distribution: flat}", [("form-choice", "flat")]),
        ("{value: 1 deg, distribution: normal}", [("meaning-uncertainty", "normal")]),
        ("{value: 9 deg ± 1 deg, half_width: 1 deg}", [("meaning-uncertainty", "9 deg")]),
        ("{value: 1 deg, degrees_of_freedom: 0}", [("form-type", "0}")]),
        ("{value: 1 deg, degrees_of_freedom: true}", [("form-type", "true")]),
        ("{value: {value: 1 deg}}", [("form-type", "{value: 1 deg")]),
        (
            "{value: 2 s, half_width: 1, colour: 5}",
            [("meaning-dimension", "2 s"), ("form-unit-missing", "1, "), ("form-unknown-key", "colour")],
        ),
        ("[1 deg]", [("form-type", "[")]),
        ("true", [("form-type", "true")]),
        ("5", [("form-unit-missing", "5")]),
        (".inf", [("form-quantity", ".inf")]),
    ],
)
def test_quantities_as_mappings_and_their_errors(text: str, errors: list[tuple[str, str]]) -> None:
    found, seen = read(text)
    assert found is None
    assert seen == [(code, 1, f"q: {text}".index(at) + 1) for code, at in errors]


def test_findings_know_their_place() -> None:
    log = Findings()
    log.error("a", Mark("f", 2, 1), "later")
    log.warning("b", Mark("f", 1, 5), "earlier")
    log.error("a", Mark("f", 2, 1), "later")
    assert [str(item) for item in log] == ["f:1:5: warning[b]: earlier", "f:2:1: error[a]: later"]
    assert len(log) == 2
    assert [item.code for item in log.errors] == ["a"]
    assert log.errors[0].to_json() == {
        "file": "f",
        "line": 2,
        "column": 1,
        "code": "a",
        "severity": "error",
        "message": "later",
        "hint": "",
    }
