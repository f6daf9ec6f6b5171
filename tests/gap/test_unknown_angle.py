"""Recordings of a turning table without an encoder. Each segment begins at a random angle, which the diagnosis does not know."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planrunner.cli import main
from planrunner.error_model.effects.interface import OutsideCoefficients, effect_named
from planrunner.gap.answer.diagnosis import Diagnosis
from planrunner.gap.hypotheses.declarations import corrected
from planrunner.tasks.diagnose import diagnose_recorded, recorded_run
from tests.blind import folder, real
from tests.blind.generator import Case, Work, label_of, one_effect, signatures, simulate, surroundings
from tests.blind.plans import Segment
from tests.blind.product import diagnosed, observation
from tests.blind.scoring import Scored

PLANS = Path(__file__).parents[2] / "plans"
CUT = 0.35
"""Largest share of a turning segment that is cut off at its beginning."""


def without_angle(here: Path, plan: str, sensor: str, effects: tuple[str, ...], seed: int) -> tuple[Case, Diagnosis]:
    """A case of the blind generator with these effects, and its diagnosis without the angle. Turning segments begin at random angles."""
    folder.write_setups(here)
    draw, around, kind = np.random.default_rng(seed), signatures(plan, sensor), real.sensor_called(sensor)
    factors, device = surroundings(kind, draw)
    work = Work(around, factors, device)
    faults = [one_effect(work, [name], 400.0, draw) for name in effects]
    label = label_of("case", "single" if effects else "none", faults, work, False)
    case = Case("case", plan, sensor, simulate(work, faults, False, draw), label, tuple(faults), work.device)
    folder.write_case(here, case, seed)
    shown = folder.shown(here, "case")
    rate = shown.bench["sampling_hz"]

    def cut(row: Segment) -> Segment:
        if row.kind != "rate":
            return row
        lost = float(draw.integers(0, int(CUT * row.duration * rate))) / rate
        return replace(row, start=row.start + lost, duration=row.duration - lost)

    shown.__dict__["segments"] = tuple(cut(row) for row in shown.segments)
    return case, diagnosed(corrected(observation(shown, encoder=False))[0])


@pytest.mark.slow
@pytest.mark.parametrize(("plan", "sensor"), [("rates", "fog"), ("poor", "mems")])
def test_an_unknown_angle_is_no_effect(plan: str, sensor: str, tmp_path: Path) -> None:
    _, found = without_angle(tmp_path, plan, sensor, (), 11)
    noise = {name for name in found.verdict.effects if isinstance(effect_named(name), OutsideCoefficients)}
    assert {*found.verdict.effects} == noise and found.verdict.kind != "unknown"


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["magnetic_sensitivity", "table_tilt", "table_rate_ripple"])
def test_an_effect_that_turns_with_the_table_is_not_misnamed(effect: str, tmp_path: Path) -> None:
    case, found = without_angle(tmp_path, "rates", "fog", (effect,), 12)
    scored = Scored(case.label, found.to_json())
    assert scored.right or found.verdict.kind == "unknown"


@pytest.mark.slow
def test_the_declared_effects_of_the_shipped_bench_are_named(tmp_path: Path) -> None:
    """The bench declares g-sensitivity, quadratic terms, temperature coefficients, which a constant temperature does not show, and a
    warm-up, which has ended when the plan begins."""
    words = ["simulate", str(PLANS / "imu_multi_position.yaml"), "--quiet", "--runs", str(tmp_path)]
    assert main([*words, "--set", "device_serial=1", "--set", "operator=n"]) == 0
    (run,) = tmp_path.glob("*imu_multi_position*")
    found = diagnose_recorded(recorded_run(run)).diagnosis
    assert {*found.verdict.effects} == {"accel_second_order", "gyro_g_sensitivity"}
    declared = {"K_x_x": 32, "K_z_x": -15, "K_y_y": -28, "K_y_z": 19, "K_z_z": 22}
    for one in found.parameters:
        if one.effect == "gyro_g_sensitivity":
            expected = declared.get(one.name, 0) / 3600
            assert abs(one.value - expected) < 4 * one.standard_uncertainty, one.name
