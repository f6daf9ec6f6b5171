"""The specification of a sensor: wrong units are refused with their place, and a diagnosis warns of values outside it."""

from __future__ import annotations

from pathlib import Path

import pytest

from planrunner.base.shipped import shipped
from planrunner.bench.model import parse_bench
from planrunner.cli import main
from planrunner.gap.answer.diagnosis import DiagnosisOptions
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
    ],
)
def test_what_is_wrong_is_said_with_its_place(specification: str, code: str) -> None:
    _, log = parse_bench(source.parse(_bench(specification), "bench.yaml"))
    (finding,) = log.errors
    assert finding.code == code
    assert finding.mark.line == len(NOMINAL.splitlines()) + 1 and finding.mark.column > len("specification: ")


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
