"""Residuals that are smaller, by chance, than the noise within the segments permits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from recorded import played, segment, sensor
from scipy.stats import f, t

from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import Estimate, EstimateRequest, Setup
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.physics.earth import Site
from planrunner.plan.schedule import Spin
from planrunner.uncertainty.decision import expanded_uncertainty

RATES = np.array([50.0, -50.0, 100.0, -100.0, 200.0, -200.0, 0.0])  # deg/s
SAMPLES = 320
NOISE = 0.01  # deg/s, of a mean
WORD = "significantly smaller than the noise"


def estimate(means: np.ndarray, draw: np.random.Generator) -> Estimate:
    """The line through segments with exactly these means and white noise about them."""
    recorded = []
    for number, (rate, mean) in enumerate(zip(RATES, means, strict=True)):
        noise = NOISE * np.sqrt(SAMPLES) * draw.standard_normal((1, SAMPLES))
        made = mean + noise - noise.mean()
        planned = segment(f"R{number}", motion=Spin(float(np.radians(rate))))
        recorded.append(played(planned, {"gyro": 0.0}, made, "deg/s", 400.0 * number))
    request = EstimateRequest(
        "scale",
        tuple(recorded),
        ScaleFactorParameters(outputs=("gyro",), drift=("none",)),
        Site(0.7),
        sensor("gyro", unit="deg/s"),
        setup=Setup(),
    )
    return combined(ScaleFactor().estimate(request))


def means_with(ratio: float, draw: np.random.Generator) -> np.ndarray:
    """Means whose residuals have `ratio` times the variance of the noise."""
    columns = np.column_stack([np.ones(len(RATES)), RATES])
    means = draw.standard_normal(len(RATES))
    fitted = columns @ np.linalg.lstsq(columns, means, rcond=None)[0]
    left = means - fitted
    line = 0.4 + 1.01 * RATES
    return line + left * NOISE * np.sqrt(ratio * (len(RATES) - 2) / (left @ left))


def test_the_noise_is_a_lower_bound() -> None:
    """With a twentieth of the expected variance, u follows from the noise: σ/√n and σ/√Σω², with the degrees of freedom of the noise."""
    found = estimate(means_with(0.05, np.random.default_rng(1)), np.random.default_rng(2))
    size = found["F0_gyro"].standard_uncertainty * np.sqrt(len(RATES))
    assert size == pytest.approx(NOISE, rel=0.2)
    assert found["K_gyro"].standard_uncertainty == pytest.approx(size / np.sqrt(np.sum(RATES**2)), rel=1e-9)
    for name in ("F0_gyro", "K_gyro", "asymmetry_gyro", "nonlinearity_gyro"):
        assert found[name].degrees_of_freedom > 200
    assert any(WORD in note for note in found.notes)


def test_residuals_as_small_as_chance_permits_stay_the_basis() -> None:
    """Just above the 1 % quantile of F, u follows from the residuals."""
    freedom = len(RATES) - 2
    ratio = 1.2 * float(f.ppf(0.01, freedom, 1e6))
    found = estimate(means_with(ratio, np.random.default_rng(3)), np.random.default_rng(4))
    assert found["F0_gyro"].standard_uncertainty == pytest.approx(NOISE * np.sqrt(ratio / len(RATES)), rel=1e-9)
    assert found["F0_gyro"].degrees_of_freedom == freedom
    assert not any(WORD in note for note in found.notes)


def test_intervals_of_runs_with_small_residuals_hold_the_truth() -> None:
    """Of many tests, those whose residuals are below a hundredth of chance. The errors of a line do not depend on its residuals, so an
    interval from such residuals would hold the truth much too rarely."""
    draw = np.random.default_rng(5)
    columns = np.column_stack([np.ones(len(RATES)), RATES])
    means = 0.4 + 1.01 * RATES + NOISE * draw.standard_normal((20_000, len(RATES)))
    left = means - means @ np.linalg.pinv(columns).T @ columns.T
    freedom = len(RATES) - 2
    variance = np.sum(left**2, axis=1) / freedom
    small = means[variance < 0.7 * NOISE**2 * f.ppf(0.01, freedom, 1e6)][:60]
    assert len(small) == 60
    held, narrow = 0, 0
    for own in small:
        found = estimate(own, draw)
        for name, truth in (("F0_gyro", 0.4), ("K_gyro", 1.01)):
            one = found[name]
            error = abs(one.value - truth)
            held += error <= expanded_uncertainty(one.standard_uncertainty, one.degrees_of_freedom)
        residual = own - columns @ np.linalg.lstsq(columns, own, rcond=None)[0]
        scatter = np.sqrt(residual @ residual / freedom / len(RATES))
        narrow += abs(found["F0_gyro"].value - 0.4) <= t.ppf(0.975, freedom) * scatter
    assert 107 <= held <= 119  # 95 % of 120, three binomial standard deviations
    assert narrow < 48  # of 60


def uneven(weights: str, means: Mapping[str, np.ndarray], larger: float, draw: np.random.Generator) -> Estimate:
    """Outputs with these means. At ±200 deg/s, their noise is `larger` times as large as in the other segments."""
    recorded = []
    for number, rate in enumerate(RATES):
        size = NOISE * np.sqrt(SAMPLES) * (larger if abs(rate) == 200.0 else 1.0)
        noise = size * draw.standard_normal((len(means), SAMPLES))
        planned = segment(f"R{number}", motion=Spin(float(np.radians(rate))))
        made = noise - noise.mean(axis=1, keepdims=True)
        own = {name: float(values[number]) for name, values in means.items()}
        recorded.append(played(planned, own, made, "deg/s", 400.0 * number))
    parameters = ScaleFactorParameters(outputs=tuple(means), drift=("none",), weights=weights)
    model = sensor(*means, unit="deg/s")
    request = EstimateRequest("scale", tuple(recorded), parameters, Site(0.7), model, setup=Setup())
    return combined(ScaleFactor().estimate(request))


@pytest.mark.parametrize("larger", [5.0, 20.0])
def test_equal_weights_with_uneven_noise(larger: float) -> None:
    """1 % of the residuals are significantly small. Divided by the mean variance of all segments, a quarter of them seemed to be."""
    draw, small = np.random.default_rng(6), 0
    sizes = NOISE * np.where(np.abs(RATES) == 200.0, larger, 1.0)
    for _ in range(60):
        means = 0.4 + 1.01 * RATES + sizes * draw.standard_normal(len(RATES))
        small += any(WORD in note for note in uneven("equal", {"gyro": means}, larger, draw).notes)
    assert small <= 3


def test_scatter_between_segments_of_another_output() -> None:
    """The scatter of the second output needs an addition to its weights. The residuals of the first output are still too small."""
    draw = np.random.default_rng(7)
    means = {"gyro": means_with(0.02, draw), "other": means_with(1e4, draw)}
    found = uneven("noise", means, 3.0, draw)
    assert [note.split(":")[0] for note in found.notes if WORD in note] == ["gyro"]
    assert any("scatter between segments" in note and note.startswith("other") for note in found.notes)
