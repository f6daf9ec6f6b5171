"""`diagnose --write-plan` where the segments do not determine all terms, on simulated and on real recordings: the plan that it writes
passes its check."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.interface import Design, EffectAbsentError, Remark
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.tasks.check import Checked
from planrunner.tasks.diagnose import Diagnosed, diagnose_recorded, recorded_run
from planrunner.tasks.named_effects import _comment, _reduced, plan_with_estimate
from tests.in_process import planrunner
from tests.tasks.test_simulate import PLAN

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


TURNS_ABOUT_Y = """
planrunner: 1
title: Turns about y
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z]}
defaults: {settle: 5 s}
segments:
  - for_each: {rate: ["±10 deg/s", "±30 deg/s", "±60 deg/s", "±90 deg/s", "±120 deg/s"]}
    orientation: {x: north, y: up, z: east}
    label: "Y{rate}"
    dwell: {turns: 3}
"""


def simulated(folder: Path, text: str, *effects: str) -> Diagnosed:
    """The diagnosis of a simulation, with the given effects as its only hypotheses."""
    plan = folder / "plan.yaml"
    plan.write_text(text, encoding="utf-8")
    words = [word for effect in effects for word in ("--with", effect)]
    assert main(["simulate", str(plan), *words, "--quiet", "--runs", str(folder / "runs")]) == 0
    names = tuple(effect.partition("=")[0] for effect in effects)
    made = diagnose_recorded(recorded_run(next((folder / "runs").iterdir())), DiagnosisOptions(effects=names))
    assert set(made.diagnosis.verdict.named) == set(names)
    return made


@pytest.mark.parametrize("effect", ["gyro_axis_delay=d_z:5 ms", "gyro_vibration_rectification=k_z:2e-3"])
def test_an_effect_that_only_rocking_shows_is_refused(tmp_path: Path, effect: str) -> None:
    """`error_model` cannot use rocking segments, and no other segment of the plan shows the effect."""
    made, name = simulated(tmp_path, PLAN, effect), effect.partition("=")[0]
    with pytest.raises(InputError, match=f"{name}: the segments that an estimate can use do not determine it"):
        plan_with_estimate(made)


def test_a_second_effect_that_only_rocking_shows_is_left_out(tmp_path: Path) -> None:
    made = simulated(tmp_path, PLAN, "gyro_axis_delay=d_z:5 ms", "table_tilt=about_east:30 arcsec")
    checked = plan_with_estimate(made)
    outputs = _outputs_of(checked)
    assert not any("gyro_axis_delay" in own for own in outputs.values())
    assert {"table_tilt.about_east", "accel_bias"} <= outputs["accel_y"]
    assert all(f"#   gyro_{axis}: gyro_axis_delay".encode() in checked.plan_bytes for axis in "xyz")


def test_turns_about_one_axis_give_the_terms_that_they_determine(tmp_path: Path) -> None:
    """Turns about y: x and z show their bias and their misalignment towards y; y shows its bias, its scale factor and its
    nonlinearity."""
    checked = plan_with_estimate(simulated(tmp_path, TURNS_ABOUT_Y, "gyro_scale_nonlinearity=k_y:1e-7"))
    assert _outputs_of(checked) == {
        "gyro_x": {"gyro_bias", "gyro_misalignment.towards_y"},
        "gyro_y": {"gyro_scale_nonlinearity", "gyro_bias", "gyro_scale_factor"},
        "gyro_z": {"gyro_bias", "gyro_misalignment.towards_y"},
    }
    assert (
        b"  # Left out, because the segments do not determine these terms:\n"
        b"  #   gyro_x: gyro_scale_nonlinearity.k, gyro_scale_factor.k, gyro_misalignment.towards_z\n"
        b"  #   gyro_y: gyro_misalignment.towards_x, gyro_misalignment.towards_z\n"
    ) in checked.plan_bytes


def _outputs_of(checked: Checked) -> dict[str, set[str]]:
    assert not any(finding.severity == "error" for finding in checked.findings)
    assert checked.plan is not None
    parameters = checked.plan.estimates["diagnosed"].parameters
    assert isinstance(parameters, ErrorModelParameters)
    return {name: set(own) for name, own in parameters.outputs.items()}


def test_superfluous_terms_are_removed_and_named() -> None:
    """x loses one of two columns of an effect, z loses all its terms, and y keeps all."""
    outputs = {"x": ["tilt", "bias"], "y": ["bias"], "z": ["tilt"]}
    left_out: dict[str, list[str]] = {}
    remarks = (
        _remark("x", out=(("tilt", "east"),), keeps=(("tilt", "north"), ("bias", "b"))),
        _remark("z", out=(("tilt", "east"), ("tilt", "north")), keeps=()),
        Remark("physics-condition", "ill-conditioned", "", "outputs.y"),
    )
    assert _reduced(Design((), remarks=remarks), outputs, left_out)
    assert outputs == {"x": ["tilt.north", "bias"], "y": ["bias"]}
    assert left_out == {"x": ["tilt.east"], "z": ["tilt.east", "tilt.north"]}
    assert _comment(left_out, 2).splitlines() == [
        "# Left out, because the segments do not determine these terms:",
        "  #   x: tilt.east",
        "  #   z: tilt.east, tilt.north",
        "  ",
    ]
    assert not _comment({}, 2)


def test_effects_that_do_not_act_are_removed_unless_nothing_would_remain() -> None:
    outputs, left_out = {"x": ["delay", "bias"], "y": ["delay"]}, dict[str, list[str]]()
    for output in ("x", "y"):
        assert _reduced(EffectAbsentError("delay", output, "does not act", ""), outputs, left_out)
    assert outputs == {"x": ["bias"]} and left_out == {"x": ["delay"], "y": ["delay"]}
    assert not _reduced(EffectAbsentError("bias", "x", "does not act", ""), outputs, left_out)
    assert not _reduced(_design_without("x", "bias"), outputs, left_out) and outputs == {"x": ["bias"]}
    assert not _reduced(None, outputs, left_out) and not _reduced(Design(()), outputs, left_out)


def _remark(output: str, out: tuple[tuple[str, str], ...], keeps: tuple[tuple[str, str], ...]) -> Remark:
    return Remark("physics-rank", "cannot identify", "", f"outputs.{output}", True, superfluous=out, keeps=keeps)


def _design_without(output: str, effect: str) -> Design:
    return Design((), remarks=(_remark(output, ((effect, "b"),), ()),))


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
