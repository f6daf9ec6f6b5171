"""A straight line through rates: certified data, hand-worked metrics, units and uncertainties."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np
import pytest
from recorded import from_means, noisy, segment, sensor

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators import method
from planrunner.estimators.analysis import combined
from planrunner.estimators.interface import Design, DesignRequest, Estimate, EstimateRequest, EstimationError, Setup
from planrunner.estimators.scale_factor import ScaleFactor, ScaleFactorParameters
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.physics.earth import Site
from planrunner.plan.quantity import parse_quantity
from planrunner.plan.schedule import Rock, Spin
from planrunner.uncertainty.influences import InputQuantity, Inputs

SITE = Site(math.radians(40.0))
DEG = math.pi / 180
NOTHING = Setup()

# NIST StRD "Norris": reference and instrument readings; certified line and standard deviations.
NORRIS = """0.2 0.1 337.4 338.8 118.2 118.1 884.6 888.0 10.1 9.2 226.5 228.1 666.3 668.5 996.3 998.5 448.6 449.1 777.0 778.9
558.2 559.2 0.4 0.3 0.6 0.1 775.5 778.1 666.9 668.8 338.0 339.3 447.5 448.9 11.6 10.8 556.0 557.7 228.1 228.3 995.8 998.0 887.6 888.8
120.2 119.6 0.3 0.3 0.3 0.6 556.8 557.6 339.1 339.3 887.2 888.0 999.0 998.5 779.0 778.9 11.1 10.2 118.3 117.6 229.2 228.9 669.1 668.4
448.9 449.2 0.5 0.2"""


def line(
    rates: np.ndarray,
    outputs: np.ndarray,
    unit: str = "deg/s",
    error: object = 0.01,
    setup: Setup = NOTHING,
    **keys: Any,
) -> Estimate:
    errors = np.broadcast_to(np.asarray(error, dtype=float), rates.shape)
    recorded = tuple(
        from_means(segment(f"R{n}", motion=Spin(rate * DEG)), {"gyro": value}, unit, [own])
        for n, (rate, value, own) in enumerate(zip(rates, outputs, errors, strict=True))
    )
    return fitted(recorded, unit, setup, **keys)


def fitted(recorded: tuple[RecordedSegment, ...], unit: str = "deg/s", setup: Setup = NOTHING, **keys: Any) -> Estimate:
    parameters = ScaleFactorParameters(outputs=("gyro",), **keys)
    request = EstimateRequest("scale", recorded, parameters, SITE, sensor("gyro", unit=unit), setup=setup)
    return combined(ScaleFactor().estimate(request))


def test_certified_line() -> None:
    data = np.array([float(cell) for cell in NORRIS.split()]).reshape(-1, 2)
    found = line(data[:, 1], data[:, 0], "pulse/s")
    swapped = line(data[:, 0], data[:, 1], "pulse/s")
    certified = (1.00211681802045, 0.429796848199937e-03, -0.262323073774029, 0.232818234301152)
    best = next(one for one in (found, swapped) if one["K_gyro"].value == pytest.approx(certified[0], rel=1e-9))
    assert best["K_gyro"].standard_uncertainty == pytest.approx(certified[1], rel=1e-8)
    assert best["F0_gyro"].value == pytest.approx(certified[2], rel=1e-8)
    assert best["F0_gyro"].standard_uncertainty == pytest.approx(certified[3], rel=1e-8)
    assert best["K_gyro"].unit == "(pulse/s)/(deg/s)"
    assert best["K_gyro"].degrees_of_freedom == 34


def test_metrics_by_hand() -> None:
    """F = 2 + ω·(3 + d) for ω > 0 and 2 + ω·(3 − d) for ω < 0, at ±1, ±2 and 0: asymmetry 2·2d/6."""
    d = 0.003
    rates = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    found = line(rates, 2 + 3 * rates + d * np.abs(rates))
    assert found["asymmetry_gyro"].value == pytest.approx(4e6 * d / 6, rel=1e-9)
    assert found["K_gyro"].value == pytest.approx(3.0)
    assert found["F0_gyro"].value == pytest.approx(2 + d * 6 / 5)
    # Residuals d·(|ω| − 1.2): the largest is 1.2·d at rest; the largest output is 2 + 6 + 2·d.
    assert found["nonlinearity_gyro"].value == pytest.approx(1e6 * 1.2 * d / (8 + 2 * d), rel=1e-9)


def test_rates_of_one_sign_have_no_asymmetry() -> None:
    found = line(np.array([1.0, 2.0, 3.0]), np.array([1.1, 2.0, 3.1]))
    assert "asymmetry_gyro" not in [item.name for item in found.coefficients]
    assert any("the same sign" in note for note in found.notes)


@pytest.mark.parametrize(("unit", "factor"), [("deg/s", 1.0), ("rad/s", 180 / math.pi), ("deg/h", 1 / 3600)])
def test_an_output_that_is_a_rate_gives_a_plain_ratio(unit: str, factor: float) -> None:
    rates = np.array([-10.0, 0.0, 10.0, 20.0])
    found = line(rates, 1.003 * rates / factor + 0.5, unit)
    assert found["K_gyro"].value == pytest.approx(1.003, rel=1e-12)
    assert found["K_gyro"].unit == "1"
    assert found["F0_gyro"].unit == unit


def test_within_segment_uncertainty_by_hand() -> None:
    """Equal noise s at ω = −1, 0, 1: u(K) = s/√2, u(F0) = s/√3."""
    found = line(np.array([-1.0, 0, 1]), np.array([-1.0, 0, 1.0]), error=0.02, uncertainty="within_segment")
    assert found["K_gyro"].standard_uncertainty == pytest.approx(0.02 / math.sqrt(2))
    assert found["F0_gyro"].standard_uncertainty == pytest.approx(0.02 / math.sqrt(3))
    assert found["K_gyro"].degrees_of_freedom == pytest.approx(3 * 31)


def test_uncertainty_of_the_rate_is_common_to_all() -> None:
    relative = parse_quantity("100 ppm")
    rates = np.array([-1.0, 0, 1])
    keys: dict[str, Any] = {"error": 0.02, "uncertainty": "within_segment"}
    plain, added = line(rates, 500 * rates, **keys), line(rates, 500 * rates, rate_uncertainty=relative, **keys)
    expected = math.hypot(plain["K_gyro"].standard_uncertainty, 500 * 1e-4)
    assert added["K_gyro"].standard_uncertainty == pytest.approx(expected, rel=1e-9)
    assert added["K_gyro"].degrees_of_freedom > plain["K_gyro"].degrees_of_freedom


def test_part_between_segments_makes_chi_square_one() -> None:
    """Segments with offsets of their own, of 1 deg/s, beside which the noise of their samples is small and unequal: the weights level
    out, and the quietest segment does not draw the line to itself."""
    draw = np.random.default_rng(0)
    rates = np.linspace(-100, 100, 21)
    offsets = draw.normal(0, 1.0, 21)
    errors = np.full(21, 0.1)
    errors[-1] = 0.0001
    recorded = tuple(
        noisy(segment(f"R{n}", motion=Spin(rate * DEG)), {"gyro": rate + offset}, "deg/s", error, draw)
        for n, (rate, offset, error) in enumerate(zip(rates, offsets, errors, strict=True))
    )
    found, equal = fitted(recorded), fitted(recorded, weights="equal")
    assert found["K_gyro"].value == pytest.approx(equal["K_gyro"].value, abs=0.1 * equal["K_gyro"].standard_uncertainty)
    assert found["K_gyro"].standard_uncertainty == pytest.approx(equal["K_gyro"].standard_uncertainty, rel=0.05)
    assert any("include scatter between segments" in note for note in found.notes)


def test_an_output_that_never_changes_has_no_asymmetry() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = line(np.array([-2.0, -1.0, 1.0, 2.0]), np.zeros(4), weights="equal")
    assert found["K_gyro"].value == 0.0
    assert "asymmetry_gyro" not in [item.name for item in found.coefficients]


def test_refusals() -> None:
    with pytest.raises(EstimationError, match="same rate"):
        line(np.array([5.0, 5.0, 5.0]), np.array([1.0, 2, 3]))
    with pytest.raises(EstimationError, match="not a unit of angular rate"):
        line(np.array([1.0, 2, 3]), np.array([1.0, 2, 3]), rate_unit="m/s^2")
    rocking = from_means(segment("K", motion=Rock(0.1, 1.0, (0.0,), 5.0)), {"gyro": 1.0}, "deg/s", [0.1])
    request = EstimateRequest("s", (rocking,), ScaleFactorParameters(outputs=("gyro",)), SITE, sensor("gyro"))
    with pytest.raises(EstimationError, match="'K' has no constant rate"):
        ScaleFactor().estimate(request)


@pytest.mark.parametrize(
    ("output", "unit", "K", "rate", "words"),
    [
        ("gyro_z", "deg/s", None, 399.9, ""),
        ("gyro_z", "deg/s", None, -401.0, "would show 401 deg/s in 'R1', beyond its full scale of 400 deg/s"),
        ("gyro_x", "deg/s", None, -401.0, ""),  # across the rotation axis
        ("accel_z", "m/s^2", None, 401.0, ""),
        ("gyro_z", "pulse/s", 2.0 / DEG, 250.0, "would show 500 pulse/s"),  # 2 pulses a degree, 400 pulses/s at most
        ("gyro_z", "pulse/s", 2.0 / DEG, 150.0, ""),
    ],
)
def test_rates_beyond_the_full_scale_are_refused(output: str, unit: str, K: float, rate: float, words: str) -> None:
    model = SensorModel("gyro", (OutputModel(output, unit, 400.0),), 100.0, {} if K is None else {f"K_{output}": K})
    planned = tuple(segment(f"R{n}", np.eye(3), Spin(one * DEG)) for n, one in enumerate((10.0, rate, 5.0)))
    parameters = ScaleFactorParameters(outputs=(output,))
    found = method.designed(ScaleFactor(), DesignRequest("s", planned, parameters, SITE, model)).remarks
    across = [("physics-input-axis", False)] if output == "gyro_x" else []
    assert [(one.code, one.error) for one in found] == ([("physics-full-scale", True)] if words else across)
    assert all(words in one.message for one in found)


def test_design_is_sound_only_with_two_rates() -> None:
    from planrunner.design.identifiability import identify

    outputs = (OutputModel("gyro", "deg/s", noise=NoiseModel(0.1)),)
    model = SensorModel("gyro", outputs, 100.0, {"K_gyro": 1.0})

    def designed(rates: list[float]) -> Design:
        planned = tuple(segment(f"R{n}", motion=Spin(rate * DEG)) for n, rate in enumerate(rates))
        return method.designed(ScaleFactor(), DesignRequest("s", planned, ScaleFactorParameters(), SITE, model))

    (sound,) = identify(designed([-100, 0, 100]))
    assert sound.sound
    (poor,) = identify(designed([100, 100]))
    assert poor.unidentifiable == ("offset", "rate")
    predicted = next(one for one in designed([-100, 0, 100]).predicted if one.name == "K_gyro")
    assert predicted.standard_uncertainty == pytest.approx(0.1 / math.sqrt(120) / (100 * math.sqrt(2)), rel=1e-9)


HELD = Setup(inputs=Inputs({"table rate": InputQuantity("table rate", 0.0, "1", 1e-5)}))
RATES = np.array([300.0, -300, 60, -60, 1, -1])


def course(rates: np.ndarray) -> np.ndarray:
    """An output with an offset, a cubic part and an asymmetry, so that no metric is zero."""
    return 2 + 500 * rates + 1e-5 * rates**3 + 0.02 * np.abs(rates)


@pytest.mark.parametrize("basis", ["residual", "within_segment"])
def test_each_rates_own_error_by_brute_force(basis: str) -> None:
    """One commanded rate is really 1e-7 more: all four figures move as the budget says, on either basis."""
    stated = line(RATES, course(RATES), setup=HELD, uncertainty=basis)
    item = next(one for one in stated.influences if one.quantity.name == "table rate")
    assert item.parts == tuple(f"{rate:g} deg/s" for rate in sorted(RATES))
    assert item.in_scatter == (basis == "residual")
    nominal = np.array([one.value for one in stated.coefficients])
    for k, rate in enumerate(sorted(RATES)):
        really = np.where(rate == RATES, RATES * (1 + 1e-7), RATES)
        # Only the linear part moves in the budget's linear model: the cubic and asymmetric ones are kept as they are.
        found = line(RATES, course(RATES) + 500 * (really - RATES), setup=HELD, uncertainty=basis)
        change = (np.array([one.value for one in found.coefficients]) - nominal) / 1e-7
        assert -item.sensitivities[:, k] == pytest.approx(change, rel=5e-3, abs=1.0)


def test_budget_of_a_scale_factor_by_hand() -> None:
    """Equal noise s = 0.02 at ω = ±1 and 0: u(K) = s/√2 from the data; errors of two rates give K·u/√2, a common one K·u."""
    rates = np.array([-1.0, 0, 1])
    keys: dict[str, Any] = {"error": 0.02, "uncertainty": "within_segment", "setup": HELD}
    found = line(rates, 500 * rates, rate_uncertainty=parse_quantity("20 ppm"), **keys)
    budget = next(one for one in found.budgets if one.coefficient == "K_gyro")
    shown = {one.quantity: one.contribution for one in budget.lines}
    assert shown == pytest.approx(
        {"data": 0.02 / math.sqrt(2), "table rate": 500e-5 / math.sqrt(2), "table rate, common": 500 * 2e-5}
    )
    assert {one.quantity: (one.source, one.unit) for one in budget.lines}["table rate, common"] == (
        "plan estimates.scale.rate_uncertainty",
        "ppm",
    )
    assert not any("treated as exact" in note for note in found.notes)


def test_check_foresees_the_rates_errors() -> None:
    rates = np.array([-1.0, 0, 1]) * DEG
    model = SensorModel(
        "gyro",
        (OutputModel("gyro", "pulse/s", noise=NoiseModel(white=0.02 * math.sqrt(120))),),
        100.0,
        {"K_gyro": 500.0 / DEG},
    )
    segments = tuple(segment(f"R{n}", motion=Spin(rate)) for n, rate in enumerate(rates))
    parameters = ScaleFactorParameters(outputs=("gyro",), rate_uncertainty=parse_quantity("20 ppm"))
    design = method.designed(ScaleFactor(), DesignRequest("s", segments, parameters, SITE, model, setup=HELD))
    predicted = next(one for one in design.predicted if one.name == "K_gyro")
    expected = math.sqrt(0.02**2 / 2 + (500 * 1e-5) ** 2 / 2 + (500 * 2e-5) ** 2)
    assert predicted.standard_uncertainty == pytest.approx(expected, rel=1e-6)
