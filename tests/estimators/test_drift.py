"""Drift as a nuisance of static methods, on recordings of the independent worlds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from accelerometer_coverage import CHANNELS, SITE, spread_attitudes
from recorded import figure, from_means, segment, sensor

from planrunner.estimators import drift_fit
from planrunner.estimators.accelerometer.accelerometer_multi_position import AccelerometerMultiPosition
from planrunner.estimators.accelerometer.parameters import AccelerometerMultiPositionParameters
from planrunner.estimators.interface import Coefficient, Estimate, EstimateRequest
from planrunner.tasks.check import Checked, Document, check_plan
from tests.worlds.campaigns import CAMPAIGNS, Campaign
from tests.worlds.coverage import Array, estimated, known, recorded
from tests.worlds.faults import WORLDS, Recorded, World
from tests.worlds.felt import starts

FROM_POSITIONS = (
    "flexure_gyro_static",
    "scale_factor",
    "imu_multi_position",
    "error_model",
    "accelerometer_multi_position",
)
STEADY = World()


def asking(estimator: str, drift: str) -> Campaign:
    """The campaign of an estimator with a key `drift`."""
    campaign = CAMPAIGNS[estimator]
    name = f"estimator: {estimator}"
    apart = "\n    " if estimator == "error_model" else ", "
    assert name in campaign.plan
    return replace(campaign, plan=campaign.plan.replace(name, f"{name}{apart}drift: {drift}"))


def found(campaign: Campaign, world: World, made: Recorded) -> Estimate:
    one = estimated(campaign, known(campaign, world), made)
    assert not isinstance(one, str), one
    return one


def by_name(estimate: Estimate) -> Mapping[str, Coefficient]:
    return {item.name: item for item in estimate.coefficients}


def line_with_drift(campaign: Campaign, made: Recorded) -> tuple[Array, Array]:
    """A straight line through the rates, and a straight line in time about the middle: coefficients, and their spreads from the scatter."""
    means = np.array([made.values[made.step == number, 0].mean() for number in range(len(campaign.steps))])
    rates = np.array([step.rate for step in campaign.steps])
    hours = (starts(campaign.steps) + [step.dwell / 2 for step in campaign.steps]) / 3600
    design = np.column_stack([np.ones(len(rates)), rates, hours - hours.mean()])
    solution, squares, _, _ = np.linalg.lstsq(design, means, rcond=None)
    covariance = squares[0] / (len(rates) - 3) * np.linalg.inv(design.T @ design)
    return solution, np.sqrt(np.diag(covariance))


def test_a_linear_drift_is_fitted_together_with_the_line() -> None:
    campaign = asking("scale_factor", "linear")
    _, made = recorded(campaign, WORLDS["linear drift"], np.random.default_rng(1))
    estimate = found(campaign, WORLDS["linear drift"], made)
    values, spreads = line_with_drift(campaign, made)
    for k, name in enumerate(("F0_gyro_z", "K_gyro_z")):
        item = by_name(estimate)[name]
        assert item.value == pytest.approx(values[k], rel=1e-9)
        assert item.standard_uncertainty == pytest.approx(spreads[k], rel=1e-6)
        assert item.degrees_of_freedom == pytest.approx(7)
    table = next(table for table in estimate.tables if "Drift" in table.title)
    row = table.rows[0]
    assert row[:2] == ("gyro_z", "linear drift")
    assert figure(row[2]) == pytest.approx(values[2], rel=1e-6)
    assert figure(row[3]) == pytest.approx(spreads[2], rel=1e-6)
    assert not estimate.warnings  # the plan asks for it


@pytest.mark.parametrize("estimator", FROM_POSITIONS)
def test_a_drift_that_the_segments_show_is_fitted_and_named(estimator: str) -> None:
    campaign, world = CAMPAIGNS[estimator], WORLDS["linear drift"]
    truth, made = recorded(campaign, world, np.random.default_rng(3))
    estimate = found(campaign, world, made)
    assert [text for text in estimate.warnings if "drift during the test" in text]
    assert [table for table in estimate.tables if "Drift" in table.title]
    for name, item in by_name(estimate).items():
        if name in truth:
            assert abs(item.value - truth[name]) < 6 * item.standard_uncertainty, name
    # Ten times the noise of a mean is far outside, where no drift is fitted.
    plain = found(asking(estimator, "none"), world, made)
    moved = [
        abs(item.value - by_name(plain)[name].value) / item.standard_uncertainty
        for name, item in by_name(estimate).items()
    ]
    assert max(moved) > 1


@pytest.mark.parametrize("estimator", FROM_POSITIONS)
def test_nothing_changes_where_nothing_drifts(estimator: str) -> None:
    campaign = CAMPAIGNS[estimator]
    _, made = recorded(campaign, STEADY, np.random.default_rng(5))
    estimate, plain = found(campaign, STEADY, made), found(asking(estimator, "none"), STEADY, made)
    assert [item.value for item in estimate.coefficients] == [item.value for item in plain.coefficients]
    assert np.array_equal(estimate.covariance, plain.covariance)
    assert not [table for table in estimate.tables if "Drift" in table.title]


def test_a_drift_that_follows_the_thermometer_is_fitted_as_such() -> None:
    campaign, world = CAMPAIGNS["imu_multi_position"], WORLDS["temperature drift, recorded"]
    truth, made = recorded(campaign, world, np.random.default_rng(2))
    estimate = found(campaign, world, made)
    assert [text for text in estimate.warnings if "a drift (temperature)" in text]
    for name, item in by_name(estimate).items():
        if name in truth:
            assert abs(item.value - truth[name]) < 5 * item.standard_uncertainty, name


def test_a_thermometer_whose_reading_hardly_changes_explains_nothing() -> None:
    """A residual that happens to be proportional to hundredths of a kelvin is no drift with temperature."""
    pattern = np.random.default_rng(8).standard_normal(len(CAMPAIGNS["scale_factor"].steps))

    def followed(size: float) -> list[str]:
        campaign = CAMPAIGNS["scale_factor"]
        _, made = recorded(campaign, STEADY, np.random.default_rng(2))
        course = pattern[made.step]
        drifting = made.values + 5 * campaign.mean * course[:, None]
        estimate = found(campaign, STEADY, replace(made, values=drifting, celsius=20 + size * course))
        return [text for text in estimate.warnings if "a drift (temperature)" in text]

    assert followed(1.0)
    assert not followed(0.01)


def unclear(estimate: Estimate) -> list[str]:
    """Warnings about a drift with temperature that the segments neither show nor exclude."""
    return [text for text in estimate.warnings if "hard to distinguish from" in text]


def test_a_temperature_that_follows_the_order_of_the_positions_is_warned_of() -> None:
    """In the eight positions almost the whole course of the temperature looks like coefficients, so that the data show no drift."""
    campaign, world = CAMPAIGNS["flexure_gyro_static"], WORLDS["temperature drift, recorded"]
    for seed in range(3):
        _, made = recorded(campaign, world, np.random.default_rng(seed))
        assert unclear(found(campaign, world, made)) or found(campaign, world, made).tables[1].title.startswith("Drift")
        for word in ("temperature", "none"):
            assert not unclear(found(asking("flexure_gyro_static", word), world, made))
    steady = World(celsius=lambda share: 20 + 0.5 * share)
    _, made = recorded(campaign, steady, np.random.default_rng(1))
    assert not unclear(found(campaign, steady, made))


def test_the_warning_gives_the_growth_of_the_uncertainty() -> None:
    """Ten rates, and a temperature that rises with the rate and a little on its own: by 1/√(1 − r²) with its correlation r."""
    campaign = CAMPAIGNS["scale_factor"]
    _, made = recorded(campaign, STEADY, np.random.default_rng(2))
    rates = np.array([step.rate for step in campaign.steps])
    for apart in (0.2, 3.0):
        kelvin = 3 * rates / rates.std() + apart * np.resize([1.0, -1.0, -1.0, 1.0], len(rates))
        expected = 1 / np.sqrt(1 - np.corrcoef(kelvin, rates)[0, 1] ** 2)
        texts = unclear(found(campaign, STEADY, replace(made, celsius=20 + kelvin[made.step])))
        assert bool(texts) == (expected >= 2)
        assert all("rate of gyro_z" in text and f"{expected:.2g} times" in text for text in texts)


def test_a_temperature_that_cannot_be_separated_from_a_coefficient_is_warned_of() -> None:
    campaign = CAMPAIGNS["scale_factor"]
    _, made = recorded(campaign, STEADY, np.random.default_rng(2))
    rates = np.array([step.rate for step in campaign.steps])
    [text] = unclear(found(campaign, STEADY, replace(made, celsius=20 + 0.01 * rates[made.step])))
    assert "rate of gyro_z" in text and "no fit to these segments can separate" in text


def test_a_drift_whose_evidence_is_weak_is_warned_of_and_not_fitted() -> None:
    """As a drift grows, the report first says nothing, then warns, and then fits it."""
    campaign, world = CAMPAIGNS["flexure_gyro_static"], STEADY
    _, made = recorded(campaign, world, np.random.default_rng(6))
    course = (made.time - made.time.mean()) / np.ptp(made.time)

    def said(size: float) -> str:
        estimate = found(campaign, world, replace(made, values=made.values + size * made.mean * course[:, None]))
        fitted = bool([table for table in estimate.tables if "Drift" in table.title])
        assert fitted == bool([text for text in estimate.warnings if "seem to drift" in text])
        weak = [text for text in estimate.warnings if "may drift" in text]
        return "fitted" if fitted else "weak" if weak else "nothing"

    stages = [said(size) for size in np.arange(0.0, 16.0, 0.5)]
    assert [one for one, other in zip(stages, ["", *stages], strict=False) if one != other] == [
        "nothing",
        "weak",
        "fitted",
    ]


def test_a_nonlinearity_is_not_taken_for_a_drift(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty times the noise of a mean: a square of the output, and a drift of the same size."""
    campaign, world = CAMPAIGNS["scale_factor"], STEADY
    _, made = recorded(campaign, world, np.random.default_rng(6))
    shape = (made.values / np.max(np.abs(made.values), axis=0)) ** 2
    bent = replace(made, values=made.values + 30 * made.mean * shape)
    course = (made.time - made.time.mean()) / np.ptp(made.time)
    drifting = replace(made, values=made.values + 30 * made.mean * course[:, None])
    texts = found(campaign, world, bent).warnings
    assert [text for text in texts if "square of the output" in text]
    assert not [text for text in texts if "seem to drift" in text]
    assert [text for text in found(campaign, world, drifting).warnings if "seem to drift" in text]
    monkeypatch.setattr(drift_fit, "_nonlinear", lambda *_: ())
    assert [text for text in found(campaign, world, bent).warnings if "seem to drift" in text]


