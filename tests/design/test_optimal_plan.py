"""`planrunner design` from plan to plan: what it prints, writes and refuses."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from planrunner.base.findings import Findings
from planrunner.cli import main
from planrunner.design import optimal
from planrunner.design.study import Asked, FoundPositions
from planrunner.estimators.interface import Design, EstimationError
from planrunner.plan import source
from planrunner.plan.orientation import OrientationKind, in_words
from planrunner.plan.rewriting import as_written, cardinal_orientations, orientation_text, with_orientations
from planrunner.tasks.check import check_plan
from planrunner.tasks.design import write_plan
from planrunner.tasks.design_positions import design_positions

FLAGSHIP = Path(__file__).resolve().parents[2] / "plans" / "flexure_gyro_eight_position.yaml"
QUICK = Asked(restarts=2)


def predicted(designs: Mapping[str, Design], name: str) -> dict[str, float]:
    return {item.name: item.standard_uncertainty for item in designs[name].predicted}


@pytest.fixture(scope="module")
def study() -> FoundPositions:
    return design_positions(check_plan(FLAGSHIP), QUICK)


def test_the_published_set_is_the_best_cardinal_one_and_free_ones_are_better(study: FoundPositions) -> None:
    planned, free = study.sets["planned"], study.sets["free"]
    assert planned.merit.determinant == pytest.approx(706.081, abs=5e-4)
    assert planned.of_cardinal is not None
    assert pytest.approx(1.0, abs=1e-9) == planned.of_cardinal.D
    assert pytest.approx(1.0, abs=1e-9) == planned.of_cardinal.A
    assert planned.merit.trace == pytest.approx(2.57809, abs=5e-6)
    assert free.merit.determinant >= 836.83
    for one in study.sets.values():
        assert one.merit.determinant <= study.bounds["free"].merit.determinant
        assert one.merit.trace >= study.bounds["free"].merit.trace
    assert 6.0 <= study.bounds["free"].certificate < 6.01


def test_the_claimed_ratio_is_reported_with_that_of_design_theory(study: FoundPositions) -> None:
    ratios = {name: one.residual_ratios["residual.ratio_traditional_to_drift"] for name, one in study.sets.items()}
    assert ratios["planned"] == pytest.approx(1.28, abs=0.005)
    assert ratios["planned"] < ratios["free"] < 1.51


def test_the_written_plan_passes_and_promises_smaller_uncertainties(study: FoundPositions, tmp_path: Path) -> None:
    path = tmp_path / "better.yaml"
    write_plan(study.text, str(FLAGSHIP), path)
    checked = check_plan(path)
    assert checked.ok
    (before, after) = (
        np.linalg.det(block.matrix.T @ block.matrix)
        for block in (study.sets["planned"].designs["drift"].blocks[0], checked.designs["drift"].blocks[0])
    )
    assert after / before == pytest.approx(836.83 / 706.081, abs=1e-3)
    old, new = (predicted(one.designs, "drift") for one in (study.sets["planned"], checked))
    assert all(new[f"D_{x}_{y}"] < old[f"D_{x}_{y}"] for x in "XY" for y in "XY")
    assert new["D_X_Z"] > old["D_X_Z"]  # the joint region shrinks, not every side of it
    with pytest.raises(EstimationError, match="the plan itself"):
        write_plan(study.text, str(FLAGSHIP), FLAGSHIP)
    kept = [line for line in FLAGSHIP.read_text().splitlines() if "  P" not in line]
    assert [line for line in path.read_text().splitlines() if "  P" not in line] == kept


@pytest.fixture
def rough_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bounds as valid as ever but not as close, in half of the time, for tests of what is found rather than of how good it is."""
    monkeypatch.setattr(optimal, "bound", partial(optimal.bound, tolerance=0.05))


@pytest.mark.slow
@pytest.mark.usefixtures("rough_bounds")
def test_a_poor_set_is_replaced_by_one_that_is_better_in_every_coefficient(tmp_path: Path) -> None:
    found = design_positions(check_plan(FLAGSHIP), Asked(estimate="traditional", restarts=1))
    assert found.sets["planned"].merit.determinant == pytest.approx(88.26, abs=0.005)
    written = write_plan(found.text, str(FLAGSHIP), tmp_path / "new.yaml")
    old, new = (predicted(one.designs, "traditional") for one in (found.sets["planned"], written))
    assert all(new[name] <= old[name] * (1 + 1e-4) for name in old)
    assert np.mean([new[name] / old[name] for name in old]) < 0.9


