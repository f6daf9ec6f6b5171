"""Compensation on verification positions: sums by hand, the predicted ratio by simulation written apart, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
from recorded import figure, from_means, noisy, segment, sensor
from test_flexure_gyro_static import CHANNELS, OPTIMAL, SITE, TRUTH, _row, attitude, pulses

from planrunner.estimators.flexure_gyro.compensation_prediction import expected_sums
from planrunner.estimators.flexure_gyro.compensation_residual import (
    CompensationResidual,
    CompensationResidualParameters,
)
from planrunner.estimators.flexure_gyro.flexure_gyro_static import FlexureGyroStatic, FlexureGyroStaticParameters
from planrunner.estimators.interface import DesignRequest, Estimate, EstimateRequest, EstimationError
from planrunner.estimators.method import designed
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel

TRADITIONAL = {
    "T1": "north west up",
    "T2": "west south up",
    "T3": "south east up",
    "T4": "east north up",
    "T5": "west up north",
    "T6": "up east north",
    "T7": "east down north",
    "T8": "down west north",
}
VERIFY = {"V1": "up west south", "V2": "west north down", "V3": "east up south"}


def recorded(positions: dict[str, str], noise: np.ndarray | np.random.Generator, error: float) -> tuple:
    """noise: of the means, or a generator of samples whose means scatter by `error`; pulse/s."""
    if isinstance(noise, np.random.Generator):
        return tuple(
            noisy(
                segment(label, attitude(words)),
                dict(zip(CHANNELS, pulses(attitude(words)), strict=True)),
                "pulse/s",
                error,
                noise,
            )
            for label, words in positions.items()
        )
    return tuple(
        from_means(
            segment(label, attitude(words)),
            dict(zip(CHANNELS, np.add(pulses(attitude(words)), row), strict=True)),
            "pulse/s",
            error,
        )
        for (label, words), row in zip(positions.items(), noise, strict=True)
    )


def calibrated(
    name: str, positions: dict[str, str], noise: np.ndarray | np.random.Generator, error: float = 0.03
) -> Estimate:
    request = EstimateRequest(
        name, recorded(positions, noise, error), FlexureGyroStaticParameters(), SITE, sensor(*CHANNELS)
    )
    return FlexureGyroStatic().estimate(request)


def compare(uses: dict[str, Estimate], noise: np.ndarray | np.random.Generator, error: float = 0.03) -> Estimate:
    parameters = CompensationResidualParameters(trials=20_000)
    segments = recorded(VERIFY, noise, error)
    return CompensationResidual().estimate(
        EstimateRequest("residual", segments, parameters, SITE, sensor(*CHANNELS), uses)
    )


def test_perfect_coefficients_leave_the_verification_noise() -> None:
    """ω residual = M⁻¹·noise; M from the chosen scale factors and angles by the source's formulas."""
    noise = np.array([[0.1, -0.2], [0.05, 0.3], [-0.4, 0.15]])
    zero = np.zeros((8, 2))
    uses = {"drift": calibrated("drift", OPTIMAL, zero), "traditional": calibrated("traditional", TRADITIONAL, zero)}
    found = compare(uses, noise)
    e, x = (np.radians(TRUTH[name] / 60) for name in ("epsilon", "xi"))
    m = np.array([[np.cos(e + x), np.sin(e + x)], [-np.sin(e), np.cos(e)]]) / np.cos(x)
    m /= np.array([[TRUTH["SF_Y"]], [TRUTH["SF_X"]]])
    expected = np.linalg.solve(m, noise.T).T
    assert found["RSS_drift"].value == pytest.approx(np.sum(expected**2), rel=1e-6)
    assert found["RSS_drift"].unit == "(deg/h)^2"
    assert found["ratio_traditional_to_drift"].value == pytest.approx(1.0, rel=1e-6)
    table = next(table for table in found.tables if table.title == "Residuals after compensation")
    assert table.headings == (
        "position",
        "'drift': ω_Y [deg/h]",
        "'drift': ω_X [deg/h]",
        "'traditional': ω_Y [deg/h]",
        "'traditional': ω_X [deg/h]",
    )
    assert table.rows[1][1:3] == pytest.approx(expected[1], rel=1e-5)


