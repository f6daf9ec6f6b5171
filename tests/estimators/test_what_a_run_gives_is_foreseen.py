"""What `check` says that a run will give against what the run then gives: names, units and, where noise decides, uncertainties."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.estimators.interface import Estimate
from planrunner.estimators.method import jacobian
from planrunner.execution.stopping import StopRequest
from planrunner.tasks.check import Checked, check_plan
from planrunner.tasks.run import analyse_run, start

PLANS = Path(__file__).parents[2] / "plans"
RATES = """\
planrunner: 1
title: rates
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_z]}
defaults: {temperature: 25 degC, settle: 5 s, dwell: 30 s, orientation: {x: east, y: north, z: up}}
segments:
  - {label: up, for_each: {rate: "±1, ±10, ±100, ±400 deg/s"}}
  - {label: down, for_each: {rate: "±1, ±10, ±100, ±400 deg/s"}}
estimates:
  one: {estimator: scale_factor, segments: "up*", outputs: gyro_z, uncertainty: within_segment}
  two: {estimator: scale_factor, segments: "down*", outputs: gyro_z}
  repeat: {estimator: repeatability, uses: [one, two]}
  means: {estimator: repeatability, channels: [gyro_z], segments: "up*"}
"""


def carried_out(checked: Checked, folder: Path) -> dict[str, Estimate]:
    run, _ = start(checked.sound(), info={}, runs=folder, stop=StopRequest(), seed=5)
    return dict(analyse_run(run).results.estimates)


def test_names_units_and_uncertainties_are_those_of_the_run(tmp_path: Path) -> None:
    (tmp_path / "rates.yaml").write_text(RATES, encoding="utf-8")
    checked = check_plan(tmp_path / "rates.yaml")
    for name, made in carried_out(checked, tmp_path / "runs").items():
        foreseen = checked.designs[name].foreseen
        assert {item.name: item.unit for item in made.coefficients} == {one.name: one.unit for one in foreseen.values()}
        if name == "one":  # within the error of 31 batches in each of eight segments
            for item in checked.designs[name].predicted:
                assert made[item.name].standard_uncertainty == pytest.approx(item.standard_uncertainty, rel=0.25)


@pytest.mark.parametrize("plan", ["flexure_gyro_eight_position", "imu_multi_position", "fixture_angles"])
def test_names_of_shipped_plans(plan: str, tmp_path: Path) -> None:
    checked = check_plan(PLANS / f"{plan}.yaml")
    info = dict.fromkeys(checked.plan.record if checked.plan else (), "x")
    run, _ = start(checked.sound(), info=info, runs=tmp_path, stop=StopRequest(), seed=5)
    for name, made in analyse_run(run).results.estimates.items():
        assert [item.name for item in made.coefficients] == list(checked.designs[name].foreseen)


@pytest.mark.parametrize(
    ("quantity", "bound", "code"),
    [
        ("one.nonlinearity_gyro_z", "at_most: 100 ppm", None),
        ("one.asymmetry_gyro_z", "at_most: 1 deg/s", "meaning-dimension"),
        ("repeat.s_K_gyro_z", "at_most: 10 ppm", None),
        ("repeat.K_gyro_z_s", "at_most: 10 ppm", "meaning-unknown-quantity"),
        ("means.s_gyro_x", "at_most: 1 deg/s", "meaning-unknown-quantity"),
    ],
)
def test_a_limit_on_any_coefficient_is_checked(quantity: str, bound: str, code: str | None, tmp_path: Path) -> None:
    text = RATES + f"limits:\n  - {{quantity: {quantity}, {bound}}}\n"
    (tmp_path / "rates.yaml").write_text(text, encoding="utf-8")
    assert [one.code for one in check_plan(tmp_path / "rates.yaml").findings.errors] == ([code] if code else [])


def test_the_closest_name_is_suggested_for_a_curve_over_temperature(tmp_path: Path) -> None:
    text = (PLANS / "imu_over_temperature.yaml").read_text(encoding="utf-8")
    limit = "  - {quantity: curves.gyro_bias_y_T9, within: 1 deg/h}\n"
    head, _, tail = text.partition("limits:\n")
    (tmp_path / "plan.yaml").write_text(head + "limits:\n" + limit + tail if tail else text + "limits:\n" + limit)
    found = [
        one for one in check_plan(tmp_path / "plan.yaml").findings.errors if one.code == "meaning-unknown-quantity"
    ]
    assert len(found) == 1
    assert "gyro_bias_y_T" in found[0].hint


def test_derivatives_are_exact_to_rounding() -> None:
    """Against the derivatives of sines and a square root, by hand."""

    def formula(x: np.ndarray) -> np.ndarray:
        return np.array([math.sin(x[0]) * x[1], math.sqrt(x[1])])

    found = jacobian(formula, np.array([0.3, 4.0]), np.array([1e-3, 4e-3]))
    expected = [[math.cos(0.3) * 4, math.sin(0.3)], [0.0, 0.25]]
    assert found == pytest.approx(np.array(expected), rel=1e-10, abs=1e-12)
