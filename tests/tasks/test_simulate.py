"""Simulating with effects: the bench's text, what is refused, and a run that is diagnosed, continued as proposed and joined."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from planrunner.base.findings import InputError
from planrunner.base.shipped import shipped
from planrunner.bench.model import bench_of, parse_bench
from planrunner.cli import main
from planrunner.error_model.virtual_instrument import AddedEffectsParameters
from planrunner.estimators.analysis import analyse
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.plan import source
from planrunner.tasks.check import check_plan
from planrunner.tasks.diagnose import diagnose_recorded, joined, recorded_run
from planrunner.tasks.named_effects import bench_with_effects, plan_with_estimate
from planrunner.tasks.simulate import parsed, simulation, with_effects

PLAN = """
planrunner: 1
title: Six positions and two rates
bench: virtual_imu_nominal
sensor: {kind: imu, outputs: [gyro_x, gyro_y, gyro_z, accel_x, accel_y, accel_z]}
defaults: {settle: 5 s, dwell: 20 s}
segments:
  - for_each:
      orientation:
        P1: &x {x: up, y: north, z: west}
        P2: {x: down, y: north, z: east}
        P3: &y {x: north, y: up, z: east}
        P4: {x: south, y: down, z: east}
        P5: &z {x: east, y: north, z: up}
        P6: {x: west, y: north, z: down}
  - {orientation: *x, for_each: {rate: "±60 deg/s"}, label: "X{rate}", dwell: {turns: 3}}
  - {orientation: *y, for_each: {rate: "±60 deg/s"}, label: "Y{rate}", dwell: {turns: 3}}
  - {orientation: *z, for_each: {rate: "±60 deg/s"}, label: "Z{rate}", dwell: {turns: 3}}
  - {orientation: *z, motion: {rock: {amplitude: 5 deg, frequency: 1 Hz}}, label: K}
