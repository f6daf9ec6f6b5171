"""Positions beside segments that spin: these stay and count; the figures are held against matrices made by hand."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from planrunner.cli import main
from planrunner.design import continuous, exchange
from planrunner.design.study import Asked
from planrunner.estimators.interface import EstimationError
from planrunner.tasks.check import check_plan
from planrunner.tasks.design_positions import design_positions

PLANS = Path(__file__).resolve().parents[2] / "plans"


def test_spins_stay_and_count() -> None:
    study = design_positions(check_plan(PLANS / "imu_multi_position.yaml"), Asked(output="gyro_x", restarts=1))
    block = next(one for one in study.sets["planned"].designs["imu"].blocks if one.output == "gyro_x")
    rows = block.matrix / block.magnitudes
    rest = np.array([label.startswith("P") for label in block.labels])
    noise = block.sigma / math.sqrt(np.mean(block.sigma[rest] ** 2))
    weighted = rows / np.where(rest, 1.0, noise)[:, None]
    assert study.sets["planned"].merit.determinant == pytest.approx(np.linalg.det(weighted.T @ weighted), rel=1e-9)
    planned, free = study.sets["planned"].merit, study.sets["free"].merit
    assert planned.determinant <= free.determinant * (1 + 1e-9)
    assert free.determinant <= study.bounds["free"].merit.determinant
    assert free.trace >= study.bounds["free"].merit.trace
    assert len(study.sight.fixed) == 6


def test_without_spins_the_rates_cannot_be_determined() -> None:
    """Earth rate alone: an accelerometer sees no spin, and its design has no fixed rows."""
    study = design_positions(check_plan(PLANS / "imu_multi_position.yaml"), Asked(output="accel_z", restarts=1))
    assert not len(study.sight.fixed)
    with pytest.raises(EstimationError, match="have different models"):
        design_positions(check_plan(PLANS / "imu_multi_position.yaml"), Asked(restarts=1))


def test_exchange_and_bound_beside_fixed_information() -> None:
    random = np.random.default_rng(4)
    rows, others = random.normal(size=(12, 4)), random.normal(size=(3, 4)) * 2
    fixed = others.T @ others
    for weighting in (None, np.eye(4)):
        all_of_them = exchange.exhaust(rows, 5, weighting, fixed=fixed)
        found = exchange.exchange(rows, 5, weighting, fixed=fixed)[0]
        chosen = rows[all_of_them.indices]
        matrix = chosen.T @ chosen + fixed
        by_hand = -math.log(np.linalg.det(matrix)) if weighting is None else float(np.trace(np.linalg.inv(matrix)))
        assert all_of_them.loss == pytest.approx(by_hand, rel=1e-9)
        assert found.loss == pytest.approx(by_hand, rel=1e-9)
        bound = continuous.solve(rows, weighting, fixed=fixed / 5, tolerance=1e-7)
        limit = -math.log(bound.determinant_bound(5)) if weighting is None else bound.trace_bound(5)
        assert limit <= by_hand
        # Shares of a coarse grid, drawn at random, do not pass it either.
        for _ in range(200):
            share = random.dirichlet(np.full(12, 0.4))
            other = 5 * (rows.T @ (share[:, None] * rows)) + fixed
            reached = -math.log(np.linalg.det(other)) if weighting is None else float(np.trace(np.linalg.inv(other)))
            assert reached >= limit


def test_a_bound_that_is_not_known_is_null_in_json(capsys: pytest.CaptureFixture[str]) -> None:
    plan = str(PLANS / "imu_multi_position.yaml")
    assert main(["design", plan, "--output", "gyro_x", "--restarts", "1", "--quiet", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["bounds"]["free"]["worst_variance"] is None
    assert printed["sets"]["free"]["efficiency"]["bound"]["G"] is None
