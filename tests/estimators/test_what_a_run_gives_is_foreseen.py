"""What `check` says that a run will give against what the run then gives: names, units and, where noise decides, uncertainties."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.estimators.interface import Estimate
from planrunner.execution.stopping import StopRequest
from planrunner.tasks.check import Checked, check_plan
from planrunner.tasks.estimate import analyse_run
from planrunner.tasks.run import start

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
ALLAN = """\
planrunner: 1
title: noise at rest
bench: virtual
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults: {temperature: 25 degC, soak: 1 min, settle: 1 min, sample_rate: 5 Hz}
segments:
  - {label: rest, orientation: {x: east, y: north, z: up}, dwell: 20 min}
estimates:
  one: {estimator: allan_deviation, segments: rest, outputs: [torquer_x, torquer_y]}
"""
ROCKING = """\
planrunner: 1
title: rocking
bench: virtual_platform
sensor: {kind: stabilised-platform, outputs: [accel_x, accel_y, accel_z]}
defaults: {dwell: 150 s, mode: navigation, orientation: {x: north, y: up, z: east}}
segments:
  - repeat: 1
    steps:
      - {label: cage-1, mode: caged, dwell: 10 s}
      - {label: static-1}
      - {label: cage-2, mode: caged, dwell: 10 s}
      - label: dynamic-1
        motion: &rocking
          rock: {amplitude: 3 deg, frequency: 0.2 Hz, phases: [0 deg, 45 deg, 90 deg]}
          for: 60 s
      - {label: cage-3, mode: caged, dwell: 10 s}
      - {label: dynamic-2, motion: *rocking}
      - {label: cage-4, mode: caged, dwell: 10 s}
      - {label: static-2}
estimates:
  one: {estimator: rocking_drift, segments: "*", accelerometer_stability: 10 ug}
"""
NAVIGATION = """\
planrunner: 1
title: navigation
bench: virtual_imu
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {orientation: {x: east, y: north, z: up}, sample_rate: 10 Hz}
segments:
  - {label: align-at-rest, dwell: 10 min}
  - {label: at-rest, dwell: 90 min}
  - motion:
      cycle: {A: 0 deg, B: 90 deg, C: 180 deg, D: 270 deg}
      moves: [A +180 C, C +90 D, D -180 B, B -90 A, A -180 C, C -90 B, B +180 D, D +90 A]
      turn_rate: 20 deg/s
      stop: 1 min
    steps:
      - {label: align-turning, dwell: {cycles: 1}}
      - {label: turning, dwell: {cycles: 1, at_least: 90 min}}
estimates:
  one: {estimator: strapdown_navigation, segments: [align-at-rest, at-rest],
     gyro_uncertainty: 0.02 deg/h, accelerometer_uncertainty: 50 ug}
  two: {estimator: strapdown_navigation, segments: [align-turning, turning],
     gyro_uncertainty: 0.02 deg/h, accelerometer_uncertainty: 50 ug}
  both:
    estimator: modulation_residual
    uses: [one, two]
    segments: [at-rest, turning]
    gyro_errors: [0.02 deg/h, -0.015 deg/h, 0.01 deg/h]
    accelerometer_errors: [50 ug, -40 ug, 30 ug]
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


@pytest.mark.parametrize(
    ("text", "by_noise"),
    [
        pytest.param(ALLAN, ("N_torquer_x", "N_torquer_y"), id="allan"),
        pytest.param(ROCKING, (), id="rocking"),
        pytest.param(NAVIGATION, ("heading", "pitch", "roll"), id="navigation", marks=pytest.mark.slow),
    ],
)
def test_estimators_with_a_foresight_of_their_own(text: str, by_noise: tuple[str, ...], tmp_path: Path) -> None:
    """by_noise: whose uncertainty declared noise alone decides, and hardly the draw of one run; results lie where they are predicted."""
    (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
    checked = check_plan(tmp_path / "plan.yaml")
    made = carried_out(checked, tmp_path / "runs")
    assert list(made) == list(checked.designs)
    assert all(name in {one.name for one in checked.designs["one"].predicted} for name in by_noise)
    for name, estimate in made.items():
        design = checked.designs[name]
        assert {one.name: one.unit for one in estimate.coefficients} == {
            one.name: one.unit for one in design.foreseen.values()
        }
        for item in design.predicted:
            found = estimate[item.name]
            assert abs(found.near(item.value) - item.value) < 4 * item.standard_uncertainty, item.name
            if item.name in by_noise:
                assert found.standard_uncertainty == pytest.approx(item.standard_uncertainty, rel=0.1), item.name


@pytest.mark.parametrize(
    "plan",
    [
        "flexure_gyro_eight_position",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("imu_multi_position", "fixture_angles")),
    ],
)
def test_names_of_shipped_plans(plan: str, tmp_path: Path) -> None:
    checked = check_plan(PLANS / f"{plan}.yaml")
    info = dict.fromkeys(checked.plan.record if checked.plan else (), "x")
    run, _ = start(checked.sound(), info=info, runs=tmp_path, stop=StopRequest(), seed=5)
    for name, made in analyse_run(run).results.estimates.items():
        foreseen = checked.designs[name].foreseen
        assert [(item.name, item.unit) for item in made.coefficients] == [
            (one.name, one.unit) for one in foreseen.values()
        ]


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