def test_a_temperature_that_does_not_change_adds_nothing() -> None:
    campaign = asking("scale_factor", "temperature")
    world = World(celsius=lambda share: np.full(len(share), 23.0))
    _, made = recorded(campaign, world, np.random.default_rng(2))
    drifting, plain = found(campaign, world, made), found(asking("scale_factor", "none"), world, made)
    assert [item.value for item in drifting.coefficients] == [item.value for item in plain.coefficients]


def test_a_temperature_that_is_not_recorded_is_refused() -> None:
    campaign = asking("scale_factor", "temperature")
    _, made = recorded(campaign, STEADY, np.random.default_rng(2))
    one = estimated(campaign, known(campaign, STEADY), made)
    assert isinstance(one, str) and "thermometer" in one


def test_each_channel_of_poses_in_unknown_attitudes_drifts_by_itself() -> None:
    """A perfect sensor whose three readings drift, without noise: the sum of |f| = g and the drifts is what it put out."""
    drifts, hours = np.array([1e-3, -2e-3, 3e-3]), np.linspace(0.0, 1.0, 24)  # m/s² per hour
    made = []
    for k, attitude in enumerate(spread_attitudes()):
        readings = 9.80 * attitude[:, 2] + drifts * (hours[k] - hours.mean())
        means = dict(zip(CHANNELS, map(float, readings), strict=True))
        planned = segment(f"P{k}", attitude, dwell=60.0)
        made.append(from_means(planned, means, "m/s^2", 2e-5, start=3600 * hours[k]))
    parameters = AccelerometerMultiPositionParameters(
        reference="gravity_magnitude", uncertainty="within_segment", drift=("linear",)
    )
    request = EstimateRequest("a", tuple(made), parameters, SITE, sensor(*CHANNELS, unit="m/s^2"))
    estimate = AccelerometerMultiPosition().estimate(request)
    perfect = [0.0] * 3 + [1.0] * 3 + [0.0] * 3
    for item, value in zip(estimate.coefficients, perfect, strict=True):
        assert abs(item.value - value) < 0.2 * item.standard_uncertainty, item.name
    table = next(table for table in estimate.tables if "Drift" in table.title)
    assert [row[1] for row in table.rows] == [f"linear drift {name}" for name in CHANNELS]
    for row, value in zip(table.rows, drifts, strict=True):
        assert row[2] == pytest.approx(value, abs=0.2 * figure(row[3]))


