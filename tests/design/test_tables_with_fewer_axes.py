"""Positions for tables of one and two axes: reached, better than planned, or refused with the reason."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from planrunner.design import optimal
from planrunner.design.study import Asked
from planrunner.estimators.interface import EstimationError
from planrunner.tasks.check import check_plan
from planrunner.tasks.design import write_plan
from planrunner.tasks.design_positions import design_positions

OUTER = "{name: outer, direction: east, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2, lowest: -120 deg, highest: 120 deg}"
INNER = "{name: inner, direction: north, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}"
ONLY = "{name: only, direction: up, max_rate: 100 deg/s, max_acceleration: 100 deg/s^2}"
BENCH = """planrunner_bench: 1
name: few
clock: virtual
site: {{latitude: 39.98 deg, gravity: 9.80154 m/s^2}}
instruments:
  table:
    driver: virtual_table
    axes: [{axes}]
  gyro:
    driver: virtual_flexure_gyro
    scale_factor: {{x: 0.2 (deg/h)/(pulse/s), y: 0.2 (deg/h)/(pulse/s)}}
    drift_x: {{F: 1.8 deg/h, X: 3.2 deg/h/g, Y: -2.1 deg/h/g, Z: 0.35 deg/h/g}}
    drift_y: {{F: -1.2 deg/h, X: 2.4 deg/h/g, Y: 3.0 deg/h/g, Z: -0.28 deg/h/g}}
    white_noise: 0.9 pulse/sqrt(s)
    full_scale: 1000000 pulse/s
    sample_rate: 100 Hz
"""
TWO = [
    "{x: east, y: north, z: up}", "{x: up, y: north, z: west}", "{x: west, y: north, z: down}",
    "{x: down, y: north, z: east}", "{x: east, y: up, z: south}", "{x: east, y: down, z: north}",
    "{x: north, y: up, z: east}", "{x: south, y: up, z: west}",
]  # fmt: skip
ONE = [f"{{from: {{x: east, y: north, z: up}}, rotate: [z {15 * k} deg]}}" for k in range(8)]


def write(folder: Path, axes: str, orientations: list[str]) -> Path:
    (folder / "few.bench.yaml").write_text(BENCH.format(axes=axes), encoding="utf-8")
    rows = "".join(f"        P{k + 1}: {text}\n" for k, text in enumerate(orientations))
    plan = folder / "few.yaml"
    plan.write_text(
        "planrunner: 1\ntitle: few axes\nbench: few.bench.yaml\nsensor: {kind: flexure-gyro, outputs: [torquer_x, torquer_y]}\n"
        "defaults: {settle: 30 s, dwell: 2 min}\nsegments:\n  - for_each:\n      orientation:\n"
        f"{rows}estimates:\n  drift: {{estimator: flexure_gyro_static, segments: P*}}\n",
        encoding="utf-8",
    )
    return plan


def test_two_axes_with_limits(tmp_path: Path) -> None:
    study = design_positions(check_plan(write(tmp_path, f"{OUTER}, {INNER}", TWO)), Asked(restarts=3))
    planned, cardinal, free = (study.sets[name].merit for name in ("planned", "cardinal", "free"))
    assert planned.determinant < cardinal.determinant < free.determinant < study.bounds["free"].merit.determinant
    better = tmp_path / "better.yaml"
    checked = write_plan(study.text, str(tmp_path / "few.yaml"), better)
    assert checked.ok and check_plan(better).ok
    matrix = checked.designs["drift"].blocks[0].matrix / checked.designs["drift"].blocks[0].magnitudes
    assert np.linalg.det(matrix.T @ matrix) == pytest.approx(free.determinant, rel=1e-6)


def test_one_axis_cannot_separate_the_drifts(tmp_path: Path) -> None:
    with pytest.raises(
        EstimationError, match=r"within this table's reach separate bias, accel_x, accel_y, accel_z \(rank 3 of 6"
    ):
        design_positions(check_plan(write(tmp_path, ONLY, ONE)), Asked(restarts=1))


@pytest.mark.slow
def test_the_worst_variance_is_lowered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        optimal, "bound", partial(optimal.bound, tolerance=0.05)
    )  # the sets are compared, not their bounds
    plan = write(tmp_path, f"{OUTER}, {INNER}", TWO)
    by_d, by_g = (design_positions(check_plan(plan), Asked(restarts=2, criterion=criterion)) for criterion in "DG")
    assert by_g.sets["free"].merit.worst < by_d.sets["free"].merit.worst
    assert by_g.sets["free"].merit.worst >= 6 / 8
    assert by_g.sets["cardinal"].merit.worst <= by_d.sets["cardinal"].merit.worst
