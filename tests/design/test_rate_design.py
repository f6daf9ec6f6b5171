"""`planrunner design` of rates, from plan to plan: what it finds, writes and refuses."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.cli import main
from planrunner.design.study import Asked
from planrunner.estimators.interface import EstimationError
from planrunner.plan.rewriting import with_rates
from planrunner.tasks.check import check_plan
from planrunner.tasks.design_rates import design_rates

BENCH = """planrunner_bench: 1
name: rates
clock: virtual
site: {latitude: 40 deg, gravity: 9.8 m/s^2}
instruments:
  table:
    driver: virtual_table
    axes: [{name: only, direction: up, max_rate: 400 deg/s, max_acceleration: 100 deg/s^2}]
  gyro:
    driver: virtual_flexure_gyro
    scale_factor: {x: 200 (deg/h)/(pulse/s), y: 200 (deg/h)/(pulse/s)}
    drift_x: {F: 1.8 deg/h, X: 3.2 deg/h/g, Y: -2.1 deg/h/g, Z: 0.35 deg/h/g}
    drift_y: {F: -1.2 deg/h, X: 2.4 deg/h/g, Y: 3.0 deg/h/g, Z: -0.28 deg/h/g}
    white_noise: 0.9 pulse/sqrt(s)
    full_scale: 1000000 pulse/s
    sample_rate: 100 Hz
"""
PLAN = """planrunner: 1
title: rates
bench: rates.bench.yaml
sensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}
defaults: {orientation: {x: east, y: north, z: up}, settle: 5 s}
segments:
  - for_each:
      rate: ±240, ±120, ±60, ±20 deg/s  # largest first
    label: R{rate}
    dwell: {turns: 1, at_least: 30 s}
estimates:
  scale: {estimator: scale_factor, segments: R*, outputs: torquer_x}
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    (tmp_path / "rates.bench.yaml").write_text(BENCH, encoding="utf-8")
    path = tmp_path / "rates.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


def by_hand(rates: tuple[float, ...]) -> float:
    """Determinant for [1, x, |x|, x³], each pair at ±x with weight by its time: whole turns of at least 30 s."""
    matrix = np.zeros((4, 4))
    for rate in rates:
        seconds = math.ceil(30 * rate / 360 - 1e-9) * 360 / rate
        for x in (rate / 240, -rate / 240):
            row = np.array([1, x, abs(x), x**3])
            matrix += seconds * np.outer(row, row)
    return float(np.linalg.det(matrix))


def test_the_best_of_all_choices_is_found(plan: Path) -> None:
    study = design_rates(check_plan(plan), Asked(keep_lowest=False))
    grid = sorted({20 * k for k in range(1, 13)} | {240, 120, 60, 20})
    best = max(itertools.combinations(grid, 4), key=by_hand)
    found = tuple(round(math.degrees(rate)) for rate in study.sets["best"].rates)
    assert sorted(found) == sorted(best)
    planned = (by_hand((240, 120, 60, 20)) / by_hand(best)) ** 0.25
    assert study.sets["planned"].efficiency == pytest.approx(planned, rel=1e-3)
    assert study.sets["best"].per_hour <= 1 + 1e-6


def test_the_lowest_rate_stays_unless_it_may_go(plan: Path) -> None:
    assert round(math.degrees(design_rates(check_plan(plan), Asked()).sets["best"].rates[-1])) == 20


def test_a_line_alone_wants_the_largest_rates(plan: Path) -> None:
    study = design_rates(check_plan(plan), Asked(line_only=True, keep_lowest=False))
    assert [round(math.degrees(rate)) for rate in study.sets["best"].rates] == [240, 220, 200, 180]


def test_the_written_plan_passes_and_keeps_its_comments(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    better, page = plan.with_name("better.yaml"), plan.with_name("page.html")
    assert main(["design", str(plan), "--write", str(better), "--html", str(page)]) == 0
    output = capsys.readouterr().out
    assert "D-optimal sets of 4 rates for offset, rate, |rate|, rate^3" in output
    text = better.read_text(encoding="utf-8")
    assert "# largest first" in text
    checked = check_plan(better)
    assert checked.ok and checked.schedule is not None
    assert len(checked.schedule.segments) == 8
    assert "<svg" in page.read_text(encoding="utf-8")


def test_recording_times_fill_the_budget_in_whole_turns(plan: Path) -> None:
    better = plan.with_name("timed.yaml")
    assert main(["design", str(plan), "--time", "30 min", "--write", str(better), "--quiet"]) == 0
    checked = check_plan(better)
    assert checked.ok and checked.schedule is not None
    assert 0.9 * 1800 < checked.schedule.total <= 1800
    dwells: dict[int, float] = {}
    for segment in checked.schedule.segments:
        assert segment.dwell is not None
        dwells[round(abs(math.degrees(segment.rate)))] = segment.dwell
        turns = segment.dwell * abs(segment.rate) / (2 * math.pi)
        assert turns == pytest.approx(round(turns), abs=1e-6) and turns > 0.5
    assert max(dwells.values()) > 2 * min(dwells.values())


def test_values_of_parameters_are_designed_for(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As for a plan that has these values."""
    rates, least = "±200, ±100, ±50, ±20 deg/s", "40 s"
    written, given = plan.with_name("written.yaml"), plan.with_name("given.yaml")
    written.write_text(PLAN.replace("±240, ±120, ±60, ±20 deg/s", rates).replace("30 s", least), encoding="utf-8")
    given.write_text(PLAN.replace("rate: ±", "rate: &rates ±").replace("30 s", "&least 30 s"), encoding="utf-8")
    options, studies = ("--parameter", f"rates={rates}", "--parameter", f"least={least}"), []
    for words in ((str(written),), (str(given), *options), (str(given),)):
        assert main(["design", *words, "--json", "--write", str(plan.with_name("better.yaml"))]) == 0
        studies.append(
            (json.loads(capsys.readouterr().out)["sets"], check_plan(plan.with_name("better.yaml")).schedule)
        )
    assert studies[0] == studies[1] != studies[2]
    assert main(["design", str(given), "--parameter", "least=1 K"]) == 2
    assert "command line: error[meaning-dimension]" in capsys.readouterr().err


def test_the_study_as_data(plan: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", str(plan), "--json", "--criterion", "A"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["criterion"] == "A"
    assert data["sets"]["best"]["efficiency"] == pytest.approx(1.0)
    assert 0 < data["sets"]["planned"]["efficiency"] < 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--criterion", "G"], "rates can be designed by D or A"),
        (["--time", "1 min"], "one turn at every rate takes"),
        (["--rates", "--estimate", "lost"], "the plan has no estimate 'lost'"),
    ],
)
def test_what_cannot_be_designed(
    arguments: list[str], words: str, plan: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["design", str(plan), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_plan_at_rest_has_no_rates(tmp_path: Path) -> None:
    flagship = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
    with pytest.raises(EstimationError, match="do not come from a sweep over rates"):
        design_rates(check_plan(flagship), Asked())


def test_rates_written_in_place_and_once_a_rate() -> None:
    flow = 'segments:\n  - for_each: {rate: "±3, ±1 deg/s"}\n'
    assert '{rate: "±2 deg/s"}' in with_rates(flow, (2, 22), ["±2 deg/s"])
    block = "segments:\n  - for_each:\n      rate: ±3, ±1 deg/s\n    label: R{rate}\n"
    written = with_rates(block, (3, 13), ["±2 deg/s", "±1 deg/s"], [5, 6])
    assert written.count("label: R{rate}") == 2 and "dwell: {turns: 6}" in written