# What check says ------------------------------------------------------------------------------------------------------


def checked(campaign: Campaign) -> Checked:
    bench = campaign.bench.format(tilt=0, rate=0, flicker=np.zeros(9), count=np.zeros(9))
    return check_plan(Document(campaign.plan.encode(), "world.yaml"), Document(bench.encode(), "world.bench.yaml"))


def spreads(campaign: Campaign) -> Mapping[str, float]:
    made = checked(campaign)
    assert made.ok, made.findings
    return {item.name: item.standard_uncertainty for item in made.designs[campaign.estimate].predicted}


def test_predicted_uncertainties_include_the_drift_that_the_plan_asks_for() -> None:
    plain, drifting = spreads(asking("scale_factor", "none")), spreads(asking("scale_factor", "linear"))
    campaign = CAMPAIGNS["scale_factor"]
    rates = np.array([step.rate for step in campaign.steps])
    segments = checked(campaign).schedule
    assert segments is not None
    begun = np.array([one.start for one in segments.segments])
    base = np.column_stack([np.ones(len(rates)), rates])
    whole = np.column_stack([base, begun - begun.mean()])
    grown = np.sqrt(np.diag(np.linalg.inv(whole.T @ whole))[:2] / np.diag(np.linalg.inv(base.T @ base)))
    assert drifting["F0_gyro_z"] / plain["F0_gyro_z"] == pytest.approx(grown[0], rel=1e-6)
    assert drifting["K_gyro_z"] / plain["K_gyro_z"] == pytest.approx(grown[1], rel=1e-6)
    assert grown.max() > 1.001


