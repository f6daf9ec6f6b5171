"""What is said of tilted mountings before anything moves: remarks, uncertainties to expect, and what `check` makes of plans."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tilted_recording import DEG, RATES, SITE, THETA, TRIAD, Gyro, inputs, plan_mounting, series, whole_turns

from planrunner.estimators import method
from planrunner.estimators.interface import Design, DesignRequest, Setup
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.scale_factor_tilted import ScaleFactorTilted
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.tasks.check import check_plan
from planrunner.uncertainty.influences import Inputs

ROOT = Path(__file__).resolve().parents[2]
PLAN = ROOT / "plans" / "scale_factor_tilted.yaml"


def designed(
    axes: dict = TRIAD,
    stated: Inputs | None = None,
    drop: int = 0,
    repeats: int = 2,
    rates: Sequence[float] = RATES,
    dwell: Callable[[float], float] = whole_turns,
    **keys: Any,
) -> Design:
    gyros = dict.fromkeys(axes, Gyro())
    planned = tuple(
        one.segment
        for repeat in range(1, repeats + 1)
        for one in series(axes, gyros, repeat=repeat, rates=rates, dwell=dwell)[drop:]
    )
    outputs = tuple(OutputModel(f"gyro_{name}", "deg/s", noise=NoiseModel(1e-4)) for name in axes)
    model = SensorModel("gyro-triad", outputs, 10.0)
    setup = Setup(None, plan_mounting(axes), stated or Inputs())
    parameters = ScaleFactorTiltedParameters(**keys)
    return method.designed(ScaleFactorTilted(), DesignRequest("scale", planned, parameters, SITE, model, setup=setup))


def test_a_sound_plan_is_not_remarked_on_and_predicted_by_hand() -> None:
    """White noise N over dwells t_j gives u(K') = N·√Σ(ω_j²/t_j)/Σω_j²; with cos θ, over repeats, and beside the fixture's angle."""
    found = designed(stated=inputs(TRIAD, 20.0))
    assert not found.remarks
    rates = np.array(RATES)
    noise = 1e-4 * math.sqrt(sum(rate**2 / whole_turns(rate) for rate in rates)) / np.sum(rates**2)
    noise /= math.cos(THETA * DEG) * math.sqrt(2)
    fixture = math.tan(THETA * DEG) * 20 / 3600 * DEG
    K = next(item for item in found.predicted if item.name == "K_x")
    assert K.standard_uncertainty == pytest.approx(math.hypot(noise, fixture), rel=1e-6)
    alone = next(item for item in designed().predicted if item.name == "K_x")
    assert alone.standard_uncertainty == pytest.approx(noise, rel=1e-3)


@pytest.mark.parametrize(
    ("keys", "code", "error"),
    [
        ({"drop": 1}, "physics-zero", True),
        ({"rates": (300.0, 150.0, 60.0)}, "physics-both-signs", False),
        ({"repeats": 1}, "physics-repeats", True),
        ({"dwell": lambda rate: 30.0, "earth_rate": "averaged"}, "physics-part-turns", True),
        ({"dwell": lambda rate: 30.0, "earth_rate": "ignored"}, "physics-part-turns", False),
        ({"axes": {**TRIAD, "w": (86.0, 0.0)}}, "physics-mounting", False),
        ({"outputs": ("gyro_x", "gyro_y")}, "physics-mounting", False),
    ],
)
def test_remarks(keys: dict, code: str, error: bool) -> None:
    (remark,) = designed(**keys).remarks
    assert (remark.code, remark.error) == (code, error)
    assert remark.hint


def changed(folder: Path, *changes: tuple[str, str]) -> list[tuple[str, int, str]]:
    """Findings of the shipped plan with some text replaced: code, line and message."""
    text = PLAN.read_text(encoding="utf-8")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    path = folder / "plan.yaml"
    path.write_text(text, encoding="utf-8")
    return [(item.code, item.mark.line, item.message) for item in check_plan(path).findings]


def test_shipped_plans_are_sound() -> None:
    for name in ("scale_factor_tilted", "fixture_angles"):
        checked = check_plan(ROOT / "plans" / f"{name}.yaml")
        assert checked.ok and not [one for one in checked.findings if one.severity != "note"]
        assert len(checked.plan_bytes.splitlines()) <= 60


def test_check_says_what_is_wrong_with_a_plan(tmp_path: Path) -> None:
    found = changed(tmp_path, ("dwell: {turns: 1, at_least: 30 s}", "dwell: 30 s"))
    assert {code for code, _, _ in found} == {
        "physics-whole-turns"
    }  # the estimate corrects for it, the mean is told of all the same
    found = changed(tmp_path, ("x: {angle: 54.7356 deg ± 20 arcsec", "x: {angle: 90 deg ± 20 arcsec"))
    assert any(code == "physics-estimate" and "does not respond to its rate" in message for code, _, message in found)
    found = changed(tmp_path, ('temperature: "-40, 20, 60 degC"', 'temperature: "20 degC"'))
    assert any("no coefficient 'temperature_coefficient_x'" in message for _, _, message in found)
    found = changed(tmp_path, ("zero: [start-zero, end-zero]", "zero: start-zero"))
    assert [code for code, _, _ in found] == ["physics-zero"]
    found = changed(tmp_path, ("azimuth: 120 deg", ""))
    assert any("mounting.y states no azimuth" in message for _, _, message in found)
    found = changed(tmp_path, ("  z: {angle", "  w: {angle"))
    assert any("mounting.w has no output" in message for _, _, message in found)


def test_rates_far_below_that_of_the_earth_are_reported_and_end_in_no_error(tmp_path: Path) -> None:
    low = [("rate: ±300, ±150, ±60, ±20, ±10, ±1 deg/s", "rate: ±1e-9, ±2e-9 deg/s")]
    low.append(("dwell: {turns: 1, at_least: 30 s}", "dwell: 30 s"))
    found = changed(tmp_path, *low)
    assert "physics-slow-rate" in {code for code, _, _ in found}
    assert any("more slowly than the Earth" in message for _, _, message in found)


def test_the_full_scale_is_that_of_the_rate_along_the_tilted_axis(tmp_path: Path) -> None:
    """150 deg/s along an axis at 54.7356 deg are 259.8 deg/s of the table."""
    bench = (ROOT / "plans" / "benches" / "virtual_gyro_triad.yaml").read_text(encoding="utf-8")
    (tmp_path / "bench.yaml").write_text(bench.replace("full_scale: 400 deg/s", "full_scale: 150 deg/s"))
    own = ("bench: virtual_gyro_triad", "bench: bench.yaml")
    assert not changed(tmp_path, own, ("±300, ±150", "±259, ±150"))
    found = changed(tmp_path, own)
    assert [code for code, _, _ in found] == ["physics-full-scale"] * 3
    assert "'gyro_x' would show" in found[0][2]


def test_whole_turns_are_judged_by_the_mounted_axes(tmp_path: Path) -> None:
    """Along the rotation axis nothing of the level Earth rate is seen; a frame whose axes lie along or across it says nothing of a
    tilted fixture."""
    part = ("dwell: {turns: 1, at_least: 30 s}", "dwell: 30 s")
    upright = [(f"{axis}: {{angle: 54.7356 deg", f"{axis}: {{angle: 0 deg") for axis in "xy"]
    upright.append(("{value: 54.7356 deg", "{value: 0 deg"))
    codes = {code for code, _, _ in changed(tmp_path, part, *upright)}
    assert "physics-whole-turns" not in codes
