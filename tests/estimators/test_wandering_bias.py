"""Biases that wander reach the uncertainty of a navigation; expected figures come from other formulas or from an independent world."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.estimators.interface import Estimate
from planrunner.estimators.strapdown.wandering import MeanAttitude, WanderingBias, interval
from planrunner.navigation.alignment import FineAlignment
from planrunner.navigation.error_equations import INPUTS, TILT, ErrorEquations
from planrunner.observation.flicker import mean_covariance, weighted_covariance
from planrunner.physics.earth import Site
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded, tally
from tests.worlds.faults import WORLDS, Recorded

SITE = Site(latitude=math.radians(40), gravity=9.8)
EQUATIONS = ErrorEquations.at(SITE)
AT_REST, CARRIED_ROUND = "strapdown_navigation at rest", "strapdown_navigation from stop to stop"


def test_sums_over_equal_intervals_have_the_covariance_of_means() -> None:
    """The convolution against the matrix; a span longer than the intervals together, and one that is shorter."""
    draw, n, step = np.random.default_rng(2), 37, 12.5
    weights = draw.standard_normal((2, 3, n))
    start = step * np.arange(n, dtype=np.float64)
    for span in (86400.0, 60.0):
        dense = weights @ mean_covariance(start, start + step, span) @ weights.swapaxes(-1, -2)
        assert weighted_covariance(weights, step, span) == pytest.approx(dense, rel=1e-9, abs=1e-9)


def test_alignment_at_rest_follows_constant_errors_to_the_tilt_that_hides_them() -> None:
    """The sum over all intervals is the response to a constant error: φ_E = −∇_N/g, φ_N = ∇_E/g, φ_U = tan L·∇_E/g − ε_E/(Ω·cos L)."""
    fine = FineAlignment(EQUATIONS, np.diag([1e-14] * 3 + [1e-10] * 3), 1.0, follow=10.0)
    fine.take(np.zeros((1800, 2)), np.repeat(np.eye(3)[None], 1800, axis=0), np.zeros(1800))
    followed = fine.finish(np.eye(3)).followed[TILT]
    assert followed.shape == (3, INPUTS, 180)
    whole, levelled = followed.sum(axis=2), EQUATIONS.levelled()
    assert whole[:2, 3:] == pytest.approx(levelled[:2, 3:], abs=0.02 / 9.8)
    assert whole[2, 0] == pytest.approx(levelled[2, 0], rel=0.02)
    assert whole[2, 3] == pytest.approx(levelled[2, 3], rel=0.05)


def test_covariances_are_those_of_drawn_courses() -> None:
    """Courses of flicker drawn from their dense covariance drive the error equations step by step; a turning unit, a pause before it."""
    draw, step, count, before = np.random.default_rng(4), 60.0, 45, 8
    aligned = 1e4 * draw.standard_normal((3, INPUTS, before - 2))
    angle = np.radians(7.0) * np.arange(count)
    zero, one = np.zeros(count), np.ones(count)
    attitude = np.array(
        [[np.cos(angle), -np.sin(angle), zero], [np.sin(angle), np.cos(angle), zero], [zero, zero, one]]
    )
    attitude = attitude.transpose(2, 0, 1)
    made = WanderingBias(EQUATIONS, aligned, attitude, before, step, 86400.0)
    start = step * np.arange(before + count, dtype=np.float64)
    root = np.linalg.cholesky(mean_covariance(start, start + step, 86400.0))
    moment = (count - 0.5) * step
    for sensor in (1, 3):
        state = np.zeros((7, before + count))
        state[TILT] = aligned[:, sensor] @ root[: before - 2]
        tilt = state[TILT]
        for k in range(count):
            transition, response = EQUATIONS.step(step if k < count - 1 else step / 2)
            along = np.zeros(INPUTS)
            along[3 * (sensor // 3) :][:3] = attitude[k][:, sensor % 3]
            state = transition @ state + np.outer(response @ along, root[before + k])
        joint = np.vstack([tilt, state[:4]])
        expected = joint @ joint.T
        size = np.sqrt(np.diag(expected))
        found = made.covariances(np.array([moment]))[0, sensor]
        assert found / np.outer(size, size) == pytest.approx(expected / np.outer(size, size), abs=1e-6)


def test_mean_attitude_over_intervals() -> None:
    mean = MeanAttitude(10.0)
    for first in (0, 15):
        time = np.arange(first, first + 15, dtype=np.float64) + 1
        mean.take(time, time[:, None, None] * np.eye(3))
    assert mean.means[:, 0, 0].tolist() == [5.5, 15.5, 25.5]
    assert (interval(600.0, 4400), interval(72 * 3600.0, 4400)) == (10.0, 59.0)


def test_declared_flicker_enters_the_budget_and_the_prediction() -> None:
    """Without it everything is as before; with it each sensor has its line, and check expects larger errors."""
    plain, declared = (
        known(CAMPAIGNS[AT_REST], WORLDS[name]) for name in ("flicker, not declared", "flicker, declared")
    )
    _, made = recorded(
        CAMPAIGNS[AT_REST], WORLDS["white noise"], np.random.default_rng(1)
    )  # with flicker: a drift, too
    without, one = (estimated(CAMPAIGNS[AT_REST], sound, made) for sound in (plain, declared))
    assert isinstance(without, Estimate) and isinstance(one, Estimate)
    lines = {each.quantity.name for each in one.influences} - {each.quantity.name for each in without.influences}
    assert lines == {f"bias instability {name}" for name in CAMPAIGNS[AT_REST].channels}
    for name in ("east_error", "north_error", "radial_error", "rms_radial_error", "radial_error_rate"):
        assert one[name].value == without[name].value
        assert one[name].standard_uncertainty > 1.05 * without[name].standard_uncertainty


@pytest.mark.parametrize("where", [3000, 40_000])
def test_one_bad_sample_does_not_move_a_navigation(where: int) -> None:
    """In the alignment and in the navigation, of a gyro: left out, named, and without effect."""
    campaign, world = CAMPAIGNS[AT_REST], WORLDS["white noise"]
    sound = known(campaign, world)
    _, made = recorded(campaign, world, np.random.default_rng(6))
    wrong = made.values.copy()
    wrong[where, 0] += 1000 * made.white[0]
    spoilt = Recorded(made.time, made.step, wrong, made.white, made.mean, made.sampling)
    clean, one = (estimated(campaign, sound, each) for each in (made, spoilt))
    assert isinstance(clean, Estimate) and isinstance(one, Estimate)
    assert [text for text in one.warnings if "spike" in text]
    for item in clean.coefficients:
        assert abs(one[item.name].value - item.value) <= 0.1 * item.standard_uncertainty, item.name


@pytest.mark.slow
@pytest.mark.parametrize("campaign", [AT_REST, CARRIED_ROUND])
def test_intervals_of_a_navigation_with_flicker_hold_the_truth(campaign: str) -> None:
    """Errors at the end, which are linear in the sensors' errors: within four binomial standard deviations of 95 %."""
    found = tally(CAMPAIGNS[campaign], WORLDS["flicker, declared"], 60, 5)
    assert not found.failed
    print({name: held / 60 for name, held in found.held.items()})
    for name in ("heading", "pitch", "roll", "east_error", "north_error", "east_velocity_error"):
        assert found.held[name] >= 60 * (0.95 - 4 * math.sqrt(0.95 * 0.05 / 60)), name
