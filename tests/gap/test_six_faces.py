"""A sensor on its six faces, in orientations that the plan does not know: only |f| counts, and it shows no angle between two axes."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.csv
import pytest

from planrunner.tasks.diagnose import diagnose_recorded, recorded_file

G = 9.80665
BENCH = """
planrunner_bench: 1
name: faces
clock: virtual
site: {latitude: 49.6 deg, gravity: 9.80665 m/s^2}
instruments:
  imu:
    driver: recording
    kind: imu
    file: example_ferraris_session.csv
    time: sample_count
    sample_rate: 102.4 Hz
    channels:
      accel_x: {column: acc_x, unit: m/s^2, noise: 0.0141 m/s^2}
      accel_y: {column: acc_y, unit: m/s^2, noise: 0.0118 m/s^2}
      accel_z: {column: acc_z, unit: m/s^2, noise: 0.0168 m/s^2}
"""
PLAN = """
planrunner: 1
title: Six faces
bench: ./bench.yaml
sensor: {kind: imu, outputs: [accel_x, accel_y, accel_z]}
segments:
  - {label: all, orientation: unknown, dwell: recorded}
diagnosis:
  nominal: [accel_bias]
  segments: {detect: still, window: 0.5 s, threshold: 0.0674 m/s^2, at_least: 2 s}
report: [summary.md]
"""


def test_axes_that_would_be_nearly_parallel_are_no_explanation(data_root: Path, tmp_path: Path) -> None:
    """The scale factor of z is half the difference of its two faces. A
    misalignment of 1.46 rad would also fit, which is impossible: it is the cosine of an angle."""
    recording = data_root / "ferraris" / "example_ferraris_session.csv"
    (tmp_path / "bench.yaml").write_text(BENCH.lstrip(), encoding="utf-8")
    (tmp_path / "plan.yaml").write_text(PLAN.lstrip(), encoding="utf-8")
    found = diagnose_recorded(recorded_file(tmp_path / "plan.yaml", None, recording)).diagnosis
    assert "accel_scale_factor" in found.verdict.effects and "accel_misalignment" not in found.verdict.effects
    sections = json.loads((recording.parent / "example_ferraris_session_list.json").read_text(encoding="utf-8"))
    column = pyarrow.csv.read_csv(recording)["acc_z"].to_numpy()
    up, down = (float(column[sections[name]["start"] : sections[name]["end"]].mean()) for name in ("z_p", "z_a"))
    (k_z,) = (p.value for p in found.parameters if p.name == "k_z")
    assert 1 + 1e-6 * k_z == pytest.approx(abs(up - down) / (2 * G), abs=0.002)
