"""Scale factors of tilted axes against recordings made by hand formulas: the Earth's rotation, metrics, fixtures, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recorded import figure, from_means, sensor
from tilted_recording import (
    DEG,
    EARTH,
    SITE,
    THETA,
    TRIAD,
    Gyro,
    earth,
    estimate,
    inputs,
    sampled,
    series,
    turned_label,
    whole_turns,
)

from planrunner.estimators.interface import EstimateRequest, EstimationError
from planrunner.estimators.temperature.parameters import TemperatureModelParameters
from planrunner.estimators.temperature.temperature_model import TemperatureModel
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Rest, Rock, Segment, Spin

LEVEL = (
    EARTH * math.cos(40 * DEG) * math.sin(THETA * DEG)
)  # deg/h, 9.41: what a level part of the Earth's rate is on a tilted axis
NORTH = {"x": (THETA, 90.0)}  # the axis that sees all of it at home
ONE = {"x": Gyro()}
GYROS = {
    "x": Gyro(1.0002, 11e-6, 3e-5),
    "y": Gyro(0.9997, -7e-6, -2e-5),
    "z": Gyro(1.0001, 9e-6, 1e-5),
    "s": Gyro(0.9999, 2e-6, 4e-5),
}
MOUNTINGS = {
    "trihedral": TRIAD,
    "two axes": {"x": (45.0, 10.0), "y": (45.0, 190.0)},
    "unequal": {"x": (20.0, 0.0), "y": (54.0, 100.0), "z": (70.0, 215.0)},
    "four axes": {"x": (THETA, 45.0), "y": (THETA, 135.0), "z": (THETA, 225.0), "s": (THETA, 315.0)},
    "along the rotation axis": {"x": (0.0, 0.0)},
    "upside down": {"x": (125.0, 30.0), "y": (54.0, 70.0)},
}


def part_turns(rate: float) -> float:
    return 180.0 if abs(rate) == 1 else whole_turns(rate)


@pytest.mark.parametrize("axes", MOUNTINGS.values(), ids=MOUNTINGS)
@pytest.mark.parametrize("dwell", [whole_turns, part_turns], ids=["whole turns", "part turns"])
def test_truth_comes_back_with_the_earth_corrected_for(axes: dict, dwell: Callable[[float], float]) -> None:
    recorded = [
        one
        for celsius in (-40.0, 20.0, 60.0)
        for repeat in (1, 2)
        for one in series(axes, GYROS, celsius, repeat, dwell=dwell, settle=7.3)
    ]
    found = estimate(recorded, axes)
    for name in axes:
        truth = GYROS[name]
        assert found[f"K_{name}"].value == pytest.approx(truth.K, rel=1e-11)
        assert found[f"K_{name}_-40degC"].value == pytest.approx(truth.K * (1 - 60 * truth.slope), rel=1e-11)
        assert found[f"F0_{name}"].value == pytest.approx(0.0, abs=1e-11)
        assert found[f"temperature_coefficient_{name}"].value == pytest.approx(truth.slope * 1e6, rel=1e-6)
        assert found[f"temperature_sensitivity_{name}"].value == pytest.approx(abs(truth.slope) * 1e6, rel=1e-6)
        assert found[f"nonlinearity_{name}"].value == pytest.approx(0.0, abs=1e-5)
        assert found[f"response_{name}"].value == pytest.approx(1.0, rel=1e-8)


def test_offset_holds_the_level_rate_of_home_when_it_is_ignored() -> None:
    """9.41 deg/h at 40 deg and 54.7356 deg: the zeros see it, whole turns do not."""
    assert pytest.approx(9.41, abs=0.005) == LEVEL
    recorded = series(NORTH, ONE)
    for how in ("ignored", "averaged"):
        found = estimate(recorded, NORTH, earth_rate=how)
        assert found["F0_x"].value * 3600 == pytest.approx(-LEVEL, rel=1e-9)
        assert found["K_x"].value == pytest.approx(1.0, rel=1e-12)
    assert estimate(recorded, NORTH)["F0_x"].value * 3600 == pytest.approx(0.0, abs=1e-8)


def test_part_of_a_turn_at_the_lowest_rate() -> None:
    """0.45 % of what the axis sees at 1 deg/s, 15 ppm of the largest output as a residual, and below 0.04 ppm in K."""
    seen = math.cos(THETA * DEG)
    assert LEVEL / 3600 / seen == pytest.approx(0.0045, abs=5e-5)
    assert LEVEL / 3600 / (300 * seen) == pytest.approx(15e-6, abs=0.5e-6)
    # Ten seconds at 1 deg/s: the axis stays within ten degrees of north, while the other rates average to nothing.
    recorded = series(NORTH, ONE, dwell=lambda rate: 10.0 if abs(rate) == 1 else whole_turns(rate))
    found = estimate(recorded, NORTH, earth_rate="ignored")
    table = next(one for one in found.tables if one.title.startswith("Residuals"))
    low = np.array([row[2] for row in table.rows if figure(row[1]) in (1.0, -1.0)])
    high = np.array([row[2] for row in table.rows if abs(figure(row[1])) > 1])
    kept = math.sin(10 * DEG) / (10 * DEG)  # mean cosine over the ten degrees
    assert low.mean() - high.mean() == pytest.approx(LEVEL / 3600 / (300 * seen) * 1e6 * kept, rel=1e-3)
    # An axis that begins towards east or west sees the sine, which has the sign of the rotation: the worst for K.
    east = {"x": (THETA, 0.0)}
    worst = estimate(series(east, ONE, dwell=part_turns), east, earth_rate="ignored")
    assert 0.01e-6 < abs(worst["K_x"].value - 1) < 0.04e-6
    with pytest.raises(EstimationError, match=r"covers 0\.5 turns"):
        estimate(series(east, ONE, dwell=part_turns), east, earth_rate="averaged")


def test_a_level_rotation_axis() -> None:
    """About north, with z north and x east, y points down: an axis at azimuth α that has turned by ψ sees −Ω·sin φ·sin θ·sin(α + ψ)."""
    axes, angle, azimuth = {"x": (THETA, 70.0)}, THETA * DEG, 70 * DEG
    attitude = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    recorded = []
    for one in series(axes, ONE, rates=(20.0, -20.0, 3.0, -3.0)):
        segment = one.segment
        seconds = 50.0 if segment.rate else 60.0
        motion = Spin(segment.rate, (0.0, 1.0, 0.0)) if segment.rate else Rest()
        turned = segment.rate * seconds
        sine = (math.cos(azimuth) - math.cos(azimuth + turned)) / turned if turned else math.sin(azimuth)
        up, north = EARTH * math.sin(40 * DEG) / 3600, EARTH * math.cos(40 * DEG) / 3600
        value = segment.rate / DEG * math.cos(angle) + north * math.cos(angle) - up * math.sin(angle) * sine
        planned = replace(segment, attitude=attitude, motion=motion, dwell=seconds)
        recorded.append(sampled(planned, {"gyro_x": 1.001 * value}))
    found = estimate(recorded, axes)
    assert found["K_x"].value == pytest.approx(1.001, rel=1e-9)
    assert found["F0_x"].value == pytest.approx(0.0, abs=1e-9)


def test_the_bench_azimuth_does_not_enter_directions_that_are_true() -> None:
    recorded = series(NORTH, ONE)
    turned = estimate(recorded, NORTH, site=replace(SITE, azimuth=0.7))
    assert turned["F0_x"].value == estimate(recorded, NORTH)["F0_x"].value


def test_an_arc_minute_of_the_fixture_is_411_ppm() -> None:
    found = estimate(series(TRIAD, GYROS), TRIAD, inputs(TRIAD, 60.0))
    budget = next(one for one in found.budgets if one.coefficient == "K_x")
    line = next(one for one in budget.lines if one.quantity == "fixture angle x")
    assert line.contribution / found["K_x"].value == pytest.approx(411e-6, abs=0.5e-6)
    assert line.contribution / found["K_x"].value == pytest.approx(
        math.tan(THETA * DEG) * math.radians(1 / 60), rel=1e-4
    )


def test_each_rate_of_the_table_counts_by_its_share() -> None:
    """K = Σ ω_j·F_j/Σ ω_j², so errors δ of each rate give u(K)/K = δ·√(Σ ω⁴)/Σ ω²; one that all share gives δ."""
    rates = np.array([300.0, 150, 60, 20, 10, 1])
    share = math.sqrt(2 * np.sum(rates**4)) / (2 * np.sum(rates**2))
    apart = estimate(series(TRIAD, GYROS), TRIAD, inputs(TRIAD, 0.0, 10e-6))
    common = estimate(series(TRIAD, GYROS), TRIAD, rate_uncertainty=parse_quantity("10 ppm"))
    for found, expected in ((apart, 10e-6 * share), (common, 10e-6)):
        line = next(
            line
            for budget in found.budgets
            if budget.coefficient == "K_x"
            for line in budget.lines
            if line.quantity.startswith("table rate")
        )
        assert line.contribution / found["K_x"].value == pytest.approx(expected, rel=1e-6)


def test_metrics_by_hand() -> None:
    """Two repeats with K = 1 ± d: repeatability √2·d, u(K) = d. A rate-dependent asymmetry comes back; one axis along the rotation."""
    axes = {"x": (0.0, 0.0)}
    d = 1e-5
    recorded = [*series(axes, {"x": Gyro(1 + d)}), *series(axes, {"x": Gyro(1 - d)}, repeat=2)]
    found = estimate(recorded, axes, uncertainty="repeats")
    assert found["K_x"].value == pytest.approx(1.0, rel=1e-12)
    assert found["repeatability_x"].value == pytest.approx(math.sqrt(2) * d * 1e6, rel=1e-9)
    assert found["K_x"].standard_uncertainty == pytest.approx(d, rel=1e-9)
    assert found["K_x"].degrees_of_freedom == 1
    lopsided = estimate(series(axes, {"x": Gyro(asymmetry=40e-6)}), axes)
    assert lopsided["asymmetry_x"].value == pytest.approx(40.0, rel=1e-3)


def test_nonlinearity_by_hand() -> None:
    """Residuals of F = ω + c·|ω| at ±2, ±1: c·(|ω| − 1.5), the largest 0.5·c over the largest output 2 + 2·c."""
    axes, c = {"x": (0.0, 0.0)}, 1e-4
    recorded = []
    for one in series(axes, ONE, rates=(2.0, -2.0, 1.0, -1.0)):
        rate = one.segment.rate / DEG
        recorded.append(sampled(one.segment, {"gyro_x": rate + c * abs(rate)}))
    found = estimate(recorded, axes, earth_rate="averaged")
    assert found["nonlinearity_x"].value == pytest.approx(0.5e6 * c / (2 + 2 * c), rel=1e-9)
    assert found["F0_x"].value == pytest.approx(1.5 * c, rel=1e-9)


def test_temperature_coefficients_of_a_curve_by_hand() -> None:
    """K = 1 + 1e-5·t + 1e-7·t² at t = −60, 0, 40 K from 20 degC: changes −2.4e-4 and 5.6e-4, so 4 and 14 ppm/K; the slope is the line's."""
    axes = {"x": (0.0, 0.0)}
    changes = {-40.0: -2.4e-4, 20.0: 0.0, 60.0: 5.6e-4}
    recorded = [one for celsius, change in changes.items() for one in series(axes, {"x": Gyro(1 + change)}, celsius)]
    found = estimate(recorded, axes)
    slope = np.polyfit([-60.0, 0.0, 40.0], list(changes.values()), 1)[0]
    assert found["temperature_sensitivity_x"].value == pytest.approx(14.0, rel=1e-6)
    assert found["temperature_coefficient_x"].value == pytest.approx(slope * 1e6, rel=1e-6)


