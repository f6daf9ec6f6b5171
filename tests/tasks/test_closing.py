"""Closing the gap: three effects at once are found one after the other, and the simulation with them agrees with the recording."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import InputError
from planrunner.cli import main
from planrunner.execution.stopping import StopRequest
from planrunner.gap.answer.diagnosis import DiagnosisOptions
from planrunner.tasks.closing import Ending, close, comparison
from planrunner.tasks.diagnose import Diagnosed, diagnose_recorded, recorded_run
from tests.tasks.test_simulate import PLAN

FEW = ("table_tilt", "gyro_g_sensitivity", "time_latency", "gyro_scale_asymmetry", "gyro_noise_excess")
BENCH = "virtual_imu_nominal"


def _recorded(folder: Path, *effects: str) -> Path:
    plan = folder / "six.yaml"
    plan.write_text(PLAN, encoding="utf-8")
    listed = [word for effect in effects for word in ("--with", effect)]
    assert main(["simulate", str(plan), *listed, "--quiet", "--runs", str(folder / "runs")]) == 0
    return next((folder / "runs").iterdir())


@pytest.fixture(scope="module")
def tilted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _recorded(tmp_path_factory.mktemp("tilted"), "table_tilt=about_east:100 arcsec")


@pytest.fixture(scope="module")
def made(tilted: Path) -> Diagnosed:
    return diagnose_recorded(recorded_run(tilted), DiagnosisOptions(effects=FEW))


def test_a_simulation_with_the_finding_agrees_and_one_without_does_not(made: Diagnosed) -> None:
    found = comparison(made, StopRequest(), BENCH)
    for name in ("accel_x", "accel_y", "accel_z"):
        one = found.channels[name]
        assert one.before_sigma > 3 and one.after_sigma < 1.5
        # A tilt of 100 arcsec moves gravity by 4.75 mm/s² between axes; the fit of the nominal parameters leaves some of it.
        assert 0.0005 < one.before < 0.00475
        assert one.after < 2 * one.noise
    assert found.after_sigma == pytest.approx(1.0, abs=0.3)


def test_what_is_entered_wrongly_does_not_close_the_gap(made: Diagnosed) -> None:
    """The comparison is no formality: the opposite tilt makes the gap larger, twice over."""
    found = comparison(made, StopRequest(), BENCH, [("table_tilt", {"about_east": "-100 arcsec"})])
    assert found.channels["accel_x"].after == pytest.approx(2 * found.channels["accel_x"].before, rel=0.2)


@pytest.mark.parametrize("count", [0.005, 0.02])
def test_a_computed_simulation_is_rounded_to_the_counts_of_the_recording(tmp_path: Path, count: float) -> None:
    """The virtual sensor has a noise of 2.45 mm/s²: half a count, and an eighth of a count."""
    run = _recorded(tmp_path, f"accel_quantization=count:{count} m/s^2")
    made = diagnose_recorded(recorded_run(run), DiagnosisOptions(effects=(*FEW, "accel_quantization")))
    sound = made.recorded.sound
    played_back = replace(sound, models=replace(sound.models, replays=True))
    made = replace(made, recorded=replace(made.recorded, sound=played_back))
    found = comparison(made, StopRequest(), stated=[("accel_quantization", {"count": f"{count} m/s^2"})])
    for name in ("accel_x", "accel_y", "accel_z"):
        recorded, before, after = found.channels[name].sample_noise
        assert after == pytest.approx(recorded, rel=0.15)
        assert before == pytest.approx(2.45e-3, rel=0.05)
    if count == 0.005:  # the noise dithers the count
        recorded = found.channels["accel_x"].sample_noise[0]
        assert recorded == pytest.approx(np.hypot(2.45e-3, count / np.sqrt(12)), rel=0.05)
        assert found.after_sigma == pytest.approx(1.0, abs=0.3)


def test_joined_runs_are_refused(made: Diagnosed) -> None:
    with pytest.raises(InputError) as caught:
        comparison(replace(made, recorded=replace(made.recorded, several=True)), StopRequest(), BENCH)
    assert {finding.code for finding in caught.value.findings} == {"gap-compare"}


@pytest.mark.slow
def test_three_effects_are_closed_one_after_the_other(tmp_path: Path) -> None:
    run = _recorded(
        tmp_path,
        "table_tilt=about_east:100 arcsec,about_north:-60 arcsec",
        "time_latency=1 ms",
        "gyro_scale_asymmetry=k_x:150 ppm,k_y:-150 ppm,k_z:200 ppm",
    )
    closed = close(recorded_run(run), StopRequest(), BENCH, DiagnosisOptions(effects=FEW))
    assert closed.ending is Ending.NOTHING_LEFT
    stated = {name: {key: float(text.split()[0]) for key, text in values.items()} for name, values in closed.stated}
    assert set(stated) == {"table_tilt", "time_latency", "gyro_scale_asymmetry"}
    assert stated["table_tilt"] == pytest.approx({"about_east": 100, "about_north": -60}, abs=3)
    assert stated["time_latency"] == pytest.approx({"delay": 1e-3}, rel=0.02)
    assert stated["gyro_scale_asymmetry"] == pytest.approx({"k_x": 150, "k_y": -150, "k_z": 200}, abs=12)
    last = closed.rounds[-1].comparison
    assert last.before_sigma > 5 and last.after_sigma == pytest.approx(1.0, abs=0.3)
    sigmas = [one.comparison.after_sigma for one in closed.rounds]
    assert np.all(np.diff(sigmas) < 0)
    assert "gyro_scale_asymmetry" in closed.bench


@pytest.mark.slow
def test_the_commands_show_and_write_it(tilted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, bench = tmp_path / "page.html", tmp_path / "closed.yaml"
    common = [str(tilted), "--simulation", BENCH]
    assert main(["close", *common, "--json", "--html", str(page), "--write-bench", str(bench)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ending"] == "nothing_left" and found["entered"]["table_tilt"]
    assert "table_tilt" in bench.read_text(encoding="utf-8")
    assert "accel_x: recording and simulations" in page.read_text(encoding="utf-8")
    assert main(["diagnose", *common, "--json", "--compare"]) == 0
    assert set(json.loads(capsys.readouterr().out)["comparison"]["channels"]) >= {"gyro_x", "accel_z"}


@pytest.mark.slow
def test_the_shipped_plan_over_temperature_is_simulated_and_closed(tmp_path: Path) -> None:
    """The plan names a bench that plays recordings back; its twin among the virtual benches can simulate it."""
    plan, bench = Path(__file__).parents[2] / "plans/imu_recorded_over_temperature.yaml", "virtual_imu_over_temperature"
    effect = "gyro_bias_temperature=c1_x:0.002,c1_y:-0.001,c1_z:0.0015"
    asked = ["simulate", str(plan), "--bench", bench, "--with", effect, "--quiet", "--runs", str(tmp_path)]
    assert main(asked) == 0
    closed = close(recorded_run(next(tmp_path.iterdir())), StopRequest(), bench, DiagnosisOptions(), 2)
    stated = dict(closed.stated)
    assert float(stated["gyro_bias_temperature"]["c1_x"].split()[0]) == pytest.approx(0.002, rel=0.02)
    found = closed.rounds[-1].comparison
    assert all(
        found.channels[f"gyro_{axis}"].after_sigma < 1.5 < found.channels[f"gyro_{axis}"].before_sigma for axis in "xyz"
    )
