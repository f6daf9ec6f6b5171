"""The weights of a fit are computed once, however many drifts are tried with them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from recorded import noisy, segment, sensor

from planrunner.estimators import least_squares
from planrunner.estimators.outputs_fit import fit_outputs
from planrunner.observation.correlated_errors import CorrelatedError
from planrunner.observation.drift import DriftCourses, in_time
from planrunner.observation.observations import observe
from planrunner.uncertainty.influences import InputQuantity


@pytest.mark.parametrize("equal", [False, True])
def test_correlated_weights_take_one_factorisation_each(monkeypatch: pytest.MonkeyPatch, equal: bool) -> None:
    factorised = []
    whitener: Callable[[np.ndarray], np.ndarray] = least_squares.whitener

    def counted(covariance: np.ndarray) -> np.ndarray:
        factorised.append(covariance)
        return whitener(covariance)

    monkeypatch.setattr(least_squares, "whitener", counted)
    n, draw = 20, np.random.default_rng(1)
    errors = np.where(np.arange(n) % 2, 1e-3, 2e-3)
    recorded = [
        noisy(segment(f"R{k}"), {"gyro": float(value)}, "deg/s", float(errors[k]), draw, 200.0 * k)
        for k, value in enumerate(5.0 + np.linspace(-1, 1, n))
    ]
    seen = observe(recorded, ["gyro"], sensor("gyro", unit="deg/s"))
    common = CorrelatedError(InputQuantity("common", 0.0, "deg/s", 1e-3), {0: np.ones((n, 1))})
    courses = DriftCourses(in_time(seen.start, seen.end, seen.seconds))
    found = fit_outputs(
        np.ones((n, 1)), seen, np.ones(1), ("offset",), "residual", equal=equal, effects=[common], drift=courses
    )
    assert "linear" in {course.name for course in found.drift.courses}
    kinds = {covariance.tobytes() for covariance in factorised}
    assert len(factorised) == len(kinds) == (2 if equal else 1)