def test_scale_factors_can_be_modelled_over_temperature() -> None:
    """K = 1 + 1e-5·t + 1e-7·t², t from 20 degC, at four temperatures: the curve itself comes back."""
    axes = {"x": (0.0, 0.0)}
    recorded = [
        one
        for celsius in (-40.0, 0.0, 20.0, 60.0)
        for one in series(axes, {"x": Gyro(1 + 1e-5 * (celsius - 20) + 1e-7 * (celsius - 20) ** 2)}, celsius)
    ]
    scale = estimate(recorded, axes)
    held = scale.extra["by_temperature"]["K_x"]
    values = dict(zip(held["temperature_degC"], held["value"], strict=True))
    assert values[60.0] == pytest.approx(1 + 5.6e-4, rel=1e-9)
    parameters = TemperatureModelParameters(coefficients=("K_x",), order=2, reference=parse_quantity("20 degC"))
    request = EstimateRequest("curve", tuple(recorded), parameters, SITE, sensor("gyro_x"), {"scale": scale})
    curve = TemperatureModel().estimate(request)
    found = sorted(item.value for item in curve.coefficients if item.name.startswith("K_x"))
    assert any(one == pytest.approx(1e-7, rel=1e-4) for one in found)
    assert any(one == pytest.approx(1e-5, rel=1e-4) for one in found)


