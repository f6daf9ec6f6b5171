"""IMU calibration, curves and repeatability through the virtual bench, against what its bench file declares."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]

PLAN = """
planrunner: 1
title: Zeros repeated after switching the motion on and off
bench: virtual_mems
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {settle: 1 s, dwell: 20 s, orientation: {x: east, y: north, z: up}}
segments:
  - {label: day1, repeat: 3}
  - {label: away, orientation: {x: up, y: east, z: north}}
  - {label: day2, repeat: 3}
estimates:
  again:
    estimator: repeatability
    segments: day*
    channels: [gyro_x, accel_z]
    groups: {first: day1*, second: day2*}
report: [summary.md]
"""


def run(plan: Path, folder: Path, *more: str) -> dict:
    done = planrunner("run", str(plan), "--quiet", *more, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    (results,) = folder.glob("runs/*/analyses/1/results.json")
    return json.loads(results.read_text(encoding="utf-8"))


def coefficients(results: dict, name: str) -> dict[str, dict]:
    estimates = results["estimates"]
    one = estimates[name] if isinstance(estimates, dict) else next(item for item in estimates if item["name"] == name)
    return {item["name"]: item for item in one["coefficients"]}


def test_repeatability_of_zeros(tmp_path: Path) -> None:
    path = tmp_path / "zeros.yaml"
    path.write_text(PLAN, encoding="utf-8")
    found = coefficients(run(path, tmp_path), "again")
    assert found["s_gyro_x"]["degrees_of_freedom"] == 4 and found["mean_gyro_x"]["degrees_of_freedom"] == 1
    # White noise 0.3 deg/√h over 20 s is 0.3/60/√20 deg/s; s with four degrees of freedom lies within 0.25 and 2.5 of it at 99.9 %.
    white = 0.3 / 60 / 20**0.5
    assert 0.2 * white < found["s_gyro_x"]["value"] < 4 * white
    assert found["mean_accel_z"]["value"] == pytest.approx((9.80154 + 0.022 * 9.80665) * 1.006, abs=0.02)


@pytest.mark.slow
def test_calibration_against_the_declared_sensor(tmp_path: Path) -> None:
    """Scale factor errors and misalignments of the bench file; biases wander from switch-on to switch-on and are left out."""
    plan = ROOT / "plans" / "imu_multi_position.yaml"
    found = coefficients(run(plan, tmp_path, "--set", "device_serial=1", "--set", "operator=x"), "imu")
    declared = {
        "gyro_scale_x": 1.0042,
        "gyro_scale_y": 0.9973,
        "gyro_scale_z": 1.0015,
        "gyro_misalignment_x_y": 5.41052,
        "gyro_misalignment_y_z": 7.15585,
        "gyro_misalignment_z_x": 4.36332,
        "gyro_g_sensitivity_K_x_x": 32.0,
        "gyro_g_sensitivity_K_z_x": -15.0,
        "gyro_g_sensitivity_K_y_y": -28.0,
        "gyro_g_sensitivity_K_z_z": 22.0,
        "accel_scale_x": 1.0035,
        "accel_scale_y": 0.9978,
        "accel_scale_z": 1.0061,
        "accel_misalignment_x_y": 3.66519,
        "accel_misalignment_x_z": -5.93412,
        "accel_misalignment_y_z": 4.71239,
    }
    for name, truth in declared.items():
        item = found[name]
        assert abs(item["value"] - truth) < 4 * item["standard_uncertainty"], (name, item["value"], truth)


@pytest.mark.slow
def test_curves_against_the_declared_sensor(tmp_path: Path) -> None:
    plan = ROOT / "plans" / "imu_over_temperature.yaml"
    results = run(plan, tmp_path, "--set", "device_serial=1", "--set", "operator=x")
    for axis, slope in (("x", 40.0), ("y", -25.0), ("z", 12.0)):
        # Bias instability of 6 deg/h over 100 K leaves a few tenths of a deg/h/K of what the chosen curve cannot tell.
        assert coefficients(results, "curves")[f"gyro_bias_{axis}_T1"]["value"] == pytest.approx(slope, abs=0.5)
        ramp = coefficients(results, "ramp")[f"gyro_{axis}_T1"]["value"] * 3600
        assert ramp == pytest.approx(slope, abs=0.7)
