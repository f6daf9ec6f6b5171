"""The specification of a sensor: wrong units are refused with their place, and a diagnosis warns of values outside it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from planrunner.base.findings import Finding
from planrunner.base.shipped import shipped
from planrunner.bench.model import parse_bench
from planrunner.bench.specification import GRADES, SENSES, Sense, grade_of
from planrunner.cli import main
from planrunner.gap.answer import parameters
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.gap.answer.parameters import ParameterEstimate
from planrunner.plan import source
from planrunner.tasks.diagnose import diagnose_recorded, recorded_run
from tests.tasks.test_simulate import PLAN

NOMINAL = (shipped("plans") / "benches" / "virtual_imu_nominal.yaml").read_text(encoding="utf-8")


def _bench(specification: str) -> str:
    return f"{NOMINAL}specification: {specification}\n"


@pytest.mark.parametrize(
    ("specification", "code"),
    [
        ("{accel_bias: ±50 deg}", "meaning-dimension"),
        ("{gyro_scale_factor: ±1 deg/s}", "meaning-dimension"),
        ("{accel_bias: 50 mg}", "form-text"),
        ("{accel_bias: ±0 mg}", "meaning-range"),
        ("{accel_byas: ±50 mg}", "form-unknown-key"),
        ("{grade: marine}", "form-choice"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(specification: str, code: str) -> None:
    _, log = parse_bench(source.parse(_bench(specification), "bench.yaml"))
    (finding,) = log.errors
    assert finding.code == code
    assert finding.mark.line == len(NOMINAL.splitlines()) + 1 and finding.mark.column > len("specification: ")


def _warned(folder: Path, bench: str) -> list[Finding]:
    """Warnings of a diagnosis on limits, of a run on a bench with biases of 5, −3 and 8 mg of the accelerometers."""
    (folder / "bench.yaml").write_text(bench, encoding="utf-8")
    (folder / "six.yaml").write_text(PLAN.replace("virtual_imu_nominal", "bench.yaml"), encoding="utf-8")
    assert main(["run", str(folder / "six.yaml"), "--quiet", "--flushed", "--runs", str(folder / "runs")]) == 0
    made = diagnose_recorded(recorded_run(next((folder / "runs").iterdir())), DiagnosisOptions(effects=("table_tilt",)))
    return [finding for finding in made.findings if finding.code in ("gap-specification", "gap-usual-limits")]


def test_a_board_with_a_bias_of_half_a_g_is_not_passed_in_silence(tmp_path: Path) -> None:
    """Nothing is declared: the noise of 50 µg/√Hz is usual for an industrial unit, whose bias is at most 30 mg."""
    (said,) = _warned(tmp_path, NOMINAL.replace("bias: 5 mg", "bias: 471 mg"))
    assert said.code == "gap-usual-limits" and said.message.startswith("accel_bias bias_x is 471")
    assert "16 times the usual limit of ±30 mg for a sensor with such noise (industrial grade)" in said.message


def test_a_value_that_the_plan_does_not_determine_is_not_compared_with_what_is_usual(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rates about one axis only: the misalignments towards the others follow from the Earth rate, and are 70 rad. The second one, beyond
    the limit of a degree of an industrial unit, is determined."""
    found = [
        ParameterEstimate("gyro_misalignment", "towards_z_x", -1.48e7, "arcsec", 0.28e7),
        ParameterEstimate("gyro_misalignment", "towards_y_z", -4926.0, "arcsec", 8.0),
    ]
    monkeypatch.setattr(parameters, "nominal_values", lambda *_: found)
    assert [one.message.split(" is ")[0] for one in _warned(tmp_path, NOMINAL)] == ["gyro_misalignment towards_y_z"]


def test_usual_values_give_no_warning(tmp_path: Path) -> None:
    assert _warned(tmp_path, NOMINAL) == []


def test_a_declared_grade_is_compared_with_and_a_declared_limit_goes_before_it(tmp_path: Path) -> None:
    found = _warned(tmp_path, _bench("{grade: navigation, accel_bias: ±7 mg}"))
    biases = [one.message for one in found if one.message.startswith("accel_bias")]
    assert len(biases) == 1 and biases[0].startswith("accel_bias bias_z") and "specification of ±7 mg" in biases[0]
    assert [one for one in found if "gyro_bias bias_x" in one.message and "its specification of" in one.message]
    assert {one.code for one in found} == {"gap-specification"}


def test_grades_have_their_order() -> None:
    """A looser grade allows larger errors and more noise."""
    for better, looser in pairwise(GRADES):
        assert all(better.quietest[sense] < looser.quietest[sense] for sense in Sense)
        assert all(better.limits()[name].value <= looser.limits()[name].value for name in SENSES)
    assert grade_of(Sense.RATE, 0.3).name == "consumer" and grade_of(Sense.RATE, 0.001).name == "navigation"
    assert grade_of(Sense.FORCE, 400.0).name == "consumer" and grade_of(Sense.FORCE, 20.0).name == "industrial"


def test_values_outside_are_warned_of_and_the_others_are_not(tmp_path: Path) -> None:
    """The bench declares biases of 5, −3 and 8 mg, and a scale factor of gyro x that is 0.21 % too large."""
    bench = _bench("{accel_bias: ±4 mg, gyro_scale_factor: ±0.3 %, accel_scale_factor: ±0.18 %, gyro_bias: ±1 deg/s}")
    (tmp_path / "bench.yaml").write_text(bench, encoding="utf-8")
    (tmp_path / "six.yaml").write_text(PLAN.replace("virtual_imu_nominal", "bench.yaml"), encoding="utf-8")
    assert main(["run", str(tmp_path / "six.yaml"), "--quiet", "--flushed", "--runs", str(tmp_path / "runs")]) == 0
    run = next((tmp_path / "runs").iterdir())
    made = diagnose_recorded(recorded_run(run), DiagnosisOptions(effects=("table_tilt",)))
    said = [finding for finding in made.findings if finding.code == "gap-specification"]
    assert [finding.message.split(" is ")[0] for finding in said] == [
        "accel_bias bias_x",
        "accel_bias bias_z",
        "accel_scale_factor k_z",
    ]
    assert "2 times its specification of ±4 mg" in said[1].message
    value = float(said[1].message.split(" is ")[1].split()[0])
    assert value == pytest.approx(8.0, abs=0.1)
    assert said[0].mark.line == len(NOMINAL.splitlines()) + 1
