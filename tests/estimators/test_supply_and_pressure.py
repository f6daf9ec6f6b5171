"""Effects of the supply voltage and the ambient pressure: planned, simulated, estimated and diagnosed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.gap.answer.diagnosis import DiagnosisOptions, hypotheses
from planrunner.tasks.check import Checked, Document, check_plan
from planrunner.tasks.diagnose import diagnose_recorded, recorded_run
from planrunner.tasks.named_effects import plan_with_estimate
from tests.in_process import planrunner
from tests.worlds.campaigns import CAMPAIGNS
from tests.worlds.coverage import estimated, known, recorded
from tests.worlds.faults import WORLDS

BENCH = """
planrunner_bench: 1
name: supplied
clock: virtual
site: {latitude: 48 deg, gravity: 9.81 m/s^2, azimuth: 0 deg}
safe_order: [table, unit]
instruments:
  table:
    driver: virtual_table
    axes: [{name: a, direction: up, max_rate: 400 deg/s, max_acceleration: 100 deg/s^2}]
  unit:
    driver: virtual_imu
    sample_rate: 50 Hz
    nominal_supply: 12 V
    voltmeter_noise: 2 mV
    barometer_noise: 10 Pa
    gyros:
      full_scale: 500 deg/s
      angle_random_walk: 0.05 deg/sqrt(h)
      bias_supply: 30 deg/h/V
      scale_factor_supply: 200 ppm/V
      bias_pressure: -0.2 deg/h/hPa
      scale_factor_pressure: -3 ppm/hPa
      axes: {z: {bias: 20 deg/h}}
    accelerometers:
      velocity_random_walk: 0.02 m/s/sqrt(h)
      bias_supply: 150 ug/V
      bias_pressure: 2 ug/hPa
      axes: {z: {bias: 400 ug}}
"""
EXACT = {
    "gyro_bias_z": 20 / 3600,
    "gyro_bias_supply_z": 30 / 3600,
    "gyro_scale_supply_z": 200.0,
    "gyro_bias_pressure_z": -0.2 / 3600,
    "gyro_scale_pressure_z": -3.0,
    "accel_bias_z": 0.4,
    "accel_bias_supply_z": 150.0,
    "accel_bias_pressure_z": 2.0,
}
EFFECTS = ("bias_supply", "scale_supply", "bias_pressure", "scale_pressure")


def text(states: str, keys: str = "", effects: tuple[str, ...] = EFFECTS) -> str:
    gyro = ", ".join(["gyro_bias", "gyro_scale_factor", *(f"gyro_{one}" for one in effects)])
    return f"""
planrunner: 1
title: Supply and pressure
sensor: {{kind: imu, outputs: [gyro_z, accel_z]}}
defaults: {{orientation: {{x: east, y: north, z: up}}, settle: 5 s, dwell: 20 s}}
segments:
  - for_each: {{{states}}}
    steps:
      - {{label: still}}
      - {{for_each: {{rate: "±60 deg/s"}}}}
estimates:
  model:
    estimator: error_model
    uncertainty: within_segment
{keys}
    outputs:
      gyro_z: [{gyro}]
      accel_z: [accel_bias, {", ".join(f"accel_{one}" for one in effects if "bias" in one)}]
"""


STATES = 'supply_voltage: "11, 13 V", ambient_pressure: "500, 1000 hPa"'
CHANNELS = "    supply_channel: supply_voltage\n    pressure_channel: ambient_pressure"


def checked(plan: str, bench: str = BENCH) -> Checked:
    return check_plan(Document(plan.encode(), "plan.yaml"), Document(bench.encode(), "bench.yaml"))


def run(tmp_path: Path, plan: str, *more: str) -> dict[str, dict[str, float]]:
    (tmp_path / "plan.yaml").write_text(plan)
    (tmp_path / "bench.yaml").write_text(BENCH)
    done = planrunner("simulate", "plan.yaml", "--bench", "bench.yaml", "--quiet", *more, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    (found,) = tmp_path.glob("runs/*/analyses/1/results.json")
    (one,) = json.loads(found.read_text(encoding="utf-8"))["estimates"]
    return {item["name"]: item for item in one["coefficients"]}


@pytest.mark.parametrize("keys", [CHANNELS, ""], ids=["recorded", "stated"])
def test_what_a_bench_declares_is_found(tmp_path: Path, keys: str) -> None:
    """The virtual sensor has a formula of its own. The bias of the accelerometer includes nothing else at rest."""
    found = run(tmp_path, text(STATES, keys))
    for name, true in EXACT.items():
        assert abs(found[name]["value"] - true) < 4 * found[name]["standard_uncertainty"], name
        assert found[name]["standard_uncertainty"] < 0.2 * abs(true), name


def test_what_is_added_to_a_simulation_is_found_above_what_the_bench_declares(tmp_path: Path) -> None:
    found = run(tmp_path, text(STATES), "--with", "gyro_bias_pressure=c_z:1e-3 deg/s/hPa")
    item = found["gyro_bias_pressure_z"]
    assert abs(item["value"] - (1e-3 + EXACT["gyro_bias_pressure_z"])) < 4 * item["standard_uncertainty"]


def test_amplitudes_that_the_planned_states_do_not_show_are_refused_before_the_run() -> None:
    for varied, hidden in (
        ('supply_voltage: "11, 13 V"', "ambient pressures"),
        ('ambient_pressure: "500, 1000 hPa"', "supply voltages"),
    ):
        errors = [one for one in checked(text(varied)).findings if one.severity == "error"]
        assert {one.code for one in errors} == {"physics-rank"}
        assert all(f"two {hidden}" in one.hint for one in errors)
    assert not [one for one in checked(text(STATES)).findings if one.severity == "error"]


STATED = {
    "supply_zero_uncertainty": (6, "20 mV", 0.02, 0.0),
    "supply_reading_uncertainty": (6, "0.2 %", 0.0, 2e-3),
    "pressure_zero_uncertainty": (7, "3 hPa", 3.0, 0.0),
    "pressure_reading_uncertainty": (7, "0.5 %", 0.0, 5e-3),
}
"""Key → channel, what the plan states, and the same as zero error, in the channel's unit, and relative error."""