def test_the_measured_temperature_counts_where_it_is_recorded() -> None:
    axes = {"x": (0.0, 0.0)}
    recorded = []
    for celsius, real in ((-40.0, -38.0), (20.0, 20.5), (60.0, 59.0)):
        for one in series(axes, {"x": Gyro(1 + 1e-5 * (real - 20.5))}, celsius):
            mean = one.statistics.mean[0]
            made = sampled(one.segment, {"gyro_x": mean, "sensor_temperature": real})
            recorded.append(replace(made, units={"gyro_x": "deg/s", "sensor_temperature": "degC"}))
    found = estimate(recorded, axes)
    assert found["temperature_coefficient_x"].value == pytest.approx(10.0, rel=1e-6)
    with pytest.raises(EstimationError, match="no channel 'thermometer'"):
        estimate(recorded, axes, temperature="thermometer")
    with pytest.raises(EstimationError, match="not a unit of temperature"):
        estimate(recorded, axes, temperature="gyro_x")


def test_drift_between_the_zeros_is_an_uncertainty_of_the_offset() -> None:
    """A change d from zero to zero: F_r may be off by d/2 either way, u = d/2/√3."""
    d = 0.01
    found = estimate(series(TRIAD, GYROS, drift=d), TRIAD)
    line = next(
        line
        for budget in found.budgets
        if budget.coefficient == "F0_x"
        for line in budget.lines
        if line.quantity == "zero drift gyro_x"
    )
    assert line.standard_uncertainty == pytest.approx(d / 2 / math.sqrt(3), rel=1e-6)
    assert line.contribution == pytest.approx(line.standard_uncertainty, rel=1e-3)


