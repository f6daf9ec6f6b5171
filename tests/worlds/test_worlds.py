"""The worlds themselves, by numbers worked out by hand; that they share no code with planrunner; and that planrunner reads them."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded, tally, world_of
from tests.worlds.faults import WORLDS, Recorded, World, flicker
from tests.worlds.felt import Step, felt, starts, turn

HERE = Path(__file__).parent
EACH = [name for name in CAMPAIGNS if "nominal azimuth" not in name]
COARSE = "counts of 5 times the noise"
COUNTED = [
    name
    for name, one in CAMPAIGNS.items()
    if COARSE not in one.without and one.causes.get(COARSE) != "" and "from stop to stop" not in name
]
"""One navigation is enough."""


def test_worlds_import_nothing_of_planrunner() -> None:
    for name in ("felt", "faults", "navigation", "platform", "campaign", "campaigns", "temperature_cycles"):
        tree = ast.parse((HERE / f"{name}.py").read_text(encoding="utf-8"))
        imported = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
        imported += [item.name for node in ast.walk(tree) if isinstance(node, ast.Import) for item in node.names]
        assert not [one for one in imported if one.startswith("planrunner")]


def test_at_rest_an_axis_feels_its_share_of_earth_and_gravity() -> None:
    """At 39.98°: 15.041067·cos = 11.52552 deg/h north, 15.041067·sin = 9.66410 deg/h up."""
    seen = felt([Step("rest", "north up east", 2.0)], 10.0)
    assert seen.rate[0] == pytest.approx([11.52552, 9.66410, 0.0], abs=2e-4)
    assert seen.force[0] == pytest.approx([0.0, 9.80154, 0.0])
    assert len(seen.time) == 20 and seen.time[0] == 30.0


def test_a_whole_turn_leaves_the_vertical_component() -> None:
    """An axis that lies level reads north when the turn begins, and nothing on average over the turn."""
    seen = felt([Step("turn", "north west up", 36.0, rate=10.0)], 50.0)
    assert seen.rate[0] == pytest.approx([11.52552, 0.0, 36000 + 9.66410], abs=2e-4)
    assert seen.rate.mean(axis=0) == pytest.approx([0.0, 0.0, 36000 + 9.66410], abs=2e-4)
    quarter = seen.rate[450]  # after 90 degrees to the left its x points west and its y south
    assert quarter[:2] == pytest.approx([0.0, -11.52552], abs=2e-4)


def test_a_position_and_a_rate_have_the_same_error_each_time_unless_it_is_anew() -> None:
    """P05 and both turns about x have the same orientation; each rate is used about three axes."""
    campaign = CAMPAIGNS["imu_multi_position"]
    numbers = {step.label: number for number, step in enumerate(campaign.steps)}
    quiet = replace(campaign, white=0 * campaign.white)
    for anew in (False, True):
        world = World(tilt=1e-3, rate=1e-3, anew=anew)
        _, made = recorded(quiet, world, np.random.default_rng(1))
        mean = {label: made.values[made.step == number].mean(axis=0) for label, number in numbers.items()}
        level = [mean[label][4:] for label in ("P05", "X+1", "X-1")]  # y and z, while x points up
        assert np.allclose(level[0], level[1]) == np.allclose(level[1], level[2]) == (not anew)


def test_a_tilt_about_east_brings_north_up() -> None:
    """A sensor turned by δ about east: its north axis rises, and feels g·sin δ."""
    seen = felt([Step("rest", "north up east", 1.0)], 10.0, tilts=np.array([[1e-3, 0.0, 0.0]]))
    assert seen.force[0, 0] == pytest.approx(9.80154 * np.sin(1e-3))
    assert turn(np.array([0.0, 0.0, np.pi / 2])) @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])


def test_steps_follow_each_other() -> None:
    assert list(starts([Step("a", "east north up", 10.0), Step("b", "east north up", 5.0)])) == [30.0, 70.0]


def test_flicker_has_the_floor_that_its_density_has() -> None:
    """B²/(2πf) two-sided has an Allan deviation of B·sqrt(2·ln 2/π) = 0.664 B at any averaging time (IEEE Std 952)."""
    time = np.arange(40_000) / 10
    made = Recorded(
        time, np.zeros(len(time), dtype=np.int64), np.zeros((len(time), 20)), np.ones(20), np.ones(20), 10.0
    )
    noise = flicker(made, np.random.default_rng(4), 1.0)
    for samples in (100, 400):  # 10 s and 40 s
        means = noise.reshape(-1, samples, 20).mean(axis=1)
        assert np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2)) == pytest.approx(0.664, rel=0.05)


def test_uncertainty_from_within_turning_segments_is_that_of_the_noise() -> None:
    """The Earth's rate, seen by axes that turn, is up to sixteen times the noise here. 24 runs of three axes: z² has the standard deviation
    1/6 of its mean, 1."""
    campaign, world = CAMPAIGNS["scale_factor_tilted, within segments"], WORLDS["white noise"]
    sound, errors = known(campaign, world), []
    for run in range(24):
        truth, made = recorded(campaign, world, np.random.default_rng([21, run]))
        one = estimated(campaign, sound, made)
        assert not isinstance(one, str), one
        errors += [(one[name].value - value) / one[name].standard_uncertainty for name, value in truth.items()]
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=4 / 6)


@pytest.mark.parametrize("estimator", COUNTED)
def test_counts_larger_than_the_noise_are_warned_of(estimator: str) -> None:
    """Equal inputs have equal rounding errors, which no scatter shows; noise of half a count averages them out."""
    campaign = CAMPAIGNS[estimator]
    for name, warned in ((COARSE, True), ("white noise", False)):
        world = WORLDS[name]
        _, made = recorded(campaign, world, np.random.default_rng(4))
        one = estimated(campaign, known(campaign, world), made)
        assert not isinstance(one, str), one
        assert any("is too small for counts" in text for text in one.warnings) == warned


@pytest.mark.parametrize("estimator", EACH)
def test_every_coefficient_of_a_device_is_estimated(estimator: str) -> None:
    """Names, units and signs agree: in white noise each is found within five standard uncertainties, which are small beside the truth."""
    campaign, world = CAMPAIGNS[estimator], WORLDS["white noise"]
    truth, made = recorded(campaign, world, np.random.default_rng(2))
    one = estimated(campaign, known(campaign, world), made)
    assert not isinstance(one, str), one
    found = {item.name: item for item in one.coefficients}
    assert truth.keys() <= found.keys()
    for name, value in truth.items():
        error = found[name].value - value
        if np.isfinite(found[name].period):
            error -= found[name].period * np.round(error / found[name].period)
        assert abs(error) <= 5 * found[name].standard_uncertainty, name


@pytest.mark.parametrize(
    "estimator", [one for one in EACH if "reversed channel" not in CAMPAIGNS[one].without and "strapdown" not in one]
)
def test_a_reversed_channel_is_reported_by_every_estimator_that_has_a_scale_factor(estimator: str) -> None:
    """Noise figures do not depend on a channel's sign, and a bias over temperature does not show it."""
    campaign, world = CAMPAIGNS[estimator], WORLDS["reversed channel"]
    _, made = recorded(campaign, world, np.random.default_rng(3))
    one = estimated(campaign, known(campaign, world), made)
    assert not isinstance(one, str), one
    if "rocking" in estimator:
        assert [text for text in one.warnings if "check the signs" in text]
    else:
        assert [text for text in one.warnings if "opposite sign" in text]