SHORT = """\
planrunner: 1
title: four positions
sensor: {kind: accelerometers, outputs: [accel_x, accel_y, accel_z]}
defaults: {settle: 5 s}
segments:
  - {label: up-1, orientation: {x: east, y: north, z: up}, dwell: 60 s}
  - {label: up-2, orientation: {x: east, y: north, z: up}, dwell: 60 s}
  - {label: down-1, orientation: {x: west, y: north, z: down}, dwell: 60 s}
  - {label: down-2, orientation: {x: west, y: north, z: down}, dwell: 60 s}
CLOSING\
estimates:
  triad: {estimator: accelerometer_multi_position, terms: [bias, accel_z], drift: DRIFT}
"""


def in_order(*labels: str, drift: str = "linear", closing: str = "") -> Checked:
    """The four positions in some order."""
    lines = SHORT.splitlines()
    rows = {line.split(": ")[1].split(",")[0]: line for line in lines if "label" in line}
    text = SHORT.replace("\n".join(rows.values()), "\n".join(rows[label] for label in labels))
    text = text.replace("DRIFT", drift).replace("CLOSING", closing)
    campaign = replace(CAMPAIGNS["accelerometer_multi_position"], plan=text)
    return checked(campaign)


def of_drift(made: Checked) -> list[tuple[str, str]]:
    """Severity and hint of the findings about a drift."""
    return [(one.severity, one.hint) for one in made.findings if one.code == "physics-drift"]


AS_LISTED = ("up-1", "up-2", "down-1", "down-2")


def test_check_warns_of_an_order_that_couples_a_drift_to_a_coefficient() -> None:
    """With the correlation r between time and the sign of gravity, an uncertainty grows by 1/√(1 − r²)."""
    made = in_order(*AS_LISTED)
    assert [severity for severity, _ in of_drift(made)] == ["warning"]
    assert made.schedule is not None
    begun = [one.start for one in made.schedule.segments]
    grown = 1 / np.sqrt(1 - np.corrcoef(begun, [1, 1, -1, -1])[0, 1] ** 2)
    text = next(one.message for one in made.findings if one.code == "physics-drift")
    assert f"{grown:.2g} times" in text and "accel_z" in text


def test_without_a_drift_in_the_plan_the_order_is_only_noted() -> None:
    made = in_order(*AS_LISTED, drift="by_evidence")
    assert [severity for severity, _ in of_drift(made)] == ["note"]
    assert not of_drift(in_order(*AS_LISTED, drift="none"))


def test_what_check_proposes_decouples_the_drift() -> None:
    [(_, hint)] = of_drift(in_order(*AS_LISTED))
    assert "'up-1' at the end" in hint
    again = "  - {label: closing, orientation: {x: east, y: north, z: up}, dwell: 60 s}\n"
    assert not of_drift(in_order(*AS_LISTED, closing=again))


def test_a_counter_balanced_order_is_not_remarked_upon() -> None:
    assert not of_drift(in_order("up-1", "down-1", "down-2", "up-2"))


def test_more_courses_than_segments_allow_are_an_error() -> None:
    made = in_order("up-1", "down-1", "down-2", "up-2", drift="quadratic")
    assert [severity for severity, _ in of_drift(made)] == ["error"]


def test_words_that_exclude_each_other_are_an_error_at_the_key() -> None:
    made = in_order(*AS_LISTED, drift="[none, linear]")
    assert not made.ok
    assert any("excludes" in one.message for one in made.findings)