def test_a_dead_zone_shows_in_the_response() -> None:
    axes = {"x": (THETA, 0.0)}
    recorded = []
    for one in series(axes, ONE):
        value = one.statistics.mean[0] if abs(one.segment.rate) > 2 * DEG else 0.0
        recorded.append(sampled(one.segment, {"gyro_x": value}))
    found = estimate(recorded, axes)
    assert found["response_x"].value == pytest.approx(0.0, abs=1e-9)
    assert any("less than half" in text for text in found.warnings)


def test_comparison_with_one_mounting_an_axis() -> None:
    found = estimate(series(TRIAD, GYROS, error=1e-5), TRIAD, inputs(TRIAD, 20.0), remounting=parse_quantity("1 h"))
    table = next(one for one in found.tables if "one mounting per axis" in one.title)
    row = dict(zip(table.headings[1:], map(figure, table.rows[0][1:]), strict=True))
    u = 20 / 3600 * DEG
    assert row["tilted: angle [ppm]"] == pytest.approx(math.tan(THETA * DEG) * u * 1e6, rel=1e-4)
    assert row["one per axis: tilt [ppm]"] == pytest.approx(math.sqrt(2) * u**2 * 1e6, rel=1e-9)
    assert row["one per axis: noise [ppm]"] == pytest.approx(row["tilted: noise [ppm]"] / math.sqrt(3), rel=1e-9)
    note = next(text for text in found.notes if text.startswith("Test time"))
    seconds = sum(whole_turns(rate) for rate in (300, 150, 60, 20, 10, 1)) * 2 + 120
    assert (
        f"{(seconds + 3600) / 3600:.3g} h in one tilted" in note
        and f"in each of 3 mountings, which would take {3 * (seconds + 3600) / 3600:.3g} h in total" in note
    )


# -- what is refused -------------------------------------------------------------------------------------------------


def test_bad_mountings() -> None:
    recorded = series(TRIAD, GYROS)
    with pytest.raises(EstimationError, match="no `mounting`"):
        estimate(recorded, {})
    with pytest.raises(EstimationError, match="does not respond to its rate"):
        estimate(recorded, {"x": (90.0, 0.0)})
    with pytest.raises(EstimationError, match=r"mounting\.w has no output"):
        estimate(recorded, {**TRIAD, "w": (THETA, 0.0)})
    with pytest.raises(EstimationError, match="'gyro_z' has no axis in `mounting`"):
        estimate(recorded, {"x": (THETA, 0.0)}, outputs=("gyro_z",))
    with pytest.raises(EstimationError, match="no output 'gyro_q'"):
        estimate(recorded, TRIAD, outputs=("gyro_q",))
    with pytest.raises(EstimationError, match=r"mounting\.x states no azimuth"):
        estimate(recorded, {"x": (THETA, None)})
    assert estimate(recorded, {"x": (THETA, None)}, earth_rate="averaged")["K_x"].value == pytest.approx(1.0002)
    tipped = [turned_label(one, attitude=np.eye(3)[[2, 0, 1]]) for one in recorded]
    with pytest.raises(EstimationError, match="z axis is 90 deg from the rotation axis"):
        estimate(tipped, TRIAD)


