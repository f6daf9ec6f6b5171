"""Decisions on standard deviations and on maxima: by χ² and by both signs, against tables and simulated tests."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.uncertainty.decision import CoefficientRole, conformance_probability, decide

SCALE, MAXIMUM = CoefficientRole.SCALE, CoefficientRole.MAXIMUM


def of(s: float, freedom: float) -> float:
    return s / math.sqrt(2 * freedom)


def test_risk_of_a_standard_deviation_is_that_of_a_table() -> None:
    """χ² of four degrees of freedom is below 0.7107 in 5 % and below 0.4844 in 2.5 %."""
    upper = math.sqrt(4 / 0.710723)
    passed = decide(1.0, of(1.0, 4), 4, upper=upper, rule="simple", role=SCALE)
    assert passed.verdict == "pass"
    assert passed.false == pytest.approx(0.05, abs=1e-5)
    assert decide(1.0, of(1.0, 4), 4, upper=upper, rule="simple").false < 0.03  # by Student's t
    edge = math.sqrt(4 / 0.484419)
    assert decide(1.0, of(1.0, 4), 4, upper=edge * 1.001, role=SCALE).verdict == "pass"
    assert decide(1.0, of(1.0, 4), 4, upper=edge * 0.999, role=SCALE).verdict == "fail"


def test_a_lower_limit_of_a_standard_deviation() -> None:
    """χ² of four degrees of freedom is above 11.1433 in 2.5 %."""
    edge = math.sqrt(4 / 11.143287)
    assert decide(1.0, of(1.0, 4), 4, lower=edge * 0.999, role=SCALE).verdict == "pass"
    assert decide(1.0, of(1.0, 4), 4, lower=edge * 1.001, role=SCALE).verdict == "fail"


def test_of_simulated_devices_as_many_conform_as_is_said() -> None:
    """Devices with σ drawn by 1/σ, from each of which five repeats gave a standard deviation about 1."""
    draw = np.random.default_rng(3)
    sigma = np.exp(draw.uniform(math.log(0.05), math.log(20), 2_000_000))
    seen = sigma * np.sqrt(draw.chisquare(4, sigma.size) / 4)
    about = np.abs(seen - 1) < 0.02
    found = conformance_probability(1.0, of(1.0, 4), 4, upper=2.0, role=SCALE)
    assert np.mean(sigma[about] <= 2.0) == pytest.approx(found, abs=0.006)


def test_many_degrees_of_freedom_are_normal() -> None:
    by_role = conformance_probability(1.0, 1e-3, math.inf, upper=1.001, role=SCALE)
    assert by_role == pytest.approx(conformance_probability(1.0, 1e-3, math.inf, upper=1.001), abs=0.001)


def test_a_maximum_may_have_either_sign() -> None:
    """Of a value of one standard uncertainty, both signs within 2: Φ(1) − Φ(−3)."""
    found = conformance_probability(1.0, 1.0, math.inf, upper=2.0, role=MAXIMUM)
    assert found == pytest.approx(0.841345 - 0.001350, abs=1e-6)
    assert conformance_probability(5.0, 0.1, math.inf, upper=5.2, role=MAXIMUM) == pytest.approx(0.97725, abs=1e-5)
