"""Segments that do not fit the others are named; the statistics against a second formula, and false alarms as seldom as stated."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import from_means, noisy, segment, sensor

from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.least_squares import fit
from planrunner.estimators.outlying_segments import agreement
from planrunner.estimators.outputs_fit import OutputsFit, fit_outputs
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.observation.observations import observe
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Spin

RATES = np.concatenate([np.linspace(-300, 300, 24), np.linspace(-290, 290, 24)])


def line(rates: np.ndarray, values: np.ndarray, draw: np.random.Generator | None = None) -> OutputsFit:
    """With `draw`, of samples whose means scatter by 1 deg/s about the values; else of the exact values."""
    recorded = []
    for n, (rate, value) in enumerate(zip(rates, values, strict=True)):
        planned, means = segment(f"R{n}", motion=Spin(float(rate))), {"gyro": float(value)}
        if draw is None:
            recorded.append(from_means(planned, means, "deg/s", 1.0))
        else:
            recorded.append(noisy(planned, means, "deg/s", 1.0, draw, samples=64))
    matrix = np.column_stack([np.ones(len(rates)), rates])
    seen = observe(recorded, ["gyro"], sensor("gyro", unit="deg/s"))
    return fit_outputs(matrix, seen, np.array([1.0, 300.0]), ("offset", "rate"), "residual")


def test_the_statistic_is_that_of_leaving_the_segment_out() -> None:
    """Studentised residuals by their definition: fit without the segment, and hold its observation against the prediction."""
    values = 0.5 + 1.01 * RATES
    values[30] += 9.0
    whole = line(RATES, values, np.random.default_rng(1))
    (found,) = agreement(whole, "residual").outliers
    values = whole.matrix @ whole.coefficients[0] + whole.fits[0].residuals
    matrix = np.column_stack([np.ones(len(RATES)), RATES])
    rest = np.arange(len(RATES)) != 30
    without = fit(matrix[rest], values[rest])
    error = values[30] - matrix[30] @ without.coefficients
    u = np.sqrt(without.variance_factor * (1 + matrix[30] @ without.cofactor @ matrix[30]))
    assert found.label == "R30"
    assert found.error == pytest.approx(error)
    assert found.deviations == pytest.approx(abs(error) / u)
    assert found.changes == pytest.approx(without.coefficients - fit(matrix, values).coefficients)


def test_two_wrong_segments_do_not_hide_each_other() -> None:
    values = 1.01 * RATES
    values[[0, 24]] += 30.0  # both at the end of the line, on the same side
    fitted = line(RATES, values, np.random.default_rng(2))
    assert {one.label for one in agreement(fitted, "residual").outliers} == {"R0", "R24"}


@pytest.mark.slow
@pytest.mark.parametrize("basis", ["residual", "within_segment"])
def test_false_alarms_are_as_seldom_as_stated(basis: str) -> None:
    """At most 1 % of sound recordings have an outlier: of 1000 not more than 21 (0.1 % of the binomial distribution beyond)."""
    draw = np.random.default_rng(3)
    rates = np.linspace(-100, 100, 10)
    alarms = sum(bool(agreement(line(rates, rates, draw), basis).outliers) for _ in range(1000))
    assert alarms <= 21


def test_exact_data_have_no_outliers() -> None:
    assert not agreement(line(RATES, 0.3 + 1.01 * RATES), "residual").outliers


def test_a_segment_that_decides_a_coefficient_alone_is_named() -> None:
    rates = np.array([0.0, 0.1, -0.1, 0.2, -0.2, 100.0])
    assert agreement(line(rates, rates, np.random.default_rng(4)), "residual").unchecked == ("R5",)


def test_a_mislabelled_rate_is_named_in_the_warnings() -> None:
    """A rate recorded under another's label: its residual is far beyond the noise."""
    labels = [f"R{n}" for n in range(len(RATES))]
    true = RATES.copy()
    true[[7, 8]] = true[[8, 7]]
    draw = np.random.default_rng(5)
    recorded = tuple(
        noisy(segment(label, motion=Spin(np.radians(planned))), {"gyro": 1.001 * rate}, "deg/s", 0.01, draw)
        for label, planned, rate in zip(labels, RATES, true, strict=True)
    )
    request = EstimateRequest(
        "line", recorded, ScaleFactorParameters(outputs=("gyro",)), Site(0.7, 9.8), sensor("gyro", unit="deg/s")
    )
    warnings = " ".join(ScaleFactor().estimate(request).warnings)
    assert "'R7'" in warnings and "'R8'" in warnings