def test_a_navigation_reports_a_reversed_north_gyro() -> None:
    """Its y axis points north: reversed, the Earth's rate seems to come from the south."""
    campaign, world = CAMPAIGNS["strapdown_navigation at rest"], WORLDS["white noise"]
    sound, (_, made) = known(campaign, world), recorded(campaign, world, np.random.default_rng(7))
    values = made.values * np.where([name == "gyro_y" for name in campaign.channels], -1, 1)
    one, other = estimated(campaign, sound, made), estimated(campaign, sound, replace(made, values=values))
    assert not isinstance(one, str) and not one.warnings
    assert not isinstance(other, str)
    (text,) = other.warnings
    assert "180 deg from the planned orientation" in text


@pytest.mark.parametrize(
    ("estimator", "channel"),
    [
        (name, list(one.channels)[k])
        for name, one in CAMPAIGNS.items()
        if "strapdown" in name
        for k in one.signed
        if list(one.channels)[k] != "gyro_y"  # see above
    ],
)
def test_a_navigation_names_every_reversed_channel_that_shows(estimator: str, channel: str) -> None:
    campaign, world = CAMPAIGNS[estimator], WORLDS["white noise"]
    _, made = recorded(campaign, world, np.random.default_rng(8))
    values = made.values * np.where([name == channel for name in campaign.channels], -1, 1)
    one = estimated(campaign, known(campaign, world), replace(made, values=values))
    (text,) = [one] if isinstance(one, str) else [text for text in one.warnings if "check the signs" in text]
    assert channel in text


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["rocking_drift", "rocking_drift, nominal azimuth"])
def test_rocking_drifts_scatter_as_predicted(estimator: str) -> None:
    """Squared errors over squared predictions: their mean over 24 tests has a standard deviation of √(2/24). An azimuth that is wrong in
    each run by an arc minute is in the prediction."""
    campaign, world, errors = CAMPAIGNS[estimator], WORLDS["white noise"], dict[str, list[float]]()
    sound = known(campaign, world)
    predicted = {one.name: one.standard_uncertainty for one in sound.designs["rocking"].predicted}
    for run in range(24):
        truth, made = recorded(campaign, world, np.random.default_rng([31, run]))
        one = estimated(campaign, sound, made)
        assert not isinstance(one, str), one
        for name, value in truth.items():
            errors.setdefault(name, []).append((one[name].value - value) / predicted[name])
    assert len(errors) == 6
    for name, found in errors.items():
        assert np.mean(np.square(found)) == pytest.approx(1.0, abs=4 * np.sqrt(2 / 24)), name
        assert abs(np.mean(found)) < 4 / np.sqrt(24), name