@pytest.mark.parametrize("key", STATED)
def test_an_error_of_a_meter_moves_coefficients_as_the_budget_states(key: str) -> None:
    """The readings are changed by one standard uncertainty, and the estimate is made again."""
    campaign, (channel, words, zero, share) = CAMPAIGNS["error_model, supply and pressure"], STATED[key]
    told = replace(
        campaign, plan=campaign.plan.replace("    outputs:\n", f"    {key}: {words}\n    drift: none\n    outputs:\n")
    )
    sound, (_, made) = (
        known(told, WORLDS["white noise"]),
        recorded(told, WORLDS["white noise"], np.random.default_rng(12)),
    )
    values = made.values.copy()
    values[:, channel] += zero + share * values[:, channel]
    found, other = estimated(told, sound, made), estimated(told, sound, replace(made, values=values))
    assert not isinstance(found, str) and not isinstance(other, str)
    name = key.removesuffix("_uncertainty").replace("_", " ")
    seen = set()
    for item in found.coefficients:
        (budget,) = [one for one in found.budgets if one.coefficient == item.name]
        for line in budget.lines:
            if line.quantity == name:
                assert line.contribution == pytest.approx(abs(other[item.name].value - item.value), rel=0.02, abs=1e-9)
                assert line.added and line.source == f"plan estimates.model.{key}"
                seen.add(item.name)
    assert {"gyro_bias_x", "accel_bias_z"} <= seen


@pytest.mark.parametrize("channel", ["supply_voltage", "ambient_pressure"])
def test_a_meter_with_the_wrong_sign_is_reported(channel: str) -> None:
    """Without it, the amplitudes that follow the channel would have the wrong sign, and the biases would be far from the truth."""
    told = CAMPAIGNS["error_model, supply and pressure"]
    sound, (_, made) = (
        known(told, WORLDS["white noise"]),
        recorded(told, WORLDS["white noise"], np.random.default_rng(13)),
    )
    values = made.values * np.where([name == channel for name in told.channels], -1, 1)
    for one, expected in ((made, 0), (replace(made, values=values), 1)):
        found = estimated(told, sound, one)
        assert not isinstance(found, str)
        warned = [text for text in found.warnings if f"The readings of {channel} have the opposite sign" in text]
        assert len(warned) == expected, found.warnings


def test_what_only_the_recording_shows_is_not_predicted() -> None:
    """The weather changes the pressure, and no plan knows it."""
    plan = text('supply_voltage: "11, 13 V"', "    pressure_channel: ambient_pressure")
    found = checked(plan)
    assert not [one for one in found.findings if one.severity == "error"]
    design = found.sound().designs["model"]
    assert design.notes == (
        "no segment states the ambient pressure, which only the recording shows: `planrunner check --data` tries the estimate on the "
        "recording",
    )
    assert not design.blocks and not design.predicted


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("    supply_channel: volts", "the sensor of this bench has no output 'volts'"),
        ("    supply_channel: ambient_pressure", "'ambient_pressure' is in hPa, which is not a unit of voltage"),
        ("    pressure_channel: supply_voltage", "'supply_voltage' is in V, which is not a unit of pressure"),
    ],
)
def test_a_channel_must_exist_and_have_the_dimension(keys: str, message: str) -> None:
    errors = [one.message for one in checked(text(STATES, keys)).findings if one.severity == "error"]
    assert [one for one in errors if message in one], errors