@pytest.mark.slow
@pytest.mark.usefixtures("rough_bounds")
def test_product_terms_get_positions_that_see_them(plan_file: Callable[..., Path], tmp_path: Path) -> None:
    plan = plan_file(
        (
            "uncertainty: residual}\n  traditional",
            "uncertainty: within_segment, terms: [accel_x_accel_z, accel_y_accel_z]}\n  traditional",
        ),
        ("  residual: {estimator: compensation_residual, uses: [drift, traditional], segments: V*}\n", ""),
    )
    assert not check_plan(plan).ok
    found = design_positions(check_plan(plan), QUICK)
    assert found.sets["planned"].merit.rank == 6
    assert "cardinal" not in found.sets
    assert found.sets["free"].merit.rank == 8
    assert write_plan(found.text, str(FLAGSHIP), tmp_path / "seen.yaml").ok
    with pytest.raises(EstimationError, match="no set of 8 cardinal orientations"):
        design_positions(check_plan(plan), Asked(restarts=1, orientations="cardinal"))


@pytest.mark.slow
@pytest.mark.usefixtures("rough_bounds")
def test_dwells_fill_the_time_budget(tmp_path: Path) -> None:
    found = design_positions(check_plan(FLAGSHIP), Asked(restarts=1, orientations="cardinal", time=4000.0))
    assert found.dwell_gain < 1.0 + 1e-9
    checked = write_plan(found.text, str(FLAGSHIP), tmp_path / "timed.yaml")
    assert checked.schedule is not None
    assert 4000.0 - 8 <= checked.schedule.total <= 4000.0
    assert [segment.dwell for segment in checked.schedule.segments[:8]] == list(found.dwells)
    with pytest.raises(EstimationError, match="too little"):
        design_positions(check_plan(FLAGSHIP), Asked(restarts=1, time=600.0))


def test_orientations_are_written_as_they_are_read() -> None:
    assert len({in_words(one) for one in cardinal_orientations()}) == 24
    random = np.random.default_rng(2)
    for _ in range(50):
        attitude = np.linalg.qr(random.normal(size=(3, 3)))[0]
        attitude *= np.linalg.det(attitude)
        log = Findings()
        node = source.parse(f"orientation: {orientation_text(attitude)}", "x").get("orientation")
        assert node is not None
        read = OrientationKind().read(node, log)
        assert read is not None and read.attitude is not None
        assert np.allclose(read.attitude, as_written(attitude), atol=1e-12)
        assert np.abs(read.attitude - attitude).max() < 2e-4
    assert orientation_text(np.eye(3)) == "{x: east, y: north, z: up}"


def test_block_orientations_are_replaced_too() -> None:
    text = "segments:\n  - label: a\n    orientation:\n      x: up  # why\n      y: north\n    dwell: 1 s\n"
    new = with_orientations(text, {(4, 7): "{x: down, y: north}"})
    assert source.plain(source.parse(new, "x"))["segments"][0] == {
        "label": "a", "orientation": {"x": "down", "y": "north"}, "dwell": "1 s",
    }  # fmt: skip


@pytest.mark.usefixtures("rough_bounds")
def test_the_command_prints_json_and_writes_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page, plan = tmp_path / "design.html", tmp_path / "new.yaml"
    arguments = [
        "design",
        str(FLAGSHIP),
        "--restarts",
        "1",
        "--json",
        "--quiet",
        "--html",
        str(page),
        "--write",
        str(plan),
    ]
    assert main(arguments) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["sets"]["planned"]["determinant"] == pytest.approx(706.081, abs=5e-4)
    assert printed["bounds"]["free"]["determinant"] >= printed["sets"]["free"]["determinant"] >= 836.83
    html = page.read_text(encoding="utf-8")
    assert html.count('class="orientation"') == 16
    assert "http://" not in html.replace("http://www.w3.org/2000/svg", "") and "https://" not in html
    assert check_plan(plan).ok


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--estimate", "nothing"], "has no estimate 'nothing'"),
        (["--estimate", "residual"], "no design matrix"),
        (["--time", "12 deg"], "--time"),
        (["--output", "w"], "no output 'w'"),
    ],
)
def test_what_cannot_be_designed_is_said(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", str(FLAGSHIP), *arguments]) == 2
    assert words in capsys.readouterr().err


def test_a_recording_has_no_table_to_move(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", str(FLAGSHIP.with_name("mpu9150_imu0.yaml"))]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_an_estimate_whose_positions_change_nothing_is_said_to_be_one(capsys: pytest.CaptureFixture[str]) -> None:
    """Of a scale factor from rates the segments at rest give the zeros alone, and those are no rows of its design matrix."""
    assert main(["design", str(FLAGSHIP.with_name("fixture_angles.yaml")), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "do not affect 'scale' (scale_factor_tilted); use --rates to design its rates" in said