def test_bad_recordings() -> None:
    recorded = series(TRIAD, GYROS)
    with pytest.raises(EstimationError, match=r"no series is complete: .* has no start zero"):
        estimate(recorded[1:], TRIAD)
    with pytest.raises(EstimationError, match="has no end zero"):
        estimate(recorded[:-1], TRIAD)
    with pytest.raises(EstimationError, match="no rates"):
        estimate([recorded[0]], TRIAD)
    with pytest.raises(EstimationError, match="only one rate"):
        estimate(series(TRIAD, GYROS, rates=(10.0,)), TRIAD)
    with pytest.raises(EstimationError, match="cut short in"):
        estimate([*recorded[:3], replace(recorded[3], truncated=True), *recorded[4:]], TRIAD)
    with pytest.raises(EstimationError, match="run only once"):
        estimate(recorded, TRIAD, uncertainty="repeats")
    with pytest.raises(EstimationError, match="within-segment noise"):
        estimate(recorded, TRIAD, uncertainty="within_segment")
    empty = replace(recorded[4], statistics=replace(recorded[4].statistics, count=0))
    with pytest.raises(EstimationError, match="no usable samples"):
        estimate([*recorded[:4], empty, *recorded[5:]], TRIAD)
    lost = from_means(recorded[4].segment, {"gyro_x": 1.0}, "deg/s")
    with pytest.raises(EstimationError, match="no channel 'gyro_y'"):
        estimate([*recorded[:4], lost, *recorded[5:]], TRIAD)
    rocking = turned_label(recorded[4], motion=Rock(0.1, 1.0, (0.0,), 5.0))
    with pytest.raises(EstimationError, match="no constant rate"):
        estimate([*recorded[:4], rocking, *recorded[5:]], TRIAD)
    other = turned_label(recorded[4], motion=Spin(1.0, (0.0, 1.0, 0.0)))
    with pytest.raises(EstimationError, match="a different direction"):
        estimate([*recorded[:4], other, *recorded[5:]], TRIAD)


def test_a_sensor_without_power_is_no_scale_factor_of_zero() -> None:
    recorded = series(TRIAD, GYROS)
    dead = dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), 0.25)
    with pytest.raises(EstimationError, match="'gyro_x' has no response to the rate at 20degC"):
        estimate([from_means(one.segment, dead, "deg/s") for one in recorded], TRIAD)


def test_a_broken_repeat_is_left_out_with_a_warning() -> None:
    recorded = [*series(TRIAD, GYROS), *series(TRIAD, GYROS, repeat=2)[:-3]]
    found = estimate(recorded, TRIAD)
    assert found["K_x"].value == pytest.approx(GYROS["x"].K, rel=1e-11)
    assert any("20degC/r2 has no end zero" in text for text in found.warnings)


def test_pauses_belong_to_no_series_and_one_temperature_has_no_coefficient() -> None:
    recorded = series(TRIAD, GYROS)
    pause = from_means(Segment(0, "20degC/r1/power-down", np.eye(3), "home", Rest(), 600.0, temperature=293.15),
                       dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), 0.0), "deg/s")  # fmt: skip
    found = estimate([*recorded, pause], TRIAD)
    assert pause.label not in found.segments
    assert "temperature_coefficient_x" not in [item.name for item in found.coefficients]
    assert any("one temperature" in text for text in found.notes)


def test_the_closed_mean_of_the_sine_agrees_with_a_sum_over_the_turn() -> None:
    angles = np.linspace(0, 2.5, 20_001)
    seen = EARTH * math.sin(40 * DEG) * math.cos(THETA * DEG) + LEVEL * np.sin(0.4 + angles)
    summed = float(np.mean((seen[1:] + seen[:-1]) / 2))
    assert earth(THETA, 0.4 / DEG, 0.0, 2.5) * 3600 == pytest.approx(summed, rel=1e-7)