def test_a_change_that_nobody_is_asked_for_is_warned_of_on_real_instruments() -> None:
    real = """
planrunner_bench: 1
name: real
site: {latitude: 48 deg, gravity: 9.81 m/s^2, azimuth: 0 deg}
instruments:
  unit: {driver: stim300, port: "socket://127.0.0.1:4001", sample_rate: 500 Hz}
"""
    plan = """
planrunner: 1
title: Supply
sensor: {kind: imu, outputs: [gyro_x]}
defaults: {orientation: unknown, dwell: 20 s}
segments:
  - {for_each: {supply_voltage: "4.5, 5 V"}PROMPT}
"""
    for prompt, warned in (("", 1), (", prompt: Set the supply to {supply_voltage}", 0)):
        found = checked(plan.replace("PROMPT", prompt), real).findings
        assert [one.code for one in found].count("physics-surroundings") == warned, [str(one) for one in found]
    assert "physics-surroundings" not in [one.code for one in checked(text(STATES)).findings]


def test_a_diagnosis_weighs_the_effects_of_a_supply_that_varies(tmp_path: Path) -> None:
    """The supply explains the gap, and a drift with time does not, because the voltages come in another order than time."""
    states = "supply_voltage: [13 V, 11 V, 12.5 V, 11.5 V, 12 V]"
    run(tmp_path, text(states, CHANNELS, ("bias_supply",)), "--with", "gyro_bias_supply=c_z:0.02 deg/s/V")
    recording = recorded_run(next((tmp_path / "runs").iterdir()))
    options = DiagnosisOptions(effects=("gyro_bias_supply", "gyro_bias_drift", "gyro_warm_up"))
    made = diagnose_recorded(recording, options)
    found = made.diagnosis
    assert found.verdict.effects == ("gyro_bias_supply",)
    plan = plan_with_estimate(made).plan
    assert plan is not None
    written = plan.estimates["diagnosed"].parameters
    assert isinstance(written, ErrorModelParameters) and written.supply_channel == "supply_voltage"
    assert written.pressure_channel is None and "gyro_bias_supply" in written.outputs["gyro_z"]
    (c,) = [one for one in found.parameters if one.name == "c_z"]
    assert abs(c.value - (0.02 + 30 / 3600)) < 4 * c.standard_uncertainty
    observed = found.grounds.weighing.observed
    weighed = {one.id for one in hypotheses(None, observed)} - {one.id for one in hypotheses(None)}
    assert weighed == {f"{kind}_{what}_supply" for kind in ("gyro", "accel") for what in ("bias", "scale")}


@pytest.mark.slow
def test_a_whole_diagnosis_names_what_follows_the_supply(tmp_path: Path) -> None:
    """Bias and scale factor of the gyro. With z always up, bias and scale factor of the accelerometer look alike."""
    states = "supply_voltage: [13 V, 11 V, 12.5 V, 11.5 V, 12 V]"
    run(tmp_path, text(states, CHANNELS, ("bias_supply",)), "--with", "gyro_bias_supply=c_z:0.02 deg/s/V")
    found = diagnose_recorded(recorded_run(next((tmp_path / "runs").iterdir()))).diagnosis
    assert {"gyro_bias_supply", "gyro_scale_supply"} < set(found.verdict.effects)
    assert set(found.verdict.effects) - {"gyro_bias_supply", "gyro_scale_supply"} < {
        "accel_bias_supply",
        "accel_scale_supply",
    }
    by_name = {(one.effect, one.name): one for one in found.parameters}
    for effect, name, true in (("gyro_bias_supply", "c_z", 0.02 + 30 / 3600), ("gyro_scale_supply", "k_z", 200.0)):
        one = by_name[effect, name]
        assert abs(one.value - true) < 4 * one.standard_uncertainty


@pytest.mark.slow
def test_errors_agree_with_what_is_stated_and_predicted() -> None:
    """A generator without planrunner's formulas, in which the values differ from those in the plan and drift. Of 16 · 24 errors at least
    half are independent, so that their root mean square scatters by 5 % at most."""
    campaign, world = CAMPAIGNS["error_model, supply and pressure"], WORLDS["white noise"]
    sound = known(campaign, world)
    predicted = {one.name: one.standard_uncertainty for one in sound.designs["model"].predicted}
    stated, foreseen = [], []
    for run_ in range(16):
        truth, made = recorded(campaign, world, np.random.default_rng([41, run_]))
        one = estimated(campaign, sound, made)
        assert not isinstance(one, str), one
        for name, value in truth.items():
            if "supply" in name or "pressure" in name:
                stated.append((one[name].value - value) / one[name].standard_uncertainty)
                foreseen.append((one[name].value - value) / predicted[name])
    assert np.sqrt(np.mean(np.square(stated))) == pytest.approx(1.0, abs=0.2)
    assert np.sqrt(np.mean(np.square(foreseen))) == pytest.approx(1.0, abs=0.2)
