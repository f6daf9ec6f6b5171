"""The shipped plans of two methods, with short dwells, over the wire: their coefficients are the virtual bench's true ones within what they
themselves state as their uncertainty."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_simulate_bench import ROOT, patient, started

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are not for Windows"),
]
DRIFT = {
    "SF_X": 0.2012,
    "SF_Y": 0.1987,
    "epsilon": 8.0,
    "xi": -5.0,
    "D_X_F": 1.83,
    "D_X_X": 3.21,
    "D_X_Y": -2.14,
    "D_X_Z": 0.352,
    "D_Y_F": -1.27,
    "D_Y_X": 2.36,
    "D_Y_Y": 3.05,
    "D_Y_Z": -0.284,
}
"""As declared in plans/benches/virtual.yaml, in the units there."""
SCALE = {"x": 40_000 * (1 + 210e-6), "y": 40_000 * (1 - 140e-6), "z": 40_000 * (1 + 65e-6)}
CURVES = {"x": (11e-6, 0.08e-6), "y": (-7e-6, 0.05e-6), "z": (9e-6, -0.06e-6)}
"""K at 20 degC [(pulse/s)/(deg/s)] and its change with temperature [1/K, 1/K²], as declared in plans/benches/virtual_gyro_triad.yaml."""


def shortened(name: str, folder: Path, *changes: tuple[str, str]) -> Path:
    text = (ROOT / "plans" / name).read_text(encoding="utf-8")
    for pattern, instead in changes:
        text, count = re.subn(pattern, instead, text)
        assert count, pattern
    plan = folder / name
    plan.write_text(text, encoding="utf-8")
    return plan


def quick(name: str) -> str:
    """A shipped bench whose chamber and sensor come to their temperature soon."""
    text = (ROOT / "plans" / "benches" / f"{name}.yaml").read_text(encoding="utf-8")
    for key, value in (("ramp", "15 K/min"), ("lag", "30 s"), ("thermal_lag", "1 min")):
        text = re.sub(rf"\b{key}: [\d.]+ (K/)?min", f"{key}: {value}", text)
    return text


def estimated(plan: Path, bench: str, truth: str, speed: str, folder: Path) -> dict[str, Any]:
    """The estimates of a whole run, `simulate-bench` to results.json, on the shipped bench."""
    (folder / "truth.yaml").write_text(quick(truth), encoding="utf-8")
    asked = patient(quick(bench)).replace(f"{{bench: {truth},", "{bench: truth.yaml,")
    assert "truth.yaml" in asked
    (folder / "patient.yaml").write_text(asked, encoding="utf-8")
    process, _ = started(folder, "--speed", speed, bench=str(folder / "patient.yaml"))
    command = [sys.executable, "-m", "planrunner", "run", str(plan), "--bench", str(folder / "bench.yaml"), "--quiet"]
    told = [f"{name}=1" for name in ("device_serial", "operator", "fixture")]
    try:
        done = subprocess.run(
            [*command, "--runs", str(folder / "runs"), *(word for item in told for word in ("--set", item))],
            capture_output=True,
            text=True,
            timeout=900,
            check=False,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )
    finally:
        process.terminate()
        process.communicate(timeout=60)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    results = json.loads(next((folder / "runs").glob("*/analyses/1/results.json")).read_text(encoding="utf-8"))
    return {one["name"]: {item["name"]: item for item in one["coefficients"]} for one in results["estimates"]}


def test_a_flexure_gyro_in_eight_positions(tmp_path: Path) -> None:
    """On the noise within the positions, of which more is seen than of scatter between them: 4 u for each of 24 coefficients,
    and no more than five of them beyond 1.96 u, of which 24 independent ones have more in 1 of 1000 runs."""
    plan = shortened(
        "flexure_gyro_eight_position.yaml",
        tmp_path,
        ("soak: 10 min", "soak: 1 min"),
        ("settle: 30 s", "settle: 15 s"),
        ("dwell: 2 min", "dwell: 40 s"),
        ("uncertainty: residual", "uncertainty: within_segment"),
    )
    estimates = estimated(plan, "lab_simulated", "virtual", "10", tmp_path)
    beyond = 0
    for name in ("drift", "traditional"):
        for coefficient, truth in DRIFT.items():
            found = estimates[name][coefficient]
            value, u = found["value"], found["standard_uncertainty"]
            assert abs(value - truth) < 4 * u, f"{name}.{coefficient}: {value} ± {u}, in truth {truth}"
            beyond += abs(value - truth) > 1.96 * u
    assert beyond <= 5


def test_scale_factors_of_a_tilted_triad(tmp_path: Path) -> None:
    plan = shortened(
        "scale_factor_tilted.yaml",
        tmp_path,
        ("soak: 60 min", "soak: 6 min"),
        ("repeat: 6", "repeat: 2"),
        ("±300, ±150, ±60, ±20, ±10, ±1 deg/s", "±300, ±60, ±10 deg/s"),
        ("dwell: 10 min", "dwell: 1 min"),
    )
    found = estimated(plan, "lab_simulated_triad", "virtual_gyro_triad", "30", tmp_path)["scale"]
    off = np.array([-60.0, 0.0, 40.0])
    for axis, (first, second) in CURVES.items():
        for name, truth in (
            (f"K_{axis}", SCALE[axis]),
            (f"temperature_coefficient_{axis}", 1e6 * np.polyfit(off, first * off + second * off**2, 1)[0]),
        ):
            value, u = found[name]["value"], found[name]["standard_uncertainty"]
            assert abs(value - truth) < 3 * u, f"{name}: {value} ± {u}, in truth {truth}"
