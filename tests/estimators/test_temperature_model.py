"""Curves over temperature: by hand, against scipy's spline, the truth, a real vacuum-chamber recording, and what cannot be done."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from recorded import figure, from_means, from_samples, noisy, real, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators import method
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import (
    Coefficient,
    DesignRequest,
    Estimate,
    EstimateRequest,
    EstimationError,
    Setup,
)
from planrunner.estimators.method import designed
from planrunner.estimators.temperature.branches import approached, branches, difference_of
from planrunner.estimators.temperature.curve import (
    HeldOut,
    OverTemperature,
    chosen,
    correlation_time,
    fit_curve,
    groups_of,
    held_out,
    natural_spline,
)
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.temperature.temperature_model import TemperatureModel
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity
from planrunner.tasks.check import check_plan
from planrunner.uncertainty.decision import expanded_uncertainty
from planrunner.uncertainty.influences import InputQuantity, Inputs

SITE = Site(math.radians(40.0))
KELVIN = 273.15
NOTHING = Setup()
CHAMBER = Setup(inputs=Inputs({"temperature": InputQuantity("temperature", 0.0, "K", 0.2)}))


def given(temperature: ArrayLike, value: ArrayLike, u: ArrayLike = 0.0, name: str = "K", unit: str = "1") -> Estimate:
    """An estimate that gives one coefficient by temperature."""
    t, y = np.atleast_1d(temperature).astype(float), np.atleast_1d(value).astype(float)
    data = {"temperature_degC": t.tolist(), "value": y.tolist(), "unit": unit}
    data["standard_uncertainty"] = np.broadcast_to(np.asarray(u, dtype=float), t.shape).tolist()
    return Estimate(
        "cal",
        "other",
        (Coefficient(name, float(y[0]), unit, 0.0),),
        np.zeros((1, 1)),
        extra={"by_temperature": {name: data}},
    )


def model(*uses: Estimate, recorded: tuple = (), setup: Setup = NOTHING, **keys: Any) -> Estimate:
    parameters = TemperatureModelParameters(**keys)
    named = {f"cal{n}": one for n, one in enumerate(uses)}
    request = EstimateRequest("curve", recorded, parameters, SITE, sensor("gyro"), named, setup=setup)
    return TemperatureModel().estimate(request)


# -- by hand ---------------------------------------------------------------------------------------------------------


def test_a_line_by_hand() -> None:
    """1, 2, 6 at 0, 10, 20 degC: slope 5/20 per kelvin through the mean 3 at 10 degC; residuals 0.5, −1, 0.5, so s² = 1.5 with one degree
    of freedom; u(slope) = s/√200, u at 10 degC = s/√3."""
    found = model(given([0, 10, 20], [1, 2, 6]), order=1, reference=parse_quantity("10 degC"))
    assert found["K_T0"].value == pytest.approx(3.0, rel=1e-9)
    assert found["K_T1"].value == pytest.approx(0.25, rel=1e-9) and found["K_T1"].unit == "1/K"
    assert found["K_T1"].standard_uncertainty == pytest.approx(math.sqrt(1.5 / 200), rel=1e-9)
    assert found["K_T0"].standard_uncertainty == pytest.approx(math.sqrt(0.5), rel=1e-9)
    assert found["K_T0"].degrees_of_freedom == 1
    curve = next(table for table in found.tables if table.title == "Curve of K")
    assert curve.rows[0][:3] == pytest.approx((0.0, 0.5, math.sqrt(0.5 + 0.75)), rel=1e-9)


def test_propagated_uncertainty_by_hand() -> None:
    """Weights 1/u²: with u = 1, 2 at two temperatures the line passes through both; u of its slope is √5 over the distance."""
    found = model(given([0, 10], [1, 2], [1, 2]), order=1, reference=parse_quantity("0 degC"), uncertainty="propagated")
    assert found["K_T1"].value == pytest.approx(0.1)
    assert found["K_T1"].standard_uncertainty == pytest.approx(math.sqrt(5) / 10, rel=1e-9)
    assert found["K_T0"].standard_uncertainty == pytest.approx(1.0, rel=1e-9)


def test_held_out_by_hand() -> None:
    """0, 1, 2 at 0, 1, 2: a constant misses by 1.5, 0, −1.5, a line by nothing."""
    t = np.array([0.0, 1.0, 2.0])
    constant, line = held_out("polynomial", (0, 1), 0.0, t, t, np.ones(3), np.arange(3))
    assert constant.error == pytest.approx(1.5)
    assert constant.standard_error == pytest.approx(np.std([2.25, 0, 2.25], ddof=1) / math.sqrt(3))
    assert line.error == pytest.approx(0, abs=1e-20)


def test_the_one_standard_error_rule() -> None:
    errors = [HeldOut(0, 9.0, 1.0), HeldOut(1, 1.3, 0.2), HeldOut(2, 1.0, 0.4), HeldOut(3, 1.1, 0.1)]
    assert chosen(errors, "one_standard_error").order == 1
    assert chosen(errors, "smallest_error").order == 2


def test_temperatures_that_belong_together() -> None:
    assert groups_of(np.array([20.0, -40.2, -39.9, 20.6, 60.0, 21.1]), 1.0).tolist() == [1, 0, 0, 1, 3, 2]


@pytest.mark.parametrize("knots", [(-40.0, 60.0), (-40.0, 0.0, 25.0, 60.0), (-40.0, -10.0, 5.0, 25.0, 33.0, 60.0)])
def test_spline_is_the_natural_spline_of_scipy(knots: tuple[float, ...]) -> None:
    interpolate = pytest.importorskip("scipy.interpolate")
    values = np.random.default_rng(1).standard_normal(len(knots))
    at = np.linspace(knots[0], knots[-1], 41)
    smooth = interpolate.CubicSpline(knots, values, bc_type="natural") if len(knots) > 2 else None
    expected = np.interp(at, knots, values) if smooth is None else smooth(at)
    assert natural_spline(np.array(knots), at) @ values == pytest.approx(expected, abs=1e-12)
    beyond = natural_spline(np.array(knots), np.array([-60.0, -50.0, -40.0, 60.0, 70.0, 80.0])) @ values
    assert np.diff(beyond[:3])[0] == pytest.approx(np.diff(beyond[:3])[1], abs=1e-12)
    assert np.diff(beyond[3:])[0] == pytest.approx(np.diff(beyond[3:])[1], abs=1e-12)
    inside = natural_spline(np.array(knots), np.array([-40.0, -40.0 + 1e-6])) @ values
    assert (beyond[2] - beyond[1]) / 10 == pytest.approx((inside[1] - inside[0]) / 1e-6, abs=1e-4)


# -- against the truth -----------------------------------------------------------------------------------------------

TEMPERATURES = np.arange(-40.0, 65.0, 10.0)


def held(celsius: np.ndarray, values: np.ndarray, sigma: float, draw: np.random.Generator) -> tuple:
    """A segment of samples at each temperature; sigma: of each mean."""
    return tuple(
        noisy(
            replace(segment(f"T{t:+.0f}"), temperature=t + KELVIN),
            {"gyro": y},
            "deg/s",
            sigma,
            draw,
            300.0 * k,
            samples=64,
        )
        for k, (t, y) in enumerate(zip(celsius.tolist(), values.tolist(), strict=True))
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "order"), [((3.0,), 0), ((3.0, 0.05), 1), ((3.0, 0.05, -1e-3), 2), ((3.0, 0.05, -1e-3, 3e-5), 3)]
)
def test_the_order_is_found(truth: tuple[float, ...], order: int) -> None:
    """Of 50 realisations the rule takes the true order in most, a lower one in none: each power is many standard errors large."""
    draw, found = np.random.default_rng(order), []
    for _ in range(50):
        exact = np.polynomial.polynomial.polyval(TEMPERATURES - 25, truth) + np.zeros(len(TEMPERATURES))
        made = model(recorded=held(TEMPERATURES, exact, 0.05, draw), channels=("gyro",))
        found.append(made.settings["order"]["gyro"])
    assert min(found) >= order
    assert np.mean(np.array(found) == order) > 0.7


@pytest.mark.parametrize("form", ["polynomial", "spline"])
def test_truth_within_the_stated_uncertainty(form: str) -> None:
    """200 recordings at fixed order: coefficients by their u, and the curve at temperatures between."""
    draw, squares, between = np.random.default_rng(5), [], []
    truth = np.polynomial.Polynomial([3.0, 0.05, -1e-3]) if form == "polynomial" else None
    knots = np.quantile(TEMPERATURES, np.linspace(0, 1, 4))
    at_knots = np.array([1.0, 3.0, 2.0, 2.5])
    for _ in range(200):
        exact = truth(TEMPERATURES - 25) if truth else natural_spline(knots, TEMPERATURES) @ at_knots
        recorded = held(TEMPERATURES, exact, 0.05, draw)
        found = model(recorded=recorded, channels=("gyro",), form=form, order=2 if truth else 3)
        expected = truth.coef if truth else at_knots
        squares.append(
            [((c.value - e) / c.standard_uncertainty) ** 2 for c, e in zip(found.coefficients, expected, strict=True)]
        )
        table = next(table for table in found.tables if table.title.startswith("Curve"))
        curve = [figure(cell) for cell in table.rows[3]]
        exact_between = truth(curve[0] - 25) if truth else natural_spline(knots, np.array([curve[0]]))[0] @ at_knots
        between.append(((curve[1] - exact_between) / curve[2]) ** 2)
    freedom = 11 - len(squares[0])
    assert np.mean(squares) == pytest.approx(freedom / (freedom - 2), rel=0.25)
    assert np.mean(between) == pytest.approx(freedom / (freedom - 2), rel=0.35)


def test_estimates_of_one_temperature_each_are_put_together() -> None:
    uses = [given(t, 1 + 1e-3 * t, 1e-4) for t in (-40.0, 0.0, 20.0, 60.0)]
    found = model(*uses, order=1)
    assert found["K_T1"].value == pytest.approx(1e-3)
    assert found["K_T0"].value == pytest.approx(1.025)


# -- channels --------------------------------------------------------------------------------------------------------


def ramp(
    label: str, low: float, high: float, gyro: Callable[[np.ndarray], np.ndarray], seed: int = 0
) -> RecordedSegment:
    """A ramp of 1000 s at 10 Hz with a thermometer in kelvin."""
    time = np.arange(10_000) / 10
    celsius = np.linspace(low, high, time.size)
    noise = 0.01 * np.random.default_rng(seed).standard_normal(time.size)
    planned = replace(segment(label), temperature=low + KELVIN, ramp_to=high + KELVIN)
    channels = {"gyro": gyro(celsius) + noise, "inside": celsius + KELVIN}
    return from_samples(planned, time, channels, {"gyro": "deg/s", "inside": "K"})


def test_a_ramp_and_its_hysteresis() -> None:
    """0.1 + 0.002·(T − 25), 0.03 more on the way down but at the ends: the loop is 0.03 wide in the middle."""
    loop = 0.03
    up = ramp("up", -20, 60, lambda t: 0.1 + 0.002 * (t - 25), 1)
    down = ramp("down", 60, -20, lambda t: 0.1 + 0.002 * (t - 25) + loop * (1 - ((t - 20) / 40) ** 2), 2)
    keys: dict[str, Any] = {"channels": ("gyro",), "temperature_channel": "inside"}
    alone = model(recorded=(up,), **keys, order=1)
    assert alone["gyro_T1"].value == pytest.approx(0.002, abs=4 * alone["gyro_T1"].standard_uncertainty)
    assert alone["gyro_T1"].unit == "deg/s/K" and "hysteresis_gyro" not in [c.name for c in alone.coefficients]
    # 80 bins of 125 samples: u(slope) = 0.01/√10000/(80/√12).
    assert alone["gyro_T1"].standard_uncertainty == pytest.approx(0.01 / 100 / (80 / math.sqrt(12)), rel=0.25)
    both = model(recorded=(up, down), **keys)
    wide = both["hysteresis_gyro"]
    assert abs(wide.value - loop) < 3 * wide.standard_uncertainty < 0.1 * loop
    assert any("each recorded only once" in text for text in both.warnings)
    branches = next(table for table in both.tables if table.title == "Hysteresis of gyro")
    for celsius, rising, falling, difference, u, *_ in ([figure(cell) for cell in row] for row in branches.rows):
        assert rising == pytest.approx(0.1 + 0.002 * (celsius - 25), abs=0.002)
        assert difference == pytest.approx(rising - falling, abs=1e-12)
        assert difference == pytest.approx(-loop * (1 - ((celsius - 20) / 40) ** 2), abs=4 * u)


def cycle(times: int, seed: int, labels: bool) -> tuple[RecordedSegment, ...]:
    """20 → −40 → 60 → 20 degC, `times` times, at 0.2 K/s with 2 samples a second, in one segment or in one for each ramp: a loop of 0.04
    and an offset of each ramp with a standard deviation of 0.01. A cycle goes on with the ramp with which the one before ended."""
    draw, offset = np.random.default_rng(seed), 0.0
    parts: list[tuple[np.ndarray, np.ndarray]] = []
    for low, high in ((20, -40), (-40, 60), (60, 20)) * times:
        celsius = np.arange(low, high, math.copysign(0.1, high - low))
        loop = 0.04 * (1 - ((celsius - 10) / 50) ** 2) * np.sign(high - low) / 2
        offset = offset if parts and low == 20 else 0.01 * draw.standard_normal()
        value = 0.1 + 0.002 * (celsius - 25) + loop + offset
        parts.append((celsius, value + 0.005 * draw.standard_normal(celsius.size)))
    if not labels:
        parts = [(np.concatenate([t for t, _ in parts]), np.concatenate([y for _, y in parts]))]
    made, begin = [], 0
    for number, (celsius, value) in enumerate(parts):
        time = (begin + np.arange(celsius.size)) / 2
        begin += celsius.size
        channels = {"gyro": value, "inside": celsius + 0.02 * np.sin(time)}
        made.append(from_samples(segment(f"part{number}"), time, channels, {"gyro": "deg/s", "inside": "degC"}))
    return tuple(made)


@pytest.mark.parametrize("times", [1, 3])
def test_a_cycle_gives_the_same_as_one_segment_and_as_ramps(times: int) -> None:
    keys: dict[str, Any] = {"channels": ("gyro",), "temperature_channel": "inside", "order": 1}
    whole, apart = (model(recorded=cycle(times, 5, labels), **keys) for labels in (False, True))
    for one, other in zip(whole.coefficients, apart.coefficients, strict=True):
        assert one.name == other.name
        assert one.value == pytest.approx(other.value, abs=0.3 * other.standard_uncertainty)
        assert one.standard_uncertainty == pytest.approx(other.standard_uncertainty, rel=0.1)
        assert one.degrees_of_freedom == pytest.approx(other.degrees_of_freedom, rel=0.2)
    assert any("ramps in the same direction differ by offsets" in note for note in apart.notes)
    assert not any("each recorded only once" in text for text in apart.warnings)


def test_ramps_that_differ_at_random_are_not_hysteresis() -> None:
    """Two cooling ramps 0.0138 deg/s apart and a heating ramp between them, without hysteresis: its interval contains zero."""
    line = {"up": 0.0069, "first": 0.0, "second": 0.0138}
    ramps = [
        ramp("first", 20, -40, lambda t: 0.002 * t + line["first"], 1),
        ramp("up", -40, 60, lambda t: 0.002 * t + line["up"], 2),
        ramp("second", 60, 20, lambda t: 0.002 * t + line["second"], 3),
    ]
    found = model(recorded=tuple(ramps), channels=("gyro",), temperature_channel="inside", order=1)["hysteresis_gyro"]
    assert found.degrees_of_freedom < 4
    assert found.value < 2 * found.standard_uncertainty


def loops(draw: np.random.Generator, cycles: int, offset: float, slope: float) -> tuple[np.ndarray, ...]:
    """Temperature, value, direction and ramp of cycles from −40 to 60 degC: a line, a loop of 0.4, and for each ramp an offset and a slope
    over 29 K, random with these standard deviations; noise 0.02."""
    celsius, parts = np.linspace(-40, 60, 41), []
    for number in range(2 * cycles):
        sense = 1 - 2 * (number % 2)
        away = offset * draw.standard_normal() + slope * draw.standard_normal() * (celsius - 10) / 29
        value = 3 + 0.05 * (celsius - 25) + sense * 0.2 * (1 - ((celsius - 10) / 50) ** 2) + away
        noise = 0.02 * draw.standard_normal(41)
        parts.append((celsius, value + noise, np.full(41, sense), np.full(41, number)))
    return tuple(np.concatenate(one) for one in zip(*parts, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "slope"), [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1)])
def test_intervals_of_curve_and_loop_include_the_scatter_of_cycles(offset: float, slope: float) -> None:
    """2000 tests of four cycles: the 95 % intervals of the common part and of the loop contain the truth."""
    draw, at, inside = np.random.default_rng(11), np.array([-30.0, 10.0, 50.0]), []
    for _ in range(2000):
        celsius, value, sense, number = loops(draw, 4, offset, slope)
        form = difference_of(celsius, sense, 4, 1.0, 50)
        assert form is not None
        values = OverTemperature(
            celsius,
            value,
            np.ones(len(value)),
            groups_of(celsius, 1.0),
            number,
            number,
            sense,
            form.columns(celsius, sense),
        )
        fit = fit_curve("polynomial", 1, 4, 25.0, values, 0, "one_standard_error", True)
        assert fit.beside_spread is not None
        rows = form.width(at)
        curve, width = fit.predict(at), (rows @ fit.beside, *fit.beside_spread.of(rows))
        for (found, u, freedom), truth in ((curve, 3 + 0.05 * (at - 25)), (width, 0.4 * (1 - ((at - 10) / 50) ** 2))):
            wide = [expanded_uncertainty(*one) for one in zip(u.tolist(), freedom.tolist(), strict=True)]
            inside.append(np.abs(found - truth) <= wide)
    assert 0.92 < np.mean(inside) < 0.985


def test_held_temperatures_reached_from_both_sides() -> None:
    """−40, 0, 40, 80 and back: at 0 and 40 the value is 0.2 lower from above."""
    celsius = (-40, 0, 40, 80, 40, 0, -40, 0, 40)
    down = (0, 0, 0, 0, 1, 1, 1, 0, 0)
    recorded = tuple(
        from_means(
            replace(segment(f"S{k}"), temperature=t + KELVIN, start=1000.0 * k),
            {"gyro": 2.0 + 0.01 * t - 0.2 * fell + 0.001 * (-1) ** k}, "deg/h", 0.001,
        )
        for k, (t, fell) in enumerate(zip(celsius, down, strict=True))
    )  # fmt: skip
    found = model(recorded=recorded, channels=("gyro",), order=1)
    assert found["hysteresis_gyro"].value == pytest.approx(0.2, abs=0.01)
    assert found["gyro_T1"].value == pytest.approx(0.01, abs=2e-4)
    alone = model(recorded=recorded[:4], channels=("gyro",), order=1)
    assert "hysteresis_gyro" not in [one.name for one in alone.coefficients]


def test_turning_points_of_a_course() -> None:
    course = np.concatenate([np.linspace(20, -40, 50), np.linspace(-40, 60, 80), np.linspace(60, 20, 40)])
    rippled = course + 0.8 * np.sin(np.arange(170))
    for one in (course, rippled):
        assert np.flatnonzero(np.diff(branches(one, 1.0))) == pytest.approx([49, 129], abs=1)
    assert not branches(np.full(5, 20.0), 1.0).any()
    sense, sweep = approached([20, -40, -40, 20, 60, 20], 1.0)
    assert sense.tolist() == [-1, -1, -1, 1, 1, -1] and sweep.tolist() == [0, 0, 0, 1, 1, 2]


def test_channel_means_at_planned_temperatures() -> None:
    held = [replace(segment(f"S{t}"), temperature=t + KELVIN) for t in (-40, 0, 40, 80)]
    recorded = tuple(from_means(one, {"gyro": 2.0 + 0.5 * k}, "deg/h", 0.01) for k, one in enumerate(held))
    found = model(
        recorded=recorded, channels=("gyro",), order=1, uncertainty="propagated", reference=parse_quantity("0 degC")
    )
    assert found["gyro_T1"].value == pytest.approx(0.5 / 40)
    assert found["gyro_T0"].value == pytest.approx(2.5)
    # Σ(T − mean)² = 2·(60² + 20²) = 8000.
    assert found["gyro_T1"].standard_uncertainty == pytest.approx(0.01 / math.sqrt(8000), rel=1e-9)


def test_vacuum_chamber_gyro() -> None:
    """25 bursts of a MEMS gyro over two hours in a thermal-vacuum chamber; slopes known of it, in deg/s/K, to their last digit."""
    path = real("psim_thermal_vacuum", "TVCtest3_7_20.csv")
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(csv.reader(file))[1:]
    data = np.array([[float(cell) for cell in row[:8]] for row in rows if len(row) >= 8 and row[0]])
    time, celsius = data[:, 0] / 1000, (data[:, 7] - 65536) / 256 + 25
    edges = [0, *(np.flatnonzero(np.diff(time) > 1) + 1), len(time)]
    assert len(edges) == 26
    names = ("gyro_x", "gyro_y", "gyro_z")
    bursts = []
    for n, (low, high) in enumerate(pairwise(edges)):
        channels = {name: data[low:high, 4 + k] for k, name in enumerate(names)} | {"chip": celsius[low:high]}
        units = dict.fromkeys(names, "rad/s") | {"chip": "degC"}
        bursts.append(from_samples(segment(f"burst{n}"), time[low:high], channels, units))
    found = model(recorded=tuple(bursts), channels=names, temperature_channel="chip", order=1)
    for name, known in zip(names, (0.060, -0.028, 0.003), strict=True):
        assert math.degrees(found[f"{name}_T1"].value) == pytest.approx(known, abs=0.001)


# -- what cannot be done ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "nothing to model"),
        ({"channels": ("gyro",), "coefficients": ("K",)}, "`coefficients` selects from other estimates"),
        ({"channels": ("gyrq",)}, "has no channel 'gyrq'"),
        ({"channels": ("gyro",)}, "has no planned temperature"),
        ({"channels": ("gyro",), "temperature_channel": "gyro"}, "not a unit of temperature"),
        (
            {"channels": ("gyro",), "temperature_channel": "inside", "bin": parse_quantity("2 degC")},
            "write it in K, for example 2 K",
        ),
        ({"channels": ("gyro",), "temperature_channel": "inside", "form": "spline", "order": 0}, "at least two knots"),
        ({"temperature_channel": "inside"}, "nothing to model"),
    ],
)
def test_bad_plans_for_channels(keys: dict[str, Any], words: str) -> None:
    with pytest.raises(EstimationError, match=words):
        model(recorded=(ramp("up", -20, 60, lambda t: t),), **keys)


@pytest.mark.parametrize(
    ("uses", "keys", "words"),
    [
        ([given([0, 10, 20], [1, 2, 3])], {"channels": ("gyro",)}, "both `channels` and `uses`"),
        ([given([0, 10, 20], [1, 2, 3])], {"coefficients": ("Q*",)}, "no coefficient matches 'Q"),
        ([given([0, 10, 20], [1, 2, 3])], {"temperature_channel": "inside"}, "is only for `channels`"),
        ([replace(given([0], [1]), extra={})], {}, "gives no coefficients over temperature"),
        ([given([0], [1]), given([10], [1], unit="deg/h")], {}, "different units"),
        ([given([0, 10], [1, 2])], {}, "too few to choose an order"),
        ([given([0, 10], [1, 2])], {"order": 2}, "cannot determine a polynomial of order 2"),
        ([given([0, 10], [1, 2])], {"order": 1}, "leave no residuals"),
        ([given([0, 10], [1, math.nan])], {"order": 1}, "not a finite number"),
        ([given([0, 10, 20], [1, 2, 3])], {"uncertainty": "propagated"}, "does not have an uncertainty"),
    ],
)
def test_bad_plans_for_coefficients(uses: list[Estimate], keys: dict[str, Any], words: str) -> None:
    with pytest.raises(EstimationError, match=words):
        model(*uses, **keys)


def test_too_few_planned_temperatures_are_an_error_before_the_run() -> None:
    held = tuple(replace(segment(f"S{t}"), temperature=t + KELVIN) for t in (0, 40))
    plain, square = (
        TemperatureModelParameters(channels=("gyro",)),
        TemperatureModelParameters(channels=("gyro",), order=2),
    )
    for parameters, needed in ((plain, 3), (square, 3)):
        design = method.designed(TemperatureModel(), DesignRequest("curve", held, parameters, SITE, sensor("gyro")))
        assert design is not None
        (remark,) = design.remarks
        assert remark.code == "physics-temperatures" and remark.error and f"needs {needed}" in remark.message
    design = designed(
        TemperatureModel(),
        DesignRequest("curve", held, TemperatureModelParameters(channels=("gyro",), order=1), SITE, sensor("gyro")),
    )
    assert design is not None and not design.remarks


PLANS = Path(__file__).resolve().parents[2] / "plans"
SIX = "uses: [m30, m10, p10, p30, p50, p70]"


@pytest.mark.parametrize(
    ("plan", "changes", "code", "words"),
    [
        ("imu_over_temperature", [], None, ""),
        (
            "imu_over_temperature",
            [(SIX, "uses: [m30, m10]")],
            "physics-temperatures",
            "2 planned temperatures are too few",
        ),
        (
            "imu_over_temperature",
            [("gyro_scale_*]", "gyro_skale_*]")],
            "meaning-unknown-quantity",
            "matches 'gyro_skale_*'",
        ),
        (
            "imu_over_temperature",
            [('"-30degC/*", gyros', '["-30degC/*", "-10degC/*"], gyros')],
            "physics-temperatures",
            "'m30' gives no coefficients over temperature",
        ),
        ("scale_factor_tilted", [], None, ""),
        ("scale_factor_tilted", [("K_*", "bias_*")], "meaning-unknown-quantity", "matches 'bias_*'"),
        ("scale_factor_tilted", [("order: 1", "order: 3")], "physics-temperatures", "K_x: 3 planned temperatures"),
    ],
)
def test_what_other_estimates_cannot_give_is_reported_by_check(
    tmp_path: Path, plan: str, changes: list[tuple[str, str]], code: str | None, words: str
) -> None:
    text = (PLANS / f"{plan}.yaml").read_text(encoding="utf-8")
    curve = "  curve: {estimator: temperature_model, uses: scale, coefficients: K_*, order: 1}\n\nlimits:"
    text = text.replace("\nlimits:", curve) if plan == "scale_factor_tilted" else text
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    found = check_plan(tmp_path / "plan.yaml").findings.errors
    assert [one.code for one in found] == ([] if code is None else [code])
    assert all(words in one.message for one in found)


def test_a_chamber_that_is_warmer_than_it_says_moves_the_curve() -> None:
    """Against the fit of what is measured where it is warmer by a little, and taken for the temperature that was planned."""
    celsius, powers = np.linspace(-40, 80, 13), (3.0, 2e-2, -3e-4, 5e-6)
    one, *others = (
        model(given(celsius, np.polynomial.polynomial.polyval(celsius + warmer - 25, powers)), setup=setup, order=3)
        for warmer, setup in ((0.0, CHAMBER), (0.01, NOTHING), (-0.01, NOTHING))
    )
    moved = [(up.value - down.value) / 0.02 for up, down in zip(*(item.coefficients for item in others), strict=True)]
    (acting,) = one.influences
    assert acting.sensitivities[:, 0] == pytest.approx(moved, rel=1e-5, abs=1e-9)
    spread = math.hypot(one.coefficients[0].standard_uncertainty, 0.2 * acting.sensitivities[0, 0])
    assert combined(one).coefficients[0].standard_uncertainty == pytest.approx(spread)


def test_a_warmer_chamber_moves_the_knots_of_a_spline_along_it() -> None:
    """By its slope, which scipy's natural spline through the same knots has too."""
    celsius = np.linspace(-40, 80, 13)
    found = model(given(celsius, np.sin(celsius / 30)), setup=CHAMBER, form="spline", order=3)
    knots = found.extra["curves"]["K"]["knots_degC"]
    spline = pytest.importorskip("scipy.interpolate").CubicSpline(
        knots, [item.value for item in found.coefficients], bc_type="natural"
    )
    # taken over the chamber's 0.2 K to either side, of 40 K from knot to knot
    assert found.influences[0].sensitivities[:, 0] == pytest.approx(spline(knots, 1), rel=(0.2 / 40) ** 2)


