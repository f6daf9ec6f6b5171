"""`diagnose --write-plan` on real recordings whose segments do not determine all terms: the plan that it writes passes its check."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.tasks.check import Checked
from planrunner.tasks.diagnose import diagnose_recorded, recorded_run
from planrunner.tasks.named_effects import plan_with_estimate
from tests.in_process import planrunner

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("PLANRUNNER_DATA", ROOT.parent / "shared" / "data"))


def real(*parts: str) -> Path:
    path = DATA.joinpath(*parts)
    if not path.is_file():
        pytest.skip(f"the real recording {'/'.join(parts)} is not beneath {DATA} (set PLANRUNNER_DATA)")
    return path


def written(name: str, data: Path, folder: Path) -> tuple[Checked, ErrorModelParameters]:
    planrunner("run", f"plans/{name}.yaml", "--data", data, "--runs", folder, "--quiet", cwd=ROOT)
    checked = plan_with_estimate(diagnose_recorded(recorded_run(next(folder.iterdir()))))
    assert checked.plan is not None
    parameters = checked.plan.estimates["diagnosed"].parameters
    assert isinstance(parameters, ErrorModelParameters)
    assert not any(finding.severity == "error" for finding in checked.findings)
    return checked, parameters


@pytest.mark.slow
def test_terms_that_one_direction_of_turn_does_not_show_are_left_out(tmp_path: Path) -> None:
    """Turns about y only: x and z show their bias and their misalignment towards y, and y shows its bias and scale factor."""
    data = real("rimu_jig", "rate_staircase.parquet").parents[1]
    checked, parameters = written("rimu_rate_staircase", data, tmp_path)
    shown = {name: set(own) for name, own in parameters.outputs.items()}
    assert shown == {
        "lsm_gyro_x": {"gyro_bias", "gyro_misalignment.towards_y"},
        "lsm_gyro_y": {"gyro_bias", "gyro_scale_factor"},
        "lsm_gyro_z": {"gyro_bias", "gyro_misalignment.towards_y"},
    }
    assert b"#   lsm_gyro_y: gyro_misalignment.towards_x, gyro_misalignment.towards_z\n" in checked.plan_bytes


@pytest.mark.slow
def test_a_temperature_that_only_the_recording_shows_is_named_by_its_channel(tmp_path: Path) -> None:
    """At rest, in a chamber that cools down: the plan states no temperature. The written plan gives the parabola that numpy fits to
    the means of the segments."""
    data = real("psim_thermal_vacuum", "TVCtest3_7_20.csv").parents[1]
    checked, parameters = written("psim_gyro_thermal_vacuum", data, tmp_path / "runs")
    assert parameters.temperature_channel == "temperature"
    assert all(set(own) == {"gyro_bias", "gyro_bias_temperature"} for own in parameters.outputs.values())
    plan = tmp_path / "written.yaml"
    plan.write_bytes(checked.plan_bytes)
    bench = str(ROOT / "plans" / "benches" / "psim_gyro_thermal_vacuum.yaml")
    planrunner("run", plan, "--bench", bench, "--data", data, "--runs", tmp_path / "again", "--quiet", cwd=ROOT)
    results = json.loads(next((tmp_path / "again").glob("*/analyses/1/results.json")).read_text())
    (made,) = [one for one in results["estimates"] if one["name"] == "diagnosed"]
    found = {one["name"]: one for one in made["coefficients"]}
    segments = recorded_run(next((tmp_path / "again").iterdir())).segments
    kelvin = np.array([one.statistics.mean[one.statistics.of("temperature")] for one in segments])
    celsius = kelvin - 273.15 if kelvin.min() > 200 else kelvin
    for axis in "xyz":
        means = np.array([one.statistics.mean[one.statistics.of(f"gyro_{axis}")] for one in segments])
        slope = np.degrees(np.polyfit(celsius - 25, means, 2)[1])
        one = found[f"gyro_bias_temperature_c1_{axis}"]
        assert one["value"] == pytest.approx(slope, abs=one["standard_uncertainty"])
