"""Stops of a navigation show biases that drift and gyros with the wrong sign; recordings come from the independent generator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planrunner.estimators.interface import Estimate
from planrunner.estimators.strapdown.reading import Increments
from planrunner.estimators.strapdown.standing import StopReader
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded, tally
from tests.worlds.faults import WORLDS

AT_REST, CARRIED_ROUND = "strapdown_navigation at rest", "strapdown_navigation from stop to stop"
EARTH = math.radians(15.041067) / 3600


@pytest.mark.parametrize("name", [AT_REST, CARRIED_ROUND])
@pytest.mark.parametrize("world", ["linear drift", "warming up", "temperature drift, recorded"])
def test_the_stated_effect_of_a_drift_is_that_of_a_navigation_without_it(name: str, world: str) -> None:
    """The same device with the same noise, navigated with and without the drift."""
    campaign = CAMPAIGNS[name]
    sound = known(campaign, WORLDS[world])
    found: list[Estimate] = []
    for one in (replace(WORLDS[world], fault=None, celsius=None), WORLDS[world]):
        estimate = estimated(campaign, sound, recorded(campaign, one, np.random.default_rng([17, 1]))[1])
        assert not isinstance(estimate, str), estimate
        found.append(estimate)
    without, drifting = found
    assert not without.warnings
    (warning,) = drifting.warnings
    assert WORLDS[world].cause in warning
    (influence,) = (item for item in drifting.influences if item.quantity.name == "drift")
    for k, item in enumerate(drifting.coefficients):
        if item.name in ("east_error", "north_error", "east_velocity_error", "north_velocity_error"):
            caused, *allowed = influence.sensitivities[k]
            assert item.value - without[item.name].value == pytest.approx(caused, abs=4 * math.hypot(*allowed)), (
                item.name
            )


def test_a_reversed_east_gyro_is_named_once_the_unit_is_turned() -> None:
    """During the alignment its axis points east, where the Earth's rate has no component."""
    campaign, world = CAMPAIGNS[CARRIED_ROUND], WORLDS["white noise"]
    sound, (_, made) = known(campaign, world), recorded(campaign, world, np.random.default_rng(7))
    values = made.values * np.where([name == "gyro_x" for name in campaign.channels], -1, 1)
    for own, named in ((made.values, False), (values, True)):
        one = estimated(campaign, sound, replace(made, values=own))
        assert not isinstance(one, str), one
        assert any("gyro_x" in text and "check the signs" in text for text in one.warnings) == named


def _stand(reader: StopReader, begin: float, seconds: int, rates: np.ndarray, rotation: np.ndarray) -> None:
    """Ten samples per second and a knot every second. rates: (6,)."""
    time = begin + 0.1 * np.arange(1, 10 * seconds + 1, dtype=np.float64)
    values = np.repeat(rates[:, None] * 0.1, len(time), axis=1)
    piece = Increments(time, np.full(len(time), 0.1), values, {})
    reader.take(piece, np.arange(9, len(time), 10), np.repeat(rotation[None], seconds, axis=0))


def test_readings_are_averaged_by_position_and_turns_are_left_out() -> None:
    """Two stops in one position, one in another, and turns of ten seconds; the seconds next to a turn are not used."""
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turn = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 9.8])
    first, second = np.array([0.0, EARTH, 0.0, 0.0, 0.0, 9.8]), np.array([EARTH, 0.0, 0.0, 0.0, 0.0, 9.8])
    reader = StopReader(EARTH, np.full(6, 1e-9), 1280.0, 0.0)
    for begin, seconds, rates, rotation in (
        (0.0, 40, first, np.eye(3)),
        (40.0, 10, turn, quarter),
        (50.0, 40, second, quarter),
        (90.0, 10, -turn, np.eye(3)),
        (100.0, 40, first, np.eye(3)),
    ):
        _stand(reader, begin, seconds, rates, rotation)
    stops = reader.finish()
    totals = [stops.seconds[stops.position == k].sum() for k in (0, 1)]
    assert totals == pytest.approx(
        [76.0, 38.0], abs=1.01
    )  # the first second and the last one wait for their neighbours
    for k, rates in enumerate((first, second)):
        here = stops.position == k
        assert stops.means[here] == pytest.approx(np.repeat(rates[None], here.sum(), axis=0), abs=1e-12)
    assert float(stops.time @ stops.seconds / stops.seconds.sum()) == pytest.approx(70.0, abs=1.0)


def test_memory_does_not_grow_with_the_length_of_the_recording() -> None:
    reader = StopReader(EARTH, np.full(6, 1e-9), 12_000.0, 0.0)
    rates = np.array([0.0, EARTH, 0.0, 0.0, 0.0, 9.8])
    for k in range(100):
        _stand(reader, 120.0 * k, 120, rates, np.eye(3))
    assert 120 <= len(reader.finish().time) <= 129


@pytest.mark.slow
@pytest.mark.parametrize("name", [AT_REST, CARRIED_ROUND])
def test_every_drift_is_named_and_white_noise_is_not(name: str) -> None:
    for world, named in (
        ("linear drift", 15),
        ("warming up", 15),
        ("temperature drift, recorded", 15),
        ("white noise", 0),
    ):
        found = tally(CAMPAIGNS[name], WORLDS[world], 15, 3)
        assert found.coverage[0] > 0.9
        assert (found.named if named else found.warned) == named
