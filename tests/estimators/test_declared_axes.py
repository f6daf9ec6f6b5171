"""What outputs say against their declared axes, signs and units."""

from __future__ import annotations

import pytest

from planrunner.estimators.declared_axes import AxisResponse, contradictions
from planrunner.plan.units import unit


def rows(matrix: list[list[float]], text: str = "g") -> list[AxisResponse]:
    kind = "accel" if text in ("g", "m/s^2") else "gyro"
    return [
        AxisResponse(f"{kind}_{'xyz'[k]}", k, unit(text), dict(enumerate(ratios)))
        for k, ratios in enumerate(matrix)
        if ratios
    ]


def test_a_triad_as_declared_raises_nothing() -> None:
    assert contradictions(rows([[1.01, 0.02, -0.01], [0.0, 0.85, 0.03], [0.01, 0.0, 1.15]])) == []


def test_one_reversed_axis_is_named_and_makes_the_triad_left_handed() -> None:
    first, second = contradictions(rows([[1, 0, 0], [0, -1, 0], [0, 0, 1]]))
    assert "accel_y" in first and "opposite sign" in first
    assert "left-handed" in second


def test_two_reversed_axes_are_a_turned_sensor_with_a_right_handed_triad() -> None:
    found = contradictions(rows([[-1, 0, 0], [0, -1, 0], [0, 0, 1]]))
    assert len(found) == 2 and not any("left-handed" in text for text in found)


@pytest.mark.parametrize(("text", "cause"), [("g", "gravity instead of specific force"), ("deg/s", "clockwise")])
def test_three_reversed_axes_have_one_cause(text: str, cause: str) -> None:
    (found,) = contradictions(rows([[-1, 0, 0], [0, -1, 0], [0, 0, -1]], text))
    assert cause in found


def test_exchanged_axes_are_named_with_the_axis_that_they_follow() -> None:
    first, second, third = contradictions(rows([[0.01, 1, 0], [1, 0.02, 0], [0, 0, 1]]))
    assert "accel_x responds mostly along y" in first and "accel_y responds mostly along x" in second
    assert "left-handed" in third


@pytest.mark.parametrize(
    ("declared", "size", "other"),
    [
        ("rad/s", 57.3, "deg/s"),
        ("deg/s", 1 / 57.1, "rad/s"),
        ("g", 9.81, "m/s^2"),
        ("m/s^2", 1 / 9.81, "g"),
        ("deg/s", 3600.0, "deg/h"),
        ("g", 1000.0, "mg"),
    ],
)
def test_a_wrong_unit_is_recognised_by_the_recorded_numbers(declared: str, size: float, other: str) -> None:
    (found,) = contradictions(rows([[size, 0, 0]], declared))
    assert f"agree with {other}," in found


def test_a_scale_factor_far_from_one_without_another_unit() -> None:
    (found,) = contradictions(rows([[0.5, 0, 0]]))
    assert "far from 1" in found


def test_an_output_that_was_not_excited_along_its_axis_is_not_judged() -> None:
    assert contradictions([AxisResponse("accel_x", 0, unit("g"), {1: -0.7, 2: 0.1})]) == []
