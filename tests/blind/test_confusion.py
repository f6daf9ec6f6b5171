"""Effects that are easily taken for each other, from a generator that shares no code with the diagnosis."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest

from tests.blind import folder
from tests.blind.confusion import STRONGEST, WEAKEST, Answered, answered, answers, case_of, score

SEED = 7


def one_of(group: str, effect: str, number: int) -> Answered:
    with tempfile.TemporaryDirectory() as name:
        folder.write_setups(Path(name))
        return answered(case_of(group, SEED, number, effect), SEED, Path(name))


def test_a_step_is_not_a_random_walk() -> None:
    """Before a step was a hypothesis, it was named as a random walk."""
    one = one_of("steps", "gyro_bias_step", 1)
    assert one.named == ("gyro_bias_step",)
    time, u = one.parameters["gyro_bias_step.time"]
    assert abs(time - one.shape[0]) < 3 * u
    sizes = [one.parameters[f"gyro_bias_step.s_{axis}"] for axis in "xyz"]
    assert all(abs(size - true) < 4 * u for (size, u), true in zip(sizes, one.theta, strict=True))


def test_a_random_walk_is_not_a_step() -> None:
    one = one_of("steps", "gyro_bias_random_walk", 1)
    assert one.named == ("gyro_bias_random_walk",)


@pytest.mark.parametrize(("effect", "name"), [("gyro_bandwidth", "tau"), ("time_latency", "delay")])
def test_a_lag_is_not_half_a_delay(effect: str, name: str) -> None:
    """With a free amplitude a lag was named as a delay, or as two effects with shares of each, and u was 1e-109 s."""
    one = one_of("late", effect, 5)
    assert one.named == (effect,) and one.probability > 0.9
    value, u = one.parameters[f"{effect}.{name}"]
    assert abs(value - one.theta[0]) < 4 * u and u < 1e-3 * value
    assert f"{effect}.share" not in one.parameters


def test_the_count_of_answers() -> None:
    usual = {"case": "", "energy": 50.0, "kind": "effect", "members": (), "in_set": True, "theta": (), "shape": ()}

    def one(effect: str, named: str, probability: float) -> Answered:
        told = {"effect": effect, "named": (named,), "right": effect == named, "probability": probability}
        return Answered(**{**usual, **told, "parameters": {}})  # type: ignore[arg-type]

    found = score([one("a", "a", 0.995), one("a", "b", 0.999), one("b", "b", 0.9)])
    assert found["said"] == {"a": {"a": 1, "b": 1}, "b": {"b": 1}}
    assert found["right"] == [2, 3] and found["right where P >= .99"] == [1, 2]


@pytest.mark.slow
def test_steps_and_walks_of_any_strength() -> None:
    found = list(answers("steps", 2, SEED))
    assert all(WEAKEST <= one.energy <= STRONGEST for one in found)
    assert sum(one.right for one in found) == 4 and all(one.in_set for one in found), score(found)
    assert not any("step" in one.named[0] for one in found if one.named and one.effect == "gyro_bias_random_walk")


@pytest.mark.slow
def test_steps_of_accelerometers() -> None:
    found = list(answers("accelerometer steps", 2, SEED))
    assert sum(one.right for one in found) == 2 and np.mean([one.in_set for one in found]) == 1.0, score(found)
