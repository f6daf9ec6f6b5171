"""Derivatives by the complex step: against those by hand, and for each formula of an estimator against central differences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from planrunner.base.arrays import Array
from planrunner.error_model.terms import error_model
from planrunner.estimators.accelerometer.gravity_magnitude import fit_magnitude
from planrunner.estimators.flexure_gyro.compensation_influences import sums_and_ratios
from planrunner.estimators.imu.coefficients import Response, calibration
from planrunner.estimators.tilted.evaluation import over_temperature
from planrunner.estimators.tilted.fixture_gains import polar
from planrunner.estimators.tilted.mounted_axes import MountedAxes
from planrunner.plan.units import unit
from planrunner.uncertainty.derivatives import Formula, angle_of, jacobian, length

RNG = np.random.default_rng(11)


def by_differences(formula: Formula, at: Array, sizes: Array | float = 1.0) -> Array:
    """(q, p), to some 1e-9 of the derivative. sizes: of the parameters."""
    steps = 1e-5 * np.broadcast_to(sizes, at.shape)
    moved = np.diag(steps)
    return np.asarray((formula(at[:, None] + moved) - formula(at[:, None] - moved)) / (2 * steps))


def test_derivatives_are_exact_to_rounding() -> None:
    found = jacobian(lambda x: np.stack([np.sin(x[0]) * x[1], np.sqrt(x[1])]), np.array([0.3, 4.0]))
    expected = [[math.cos(0.3) * 4, math.sin(0.3)], [0.0, 0.25]]
    assert found == pytest.approx(np.array(expected), rel=1e-15)


@pytest.mark.parametrize("degrees", [0, 30, 45, 80, 90, 100, 179.9, 180, -30, -90, -135, -179])
def test_angle_and_length_in_every_quadrant(degrees: float) -> None:
    at = 3.0 * np.array([math.sin(math.radians(degrees)), math.cos(math.radians(degrees))])
    assert angle_of(at[0], at[1]) == pytest.approx(math.atan2(*at), abs=1e-15)
    assert length(at) == pytest.approx(3.0)
    found = jacobian(lambda x: np.stack([angle_of(x[0], x[1]), length(x)]), at)
    expected = [[at[1] / 9, -at[0] / 9], at / 3]
    assert found == pytest.approx(np.array(expected), abs=1e-15)


@pytest.mark.parametrize("lower_triangular", [False, True])
def test_calibration_of_an_imu(lower_triangular: bool) -> None:
    gyro, accel = (
        error_model(("bias", "rate_x", "rate_y", "rate_z", "accel_x")),
        error_model(("bias", "accel_x", "accel_y", "accel_z")),
    )
    if lower_triangular:
        gyro = error_model(("bias", "rate_x", "rate_y", "rate_z", "accel_x", "accel_y", "accel_z"))
    responses = []
    for kind, model, text in (("gyro", gyro, "deg/s"), ("accel", accel, "g")):
        values = RNG.normal(0, 0.1, (3, len(model.names)))
        values[:, 1:4] += np.eye(3)
        responses.append(Response(kind, (unit(text),) * 3, model, values / unit(text).factor))
    made = calibration(responses, lower_triangular)
    at = np.concatenate([one.values.ravel() for one in responses])
    expected = by_differences(made.formula, at)
    assert len(expected) == len(made.quantities)
    assert jacobian(made.formula, at) == pytest.approx(expected, rel=1e-6, abs=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("gain", [(0.4, 0.3, 0.9), (-0.4, -0.3, 0.9), (-0.4, 0.3, -0.9), (0.4, 0.9), (-0.4, 0.9)])
def test_polar_form_of_a_gain(gain: tuple[float, ...]) -> None:
    axes = MountedAxes(("x",), ("gyro_x",), np.array([math.radians(54.7)]), np.array([math.radians(200)]))
    basis = np.eye(3) if len(gain) == 3 else np.array([[1.0, 0, 0], [0, 0, 1.0]]).T
    at = np.array(gain)
    formula = polar(at, basis, axes, 0)
    assert abs(formula(at[:, None])[0, 0]) == pytest.approx(np.linalg.norm(at))
    assert jacobian(formula, at) == pytest.approx(by_differences(formula, at), rel=1e-8, abs=1e-9)


def test_change_of_a_scale_factor_over_temperature() -> None:
    kelvin, values = np.array([233.0, 298.0, 343.0]), np.array([1.001, 1.0, 0.997])

    def formula(k: Array) -> Array:
        return over_temperature(k, kelvin, 1, 2)

    assert formula(values[:, None])[1, 0] == pytest.approx(0.003 / 45)
    assert jacobian(formula, values) == pytest.approx(by_differences(formula, values), rel=1e-6, abs=1e-9)


def test_sums_of_squares_and_their_ratios() -> None:
    residuals = RNG.normal(size=12)
    assert jacobian(lambda x: sums_and_ratios(x, 2), residuals) == pytest.approx(
        by_differences(lambda x: sums_and_ratios(x, 2), residuals), rel=1e-7, abs=1e-8
    )


def test_magnitude_of_gravity() -> None:
    """Of a perfect triad |f| grows along the force as one, and falls with scale factors by the squares of the direction's parts."""
    directions = RNG.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = fit_magnitude(9.8 * directions, 9.8)
    assert found.directions == pytest.approx(directions, abs=1e-9)
    expected = np.column_stack(
        [
            -directions,
            -9.8 * directions**2,
            *(-9.8 * directions[:, i] * directions[:, j] for i, j in ((0, 1), (0, 2), (1, 2))),
        ]
    )
    assert found.jacobian == pytest.approx(expected, abs=1e-8)