def test_the_sensors_own_thermometer_is_not_the_chambers() -> None:
    up = ramp("up", -20, 60, lambda t: 0.1 + 0.002 * (t - 25))
    keys: dict[str, Any] = {"channels": ("gyro",), "order": 1, "setup": CHAMBER}
    assert model(recorded=(up,), temperature_channel="inside", **keys).influences == ()
    held = tuple(
        from_means(replace(segment(f"S{t}"), temperature=t + KELVIN), {"gyro": 2.0 + 0.5 * t}, "deg/h", 0.01)
        for t in (0, 10, 20)
    )
    (acting,) = model(recorded=held, **keys).influences
    assert acting.sensitivities[:, 0] == pytest.approx([0.5, 0.0])


def test_residuals_that_resemble_each_other() -> None:
    """1 + 2·Σ r: of (1, 1, −1, −1) r₁ = 1/4 and r₂ is negative; alternating ones count as independent."""
    assert correlation_time([np.array([1.0, 1.0, -1.0, -1.0])]) == pytest.approx(1.5)
    assert correlation_time([np.array([1.0, -1.0, 1.0, -1.0])]) == 1.0
    assert correlation_time([]) == 1.0
    # A first-order autoregression of 0.8: (1 + 0.8)/(1 − 0.8) = 9.
    draw = np.random.default_rng(1).standard_normal(20_000)
    series = np.zeros(20_000)
    for k in range(1, 20_000):
        series[k] = 0.8 * series[k - 1] + draw[k]
    assert correlation_time([series]) == pytest.approx(9, rel=0.2)
