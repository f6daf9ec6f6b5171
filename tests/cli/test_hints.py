"""Hints say what helps: each situation is made, and what the hint proposes is tried."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from planrunner.base.findings import Finding, InputError, nearest
from planrunner.base.shipped import shipped
from planrunner.bench.model import benches_for, models, read_bench
from planrunner.cli import main
from planrunner.design.study import Asked
from planrunner.estimators.interface import EstimationError
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.interfaces import InstrumentError
from planrunner.instruments.recording_file import RecordedFile, open_recording
from planrunner.plan.model import parse_plan
from planrunner.plan.run_information import gather
from planrunner.plan.units import suggestion
from planrunner.tasks.check import check_plan
from planrunner.tasks.design_rates import design_rates, has_rates_alone

PLANS = Path(__file__).resolve().parents[2] / "plans"
EIGHT = PLANS / "flexure_gyro_eight_position.yaml"


def findings(tmp_path: Path, plan: Path, *changes: tuple[str, str], bench: str | None = None) -> list[Finding]:
    text = plan.read_text(encoding="utf-8")
    for written, instead in changes:
        assert written in text
        text = text.replace(written, instead)
    path = tmp_path / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return list(check_plan(path, bench=bench).findings)


def test_the_wrong_bench_is_named_with_those_that_fit() -> None:
    (finding,) = check_plan(EIGHT, bench="virtual_imu").findings
    named = benches_for("flexure-gyro")
    assert named and all(name in finding.hint for name in named)
    for name in named:
        sensor = models(read_bench(name)[0]).sensor
        assert sensor is not None and sensor.kind == "flexure-gyro"


def test_a_bench_file_that_is_missing_is_no_plan() -> None:
    (finding,) = check_plan(EIGHT, bench="nowhere.yaml").findings
    assert finding.code == "file-missing"
    assert "bench list" in finding.hint


@pytest.mark.parametrize("word", ["vibration", "duration"])
def test_another_word_is_no_slip_of_a_key(word: str) -> None:
    assert nearest(word, ["orientation", "motion", "rate", "dwell"]) is None


@pytest.mark.parametrize(
    ("word", "meant"), [("dwel", "dwell"), ("mim", "min"), ("lable", "label"), ("orientatoin", "orientation")]
)
def test_a_slip_is_recognised(word: str, meant: str) -> None:
    assert nearest(word, ["orientation", "label", "dwell", "min", "settle"]) == meant


def test_a_unit_is_suggested_of_the_dimension_that_is_needed(tmp_path: Path) -> None:
    (finding,) = findings(tmp_path, EIGHT, ("dwell: 2 min", "dwell: 2 mim"))
    assert "'min'" in finding.hint
    (finding,) = findings(tmp_path, EIGHT, ("25 degC", "25 degX"))
    assert "'degC'" in finding.hint
    assert "'mm'" in suggestion("mim"), "where any unit may stand, the nearest of all"


def test_an_estimate_without_channels_is_asked_to_name_them(tmp_path: Path) -> None:
    lines = [
        ("    gyros: [gyro_x, gyro_y, gyro_z]\n", ""),
        ("    accelerometers: [accel_x, accel_y, accel_z]\n", ""),
    ]
    for finding in findings(tmp_path, PLANS / "imu_multi_position.yaml", *lines):
        assert finding.code == "physics-estimate"
        assert "segments" not in finding.hint and "gyros: [" in finding.hint


def test_rates_missing_about_an_axis_are_said_once_and_not_as_a_spread_of_states(tmp_path: Path) -> None:
    found = findings(
        tmp_path, PLANS / "imu_multi_position.yaml", ("        X: {x: up, y: east, z: north}\n      ", "      ")
    )
    assert {finding.code for finding in found} == {"physics-earth-rate-alone", "physics-limit"}
    assert all("rate" in finding.hint for finding in found if finding.code == "physics-earth-rate-alone")


@pytest.mark.parametrize("given", ["device_serial", "device_serial=", "device_serial= "])
def test_run_information_without_its_value(given: str) -> None:
    plan, _ = parse_plan(EIGHT.read_text(encoding="utf-8"), str(EIGHT))
    assert plan is not None
    with pytest.raises(InputError) as caught:
        gather(plan, [given, "operator=A. Example"], None)
    (finding,) = caught.value.findings
    assert "--set device_serial=" in finding.hint


def test_run_information_under_a_misspelt_name() -> None:
    plan, _ = parse_plan(EIGHT.read_text(encoding="utf-8"), str(EIGHT))
    assert plan is not None
    with pytest.raises(InputError) as caught:
        gather(plan, ["device_seriel=7"], None)
    assert {finding.code: finding.message.count("device_seri") for finding in caught.value.findings} == {
        "run-info-unknown": 1,
        "run-info-missing": 0,
    }


@pytest.mark.parametrize("command", ["report", "estimate", "run", "check", "export"])
def test_a_command_without_arguments_says_where_they_are_explained(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command]) == 2
    assert f"`planrunner {command} --help`" in capsys.readouterr().err


@pytest.mark.parametrize("channel", ["accel_q", "gyro_x"])
def test_still_spans_need_accelerometers(channel: str, tmp_path: Path) -> None:
    spans = f"{{detect: still, channels: [{channel}], window: 1 s, threshold: 0.1 m/s^2, at_least: 2 s}}"
    asked = f"own_frame:\n    segments: {spans}\n    reference: gravity_magnitude\n    estimator: accelerometer_multi_position\n"
    plan = PLANS / "imu_multi_position.yaml"
    rest = plan.read_text(encoding="utf-8").partition("  own_frame:\n")[2].partition("\nlimits:")[0]
    found = findings(tmp_path, plan, (f"own_frame:\n{rest}", asked))
    (finding,) = [one for one in found if one.code == "physics-estimate"]
    assert finding.hint == "name the accelerometers of the sensor under `channels` of `segments`"
    assert finding.mark.text is not None
    assert finding.mark.text.splitlines()[finding.mark.line - 1].endswith(spans)


@pytest.mark.parametrize("when", ["9999-12-31T23:59", "0001-01-01T00:00", "2026-02-30T10:00", "tomorrow"])
def test_a_night_begins_in_a_year_that_every_time_zone_has(when: str, capsys: pytest.CaptureFixture[str]) -> None:
    suite = next((shipped("plans") / "suites").glob("*.yaml"))
    assert main(["check", str(suite), "--at", when]) == 2
    assert f"of a year from 1971 to 9000, not {when!r}" in capsys.readouterr().err


def test_a_file_without_a_header(tmp_path: Path) -> None:
    path = tmp_path / "samples.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([0.01 * row, 1.5, -2e-3] for row in range(5))
    with pytest.raises(InstrumentError, match="no header"):
        open_recording([RecordedFile(path, path.name)], TimeStamps("time"), {"gyro_x": "gyro_x"})
    path.write_text("t,gyro_x\n0,1\n", encoding="utf-8")
    with pytest.raises(InstrumentError) as caught:
        open_recording([RecordedFile(path, path.name)], TimeStamps("time"), {"gyro_x": "gyro_x"})
    assert "no header" not in str(caught.value)


RATES = """\
planrunner: 1
title: Rates up and down
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_z]}
defaults: {temperature: 25 degC, settle: 5 s, dwell: 30 s, orientation: {x: east, y: north, z: up}}
segments:
  - {label: zero-start}
  - {label: "up{rate}", for_each: {rate: "1, 5, 10 deg/s"}}
  - {label: "down{rate}", for_each: {rate: "-1, -5, -10 deg/s"}}
estimates:
  sf: {estimator: scale_factor, segments: "*", outputs: gyro_z}
"""


def test_rates_of_several_sweeps_are_not_designed_as_positions(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(RATES, encoding="utf-8")
    assert has_rates_alone(check_plan(path))
    with pytest.raises(EstimationError, match="lines 8, 9"):
        design_rates(check_plan(path), Asked())
    one = [line for line in RATES.splitlines() if "down{" not in line]
    path.write_text("\n".join(one).replace('"1, 5, 10 deg/s"', '"±1, ±5, ±10 deg/s"'), encoding="utf-8")
    assert has_rates_alone(check_plan(path))
    assert design_rates(check_plan(path), Asked()).estimate == "sf", "what the message proposes works"