"""
FEW = DiagnosisOptions(
    effects=("gyro_g_sensitivity", "table_tilt", "time_latency", "gyro_warm_up", "gyro_noise_excess")
)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "six.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


def _simulated(plan: Path, *effects: str, bench: str = "virtual_imu_nominal") -> Path:
    runs = plan.parent / f"runs{len(list(plan.parent.glob('runs*')))}"
    listed = [word for effect in effects for word in ("--with", effect)]
    assert main(["simulate", str(plan), *listed, "--bench", bench, "--quiet", "--runs", str(runs)]) == 0
    return next(runs.iterdir())


@pytest.mark.parametrize("delay", [5.0, -5.0])
def test_a_delay_shifts_the_output_of_a_rocking_gyro(plan: Path, delay: float) -> None:
    """Two simulations with the same noise, at 50 Hz. The phases follow from fitted sines: the delay acts on the output with its scale
    factor, and the outputs are means over the sampling intervals."""
    runs = [_simulated(plan, *own, bench="virtual_imu_over_temperature") for own in ((), (f"time_latency={delay} ms",))]
    phases = []
    for run in runs:
        (path,) = (run / "segments").glob("*-K.parquet")
        read = pq.read_table(path)
        time, rate = read["time"].to_numpy(), read["gyro_z"].to_numpy()
        terms = np.column_stack([np.sin(2 * np.pi * time), np.cos(2 * np.pi * time), np.ones(len(time))])
        sine, cosine, _ = np.linalg.lstsq(terms, rate, rcond=None)[0]
        phases.append(np.arctan2(cosine, sine))
    assert (phases[0] - phases[1]) / (2 * np.pi) * 1e3 == pytest.approx(delay, abs=2e-4)  # ms


@pytest.mark.parametrize(
    "bench", sorted((shipped("plans") / "benches").glob("virtual*.yaml")), ids=lambda path: path.stem
)
def test_effects_fit_into_every_shipped_bench(bench: Path) -> None:
    made = simulation(shipped("plans") / "imu_multi_position.yaml", "virtual_imu_nominal", ["table_tilt=20"])
    text = with_effects(bench.read_text(encoding="utf-8"), made.additions)
    found, log = parse_bench(source.parse(text, bench.name))
    assert not log.errors
    assert found is not None
    added = found.instruments["added"].parameters
    assert isinstance(added, AddedEffectsParameters)
    assert added.effects["table_tilt"]["about_east"] == "20 arcsec"
    assert found.safe_order[-1] == "added"


@pytest.mark.parametrize(
    ("effects", "bench", "code"),
    [
        (["table_tlit"], None, "effect-unknown"),
        (["table_tilt", "table_tilt=2"], None, "effect-twice"),
        (["table_tilt="], None, "effect-value"),
        (["gyro_bias_gauss_markov=tau:0 s"], None, "effect-value"),
        (["table_tilt=about_east:1,about_east:2"], None, "effect-value"),
        (["gyro_bias"], "imu_recording", "simulate-bench"),
    ],
)
def test_what_is_wrong_is_said(plan: Path, effects: list[str], bench: str | None, code: str) -> None:
    with pytest.raises(InputError) as caught:
        simulation(plan, bench, effects)
    assert code in {finding.code for finding in caught.value.findings}


def test_a_sensor_that_takes_no_effects_is_named() -> None:
    with pytest.raises(InputError, match="does not support added effects"):
        simulation(shipped("plans") / "flexure_gyro_eight_position.yaml", None, ["table_tilt"])


def test_a_run_with_values_of_parameters_keeps_them(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan.write_text(PLAN.replace("dwell: 20 s", "dwell: &dwell 20 s"), encoding="utf-8")
    words = ["simulate", str(plan), "--with", "table_tilt=20", "--quiet", "--runs", str(plan.parent / "runs")]
    assert main([*words, "--parameter", "dwell=2 min"]) == 0
    (run,) = (plan.parent / "runs").iterdir()
    assert "dwell: &dwell 2 min" in (run / "plan.yaml").read_text(encoding="utf-8")
    assert "table_tilt" in (run / "bench.yaml").read_text(encoding="utf-8")
    assert json.loads((run / "run.json").read_text(encoding="utf-8"))["plan"] == "six (dwell=2 min)"
    capsys.readouterr()
    assert main([*words, "--parameter", "dwell=2 K"]) == 2
    assert "command line: error[meaning-dimension]" in capsys.readouterr().err


def test_values_are_distinguished() -> None:
    assert parsed("gyro_warm_up=tau:600 s,a_x:0.01 deg/s") == ("gyro_warm_up", {"tau": "600 s", "a_x": "0.01 deg/s"})
    assert parsed("time_latency = 1 ms") == ("time_latency", {"": "1 ms"})
    assert parsed("table_tilt") == ("table_tilt", {})


@pytest.mark.slow
def test_without_effects_nothing_changes(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = _simulated(plan)
    assert "Nothing was added" in capsys.readouterr().out
    found = diagnose_recorded(recorded_run(run), FEW)
    assert found.diagnosis.verdict.kind == "none"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "name"),
    [
        ("gyro_g_sensitivity=K_x_y:0.003,K_y_x:-0.002", "gyro_g_sensitivity"),
        ("time_latency=0.5 ms", "time_latency"),
        ("gyro_noise_excess=0.004", "gyro_noise_excess"),
    ],
)
def test_what_is_added_is_found_back(plan: Path, effect: str, name: str) -> None:
    """Self-consistency, of every stage that the plan can show: the same columns on both sides."""
    run = _simulated(plan, effect)
    assert name in (run / "bench.yaml").read_text(encoding="utf-8")
    found = diagnose_recorded(recorded_run(run), FEW).diagnosis
    assert found.verdict.effects == (name,)


@pytest.mark.slow
def test_hysteresis_is_found_in_segments_that_state_no_temperature(tmp_path: Path) -> None:
    """The chamber stays at the temperature of the segment before. An estimate that took 25 degC there would see the opposite change."""
    warm = [25, 60, None, 25, None, -20, None, 25, None]
    states = ["" if one is None else f", temperature: {one} degC, soak: 2 h" for one in warm]
    plan = tmp_path / "cycle.yaml"
    plan.write_text(
        "planrunner: 1\ntitle: A cycle\nbench: virtual_mems\nsensor: {kind: imu, outputs: [gyro_z]}\n"
        "defaults: {orientation: {x: east, y: north, z: up}, dwell: 1 min}\nsegments:\n"
        + "".join(f"  - {{label: S{number}{state}}}\n" for number, state in enumerate(states))
        + "estimates:\n  fit:\n    estimator: error_model\n    drift: none\n    outputs: "
        "{gyro_z: [gyro_bias, gyro_bias_temperature.c1, gyro_thermal_hysteresis]}\n",
        encoding="utf-8",
    )
    run = _simulated(plan, "gyro_thermal_hysteresis=2 deg/s")
    results = json.loads((run / "analyses" / "1" / "results.json").read_text(encoding="utf-8"))
    (found,) = (one for one in results["estimates"][0]["coefficients"] if "hysteresis" in one["name"])
    assert abs(found["value"] - 2.0) < 2.5 * found["standard_uncertainty"] < 0.1  # t of 6 degrees of freedom, 95 %


@pytest.mark.slow
def test_a_proposed_plan_passes_its_checks_runs_and_is_weighed_with_the_first(plan: Path, tmp_path: Path) -> None:
    first = recorded_run(_simulated(plan, "table_tilt=about_east:1.3"))
    before = diagnose_recorded(first, FEW)
    following = before.following
    assert following is not None
    expected = following.to_json()["expected"]
    assert isinstance(expected, dict)
    assert expected["probability"] > expected["probability_now"]
    path = tmp_path / "next.yaml"
    path.write_text(following.text, encoding="utf-8")
    sound = check_plan(path).sound()
    assert not sound.findings
    assert sound.schedule.total == pytest.approx(3600 * expected["hours"])
    assert main(["run", str(path), "--quiet", "--flushed", "--runs", str(tmp_path / "more")]) == 0
    both = joined(first, [next((tmp_path / "more").iterdir())])
    assert len(both.segments) == len(first.segments) + len(sound.schedule.segments)
    times = [item.statistics.start for item in both.segments]
    assert times == sorted(times)
    after = diagnose_recorded(both, FEW)
    tilt = [sum(p for n, p in d.diagnosis.posterior.probability.items() if "table_tilt" in n) for d in (before, after)]
    assert tilt[1] > tilt[0]


def test_a_named_effect_becomes_an_effect_of_the_bench(plan: Path) -> None:
    found = diagnose_recorded(recorded_run(_simulated(plan, "table_tilt=about_east:30 arcsec")), FEW)
    assert found.diagnosis.verdict.effects == ("table_tilt",)
    text = bench_with_effects(found, "virtual_imu_nominal")
    added = bench_of(text.encode(), "bench.yaml").instruments["added"].parameters
    assert isinstance(added, AddedEffectsParameters)
    stated = added.effects["table_tilt"]["about_east"]
    assert float(stated.split()[0]) == pytest.approx(30, abs=1)
    made = plan_with_estimate(found)
    assert "table_tilt" in made.plan_bytes.decode()


def test_the_plan_of_a_named_effect_finds_it(plan: Path) -> None:
    line = "  line: {estimator: scale_factor, segments: 'Z*', outputs: gyro_z, uncertainty: within_segment}\n"
    plan.write_text(f"{PLAN}estimates:\n{line}", encoding="utf-8")
    effect = "gyro_g_sensitivity=K_x_x:0.02 deg/s/g,K_y_y:-0.02 deg/s/g,K_z_z:0.01 deg/s/g"
    recorded = recorded_run(_simulated(plan, effect))
    found = diagnose_recorded(recorded, FEW)
    assert found.diagnosis.verdict.effects == ("gyro_g_sensitivity",)
    made = plan_with_estimate(found)
    sound = made.sound()
    assert made.plan_bytes.decode().startswith(plan.read_text(encoding="utf-8").rstrip())
    assert set(sound.plan.estimates) == {"line", "diagnosed"}
    results = analyse(sound.plan.estimates, (), recorded.segments, sound.models.site, sound.sensor, sound.setup)
    item = results.estimates["diagnosed"]["gyro_g_sensitivity_K_x_x"]
    assert abs(item.value - 0.02) < 4 * item.standard_uncertainty < 0.01


@pytest.mark.slow
def test_nothing_is_written_where_nothing_is_named(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = _simulated(plan)
    folder = plan.parent
    assert main(["diagnose", str(run), "--write-plan", str(folder / "p"), "--write-bench", str(folder / "b")]) == 0
    said = capsys.readouterr().out
    assert said.count("is not written") == 2 and not (folder / "p").exists() and not (folder / "b").exists()
