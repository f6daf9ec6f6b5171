"""A scale factor that only shows in the response to a recorded motion: the segments have no mean rate and no slow changes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from planrunner.cli import main

pytestmark = pytest.mark.slow
RATE, SEGMENTS, LONG = 50, 8, 40.0

BENCH = """planrunner_bench: 1
name: stepper
clock: virtual
site: {latitude: 48 deg, gravity: 9.809 m/s^2}
instruments:
  imu:
    driver: recording
    file: r.csv
    kind: imu
    sample_rate: 50 Hz
    time: {column: t, unit: s}
    segments: {table: s.csv}
    channels:
      gyro_z: {column: wz, unit: deg/s, noise: 0.1 deg/s}
      encoder: {column: angle, unit: deg}
"""
PLAN = """planrunner: 1
title: A gyro on a table with an encoder
bench: ./b.bench.yaml
sensor: {kind: imu, outputs: [gyro_z]}
defaults:
  orientation: {x: east, y: north, z: up}
  dwell: recorded
  motion: {about: up, recorded: {angle: encoder}}
segments:
  - {label: "part_{repeat}", repeat: 8}
estimates:
  gyro: {estimator: error_model, outputs: {gyro_z: [gyro_bias, gyro_scale_factor]}}
report: [summary.md]
"""


def diagnosed(folder: Path, scale: float, capsys: pytest.CaptureFixture[str], late: float = 0.0) -> dict[str, object]:
    """The diagnosis of a gyro that is turned to and fro by two superposed oscillations; bias 0.2 deg/s, Earth's rate in z. late: s, delay
    of the gyro."""
    draw = np.random.default_rng(12)
    time = np.arange(round(SEGMENTS * LONG * RATE)) / RATE
    rate, angle = np.zeros(len(time)), np.zeros(len(time))
    for amplitude, hertz in ((20.0, 0.35), (9.0, 0.61)):
        rate += amplitude * np.cos(2 * np.pi * hertz * (time - late))
        angle += amplitude * np.sin(2 * np.pi * hertz * time) / (2 * np.pi * hertz)
    wz = scale * (rate + 15.041 / 3600 * np.sin(np.radians(48))) + 0.2 + draw.normal(0, 0.1, len(time))
    table = np.column_stack([time, wz, angle])
    np.savetxt(folder / "r.csv", table, "%.7f", delimiter=",", header="t,wz,angle", comments="")
    spans = [f"part_{k + 1},{k * LONG},{(k + 1) * LONG}" for k in range(SEGMENTS)]
    (folder / "s.csv").write_text("\n".join(["label,start_s,end_s", *spans, ""]))
    (folder / "b.bench.yaml").write_text(BENCH)
    (folder / "p.yaml").write_text(PLAN)
    arguments = ["diagnose", str(folder / "p.yaml"), "--recording", str(folder / "r.csv"), "--json"]
    assert main([*arguments, "--nominal", "gyro_bias"]) == 0, capsys.readouterr().err
    said: dict[str, object] = json.loads(capsys.readouterr().out)
    return said


def test_a_scale_factor_is_found_in_the_response_to_a_recorded_motion(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = diagnosed(tmp_path, 1.005, capsys)
    verdict = said["verdict"]
    assert "gyro_scale_factor" in {*verdict["effects"], *verdict["class"]}  # type: ignore[index]
    assert said["rest"]["passes"]  # type: ignore[index]
    assert said["gap"]["gyro_z"]["before"] > 5 * said["gap"]["gyro_z"]["noise_floor"]  # type: ignore[index]


def test_a_small_scale_factor_is_found_although_the_gyro_is_late(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The delay causes an error in quadrature with the rate, thirty times as large as that of the scale factor. It is no noise."""
    said = diagnosed(tmp_path, 1.001, capsys, late=0.013)
    verdict = said["verdict"]
    assert "gyro_axis_delay+gyro_scale_factor" in verdict["class"]  # type: ignore[index]
    assert verdict["noise"] == []  # type: ignore[index]


def test_a_right_scale_factor_leaves_no_gap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert diagnosed(tmp_path, 1.0, capsys)["verdict"]["kind"] == "none"  # type: ignore[index]
