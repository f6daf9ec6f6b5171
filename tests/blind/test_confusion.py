"""Effects that are easily taken for each other, from a generator that shares no code with the diagnosis."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.blind import folder
from tests.blind.confusion import STRONGEST, WEAKEST, Answered, answered, answers, case_of, score

SEED = 7


def one_of(
    group: str, effect: str, number: int, energy: float | None = None, effects: Sequence[str] | None = None
) -> Answered:
    with tempfile.TemporaryDirectory() as name:
        folder.write_setups(Path(name))
        return answered(case_of(group, SEED, number, effect, energy), SEED, Path(name), effects)


AMONG_ALL = pytest.param(None, marks=pytest.mark.slow, id="all")
"""All effects are hypotheses, which takes long; the effects that are easily taken for each other are tested quickly."""
OF_TIME = (
    "gyro_bias_step",
    "gyro_bias_random_walk",
    "gyro_bias_gauss_markov",
    "gyro_bias_drift",
    "gyro_warm_up",
    "mount_shift",
)
LATE = (
    "gyro_bandwidth",
    "time_latency",
    "reference_latency",
    "gyro_axis_delay",
    "samples_dropped",
)


FURTHER = {
    ("vibration", "gyro_vibration_rectification"): (("k", 1.0),),
    ("vibration", "accel_vibration_rectification"): (("k", 9.80665e-6),),
    ("mounting", "mount_shift"): (("about", np.radians(1 / 3600)),),
    ("axes late", "gyro_axis_delay"): (("d", 1e-3),),
    ("thermal lag", "gyro_bias_temperature_lagged"): (("c", 1.0),),
}
"""Group and effect: the name of its amplitudes, and the size of their unit in that of the generator."""


@pytest.mark.slow
@pytest.mark.parametrize(("group", "effect"), FURTHER)
@pytest.mark.parametrize(("number", "energy"), [(0, 160.0), (1, 400.0)])
def test_a_further_effect_is_named_with_its_size(group: str, effect: str, number: int, energy: float) -> None:
    one = one_of(group, effect, number, energy)
    assert one.named == (effect,) and one.in_set
    (((amplitude, unit),),) = (FURTHER[group, effect],)
    for axis, true in zip("xyz", one.theta, strict=True):
        value, u = one.parameters[f"{effect}.{amplitude}_{axis}"]
        assert abs(value * unit - true) < 4 * u * unit, (axis, value, u, true)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "energy"), [(0, 160.0), (2, 400.0)])
def test_a_limit_is_found_on_its_side(number: int, energy: float) -> None:
    """A limit on one side is weighed if it is named; if the rates exceed it on that side only, it is the same as one of both sides."""
    from tests.blind.product import diagnosis_of

    case = case_of("limits", SEED, number, "gyro_saturation_asymmetric", energy)
    with tempfile.TemporaryDirectory() as name:
        folder.write_setups(Path(name))
        folder.write_case(Path(name), case, SEED)
        found = diagnosis_of(
            folder.shown(Path(name), case.name),
            ("gyro_saturation", "gyro_saturation_asymmetric", "gyro_scale_nonlinearity"),
        )
    said = set(found.verdict.members or found.verdict.effects)
    assert "gyro_saturation_asymmetric" in said and "gyro_scale_nonlinearity" not in said
    other = "lower" if case.faults[0].shape[0] > 0 else "upper"
    assert other not in {one.name for one in found.parameters}
    soft = one_of("limits", "gyro_soft_saturation", number, energy)
    assert soft.in_set and soft.right and soft.named[0] == "gyro_soft_saturation"
    limit, u = soft.parameters["gyro_soft_saturation.limit"]
    assert abs(limit - 1 / soft.theta[0]) < 4 * u


@pytest.mark.parametrize(
    ("group", "effect", "parameter"),
    [
        ("accelerometer noise", "accel_noise_excess", "white"),
        ("accelerometer counts", "accel_quantization", "count"),
    ],
)
def test_noise_of_accelerometers_is_named_with_its_size(group: str, effect: str, parameter: str) -> None:
    case = case_of(group, SEED, 1, effect)
    one = one_of(group, effect, 1)
    assert one.named == (effect,) and one.probability > 0.9
    for axis, name in enumerate("xyz"):
        value, u = one.parameters[f"{effect}.{parameter}_{name}"]
        expected = one.theta[0]
        if parameter == "white":
            readings = case.columns[f"accel_{name}_m_per_s2"]
            steps = np.diff(readings[:500])  # at rest; 50 samples a second
            expected = float(np.std(steps) / np.sqrt(2 * 50))
        assert abs(value - expected) < max(4 * u, 0.1 * expected), axis


@pytest.mark.slow
@pytest.mark.parametrize(("number", "energy"), [(0, 400.0), (1, 1e8)])
def test_lost_samples_are_no_delay_from_the_beginning(number: int, energy: float) -> None:
    from tests.blind.product import diagnosis_of

    case = case_of("lost samples", SEED, number, "samples_dropped", energy)
    with tempfile.TemporaryDirectory() as name:
        folder.write_setups(Path(name))
        folder.write_case(Path(name), case, SEED)
        shown = folder.shown(Path(name), case.name)
        found = diagnosis_of(shown, ("samples_dropped", "time_latency", "gyro_bandwidth"))
    assert found.verdict.effects == ("samples_dropped",)
    (lost,) = (one for one in found.parameters if one.name == "lost")
    assert abs(lost.value * 1e-3 - case.faults[0].theta[0]) < 4e-3 * lost.standard_uncertainty


@pytest.mark.parametrize(
    ("number", "lasting"), [(0, 0.4), *(pytest.param(n, 3.0, marks=pytest.mark.slow) for n in (1, 2))]
)
def test_stuck_samples_are_named_with_time_and_duration(number: int, lasting: float) -> None:
    one = one_of("stuck", "samples_stuck", number, lasting)
    assert one.named == ("samples_stuck",) and one.in_set
    step = 1 / (20.0 if number == 1 else 50.0)  # s between samples
    begin, u = one.parameters["samples_stuck.time"]
    assert abs(begin - one.shape[0]) <= step
    assert abs(one.parameters["samples_stuck.lasting"][0] - lasting) <= step and u < step


@pytest.mark.parametrize(("number", "energy"), [(0, 9e3), pytest.param(1, 9e3, marks=pytest.mark.slow)])
def test_a_line_appears_at_its_folded_frequency(number: int, energy: float) -> None:
    """49.7 and 99.1 Hz, sampled at 50 Hz."""
    one = one_of("interference", "gyro_line_interference", number, energy)
    assert one.named == ("gyro_line_interference",) and one.in_set
    true, _ = one.shape
    frequency, u = one.parameters["gyro_line_interference.frequency"]
    assert abs(frequency - abs(true - 50.0 * round(true / 50.0))) < 4 * u
    for axis, amplitude in zip("xyz", one.theta, strict=True):
        cosine, sine = (one.parameters[f"gyro_line_interference.{wave}_{axis}"] for wave in ("cos", "sin"))
        assert abs(np.hypot(cosine[0], sine[0]) - abs(amplitude)) < 4 * np.hypot(cosine[1], sine[1])


@pytest.mark.slow
@pytest.mark.parametrize(("number", "energy"), [(0, 3e4), (1, 3e4)])
def test_a_line_of_the_accelerometers_is_named(number: int, energy: float) -> None:
    one = one_of("interference", "accel_line_interference", number, energy)
    assert one.named == ("accel_line_interference",) and one.in_set


@pytest.mark.parametrize("effects", [pytest.param(LATE, id="alike"), AMONG_ALL])
def test_an_axis_that_is_late_is_no_delay_of_all(effects: Sequence[str] | None) -> None:
    one = one_of("axes late", "gyro_axis_delay", 0, 250.0, effects)
    assert one.named == ("gyro_axis_delay",) and one.in_set


@pytest.mark.parametrize("effects", [pytest.param(OF_TIME, id="alike"), AMONG_ALL])
def test_a_step_is_not_a_random_walk(effects: Sequence[str] | None) -> None:
    """Before a step was a hypothesis, it was named as a random walk."""
    one = one_of("steps", "gyro_bias_step", 1, effects=effects)
    assert one.named == ("gyro_bias_step",)
    time, u = one.parameters["gyro_bias_step.time"]
    assert abs(time - one.shape[0]) < 3 * u
    sizes = [one.parameters[f"gyro_bias_step.s_{axis}"] for axis in "xyz"]
    assert all(abs(size - true) < 4 * u for (size, u), true in zip(sizes, one.theta, strict=True))


@pytest.mark.parametrize("effects", [pytest.param(OF_TIME, id="alike"), AMONG_ALL])
def test_a_random_walk_is_not_a_step(effects: Sequence[str] | None) -> None:
    one = one_of("steps", "gyro_bias_random_walk", 1, effects=effects)
    assert one.named == ("gyro_bias_random_walk",)


@pytest.mark.parametrize("effects", [pytest.param(LATE, id="alike"), AMONG_ALL])
@pytest.mark.parametrize(("effect", "name"), [("gyro_bandwidth", "tau"), ("time_latency", "delay")])
def test_a_lag_is_not_half_a_delay(effect: str, name: str, effects: Sequence[str] | None) -> None:
    """With a free amplitude a lag was named as a delay, or as two effects with shares of each, and u was 1e-109 s."""
    one = one_of("late", effect, 5, effects=effects)
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