def test_expected_ratio_and_its_range_against_simulation_written_apart() -> None:
    """Each of 16 campaigns of samples knows the noise of its sets to some 5 %, and with it the ratio."""
    rng = np.random.default_rng(0)
    campaigns = [
        compare(
            {
                "drift": calibrated("drift", OPTIMAL, rng),
                "traditional": calibrated("traditional", TRADITIONAL, rng),
            },
            rng,
        )
        for _ in range(16)
    ]
    rows = np.array([[figure(cell) for cell in one.tables[0].rows[0][2:]] for one in campaigns])
    row = rows.mean(axis=0)
    sums = {}
    check = np.array([_row(attitude(words)) for words in VERIFY.values()])
    noise = rng.normal(size=(40_000, 3, 2))
    for name, positions in (("drift", OPTIMAL), ("traditional", TRADITIONAL)):
        matrix = np.array([_row(attitude(words)) for words in positions.values()])
        wrong = np.einsum("pn,rnk->rpk", np.linalg.pinv(matrix), rng.normal(size=(40_000, 8, 2)))
        sums[name] = np.sum((noise - np.einsum("vp,rpk->rvk", check, wrong)) ** 2, axis=(1, 2))
    ratio = sums["traditional"] / sums["drift"]
    assert row[0] == pytest.approx(sums["traditional"].mean() / sums["drift"].mean(), rel=0.03)
    assert row[1:] == pytest.approx(np.quantile(ratio, (0.5, 0.05, 0.95)), rel=0.05)
    assert (np.abs(rows[:, 0] / row[0] - 1) < 0.2).all()
    assert 1.08 <= row[0] <= 1.51  # what the methods' check found for sets of three cardinal positions
    assert any("4 to 8" in note for note in campaigns[0].notes)


def test_design_predicts_the_same_ratio() -> None:
    outputs = tuple(OutputModel(name, "pulse/s", noise=NoiseModel(0.3)) for name in CHANNELS)
    model = SensorModel("flexure-gyro", outputs, 10.0)

    def planned(positions: dict[str, str]) -> tuple:
        return tuple(segment(label, attitude(words)) for label, words in positions.items())

    designs = {
        name: designed(
            FlexureGyroStatic(), DesignRequest(name, planned(positions), FlexureGyroStaticParameters(), SITE, model)
        )
        for name, positions in (("drift", OPTIMAL), ("traditional", TRADITIONAL))
    }
    request = DesignRequest("r", planned(VERIFY), CompensationResidualParameters(), SITE, model, designs)
    design = designed(CompensationResidual(), request)
    check = np.array([_row(attitude(words)) for words in VERIFY.values()])
    expected = []
    for positions in (OPTIMAL, TRADITIONAL):
        matrix = np.array([_row(attitude(words)) for words in positions.values()])
        expected.append(3 + np.trace(check @ np.linalg.inv(matrix.T @ matrix) @ check.T))
    assert design.extra["ratios"]["ratio_traditional_to_drift"] == pytest.approx(expected[1] / expected[0], rel=1e-9)


def test_noise_of_the_calibration_enters_the_expected_sums_as_its_variance() -> None:
    """Two outputs, a bias alone: the mean of n observations of standard deviations σ_i, by their weights, has the variance 1/Σσ_i⁻²."""
    sigma = np.array([[1.0, 2.0, 4.0], [3.0, 3.0, 3.0]])
    verification = np.ones((5, 1))
    (found,) = expected_sums(verification, ((np.ones((3, 1)), sigma),))
    assert found == pytest.approx(sum(5 * (1 + 1 / np.sum(own**-2)) for own in sigma), rel=1e-12)


def test_refusals() -> None:
    drift = calibrated("drift", OPTIMAL, np.zeros((8, 2)))
    with pytest.raises(EstimationError, match="two or more sets"):
        compare({"drift": drift}, np.ones((3, 2)))
    other = Estimate("scale", "scale_factor", (), np.zeros((0, 0)))
    with pytest.raises(EstimationError, match="'scale' is not a set of the twelve"):
        compare({"drift": drift, "scale": other}, np.ones((3, 2)))