@pytest.mark.slow
@pytest.mark.parametrize("channel", CAMPAIGNS["rocking_drift"].channels)
def test_a_spike_in_any_channel_of_a_platform_is_named_and_moves_no_drift(channel: str) -> None:
    """At rest, while the base rocks, and in the second window of each."""
    campaign, world = CAMPAIGNS["rocking_drift"], WORLDS["white noise"]
    sound, (_, made) = known(campaign, world), recorded(campaign, world, np.random.default_rng(6))
    sound_one = estimated(campaign, sound, made)
    assert not isinstance(sound_one, str) and not sound_one.warnings
    place = list(campaign.channels).index(channel)
    for step, seconds in ((1, 100.0), (3, 100.0), (1, 595.0), (3, 595.0)):
        values = made.values.copy()
        row = int(np.flatnonzero(made.step == step)[0] + seconds * made.sampling)
        values[row, place] += 1000 * made.white[place]
        one = estimated(campaign, sound, replace(made, values=values))
        assert not isinstance(one, str)
        (text,) = one.warnings
        assert f"spike of {channel} in '{campaign.steps[step].label}'" in text
        for item in sound_one.coefficients:
            assert abs(one[item.name].value - item.value) <= 0.1 * item.standard_uncertainty


@pytest.mark.slow
@pytest.mark.parametrize("channel", CAMPAIGNS["rocking_drift"].channels)
def test_each_reversed_channel_of_a_platform_is_reported(channel: str) -> None:
    """It hardly shows in rocking drifts, which are differences of runs."""
    campaign, world = CAMPAIGNS["rocking_drift"], WORLDS["white noise"]
    _, made = recorded(campaign, world, np.random.default_rng(5))
    values = made.values * np.where([name == channel for name in campaign.channels], -1, 1)
    one = estimated(campaign, known(campaign, world), replace(made, values=values))
    assert "check" in one if isinstance(one, str) else [text for text in one.warnings if "check the signs" in text]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("estimator", "name"),
    [
        (estimator, name)
        for estimator in (
            "imu_multi_position",
            "error_model",
            "accelerometer_multi_position",
            "temperature_model, two cycles",
        )
        for name, world in WORLDS.items()
        if name not in CAMPAIGNS[estimator].without and not world.warns
    ],
)
def test_intervals_hold_the_truth_or_a_warning_names_the_cause(estimator: str, name: str) -> None:
    """25 runs of what docs/coverage-in-independent-worlds.md gives for more. Four standard errors, which the runs' scatter gives."""
    world = world_of(estimator, name)
    seen = tally(CAMPAIGNS[estimator], world, 25, 41)
    assert not seen.failed
    coverage, error = seen.coverage
    held = coverage >= 0.95 - 4 * error
    assert seen.named == seen.runs if name == COARSE and world.cause else held
    if world.cause in ("Bad samples", "temperature"):
        assert seen.named == seen.runs
