"""`validate: monte_carlo` on estimates: the chain of the static coefficients, the general first-order one, and what a report is told."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorded import figure, noisy, segment, sensor
from scipy import integrate, stats
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, attitude, pulses
from test_stated_inputs_move_coefficients import SETUP

from planrunner.error_model.flexure_gyro import physical_coefficients
from planrunner.estimators.analysis import analyse, combined
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import Coefficient, Estimate, EstimateRequest
from planrunner.estimators.monte_carlo_validation import TITLE, linear_chain, validated
from planrunner.plan.expand import expand
from planrunner.plan.model import USUAL, EstimateSpec, MonteCarloSpec, parse_plan
from planrunner.uncertainty.influences import Influence, InputQuantity

FEW = MonteCarloSpec(digits=1, draws=100_000, seed=3)


def recording(error: float = 0.03, truth: dict[str, float] = TRUTH) -> tuple:
    """Samples; error: standard uncertainty of each mean, pulse/s."""
    rng = np.random.default_rng(1)
    return tuple(
        noisy(
            replace(segment(label, attitude(words)), orientation=words),
            dict(zip(CHANNELS, pulses(attitude(words), truth), strict=True)),
            "pulse/s",
            error,
            rng,
        )
        for label, words in OPTIMAL.items()
    )


def request(error: float = 0.03, basis: str = "within_segment", **keys: Any) -> EstimateRequest:
    parameters = FlexureGyroStaticParameters(uncertainty=basis, **keys)
    return EstimateRequest("drift", recording(error), parameters, SITE, sensor(*CHANNELS), setup=SETUP)


@pytest.mark.parametrize("noise", [0.03, 3.0])
def test_draws_of_the_chain_have_the_combined_covariance(noise: float) -> None:
    """At both levels of noise the closed-form inverse is nearly linear, and some 250 degrees of freedom make t nearly normal."""
    asked = request(noise)
    made = combined(FlexureGyroStatic().estimate(asked))
    draws = FlexureGyroStatic().chain(asked, made)(np.random.default_rng(0), 200_000)
    assert draws.shape == (24, 200_000)
    assert np.mean(draws, axis=1) == pytest.approx(
        [item.value for item in made.coefficients], rel=0.02, abs=0.3 * noise
    )
    spread = [item.standard_uncertainty for item in made.coefficients]
    assert np.std(draws, axis=1) == pytest.approx(spread, rel=0.02)
    correlation = made.covariance / np.outer(spread, spread)
    assert np.corrcoef(draws) == pytest.approx(correlation, abs=0.02)


def test_many_inverses_at_once_are_those_of_one_by_one() -> None:
    rng = np.random.default_rng(2)
    outputs = rng.normal(size=(2, 7, 5)) + np.array([[0, 5, 1, 0, 0, 0, 0], [0, -1, 4, 0, 0, 0, 0]])[:, :, None]
    together = physical_coefficients(outputs)
    for n in range(5):
        assert together[:, n] == pytest.approx(physical_coefficients(outputs[:, :, n]), rel=1e-12)


def test_unpooled_outputs_are_drawn_with_their_own_degrees_of_freedom() -> None:
    """Two degrees of freedom an output: SF_X rests on one of them (t quantile 4.30), ξ on both: P(a·t₁ + b·t₂ ≤ q) by quadrature."""
    asked = request(0.03, "residual", pool_outputs=False)
    made = combined(FlexureGyroStatic().estimate(asked))
    draws = FlexureGyroStatic().chain(asked, made)(np.random.default_rng(0), 400_000)
    item = made["SF_X"]
    assert np.quantile(draws[0] - item.value, 0.975) == pytest.approx(4.303 * item.standard_uncertainty, rel=0.03)
    xi = made["xi"]
    share = 0.5 + np.sqrt((4 / xi.degrees_of_freedom - 1) / 4)  # Welch–Satterthwaite: 2/ν = share² + (1 − share)²
    end = np.quantile(draws[3] - xi.value, 0.975) / xi.standard_uncertainty

    def below(t: float) -> float:
        return float(stats.t.pdf(t, 2) * stats.t.cdf((end - np.sqrt(share) * t) / np.sqrt(1 - share), 2))

    assert integrate.quad(below, -np.inf, np.inf)[0] == pytest.approx(0.975, abs=0.002)


def test_a_plan_asks_for_it_and_the_estimate_says_what_came_out() -> None:
    spec = EstimateSpec(
        estimator="flexure_gyro_static", segments=("P*",), validate=FEW, parameters=FlexureGyroStaticParameters()
    )
    found, again = (analyse({"drift": spec}, (), recording(0.3), SITE, sensor(*CHANNELS), SETUP) for _ in range(2))
    assert not found.failures
    drift = found.estimates["drift"]
    table = next(one for one in drift.tables if one.title == TITLE)
    assert [row[0] for row in table.rows] == list(drift.headline)
    assert {row[-1] for row in table.rows} == {"yes"}
    for row in table.rows:
        item = drift[str(row[0])]
        assert row[4] == pytest.approx(item.value - 2.7764 * item.standard_uncertainty, abs=figure(row[11]))

    assert drift.settings["validate"] == "monte_carlo"
    assert again.estimates["drift"].tables == drift.tables


def rectangle(u: float, data: float) -> Estimate:
    """One coefficient whose uncertainty is nearly all one rectangular input."""
    made = Estimate(
        "e",
        "x",
        (Coefficient("c", 1.0, "V", data),),
        np.array([[data**2]]),
        influences=(Influence(InputQuantity("a", 0.0, "V", u, distribution="rectangular"), np.ones((1, 1))),),
    )
    return combined(made)


def test_an_interval_that_k_times_u_misjudges_is_named() -> None:
    """A rectangle of u = 0.95: 95 % lie within 0.95·√3·u = 1.56, and k·u = 1.86 is 0.3 wider: more than δ of two digits (0.005)."""
    estimate = rectangle(0.95, 0.01)
    found = validated(estimate, linear_chain(estimate), MonteCarloSpec(digits=2, draws=100_000, seed=1), True)
    (row,) = found.tables[-1].rows
    assert row[-1] == "no"
    assert row[5] == pytest.approx(1 + 0.95 * 3**0.5 * 0.95, abs=0.01)
    assert "does not validate the stated interval of c" in found.warnings[-1]
    assert any("do not test whether the linear approximation is sufficient" in note for note in found.notes)


def test_too_few_draws_leave_it_undecided() -> None:
    """A normal input of u = 0.99: 20 000 draws know its ends to some 0.04, and δ of two digits is 0.005."""
    made = Estimate(
        "e",
        "x",
        (Coefficient("c", 1.0, "V", 0.0),),
        np.zeros((1, 1)),
        influences=(Influence(InputQuantity("a", 0.0, "V", 0.99), np.ones((1, 1))),),
    )
    estimate = combined(made)
    verdicts = [
        validated(estimate, linear_chain(estimate), MonteCarloSpec(digits=2, draws=20_000, seed=seed), True)
        .tables[-1]
        .rows[0][-1]
        for seed in range(40)
    ]
    assert verdicts.count("undecided") > 20
    # The interval is right. Each end is misjudged in at most 5 % of the cases: more than 10 of 40 occur with a probability below 0.002.
    assert verdicts.count("no") <= 10


def test_the_key_is_read_in_both_forms() -> None:
    text = """planrunner: 1
title: t
sensor: {kind: flexure-gyro, outputs: [torquer_x]}
segments: [{label: P1, orientation: {x: up, y: north}, dwell: 1 s}]
estimates:
  a: {estimator: flexure_gyro_static, validate: monte_carlo}
  b: {estimator: flexure_gyro_static, validate: {digits: 2, draws: 200000}}
  c: {estimator: flexure_gyro_static, validate: montecarlo}
"""
    plan, log = parse_plan(text, "p.yaml")
    assert plan is not None
    assert expand(plan, log)
    assert plan.estimates["a"].validate == "monte_carlo"
    assert plan.estimates["b"].validate == MonteCarloSpec(digits=2, draws=200_000, seed=1)
    assert MonteCarloSpec(digits=1, draws=1_000_000, seed=1) == USUAL
    assert [item.mark.line for item in log.errors] == [8]
