"""The shipped plans on the virtual bench, whose true coefficients stand in its file: the intervals hold them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.in_process import planrunner

ROOT = Path(__file__).resolve().parents[2]

# As the benches declare them: angle [deg], scale factor [(pulse/s)/(deg/s)], and K relative to that at 20 degC at −40 and 60 degC.
ANGLES = {"x": 54.7427, "y": 54.7301, "z": 54.7389}
SCALE = {"x": 40_000 * (1 + 210e-6), "y": 40_000 * (1 - 140e-6), "z": 40_000 * (1 + 65e-6)}
CURVES = {"x": (11e-6, 0.08e-6), "y": (-7e-6, 0.05e-6), "z": (9e-6, -0.06e-6)}


def results(plan: str, folder: Path) -> dict[str, dict[str, dict]]:
    """Estimate → coefficient → what results.json says of it."""
    keys = [f"--set={name}=T-1" for name in ("device_serial", "operator", "fixture")]
    done = planrunner("run", str(ROOT / "plans" / plan), *keys, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = folder.glob("runs/*/analyses/1/results.json")
    data = json.loads(found.read_text(encoding="utf-8"))
    return {one["name"]: {item["name"]: item for item in one["coefficients"]} for one in data["estimates"]}


@pytest.mark.slow
def test_calibrated_fixture_gives_true_angles_and_scale_factors(tmp_path: Path) -> None:
    found = results("fixture_angles.yaml", tmp_path)
    for axis, angle in ANGLES.items():
        item = found["fixture"][f"angle_{axis}"]
        assert abs(item["value"] - angle) < 3 * item["standard_uncertainty"]
        item = found["scale"][f"K_{axis}"]
        assert item["standard_uncertainty"] / item["value"] < 20e-6
        # The slope of the line is not K at small rates: what is not linear in the gyros is a few ppm of it.
        assert abs(item["value"] - SCALE[axis]) < 3 * item["standard_uncertainty"] + 10e-6 * SCALE[axis]


@pytest.mark.slow
def test_one_tilted_mounting_gives_true_scale_factors_and_temperature_coefficients(tmp_path: Path) -> None:
    import numpy as np

    found = results("scale_factor_tilted.yaml", tmp_path)["scale"]
    off = np.array([-60.0, 0.0, 40.0])
    for axis, (first, second) in CURVES.items():
        item = found[f"K_{axis}"]
        assert abs(item["value"] - SCALE[axis]) < 3 * item["standard_uncertainty"]
        slope = np.polyfit(off, first * off + second * off**2, 1)[0]
        item = found[f"temperature_coefficient_{axis}"]
        assert abs(item["value"] - slope * 1e6) < 3 * item["standard_uncertainty"]
        assert item["standard_uncertainty"] < 0.1
